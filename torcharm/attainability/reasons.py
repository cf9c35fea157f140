"""Why a task is not held."""

import math
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import with_slices
from torcharm.statics.cross_section import RANGE_SLACK, characterised_range, cross_sections
from torcharm.wrench_sets.node_distances import lack_in_words

NO_CENTRELINE = "the centreline of the shape would have no length"
NOTHING = 1e-6
"""A miss [N] that explains nothing: of the size of rounding."""
SHARE = 0.005
"""A part of the task's length or bend that is not told: it reads 0 %."""
ANGLE = math.radians(1.0)
"""A bend that is not told, and that of a shape that counts as straight [rad]: well within the default tolerance."""
OTHER_SIDE = -1.2
"""By how much of the task's bend less than that an arm bends to the other side, and not just not at all."""
AT_LIMIT = 1e-6
"""Of its limit, how far from 0 or from the limit a pressure is at it: descents end there to rounding."""


def one_design(segment: ArmDesign, batch: torch.Size, index: tuple[int, ...]) -> ArmDesign:
    """One design of a segment, whose arm has a batch of designs."""
    return segment._map(lambda value: value.detach().expand(*batch, value.shape[-1])[index])


def missing(absolute: Tensor | None, relative: Tensor | None, weights: tuple[float, float]) -> tuple[float, str]:
    """How much the worst node lacks, and which, from 1, in words; 0 and "" where none does.

    Args:
        absolute, relative: distances (N,) from the nodes' sets; the latter count where the former are none.
        weights: k_f and k_m, by which forces and moments are one distance.
    """
    for distance, before in ((absolute, ""), (relative, "no pressure serves all nodes: ")):
        if distance is not None:
            miss, node = float(distance.max()), int(distance.argmax())
            if miss > NOTHING:
                return miss, before + lack_in_words(node, miss, weights, relative=distance is relative)
    return 0.0, ""


def differences(wanted: Tensor, reached: Tensor, nodes: Sequence[int]) -> str:
    """What an arm does wrong: too short or long, bent too little or much, or sideways; "" if its mean shape is right.

    The length is that of the whole arm. The bend is measured along the task's: by which factor the task's curvatures
    come nearest to those reached, by least squares over the arm; so a shape of two bends has one, too. To the side is
    across the task's plane of bending at each node, in space.

    Args:
        wanted, reached: (N, 3 or 6) twists of the task and of the shape predicted.
        nodes: of each segment.
    """
    part = torch.cat([wanted.new_full((count,), 1 / count) for count in nodes])
    long, length = (float(part @ twists[:, 0]) for twists in (reached, wanted))
    bend, aim = _bends(reached), _bends(wanted)
    square = float(part @ (aim * aim).sum(-1))
    said = [_too(long / length - 1, "short", "long")]
    if square <= ANGLE**2:
        turned = float(torch.linalg.vector_norm(part @ (bend - aim)))
        said.append(f"bends by {_rounded(math.degrees(turned))}°, the task does not" if turned > ANGLE else "")
    else:
        more = float(part @ (aim * bend).sum(-1)) / square - 1
        amount = "to the other side" if more < OTHER_SIDE else _too(max(more, -1.0), "little", "much")
        said.append(amount and f"bends {amount}")
        if bend.shape[-1] == 2:
            along = torch.nn.functional.normalize(aim, dim=-1)
            aside = float(part @ (along[:, 0] * bend[:, 1] - along[:, 1] * bend[:, 0]).abs())
            said.append(f"bends {_rounded(math.degrees(aside))}° sideways" if aside > ANGLE else "")
    return ", ".join(filter(None, said))


def _bends(twists: Tensor) -> Tensor:
    """(N, 1 or 2) what bends of twists, without torsion."""
    return twists[:, 2:] if twists.shape[-1] == 3 else twists[:, 4:]


def _too(more: float, less_word: str, more_word: str) -> str:
    """`3 % too short`, or "" for next to nothing."""
    return f"{_rounded(100 * abs(more))} % too {more_word if more > 0 else less_word}" if abs(more) > SHARE else ""


def _rounded(value: float) -> str:
    """Two digits, or all before the point."""
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


def at_limits(pressure: Tensor, limit: Tensor) -> str:
    """Which driven actuators, from 1, are at their limit, and which without pressure; "" if none is.

    Args:
        pressure, limit: (M) of all segments [kPa].
    """
    full, none = limits_reached(pressure, limit)
    said = [f"{listed(full)} at {'its' if int(full.sum()) == 1 else 'their'} limit" if bool(full.any()) else ""]
    said.append(f"{listed(none)} without pressure" if bool(none.any()) else "")
    return ", ".join(filter(None, said))


def limits_reached(pressure: Tensor, limit: Tensor) -> tuple[Tensor, Tensor]:
    """Whether driven actuators are at their limit, and whether they are without pressure, both (..., M).

    Args:
        pressure, limit: (..., M) of all segments [kPa].
    """
    driven = limit > 0
    return driven & (pressure >= (1 - AT_LIMIT) * limit), driven & (pressure <= AT_LIMIT * limit)


def listed(which: Tensor) -> str:
    """`actuator 1`, `actuators 1, 4`: those of a mask (M), counted from 1."""
    numbers = [str(index + 1) for index in which.nonzero().flatten().tolist()]
    return f"actuator{'s' * (len(numbers) > 1)} {', '.join(numbers)}"


def out_of_range(segments: Sequence[ArmDesign], twists: Tensor, nodes: Sequence[int]) -> str:
    """The actuator that is strained furthest beyond its range, or whose limit is.

    Args:
        segments: of one design.
        twists: (N, 3 or 6) of all segments.
        nodes: of each segment.
    """
    excess, value, actuator, node, low, high = max(_worst_strains(segments, twists, nodes))
    if value <= -1:
        return f"actuator {actuator} would have no length at node {node} (strain {value:.3g})"
    if excess > RANGE_SLACK:
        return (
            f"actuator {actuator} is strained to {told_apart(value, low, high)} at node {node}, "
            f"characterised from {_signed(low)} to {_signed(high)}"
        )
    for segment, own in with_slices(segments):
        for index, model in enumerate(segment.actuators):
            limit, known = float(segment.max_pressure[index]), float(model.pressure_range[1])
            if limit > known * (1 + RANGE_SLACK):
                return f"actuator {own.start + index + 1} is driven to {limit:g} kPa, characterised to {known:g} kPa"
    return "a pressure, or a strain together with its pressure, lies outside of what was characterised"


@torch.no_grad()
def _worst_strains(
    segments: Sequence[ArmDesign], twists: Tensor, nodes: Sequence[int]
) -> Iterator[tuple[float, float, int, int, float, float]]:
    """Of each segment's worst strain the excess, value, actuator and node, from 1, and what was characterised."""
    first = 0
    for (segment, own), part in zip(with_slices(segments), twists.split(list(nodes), -2), strict=True):
        strain = cross_sections(segment, part).strain
        low, high, excess = characterised_range(segment.actuators, strain)
        excess = torch.where(strain <= -1, 1e3 - strain, excess)  # no length at all is worse than any strain
        node, index = divmod(int(excess.argmax()), segment.actuator_count)
        most, value = float(excess[node, index]), float(strain[node, index])
        yield most, value, own.start + index + 1, first + node + 1, float(low[index]), float(high[index])
        first += len(part)


def told_apart(strain: float, low: float, high: float) -> str:
    """A strain by as many digits as tell it from the ends of its range."""
    ends = {_signed(end) for end in (low, high)}
    digits = next((count for count in (2, 3, 4, 6) if _signed(strain, count) not in ends), 9)
    return _signed(strain, digits)


def _signed(value: float, digits: int = 2) -> str:
    """A number with its sign; 0 has none."""
    return f"{value:+.{digits}g}" if value else "0"
