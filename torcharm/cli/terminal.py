"""What every command shares: how mistakes are told, where outputs may go, what is printed."""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from rich.console import Console

    from torcharm.study import NamedTask

FIGURE_FORMATS = ("png", "pdf", "svg", "jpg", "eps")
MISTAKE, INTERRUPTED = 2, 130


def fail(message: str, code: int = MISTAKE) -> NoReturn:
    """Say on one line of the standard error what is wrong, and exit."""
    print("torcharm:", " ".join(message.split()), file=sys.stderr)
    sys.exit(code)


@contextmanager
def mistakes() -> Iterator[None]:
    """Report in one line what a person can cause."""
    try:
        yield
    except KeyboardInterrupt:
        fail("interrupted", INTERRUPTED)
    except BrokenPipeError:
        raise  # whoever read the output has left: no mistake
    except MemoryError:
        fail("not enough memory for this study")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        fail(f"{where}{error.strerror or error}")
    except ValueError as error:
        fail(str(error))


def check_outputs(study: Path | None, out: Path | None, figure: Path | None) -> None:
    """Raise a ValueError about an output that cannot be written, before the work is done."""
    for option, path in (("--out", out), ("--figure", figure)):
        if path is None:
            continue
        if path.is_dir():
            raise ValueError(f"{option}: {path}: is a directory, must be a file")
        if not path.parent.is_dir():
            raise ValueError(f"{option}: {path}: the directory {path.parent} does not exist")
        try:
            _try_writing(path)
        except OSError as error:
            raise ValueError(f"{option}: {path}: cannot be written, {error.strerror}") from None
        if study is not None and path.resolve() == study.resolve():
            raise ValueError(f"{option}: {path}: is the study itself, must be another file")
    if figure is None:
        return
    if figure.suffix.lower().removeprefix(".") not in FIGURE_FORMATS:
        raise ValueError(
            f"--figure: {figure}: must end in one of .{', .'.join(FIGURE_FORMATS)}, got {figure.suffix or 'no ending'}"
        )
    if out is not None and out.resolve() == figure.resolve():
        raise ValueError(f"--figure: {figure}: is the file of --out, must be another")


def _try_writing(path: Path) -> None:
    """Open the file, or one beside it, as permissions alone do not tell; leaves no trace."""
    if path.is_file():
        path.open("ab").close()
    elif not path.exists():
        tempfile.TemporaryFile(dir=path.parent).close()


def figure_paths(path: Path, tasks: Sequence["NamedTask"]) -> list[Path]:
    """The path itself for one task; with the task's number for each of several."""
    if len(tasks) == 1:
        return [path]
    return [path.with_stem(f"{path.stem}-{index}") for index in range(1, len(tasks) + 1)]


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
