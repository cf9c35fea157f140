"""What every command shares: how mistakes are told, how far work is, and what is printed."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from rich.console import Console

MISTAKE, INTERRUPTED = 2, 130
COMPILING = "torcharm: compiling, once: about {} s"


def tell(message: str) -> None:
    """Say something on one line of the standard error."""
    print("torcharm:", " ".join(message.split()), file=sys.stderr)


def fail(message: str, code: int = MISTAKE) -> NoReturn:
    """Say on one line of the standard error what is wrong, and exit."""
    tell(message)
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


def bare(text: str) -> float | str:
    """The number that an option's text is, in the first of its units then; or the text, which may have one of them."""
    try:
        return float(text)
    except ValueError:
        return text


def numbers(option: str, text: str, units: Sequence[dict[str, float]]) -> list[float]:
    """Numbers with commas between them, of an option's text; each may have one of its own units behind it."""
    from torcharm.study.units import parsed

    parts = text.split(",")
    if len(parts) != len(units):
        many = f"{len(units)} numbers with commas between them" if len(units) > 1 else "one number"
        raise ValueError(f"{option}: must be {many}, got {text}")
    try:
        return [float(parsed(bare(part.strip()), own)) for part, own in zip(parts, units, strict=True)]
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from None


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


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[..., None]]:
    """A bar on the standard error, of a terminal only; elsewhere a line if the engine is compiled first.

    Gives a function that moves it on to so many of the total, with some words behind the bar.
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

        def move(to: int, words: str = "") -> None:
            bar.update(task, completed=to, words=words)

        yield move


def open_console() -> "Console":
    """Standard output, with nothing read into what is printed."""
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False)


def say(text: str = "") -> None:
    """A line that a pipe gets whole; a terminal wraps it."""
    open_console().print(text, soft_wrap=True)


def count(number: int, thing: str) -> str:
    """`1 load`, `2 loads`."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
