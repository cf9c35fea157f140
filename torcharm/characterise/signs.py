"""Which way the positive forces of a file act, told from the samples: what is pulled longer pulls more."""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torcharm.characterise.columns import Column
from torcharm.characterise.least_squares import Monomials, exponents

Array = NDArray[np.float64]

OTHER = {"pull": "push", "push": "pull"}
SAID, NAMED, ASSUMED = "as said", "as its name says", "assumed"
"""How the sense of positive forces is known."""
LEAST_STRAIN = 1e-3
"""A strain or a range of strains below which there is noise alone."""
MOST_SAMPLES = 4000
"""Of a recording, of which so many, evenly spread, tell as much as all."""
CLEAR = 0.8
"""Of the mean size of the force's slope along the strain, how much its mean must be for its sign to be clear."""
OPEN = 20.0
"""So often may what is no noise in forces count in their change over all strains; more, and samples leave it open."""
ABOVE_NOISE = 2.0
"""In root mean squares of what a quadratic leaves of forces: by so much must they change over the strains."""
ROUNDING = 1e-9
"""Of the largest force: at least so much counts as noise, as what is exact in a file is not after arithmetic."""


def positive_forces(strain: Array, pressure: Array, force: Array) -> str:
    """What positive forces do by the samples, "pull" or "push"; "" where that is not clear.

    An actuator that is held at a pressure resists being moved: the longer it is, the more it pulls, or the less it
    pushes. The slope is that of the best quadratic, or plane where samples do not determine the former.

    Args:
        strain: (n) positive where longer.
        pressure: (n) [kPa].
        force: (n) as the file has it.
    """
    step = max(1, len(force) // MOST_SAMPLES)
    x, y, f = strain[::step], pressure[::step], force[::step]
    if np.ptp(x) == 0:
        return ""
    half = np.ptp(x) / 2  # by differences, which of a quadratic are exact
    for degree in (2, 1):
        monomials = Monomials.for_data(((0, 0), *exponents(degree)), x, y)
        if len(f) < 2 * len(monomials.powers):
            return ""
        matrix, ends = monomials.values(x, y), (monomials.values(x + sign * half, y) for sign in (1, -1))
        coefficients, _, rank, _ = np.linalg.lstsq(matrix, f, rcond=None)
        changes = np.subtract(*ends)  # of the force over all strains
        gain = np.sqrt(len(f)) * np.linalg.norm(np.linalg.lstsq(matrix.T, changes.mean(0), rcond=None)[0])
        if rank == len(monomials.powers) and gain <= OPEN:
            break
    else:
        return ""
    slope = changes @ coefficients / (2 * half)
    mean = float(slope.mean())
    noise = max(float((f - matrix @ coefficients).std()), ROUNDING * float(np.abs(f).max()))
    if abs(mean) < CLEAR * float(np.abs(slope).mean()) or abs(mean) * np.ptp(x) <= ABOVE_NOISE * noise:
        return ""
    return "pull" if mean > 0 else "push"


@dataclass(frozen=True)
class Signs:
    """What is known of the signs of a file before its samples are looked at.

    Attributes:
        positive: what positive forces do, "pull" or "push".
        known: how that is known: `SAID`, `NAMED` or `ASSUMED`.
        longer: whether positive strains are surely longer, as their column's name says.
    """

    positive: str = "pull"
    known: str = SAID
    longer: bool = True


def known_signs(force: Column, stretch: Column, positive: str | None, usual: str) -> Signs:
    """What a person and the names of columns tell of signs, squeezing forces' among them; else forces do the usual."""
    if positive is None and not force.compressive:
        return Signs(usual, ASSUMED, stretch.sure)
    return Signs(positive or "push", SAID if positive else NAMED, stretch.sure)


def settled(
    signs: Signs, strain: Array, pressure: Array, force: Array, source: str
) -> tuple[Array, Array, tuple[tuple[str, str], ...]]:
    """Strains, positive where longer; forces, positive where they push; and how both are known, for the record.

    What nobody says and no name tells is what samples tell (see `positive_forces`), or else assumed. Strains that no
    name tells the sense of count shortening where forces, whose sense is said or named, tell so.

    Args:
        signs: what is known.
        strain, pressure, force: (n) as the file has them.
        source: the file, for messages.

    Raises:
        ValueError: samples may be of a muscle that contracts and pulls, or of a bellows that extends and pushes.
    """
    told, way = positive_forces(strain, pressure, force), signs.positive
    words = f"{way}, {signs.known}"
    sure = signs.longer or strain.min() < -LEAST_STRAIN
    shorter = not sure and signs.known != ASSUMED and told == OTHER[way]
    if signs.known == ASSUMED:
        if not sure and told == "push" and force.mean() > 0:
            raise ValueError(
                f"{source}: must be told what it is of, as strains are above 0 and forces fall with them: a muscle "
                "that contracts and pulls (--positive pull), or a bellows that extends and pushes (--positive push)"
            )
        way = told or way
        why = "as what is stretched pulls back" if told else ASSUMED
        words = f"{way}, {why} (--positive {OTHER[way]} takes them the other way)"
    elif told == OTHER[way] and not shorter:
        less = "pulls less the more it is stretched" if way == "pull" else "pushes less the more it is squeezed"
        warnings.warn(
            f"{source}: positive forces {way}, {signs.known}, but then it {less}: is the sign of forces, or that of "
            "strains, another? --columns names strains that count shortening: contraction=1",
            stacklevel=4,
        )
    strains = "shorter, as forces fall with them" if shorter else "longer, assumed"
    # 0 is added to turn -0.0 into 0.
    return (
        (-strain if shorter else strain) + 0.0,
        (-force if way == "pull" else force) + 0.0,
        (("positive forces", words), *(() if sure else (("positive strains", strains),))),
    )
