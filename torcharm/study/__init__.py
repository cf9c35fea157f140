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

from torcharm.study.data import NamedArm, NamedTask, Settings, Study
from torcharm.study.key_reference import key_reference
from torcharm.study.reading import example_study, example_text, load_study, paper_study, parse_study
from torcharm.study.results import (
    RESULT_FORMATS,
    StudyResult,
    Summary,
    check_format,
    csv_text,
    evaluate_study,
    result_rows,
    summarise,
    write_results,
    write_rows,
)
from torcharm.study.task_writing import task_to_toml
from torcharm.study.workspaces import workspace_rows
from torcharm.study.writing import arm_to_toml, moved_files, study_to_toml

__all__ = [
    "RESULT_FORMATS",
    "NamedArm",
    "NamedTask",
    "Settings",
    "Study",
    "StudyResult",
    "Summary",
    "arm_to_toml",
    "check_format",
    "csv_text",
    "evaluate_study",
    "example_study",
    "example_text",
    "key_reference",
    "load_study",
    "moved_files",
    "paper_study",
    "parse_study",
    "result_rows",
    "study_to_toml",
    "summarise",
    "task_to_toml",
    "workspace_rows",
    "write_results",
    "write_rows",
]
