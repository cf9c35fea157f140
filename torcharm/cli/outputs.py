"""The files that commands write: where they may go, what goes there, and that a failure costs no other."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from torcharm.cli.terminal import count, say
from torcharm.files import atomic_write, check_writable, is_stream

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_FORMATS = ("png", "pdf", "svg", "jpg", "eps")

Output = tuple[Path, Callable[[Path], object], str]
"""Where to, what writes the file whose name it is given, and what to say after `Wrote ...` then."""
Task = TypeVar("Task")


def check(
    study: Path | None,
    out: Path | None,
    figure: Path | None = None,
    endings: Sequence[str] = (),
    checkpoint: Path | None = None,
) -> None:
    """Raise a ValueError about an output that cannot be written, before the work is done.

    Endings are those that --out may have; without any it may have all.
    """
    taken = {"the study itself": study}
    allowed = {"out": endings, "figure": FIGURE_FORMATS, "checkpoint": ()}
    for name, path in (("out", out), ("figure", figure), ("checkpoint", checkpoint)):
        if path is None:
            continue
        if name != "checkpoint":  # of which there is one for each arm
            check_writable(path, f"--{name}")
        for what, other in taken.items():
            if other is not None and path.resolve() == other.resolve():
                raise ValueError(f"--{name}: {path}: is {what}, must be another file")
        taken[f"the file of --{name}"] = path
        _check_ending(f"--{name}", path, allowed[name])


def _check_ending(option: str, path: Path, allowed: Sequence[str]) -> None:
    """Raise a ValueError unless an output ends in one of the formats allowed, if there are any, or is a stream."""
    if not allowed or path.suffix.lower().removeprefix(".") in allowed or (option == "--out" and is_stream(path)):
        return
    which = f"one of .{', .'.join(allowed)}" if len(allowed) > 2 else f".{' or .'.join(allowed)}"
    raise ValueError(f"{option}: {path}: must end in {which}, got {path.suffix or 'no ending'}")


def numbered(option: str, path: Path | None, count: int) -> list[Path]:
    """The path itself for one thing to write; with the thing's number for each of several; nothing without a path.

    A ValueError says which of them cannot be written.
    """
    if path is None:
        return []
    several = [path.with_stem(f"{path.stem}-{index}") for index in range(1, count + 1)]
    found = [path] if count == 1 else several
    for one in found:
        check_writable(one, option)
    return found


def rows(out: Path | None, found: Sequence[Mapping[str, Any]]) -> Iterator[Output]:
    """The file of --out, if it is asked for: a table of rows."""
    from torcharm.study import write_rows

    if out is not None:
        yield out, lambda path: write_rows(path, found, out.suffix), f" ({count(len(found), 'row')})."


def by_task(tasks: Sequence[Task], found: Sequence[Any]) -> list[tuple[Task, list[Any]]]:
    """Each task, or plan, with what is found on it."""
    return [(task, [one for one in found if one.task is task]) for task in tasks]


def figures(
    places: Sequence[Path], found: Iterable[tuple[Any, Any]], draw: Callable[[Any, Any], "Figure"]
) -> Iterator[Output]:
    """The files of --figure, if they are asked for: one for each task that something is found on."""

    def write(path: Path, task: Any, own: Any) -> None:
        draw(task, own).savefig(path)

    for place, (task, own) in zip(places, found, strict=False):
        if own:
            yield place, partial(write, task=task, own=own), f" ({task.name})."


def save(outputs: Iterable[Output]) -> None:
    """Write each output whole and say so; a failure costs no other output, and is an error at the end."""
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
            say(f"Wrote {path}{words}")
    if failed:
        raise ValueError("; ".join(failed))
