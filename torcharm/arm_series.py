"""Arms of several pressure segments in series, joined directly or by rigid links."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.arm import ArmDesign
from torcharm.geometry import se3
from torcharm.geometry.rod import check_rigid
from torcharm.inputs import HoldsTensors, TensorLike, as_floating, broadcast_shapes, check_at_least, check_finite, shown


@dataclass(frozen=True, eq=False, init=False, repr=False)
class RigidLink(HoldsTensors):
    """What does not deform: a connector between two segments, or a mount between the last one and the tip.

    Attributes:
        length: (...) of a straight link along the backbone [m], or None.
        pose: of the link's end in the frame of its start, (..., 3) or (..., 4, 4); None for a straight link.
        mass: (...) [kg], at the middle of the line from its start to its end.

    Example:
        >>> elbow = ta.RigidLink(pose=[0.02, 0.03, math.pi / 2], mass=0.05)  # between two segments, turning left
        >>> ta.series([ta.bellows_arm(length=0.3), elbow, ta.bellows_arm(length=0.2)]).links
        (RigidLink(pose (3,), torch.float64), None)
    """

    length: Tensor | None
    pose: Tensor | None
    mass: Tensor

    def __init__(
        self, length: TensorLike | None = None, pose: TensorLike | None = None, mass: TensorLike = 0.0
    ) -> None:
        """Check.

        Args:
            length: (...) [m]; fits an arm of either dimension.
            pose: in place of a length, (..., 3) `(x, y, θ)` [m, m, rad] in a planar arm, (..., 4, 4) in a spatial one.
            mass: (...) [kg].

        Raises:
            ValueError: not exactly one of length and pose is given, or a value makes no sense.
        """
        if (length is None) == (pose is None):
            raise ValueError(
                f"length: must be given, or a pose in its place, got {'neither' if pose is None else 'both'}"
            )
        given = {"length": length} if pose is None else {"pose": pose}
        value, mass_ = as_floating(**given, mass=mass)
        check_finite(next(iter(given)), value)
        if pose is None:
            check_at_least("length", value, 0.0, unit="m")
        else:
            if value.ndim < 1 or not (value.shape[-1] == 3 or value.shape[-2:] == (4, 4)):
                raise ValueError(f"pose: must have shape (..., 3) or (..., 4, 4), got {tuple(value.shape)}")
            check_rigid("pose", value)
        check_finite("mass", mass_)
        check_at_least("mass", mass_, 0.0, unit="kg")
        object.__setattr__(self, "length", value if pose is None else None)
        object.__setattr__(self, "pose", None if pose is None else value)
        object.__setattr__(self, "mass", mass_)

    @property
    def dimension(self) -> int | None:
        """2 or 3, or None for a straight link, which fits either."""
        if self.pose is None:
            return None
        return 3 if self.pose.shape[-2:] == (4, 4) else 2

    def end(self, dimension: int) -> Tensor:
        """Pose of the link's end in the frame of its start: (..., 3) for dimension 2, (..., 4, 4) for 3."""
        if self.pose is not None:
            return self.pose
        assert self.length is not None
        zero = torch.zeros_like(self.length)
        if dimension == 2:
            return torch.stack((self.length, zero, zero), -1)
        place = torch.stack((self.length, zero, zero), -1)
        return se3.from_parts(torch.eye(3).to(place).expand(*place.shape, 3), place)

    def without_mass(self) -> "RigidLink":
        """The same link, weighing nothing."""
        return RigidLink(self.length, self.pose)

    def _map(self, change: Callable[[Tensor], Tensor]) -> "RigidLink":
        """The same link with every tensor changed alike; what was checked stays so."""
        new = object.__new__(type(self))
        for name in ("length", "pose", "mass"):
            value = getattr(self, name)
            object.__setattr__(new, name, None if value is None else change(value))
        return new

    def __repr__(self) -> str:
        """Shapes, no numbers."""
        name, value = ("length", self.length) if self.pose is None else ("pose", self.pose)
        assert value is not None
        return f"RigidLink({name} {tuple(value.shape)}, {value.dtype})"


@dataclass(frozen=True, eq=False, repr=False)
class ArmSeries(HoldsTensors):
    """Pressure segments one after the other, made by `series`.

    Attributes:
        segments: the arms from base to tip; their batches broadcast.
        links: what follows each segment before the next one or the tip: a rigid link, or None.

    Example:
        >>> ta.series([ta.bellows_arm(), ta.mckibben_arm()]).max_pressure.tolist()  # in the order of pressures
        [50.0, 50.0, 50.0, 50.0, 100.0, 100.0, 100.0, 100.0]
    """

    segments: tuple[ArmDesign, ...]
    links: tuple[RigidLink | None, ...]

    @property
    def dimension(self) -> int:
        """2 for a planar arm, 3 for a spatial one."""
        return self.segments[0].dimension

    @property
    def batch_shape(self) -> torch.Size:
        """Shape of the batch of designs; empty for one design."""
        return torch.broadcast_shapes(*(segment.batch_shape for segment in self.segments))

    @property
    def neutral_length(self) -> Tensor:
        """(*batch) the sum of the segments' neutral lengths [m], without links."""
        return torch.stack([one.neutral_length.expand(self.batch_shape) for one in self.segments]).sum(0)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """All force models, segment after segment."""
        return tuple(model for segment in self.segments for model in segment.actuators)

    @property
    def actuator_count(self) -> int:
        """Of all segments: pressures are given segment after segment."""
        return len(self.actuators)

    @property
    def max_pressure(self) -> Tensor:
        """(*batch, M) pressure limits [kPa] of all segments."""
        shape = self.batch_shape
        limits = [segment.max_pressure.expand(*shape, segment.actuator_count) for segment in self.segments]
        return torch.cat(limits, -1)

    def __repr__(self) -> str:
        """Kinds and shapes, no numbers."""
        parts = []
        for segment, link in zip(self.segments, self.links, strict=True):
            parts += [repr(segment)] if link is None else [repr(segment), repr(link)]
        return f"ArmSeries({', '.join(parts)})"


def series(parts: Sequence[ArmDesign | ArmSeries | RigidLink]) -> ArmSeries:
    """An arm of segments in series, from its base to its tip.

    Args:
        parts: segments, each an arm (or a series of its own), with rigid links between them where there are any,
            and behind the last one if a mount carries the tip. A link before the first is part of the base's pose.

    Raises:
        ValueError: there is no segment, a link has no segment right before it, planar and spatial parts are mixed,
            or batches do not broadcast.

    Example:
        >>> arm = ta.series([ta.bellows_arm(length=0.3), ta.RigidLink(length=0.03), ta.mckibben_arm(length=0.2)])
        >>> arm.actuator_count, round(float(arm.neutral_length), 3)  # without the link
        (8, 0.5)
    """
    if not isinstance(parts, Sequence) or isinstance(parts, str):
        raise ValueError(f"parts: must be a list of arms and links, got {shown(parts)}")
    segments: list[ArmDesign] = []
    links: list[RigidLink | None] = []
    for index, part in enumerate(parts):
        if isinstance(part, ArmDesign):
            segments.append(part)
            links.append(None)
        elif isinstance(part, ArmSeries):
            segments += part.segments
            links += part.links
        elif not isinstance(part, RigidLink):
            raise ValueError(f"parts[{index}]: must be an ArmDesign, an ArmSeries or a RigidLink, got {shown(part)}")
        elif not links or links[-1] is not None:
            where = "the base (its pose belongs to the task)" if not links else "another link (join the two in one)"
            raise ValueError(f"parts[{index}]: a link must follow a segment, got one behind {where}")
        else:
            links[-1] = part
    if not segments:
        raise ValueError("parts: must hold at least one ArmDesign, got none")
    _check_alike(segments, links)
    return ArmSeries(tuple(segments), tuple(links))


def rebuilt(arm: ArmDesign | ArmSeries, segments: Sequence[ArmDesign]) -> ArmDesign | ArmSeries:
    """Other segments in place of an arm's, with its links."""
    return ArmSeries(tuple(segments), arm.links) if isinstance(arm, ArmSeries) else segments[0]


def segments_of(arm: ArmDesign | ArmSeries) -> tuple[tuple[ArmDesign, ...], tuple[RigidLink | None, ...]]:
    """The segments of an arm, and the link or None behind each."""
    return (arm.segments, arm.links) if isinstance(arm, ArmSeries) else ((arm,), (None,))


def with_slices(segments: Sequence[ArmDesign]) -> Iterator[tuple[ArmDesign, slice]]:
    """Each segment, and the slice of its actuators among those of all."""
    first = 0
    for segment in segments:
        own = slice(first, first + segment.actuator_count)
        yield segment, own
        first = own.stop


def _check_alike(segments: list[ArmDesign], links: list[RigidLink | None]) -> None:
    dimension, like = segments[0].dimension, segments[0].radii
    for index, segment in enumerate(segments):
        if segment.dimension != dimension:
            raise ValueError(
                f"segments[{index}]: must be of dimension {dimension} as the first, got {segment.dimension}"
            )
        if segment.radii.dtype != like.dtype or segment.radii.device != like.device:
            raise ValueError(
                f"segments[{index}]: must have the first one's dtype and device, {like.dtype} on {like.device}, "
                f"got {segment.radii.dtype} on {segment.radii.device}"
            )
    for index, link in enumerate(links):
        if link is not None and link.dimension not in (None, dimension):
            form = "(..., 3)" if dimension == 2 else "(..., 4, 4)"
            raise ValueError(f"links[{index}].pose: must have shape {form} as the arm's dimension is {dimension}")
    broadcast_shapes(**{f"segments[{index}]": segment.batch_shape for index, segment in enumerate(segments)})
