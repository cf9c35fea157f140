"""Files that are never seen half-written, and inputs that are files at all.

What is written goes to a temporary file beside its target and takes the target's name once it is whole: whoever
reads sees the old file or the new one. What is read must be a regular file of bounded size, so that a pipe, a
device or a folder given by mistake is refused in a sentence rather than waited for.
"""

import errno
import gc
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path

StrPath = str | PathLike[str]

MOST_BYTES = 200_000_000
"""The largest file that is read; a larger one is none that a person meant."""
TEMPORARY = ".torcharm-"
"""How the name of a file begins that is being written; a process that was killed may leave one."""
_LONGEST_SUFFIX = 16
_CELL_STARTS = ("=", "+", "-", "@", "\t", "\r")
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}


@contextmanager
def atomic_write(path: StrPath) -> Iterator[Path]:
    """Give the name of a temporary file to write; at the end of the block it becomes `path`, whole.

    The temporary file lies beside the target and ends like it, and its name belongs to this process alone, so that
    several may write the same target. If the block raises, or the file cannot be brought to disk, the temporary file
    is removed and what was at `path` stays. A link is followed, and an existing file's permissions are kept. What is
    neither file nor folder, such as /dev/stdout, is written directly.

    Raises:
        OSError: the file cannot be written; and whatever the block raises.
    """
    if is_stream(path):
        yield Path(path)
        return
    target = Path(os.path.realpath(path))
    partial = _beside(target)
    try:
        partial.open("xb").close()
        if target.is_file():
            with suppress(OSError):
                partial.chmod(stat.S_IMODE(target.stat().st_mode))
        yield partial
        to_disk(partial, os.O_RDWR)
        os.replace(partial, target)
    except OSError as error:
        if error.errno is not None and error.filename in (None, str(partial), partial):  # a person knows the target
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
    if os.name == "posix":
        with suppress(OSError):  # the file is whole already; some file systems cannot bring a folder to disk
            to_disk(target.parent, os.O_RDONLY)


class _Untouched(Exception):
    """Ends a trial that writes nothing."""


def check_writable(path: StrPath, name: str = "") -> None:
    """Raise a ValueError, on a field or option of a name, if `atomic_write` could not write `path`; leaves no trace."""
    prefix = f"{name}: {path}" if name else f"{path}"
    if os.path.isdir(path):
        raise ValueError(f"{prefix}: is a directory, must be a file")
    try:
        folder = os.path.dirname(os.path.realpath(path))
        if is_stream(path) and not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except (OSError, ValueError) as error:  # the latter of names that hold a NUL
        raise ValueError(f"{prefix}: cannot be written, {_reason(error)}") from None
    if not os.path.isdir(folder):
        raise ValueError(f"{prefix}: the directory {Path(path).parent} does not exist")
    try:
        with suppress(FileNotFoundError):
            if stat.S_ISREG(os.stat(path).st_mode):
                open(path, "ab").close()  # a file that is protected is not replaced either
        with atomic_write(path):
            raise _Untouched
    except _Untouched:
        return
    except (OSError, ValueError) as error:
        raise ValueError(f"{prefix}: cannot be written, {_reason(error)}") from None


def read_file(path: StrPath) -> bytes:
    """All of a regular file.

    Raises:
        ValueError: it cannot be read, is a folder, a pipe or a device, or holds more than `MOST_BYTES`; the message
            begins with the path.
    """
    if not isinstance(path, (str, PathLike)):  # a number would be taken for a file that the process has open
        raise ValueError(f"path: must be a path, got {path!r}")
    found = b""
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISREG(mode):
            with open(path, "rb") as file:
                found = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # the latter of names that hold a NUL
        raise ValueError(f"{path}: cannot be read: {_reason(error)}") from None
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "a device")
        raise ValueError(f"{path}: cannot be read: is {kind}, must be a regular file")
    if len(found) > MOST_BYTES:
        raise ValueError(f"{path}: cannot be read: must hold at most {MOST_BYTES / 1e6:g} MB, holds more")
    return found


def plain_cell(text: str) -> str:
    """A text as a cell of a CSV file that no spreadsheet takes for a formula: an apostrophe before =, +, - or @."""
    return f"'{text}" if text.startswith(_CELL_STARTS) else text


def is_stream(path: StrPath) -> bool:
    """Whether it is there and no file of its own: a device, a pipe, or a name for what a process has open."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)) or os.path.abspath(path).startswith(("/dev/fd/", "/dev/std"))


def _beside(target: Path) -> Path:
    """A new name in the target's folder, with its ending."""
    suffix = target.suffix if len(target.suffix.encode()) <= _LONGEST_SUFFIX else ""
    return target.parent / f"{TEMPORARY}{os.getpid()}-{secrets.token_hex(6)}{suffix}"


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)


def to_disk(path: Path, flags: int) -> None:
    """Wait until what was written to a file or a directory is on the disk."""
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def without_collection() -> Iterator[None]:
    """Without Python's search for circles of references: lines become many small lists that have none, and to look
    through them again and again takes longer than to read them."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
