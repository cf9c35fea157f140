"""What a report is made of: sections, of tables, sentences and figures, for the template to lay out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from markupsafe import Markup

from torcharm.study import NamedArm, NamedTask, Study, StudyResult
from torcharm.study.built import BuiltStudy
from torcharm.workspaces import Workspace


@dataclass(frozen=True)
class Evaluated:
    """A study, and what was found of its designs.

    Attributes:
        study: what was asked.
        results: of `evaluate_study`, those that there are.
        refused: names of designs that could not be evaluated, by why.
        source: what commands call the study's file.
        built: what was found of designs as they are built; empty where nothing is scattered.
        workspaces: where designs can reach, where that was asked for.
    """

    study: Study
    results: Sequence[StudyResult]
    refused: Mapping[str, Sequence[str]] = field(default_factory=dict)
    source: str = "study.toml"
    built: Sequence[BuiltStudy] = ()
    workspaces: Sequence[tuple[NamedArm, Workspace]] = ()

    def of_arm(self, arm: NamedArm) -> list[StudyResult]:
        """What was found of one design, task by task."""
        return [result for result in self.results if result.arm is arm]

    def of_task(self, task: NamedTask) -> list[StudyResult]:
        """What was found on one task, design by design."""
        return [result for result in self.results if result.task is task]

    @property
    def predicted(self) -> bool:
        """Whether errors were predicted, and not only sets measured."""
        return self.results[0].attainability.prediction is not None

    @property
    def tasks(self) -> list[NamedTask]:
        """Those that something was found on."""
        return [task for task in self.study.tasks if self.of_task(task)]


class Count(NamedTuple):
    """How many loads have a verdict, and the colour in which that is drawn."""

    word: str
    number: int
    colour: str


@dataclass(frozen=True)
class Column:
    """Of a table.

    Attributes:
        title: what is in it.
        unit: of its numbers; "" has none.
        cells: for each row a text, or counts that are drawn as a bar beside the words.
        numeric: whether cells are numbers, which stand at the right.
    """

    title: str
    unit: str
    cells: Sequence[str | Sequence[Count]]
    numeric: bool = True


class Panel(NamedTuple):
    """A figure as inline SVG, of what, and a line below."""

    title: str
    caption: str
    svg: Markup


@dataclass(frozen=True)
class Block:
    """A part of a section, with what there is of a heading, sentences, commands, a table and figures.

    Attributes:
        title: of the part, "" without.
        points: sentences, each by itself, and what it is about, or "".
        commands: that a person may run, and what each does.
        table: columns of one length.
        panels: figures beside each other,
        columns: at most so many.
    """

    title: str = ""
    points: Sequence[tuple[str, str]] = ()
    commands: Sequence[tuple[str, str]] = ()
    table: Sequence[Column] = ()
    panels: Sequence[Panel] = ()
    columns: int = 3


@dataclass(frozen=True)
class Section:
    """One of the report's.

    Attributes:
        title: of the section.
        blocks: its parts.
        text: what it shows, in sentences.
        csv: the same numbers to be copied; "" where there are none.
    """

    title: str
    blocks: Sequence[Block]
    text: str = ""
    csv: str = ""
