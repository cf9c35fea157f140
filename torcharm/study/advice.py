"""What a designer may try next, from what a design's loads were found to lack.

A predicted equilibrium is a minimum of the error over the pressures allowed. Where a pressure is at its limit there, a
higher one lowers the error to first order, and where it is at zero, one below would: that is, an actuator that acts the
other way at the same place.
"""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from torcharm.attainability.reasons import limits_reached, listed
from torcharm.study.results import StudyResult

MOSTLY = 0.5
"""From which share of the missed loads on a cause is told."""

AT_BOUND = (
    "at the limit: a higher one, or more force there, may help.",
    "without pressure: one there that acts the other way may help.",
)


def advice(result: StudyResult) -> Iterator[str]:
    """What to try with one design, in a sentence each, from what was found of it on one task."""
    words = result.verdicts
    if words is None:
        excluded = sum(map(bool, result.reasons))
        if excluded:
            yield f"{excluded} of {result.loads} loads are excluded, most often as {_most_often(result.reasons)}."
        return
    own = {word: [reason for reason, one in zip(result.reasons, words, strict=True) if one == word] for word in words}
    if "impossible" in own:
        yield f"Look at units and the shape, which leaves no length: {_most_often(own['impossible'])}."
    if "excluded by range" in own:
        yield (
            "Characterise the actuators further (torcharm fit), or ask for a shape that strains them less: "
            f"{_most_often(own['excluded by range'])}."
        )
    if "missed" in own:
        yield from _of_missed(result, np.flatnonzero(np.asarray(words) == "missed"))
    if "undecided" in own:
        yield f"Undecided, {len(own['undecided'])}: torcharm search follows the arm from rest, which may tell."
    if set(own) == {"held"}:
        margin = result.attainability.capacity_margin
        least = "" if margin is None else f" At the tightest, {float(margin.min()):.2g} N more were to be had."
        yield f"All are held.{least if margin is not None and float(margin.min()) > 0 else ''}"


def _of_missed(result: StudyResult, missed: "np.typing.NDArray[np.intp]") -> Iterator[str]:
    """Of the loads that are missed, by their indices: which pressures end at a bound, and what sets say."""
    found, enough = result.attainability, MOSTLY * len(missed)
    assert found.prediction is not None
    pressure = found.prediction.pressure.detach()
    pressure = pressure.reshape(-1, pressure.shape[-1])[missed]
    for ended, words in zip(limits_reached(pressure, result.arm.design.max_pressure.detach()), AT_BOUND, strict=True):
        usual = ended.sum(0) >= enough
        if bool(usual.any()):
            together = int(ended[:, usual].all(-1).sum())
            be = "are" if int(usual.sum()) > 1 else "is"
            yield f"Under {together} of {len(missed)} missed loads {listed(usual)} {be} {words}"
    absolute, relative = (
        None if value is None else (value.reshape(-1, value.shape[-1])[missed] <= 0).all(-1)
        for value in (found.absolute_per_node, found.relative_per_node)
    )
    if absolute is None or relative is None:
        return
    apart = int((absolute & ~relative).sum())
    if apart >= enough:
        yield (
            f"{apart} of {len(missed)} missed loads ask of each node what it can do, but by a pressure of its own: "
            "more segments in series may help."
        )


def _most_often(reasons: Sequence[str]) -> str:
    """The reason that is given most often, of those the first, without a stop at its end."""
    return Counter(reasons).most_common(1)[0][0].rstrip(".")
