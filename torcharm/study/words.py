"""What results of a study say in sentences: what verdicts mean, why a load is not held, and what to run next."""

import math
from collections.abc import Iterator, Sequence

from torcharm.attainability import PoseTolerance
from torcharm.inputs import three_digits
from torcharm.study.data import Settings
from torcharm.study.results import MM, StudyResult, Summary
from torcharm.workspaces import Workspace
from torcharm.wrench_sets.node_distances import counted

MEANINGS = {
    "missed": "the least error that was found is beyond that",
    "excluded by range": "beyond characterised strains or pressures: figures extrapolate",
    "undecided": "a better pressure may exist, or no stable shape that loading leads to",
    "impossible": "an actuator would have no length",
}

# What puzzles beside results, in a sentence that begins in the middle of a line or, with a capital, on its own.
HELD_OUTSIDE = (
    "held beside a margin below 0: the margin is that of the exact shape, and held allows a shape within the tolerance"
)
NOT_EXCLUDED = "not excluded: no node lacks a wrench, which is necessary but not sufficient."
CHANGE = (
    "change from the base: a segment's nodes share its pressures, so these have to give each node what it needs beyond "
    "the first"
)


def sentence(reason: str) -> str:
    """A reason with a stop behind it, unless it is a question."""
    return reason if reason.endswith("?") else f"{reason}."


def why_not(summary: Summary, load: int, verdict: str, reason: str) -> str:
    """The sentence on the load that stands for those not held, after the arm's name."""
    alike = 0 if summary.verdicts is None else summary.verdicts[verdict]
    which = f", the furthest off of {alike} {verdict}" if alike > 1 else ""
    about = f", load {load} of {summary.loads}{which}" if summary.loads > 1 else ""
    return f"{about}: {sentence(reason)}"


def allowed(tolerance: PoseTolerance, length: str = "the length") -> str:
    """How far off tip and shape may be, of an arm whose length has a name where that decides."""
    near = f"2 % of {length}" if tolerance.tip is None else f"{MM * tolerance.tip:g} mm"
    return f"tip and shape within {near}, turned within {math.degrees(tolerance.rotation):.3g}°"


def verdict_legend(settings: Settings, results: Sequence[StudyResult]) -> Iterator[str]:
    """What the verdicts mean that were given, in a line each."""
    yield f"held: {allowed(settings.tolerance)}."
    words = {word for result in results for word in result.verdicts or ()}
    for word, meaning in MEANINGS.items():
        if word in words:
            yield f"{word}: {meaning}."


def worst_node_legend(settings: Settings) -> str:
    """What the worst node is, in a line."""
    how = counted(settings.weights)
    return f"worst node: lacks most, on average, of the wrench that it needs, {how}; 1 is the base."


def weighing_legend(settings: Settings) -> str:
    """How moments come into newtons, in a line."""
    return f"{counted(settings.weights)}: so do moments count beside forces in what nodes lack, and in margins."


def region_size(found: Workspace) -> str:
    """How large a region that a tip reaches is, or a volume."""
    return f"{three_digits(1e4 * found.size)} cm²" if found.dimension == 2 else f"{three_digits(1e3 * found.size)} dm³"


def next_commands(study: str, results: Sequence[StudyResult]) -> Iterator[tuple[str, str]]:
    """Commands that may bring a study's arms nearer to what they miss, and what each does."""
    if any(word in ("missed", "excluded by range") for result in results for word in result.verdicts or ()):
        yield f"torcharm optimise {study}", "looks for radii and lengths that come nearer"
        yield f"torcharm search {study}", "for the pressures that do, loading from rest"
