"""What every command shares: how mistakes are told, where outputs may go, what is printed."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from torcharm.files import atomic_write, check_writable, is_stream

if TYPE_CHECKING:
    from rich.console import Console

    from torcharm.study import Study


FIGURE_FORMATS = ("png", "pdf", "svg", "jpg", "eps")
MISTAKE, INTERRUPTED = 2, 130
MOST_NAMED = 4
"""Of the arms of which the same is asked."""
COMPILING = "torcharm: compiling, once: about {} s"


def fail(message: str, code: int = MISTAKE) -> NoReturn:
    """Say on one line of the standard error what is wrong, and exit."""
    print("torcharm:", " ".join(message.split()), file=sys.stderr)
    sys.exit(code)


@contextmanager
def mistakes() -> Iterator[None]:
    """Report in one line what a person can cause."""
    try:
        yield
    except KeyboardInterrupt as error:
        fail(": ".join(["interrupted", *map(str, error.args)]), INTERRUPTED)
    except BrokenPipeError:
        raise  # whoever read the output has left: no mistake
    except MemoryError:
        fail("not enough memory for this study")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        fail(f"{where}{error.strerror or error}")
    except ValueError as error:
        fail(str(error))


@contextmanager
def as_given(option: str, text: str) -> Iterator[None]:
    """Let a ValueError about an option's value name the option, and tell the value as it was given, unit and all."""
    try:
        yield
    except ValueError as error:
        words, _, got = str(error).rpartition(", got ")
        _, must, allowed = words.partition("must be ")
        _, also, hint = got.partition("; ")
        raise ValueError(f"{option}: {must}{allowed}, got {text}{also}{hint}") from None


def finish(interrupted: bool, finished: Sized, refused: Mapping[str, Sequence[str]]) -> None:
    """Say who was refused, and end the command by an error unless all is well.

    Args:
        interrupted: whether Ctrl-C came.
        finished: what there is to show all the same.
        refused: names of arms by why they were.
    """
    for why, names in refused.items():
        print("torcharm:", " ".join(f"{', '.join(dict.fromkeys(names))}: {why}".split()), file=sys.stderr)
    if interrupted:
        raise KeyboardInterrupt(*[] if finished else ["nothing was finished"])
    if refused:
        sys.exit(MISTAKE)


def asked_about(study: "Study") -> "Study":
    """The study, after what is doubtful about it, on the standard error.

    That is limits that make sense in other units, actuators at one place, and a bending stiffness that was assumed.
    """
    from torcharm.attainability.questions import note_on_bending, question_about_limits, question_about_places
    from torcharm.statics.balance import segments_of

    arms: dict[str, list[str]] = {}
    for arm in study.arms:
        segments = segments_of(arm.design)[0]
        for question in (question_about_limits(segments), question_about_places(segments), note_on_bending(segments)):
            if question is not None:
                arms.setdefault(question, []).append(arm.name)
    for question, names in arms.items():
        rest = [f"{len(names) - MOST_NAMED} more"] if len(names) > MOST_NAMED else []
        print(f"torcharm: {', '.join([*names[:MOST_NAMED], *rest])}: {question}", file=sys.stderr)
    return study


@contextmanager
def compiling_told() -> Iterator[None]:
    """Where the standard error is no terminal, say on it when the engine is compiled; on a terminal the engine does."""
    from numba.core.event import Listener, install_listener

    from torcharm.engine.code_parts import SECONDS

    class Once(Listener):
        told = sys.stderr.isatty()

        def on_start(self, event: object) -> None:
            if not self.told:
                print(COMPILING.format(SECONDS), file=sys.stderr, flush=True)
            self.told = True

        def on_end(self, event: object) -> None:
            pass

    with install_listener("numba:compile", Once()):
        yield


def check_outputs(study: Path | None, out: Path | None, figure: Path | None) -> None:
    """Raise a ValueError about an output that cannot be written, before the work is done."""
    for option, path in (("--out", out), ("--figure", figure)):
        if path is None:
            continue
        check_writable(path, option)
        if study is not None and path.resolve() == study.resolve():
            raise ValueError(f"{option}: {path}: is the study itself, must be another file")
    if figure is None:
        return
    check_ending("--figure", figure, FIGURE_FORMATS)
    if out is not None and out.resolve() == figure.resolve():
        raise ValueError(f"--figure: {figure}: is the file of --out, must be another")


def check_ending(option: str, path: Path | None, allowed: Sequence[str]) -> None:
    """Raise a ValueError unless an output, if there is one, ends in one of the formats allowed, or is a stream."""
    if path is None or path.suffix.lower().removeprefix(".") in allowed or (option == "--out" and is_stream(path)):
        return
    which = f"one of .{', .'.join(allowed)}" if len(allowed) > 2 else f".{' or .'.join(allowed)}"
    raise ValueError(f"{option}: {path}: must end in {which}, got {path.suffix or 'no ending'}")


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[..., None]]:
    """A bar on the standard error, of a terminal only; elsewhere a line if the engine is compiled first.

    Gives a function that moves it on by one; or to so many of the total, as `to=3`, with some words behind the bar.
    """
    if not sys.stderr.isatty():
        with compiling_told():
            yield lambda to=None, words="": None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress, TextColumn

    columns = (*Progress.get_default_columns(), TextColumn("{task.fields[words]}", markup=False))
    console = Console(stderr=True)
    with compiling_told(), Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(escape(what), total=total, words="")

        def move(to: int | None = None, words: str = "") -> None:
            bar.update(task, advance=1 if to is None else None, completed=to, words=words)

        yield move


def save_all(console: "Console", outputs: Iterable[tuple[Path, Callable[[Path], object], str]]) -> None:
    """Write each output whole and say so; a failure costs no other output, and is an error at the end.

    Args:
        console: to say it.
        outputs: where to, what writes the file whose name it is given, and what to say after `Wrote ...` then.
    """
    failed = []
    for path, write, words in outputs:
        try:
            with atomic_write(path) as partial:
                write(partial)
        except BrokenPipeError:
            raise
        except (OSError, ValueError, MemoryError) as error:
            failed.append(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error or 'no memory'}")
        else:
            say(console, f"Wrote {path}{words}")
    if failed:
        raise ValueError("; ".join(failed))


def numbered(path: Path | None, count: int) -> list[Path]:
    """The path itself for one thing to write; with the thing's number for each of several; nothing without a path."""
    if path is None or count == 1:
        return [] if path is None else [path]
    return [path.with_stem(f"{path.stem}-{index}") for index in range(1, count + 1)]


def open_console() -> "Console":
    """Standard output, with nothing read into what is printed."""
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False)


def say(console: "Console", text: str) -> None:
    """A line that a pipe gets whole; a terminal wraps it."""
    console.print(text, soft_wrap=True)


def count(number: int, thing: str) -> str:
    """`1 load`, `2 loads`."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
