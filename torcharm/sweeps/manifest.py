"""A sweep's folder: its manifest, which says what the sweep is, its locks, and where everything lies.

`manifest.json` is written once, before the first shard, and never again. All that is computed afterwards is a pure
function of it and of the arm, the space and the tasks, which it holds digests of.
"""

import hashlib
import json
import pickle
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from torcharm.design.space import Arm
from torcharm.extras import extra
from torcharm.files import TEMPORARY, StrPath, atomic_write, check_writable, read_file
from torcharm.sweeps.designs import DesignPoints, points_from_json

KIND = "torcharm sweep, 2"
"""Of the folder; another number stands for other files in it."""
MANIFEST, ARM, SUMMARY, SHARDS = "manifest.json", "arm.pickle", "summary.parquet", "shards"

Part = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Manifest:
    """What a sweep is.

    Attributes:
        problem: digests, or short texts, of the arm, the space, the tasks and all options, by their names.
        count: designs in all.
        shard_designs: of each shard but the last.
        chunk_designs: worked on at once: bounds memory.
        tasks: how many, loads counted.
        numbers, counts: columns of single precision and of whole numbers.
        points: of `DesignPoints`.
    """

    problem: Mapping[str, str]
    count: int
    shard_designs: int
    chunk_designs: int
    tasks: int
    numbers: tuple[str, ...]
    counts: tuple[str, ...]
    points: Mapping[str, Any]

    @property
    def shards(self) -> int:
        """How many there are."""
        return -(-self.count // self.shard_designs)

    def first_of(self, shard: int) -> int:
        """Index of a shard's first design; of the number of shards, the number of designs."""
        return min(shard * self.shard_designs, self.count)

    @cached_property
    def design_points(self) -> DesignPoints:
        """Of each index its values."""
        return points_from_json(dict(self.points))

    @cached_property
    def text(self) -> str:
        """As its file holds it."""
        return json.dumps({"kind": KIND, **asdict(self)}, indent=1) + "\n"

    @cached_property
    def digest(self) -> str:
        """That every shard carries."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]


def read_manifest(folder: StrPath) -> Manifest:
    """The manifest of a folder, if this torcharm wrote one."""
    path = Path(folder) / MANIFEST
    if not path.is_file():
        raise ValueError(f"{folder}: holds no sweep: there is no {MANIFEST}")
    try:
        content = json.loads(read_file(path))
        if content.pop("kind") != KIND:
            raise ValueError
        for name in ("numbers", "counts"):
            content[name] = tuple(content[name])
        return Manifest(**content)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(f"{path}: is no manifest that this torcharm wrote; name another folder") from None


def check_same(folder: StrPath, there: Manifest, problem: Mapping[str, str], shard_designs: int | None) -> None:
    """Raise a ValueError that names what differs between a folder's sweep and the one asked for."""
    here, other = dict(problem), dict(there.problem)
    if shard_designs is not None:
        here["shard_size"], other["shard_size"] = str(shard_designs), str(there.shard_designs)
    differing = [name for name in dict.fromkeys((*other, *here)) if here.get(name) != other.get(name)]
    if not differing:
        return
    short = [name for name in differing if max(len(str(one.get(name))) for one in (here, other)) <= LONGEST_TOLD]
    told = [
        f"{name} ({other.get(name)} there, {here.get(name)} given)" if name in short else name for name in differing
    ]
    raise ValueError(
        f"out: {folder} holds another sweep, whose {', '.join(told)} {'differs' if len(told) == 1 else 'differ'}; "
        "name another folder"
    )


LONGEST_TOLD = 15
"""Texts up to this length are told: they say something, which digests and whole spaces do not."""


def prepare_folder(folder: Path) -> None:
    """Make the folder, and see that it can be written."""
    try:
        (folder / SHARDS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"out: {folder}: cannot be written, {error.strerror or error}") from None
    for place in (folder, folder / SHARDS):
        check_writable(place / MANIFEST, "out")


def make_manifest(folder: Path, arm: Arm, decide: Callable[[], Manifest]) -> Manifest:
    """The manifest that is there, or one that is decided upon now; of several processes at once, one decides."""
    with extra("filelock", "sweep").FileLock(folder / ".manifest.lock"):
        if not (folder / MANIFEST).exists():
            made = decide()
            with atomic_write(folder / ARM) as partial:
                partial.write_bytes(pickle.dumps(arm))
            with atomic_write(folder / MANIFEST) as partial:
                partial.write_text(made.text, encoding="utf-8")
        return read_manifest(folder)


@contextmanager
def locked(folder: Path, part: Part | None) -> Iterator[None]:
    """Make the folder, and hold the lock of a sweep, or of a part of it.

    The system releases it when the process ends, however that ends. Parts of one sweep exclude each other only if they
    are the same, and the whole, which removes what others left half-written, excludes all parts.
    """
    prepare_folder(folder)
    filelock = extra("filelock", "sweep")

    def take(path: Path) -> Any:
        lock = filelock.FileLock(path)
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout:
            whose = f"part {part[0]}/{part[1]} of the sweep" if part and "part" in path.name else "a sweep"
            raise ValueError(
                f"out: {folder}: {whose} runs in this folder already; wait until it ends, or name another folder"
            ) from None
        return lock

    whole = folder / ".sweep.lock"
    own = whole if part is None else folder / f".part-{part[0]}-of-{part[1]}.lock"
    others = sorted(folder.glob(".part-*.lock")) if part is None else [whole]
    with ExitStack() as held:
        held.enter_context(take(own))
        for other in others:  # that nobody holds it now is enough: shards are the same whoever writes them
            take(other).release()
        if part is None:
            remove_leftovers(folder)
        yield


def remove_leftovers(folder: Path) -> None:
    """Remove what processes that were killed left half-written; for who holds the lock of the whole sweep."""
    for left in [*folder.glob(f"{TEMPORARY}*"), *(folder / SHARDS).glob(f"{TEMPORARY}*")]:
        with suppress(OSError):
            left.unlink()


def stored_arm(folder: StrPath) -> Arm:
    """The arm that a sweep began with, if it can be read here: force models' classes must be importable."""
    path = Path(folder) / ARM
    try:
        found: Arm = pickle.loads(read_file(path))
    except ValueError:
        raise
    except Exception as error:  # unpickling raises whatever it comes upon
        raise ValueError(f"{path}: cannot be read here ({error}); give the arm: open_sweep(folder, arm=arm)") from None
    return found
