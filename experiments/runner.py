"""Which experiments there are, and running them one after another, resumably."""

import ast
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

HERE = Path(__file__).parent
LOG_LINES = 12
"""Of a failed run's output, so many are shown."""


@dataclass(frozen=True)
class Experiment:
    """A folder that `python -m` runs.

    Attributes:
        name: of the folder.
        summary: the first line of the package's docstring.
        folder: where it is.
    """

    name: str
    summary: str
    folder: Path


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        name: of the experiment.
        code: exit code; 0 is success.
        seconds: it took.
        memory_mib: most memory it held; None where the system does not say.
        fingerprint: of the code that ran.
        log: the file with all it printed.
    """

    name: str
    code: int
    seconds: float
    memory_mib: float | None
    fingerprint: str
    log: str


def discover(root: Path = HERE) -> list[Experiment]:
    """Every folder with a `__main__.py`, by name."""
    return [
        Experiment(main.parent.name, _summary(main.parent), main.parent) for main in sorted(root.glob("*/__main__.py"))
    ]


def _summary(folder: Path) -> str:
    """The first line of the docstring, without importing anything."""
    for file in (folder / "__init__.py", folder / "__main__.py"):
        if file.is_file():
            text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
            if text:
                return text.splitlines()[0]
    return ""


def choose(found: Sequence[Experiment], names: Sequence[str]) -> list[Experiment]:
    """Those named, in the order found; all if none is.

    Raises:
        ValueError: a name is none of them.
    """
    known = {experiment.name for experiment in found}
    for name in names:
        if name not in known:
            raise ValueError(f"names: must be among {', '.join(sorted(known))}, got {name}")
    return [experiment for experiment in found if not names or experiment.name in names]


def default_state(quick: bool) -> Path:
    """Where logs and records of finished runs go: the user's cache, so that the checkout stays clean."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    checkout = hashlib.sha256(str(HERE).encode()).hexdigest()[:12]
    return cache / "torcharm" / "experiments" / checkout / ("quick" if quick else "full")


def fingerprint(experiment: Experiment) -> str:
    """Changes with the experiment's code and with the library's; what was run with another one is not finished."""
    root = experiment.folder.parent
    files = [*experiment.folder.rglob("*.py"), *root.glob("*.py"), *(root.parent / "torcharm").rglob("*.py")]
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(str(file.relative_to(root.parent)).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def finished(experiment: Experiment, state: Path) -> Outcome | None:
    """The successful run of the same code, if there was one."""
    try:
        record = Outcome(**json.loads((state / f"{experiment.name}.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
    return record if record.code == 0 and record.fingerprint == fingerprint(experiment) else None


def run(experiment: Experiment, state: Path, arguments: Sequence[str]) -> Outcome:
    """Run it in a process of its own, and record how that ended.

    Interrupted, it ends the process and records nothing.
    """
    state.mkdir(parents=True, exist_ok=True)
    log, stamp = state / f"{experiment.name}.log", fingerprint(experiment)
    record = state / f"{experiment.name}.json"
    record.unlink(missing_ok=True)
    command = [sys.executable, "-m", f"{experiment.folder.parent.name}.{experiment.name}", *arguments]
    started = time.perf_counter()
    with log.open("wb") as output:
        process = subprocess.Popen(
            command,
            cwd=experiment.folder.parent.parent,
            stdout=output,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
        )
        try:
            code, memory = _wait(process)
        except BaseException:
            process.terminate()
            process.wait()
            raise
    outcome = Outcome(experiment.name, code, time.perf_counter() - started, memory, stamp, str(log))
    partial = record.with_suffix(".part")
    partial.write_text(json.dumps(asdict(outcome)), encoding="utf-8")
    partial.replace(record)
    return outcome


def _wait(process: "subprocess.Popen[bytes]") -> tuple[int, float | None]:
    """The exit code, and the most memory held [MiB] where the system tells."""
    if not hasattr(os, "wait4"):
        return process.wait(), None
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, usage.ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def last_lines(outcome: Outcome) -> Iterator[str]:
    """The end of what a run printed."""
    yield from Path(outcome.log).read_text(encoding="utf-8", errors="replace").splitlines()[-LOG_LINES:]
