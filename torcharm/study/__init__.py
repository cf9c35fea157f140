"""Studies: a TOML file that names arms, tasks and how to evaluate them, and the tables that come of it.

    study = load_study("study.toml")
    results = list(evaluate_study(study))
    write_results("results.csv", results)

`example_text()` is a commented study that shows every section, `key_reference()` one of every key,
`arm_to_toml` and `task_to_toml` write a design and a task as tables of a study, and `study_to_toml` a study
of other arms. Lengths are in metres, angles in radians, forces in newtons, moments in newton-metres,
pressures in kilopascals. Entries of lists (arms, tasks, loads, nodes) are counted from 1, in tables and in
error messages.
"""

from torcharm.study.data import NamedArm as NamedArm, NamedTask as NamedTask, Settings as Settings, Study as Study
from torcharm.study.key_reference import key_reference as key_reference
from torcharm.study.reading import (
    example_study as example_study,
    example_text as example_text,
    load_study as load_study,
    paper_study as paper_study,
    parse_study as parse_study,
)
from torcharm.study.results import (
    RESULT_FORMATS as RESULT_FORMATS,
    StudyResult as StudyResult,
    Summary as Summary,
    csv_text as csv_text,
    evaluate_arm as evaluate_arm,
    evaluate_study as evaluate_study,
    result_rows as result_rows,
    summarise as summarise,
    workspace_rows as workspace_rows,
    write_results as write_results,
    write_rows as write_rows,
)
from torcharm.study.writing import (
    arm_to_toml as arm_to_toml,
    moved_files as moved_files,
    study_to_toml as study_to_toml,
    task_to_toml as task_to_toml,
)
