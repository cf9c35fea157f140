"""What commands do with the arms of a study, one after the other, so that no arm's mistake and no Ctrl-C costs more."""

import sys
from collections.abc import Callable, Iterable, Sequence, Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from torcharm.cli.terminal import MISTAKE, progress, tell
from torcharm.inputs import check_choice

if TYPE_CHECKING:
    from torcharm.study import NamedArm, Study

MOST_NAMED = 4
"""Of the arms of which the same is asked."""

Told = Callable[..., None]
"""Is told how many steps of a piece of work are done, and words to stand behind the bar."""
Thing = TypeVar("Thing")
Result = TypeVar("Result")


def read_study(path: Path) -> "Study":
    """The study of a file, after what is doubtful about it, on the standard error."""
    from torcharm.study import load_study

    return asked_about(load_study(path))


def asked_about(study: "Study") -> "Study":
    """The study, after what is doubtful about it, on the standard error.

    That is limits that make sense in other units, actuators at one place, and a bending stiffness that was assumed.
    """
    from torcharm.arm_series import segments_of
    from torcharm.attainability.questions import note_on_bending, question_about_limits, question_about_places

    arms: dict[str, list[str]] = {}
    for arm in study.arms:
        segments = segments_of(arm.design)[0]
        for question in (question_about_limits(segments), question_about_places(segments), note_on_bending(segments)):
            if question is not None:
                arms.setdefault(question, []).append(arm.name)
    for question, names in arms.items():
        rest = [f"{len(names) - MOST_NAMED} more"] if len(names) > MOST_NAMED else []
        tell(f"{', '.join([*names[:MOST_NAMED], *rest])}: {question}")
    return study


def arms_named(study: "Study", name: str | None) -> "tuple[NamedArm, ...]":
    """All arms of a study, or that of the name given by --arm."""
    if name is not None:
        check_choice("--arm", name, [arm.name for arm in study.arms])
    return tuple(arm for arm in study.arms if name in (None, arm.name))


@dataclass
class Work:
    """The work of one command.

    Attributes:
        interrupted: whether Ctrl-C came; what was finished before is kept.
        refused: names of arms by why they were refused.
    """

    interrupted: bool = False
    refused: dict[str, list[str]] = field(default_factory=dict)

    def each(
        self,
        what: str,
        pairs: Sequence[tuple["NamedArm", Thing]],
        do: Callable[["NamedArm", Thing, Told], Iterable[Result]],
        steps: int = 1,
    ) -> list[Result]:
        """Do it for each pair of an arm and what it is to be done with, and return all results, with a bar.

        A ValueError costs its pair alone. Ctrl-C ends all; work that takes it itself, and gives what it found until
        then, raises it anew.

        Args:
            what: is done, beside the bar.
            pairs: to do it for.
            do: gives the results of one pair; is also given what to tell how far it is.
            steps: of the bar, for each pair.
        """
        found: list[Result] = []
        with progress(what, steps * len(pairs)) as move:
            try:
                for index, (arm, thing) in enumerate(pairs):

                    def told(done: int, words: str = "", before: int = index * steps) -> None:
                        move(before + done, words)

                    try:
                        for result in do(arm, thing, told):
                            found.append(result)
                    except ValueError as error:
                        self.refused.setdefault(str(error), []).append(arm.name)
                    told(steps)
            except KeyboardInterrupt:
                self.interrupted = True
        return found

    def finish(self, finished: Sized) -> None:
        """Say who was refused, and end the command by an error unless all is well; `finished` is there all the same."""
        for why, names in self.refused.items():
            tell(f"{', '.join(dict.fromkeys(names))}: {why}")
        if self.interrupted:
            raise KeyboardInterrupt(*[] if finished else ["nothing was finished"])
        if self.refused:
            sys.exit(MISTAKE)
