"""The page's design and task as a study, to a file and back."""

from pathlib import Path

from torcharm.files import atomic_write
from torcharm.page.state import State, changed_task, design_of, opened, task_of, with_arm, with_task
from torcharm.study import NamedArm, NamedTask, load_study, moved_files, study_to_toml, task_to_toml
from torcharm.study.data import unused_name

EXPLORED = ", explored"
"""What the name of a task ends in whose shape or load was changed."""


def study_text(state: State, out: Path) -> str:
    """The study with the arms as they are on the page; the task that is shown is added to it if it was changed.

    Raises:
        ValueError: the study is from no file, or a force model is none that a study can express.
    """
    study = state.study
    arms = {}
    for number, arm in enumerate(study.arms):
        files = arm.files if state.source is None else moved_files(arm.files, state.source, out)
        arms[arm.name] = NamedArm(arm.name, design_of(state, number), files)
    text = study_to_toml(study, study.name, arms)
    if not changed_task(state):
        return text
    task = NamedTask(_new_name(state), task_of(state), (state.named_arm.name,))
    return f"{text}\n{task_to_toml(task)}"


def save(state: State, out: Path) -> None:
    """Write the study, whole or not at all; an OSError says that the file cannot be written."""
    text = study_text(state, out)
    with atomic_write(out) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def load(state: State, out: Path) -> State:
    """The page of the study that was saved, at the arm of the same name, and at the task that was explored last.

    Raises:
        ValueError: the file cannot be read, or holds no study.
    """
    found = opened(load_study(out), out)
    names = [arm.name for arm in found.study.arms]
    name, task = state.named_arm.name, state.named_task.name.partition(EXPLORED)[0]
    found = with_arm(found, names.index(name)) if name in names else found
    tasks = [one.name for one in found.study.tasks_of(found.named_arm)]
    own = [place for place, one in enumerate(tasks) if one == task or one.startswith(f"{task}{EXPLORED}")]
    return with_task(found, own[-1]) if own else found


def _new_name(state: State) -> str:
    """Of the task, which no other has."""
    names, own = {task.name for task in state.study.tasks}, state.named_task.name
    return unused_name(own if own.endswith(EXPLORED) else f"{own}{EXPLORED}", names)
