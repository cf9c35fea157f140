"""What `workspace` found: states, the region that they fill, and what can be done in each cell of it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.geometry.alpha_shape import AlphaShape, alpha_shape
from torcharm.inputs import HoldsTensors, Tabular, TensorLike, as_floating, check_above_zero
from torcharm.load import ExternalLoad
from torcharm.workspaces.states import EXCLUDED, REACHED, STATES, has_payload, position_of

Array = NDArray[np.float64]


LATE = 0.25
"""Of the states, those solved last; they refine the boundary."""
GROWN = 0.03
"""Of a region's size: where the late states add more than so much, more states would add as much again and more."""


@dataclass(frozen=True, eq=False, repr=False)
class Workspace(HoldsTensors, Tabular):
    """Where an arm's tip can be under a load: S states, in the order in which they were solved.

    The region is the alpha shape of the states that are reached: where no three (in space four) of them lie within a
    circle (sphere) of radius `resolution` with no other inside, there is a gap.

    Attributes:
        tip_pose: (S, 3) `(x, y, θ)` or (S, 4, 4) [m, rad].
        pressure: (S, M) [kPa].
        twists: (S, N, K) the shapes [m, rad].
        code: (S,) indices into `STATES`, the words of `status`.
        strain_excess: (S,) largest strain beyond its actuator's characterised range, 0 if none is.
        payload_factor: (S,) the largest factor by which the payload could grow at the shape, by the sets of all nodes;
            infinite without a payload, NaN of states that are not stable.
        resolution: α of the region's alpha shape [m].
        extrapolated_resolution: of that where force models may be extrapolated, whose states are less dense.
        arm, load: what was asked.
        base_pose: (3,) or (4, 4).
        segment_nodes: elements of each segment.
        wrench_at: where an element's wrench was taken.
        stopped: "finished", or what stopped it: "interrupted", "callback".
        wanted: how many states were asked for.

    Example:
        >>> found = ta.workspace(ta.bellows_arm(), states=200, nodes=3)
        >>> found.contains([[0.0, -0.6], [0.4, 0.0]]).tolist()  # below the base, beside it
        [True, False]
    """

    tip_pose: Tensor
    pressure: Tensor
    twists: Tensor
    code: Tensor
    strain_excess: Tensor
    payload_factor: Tensor
    resolution: float
    extrapolated_resolution: float
    arm: ArmDesign | ArmSeries
    load: ExternalLoad
    base_pose: Tensor
    segment_nodes: tuple[int, ...]
    wrench_at: str
    stopped: str
    wanted: int

    @property
    def interruption(self) -> str:
        """That it was stopped before its end, and after how many states; empty if it was not."""
        return "" if self.stopped == "finished" else f"interrupted: {len(self.code)} of {self.wanted} states"

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.arm.dimension

    @property
    def position(self) -> Tensor:
        """(S, D) where the tips are [m]."""
        return position_of(self.tip_pose)

    @property
    def angle(self) -> Tensor:
        """(S,) how tips point: in the plane their heading θ, in space the elevation of body x above the horizontal
        [rad]."""
        return self.tip_pose[:, 2] if self.dimension == 2 else self.tip_pose[:, 1, 0].clamp(-1, 1).asin()

    @property
    def status(self) -> NDArray[Any]:
        """(S,) what to think of each state, a word of `STATES`."""
        return np.array(STATES)[self.code.numpy(force=True)]

    @property
    def shares(self) -> dict[str, float]:
        """The share of the states that each word of `STATES` has; they are denser where the boundary lies."""
        counts = torch.bincount(self.code, minlength=len(STATES)).tolist()
        return {word: count / max(len(self.code), 1) for word, count in zip(STATES, counts, strict=True)}

    @property
    def reached(self) -> Tensor:
        """(S,) which states make the region."""
        return self.code == REACHED

    @property
    def extrapolated(self) -> Tensor:
        """(S,) which make the region where force models may be extrapolated: the same, and those excluded by range."""
        return self.code <= EXCLUDED

    @cached_property
    def region(self) -> AlphaShape:
        """What is reached."""
        return self._shape(self.reached, self.resolution)

    @cached_property
    def extrapolated_region(self) -> AlphaShape:
        """What is reached where force models may be extrapolated."""
        if bool((self.reached == self.extrapolated).all()):
            return self.region
        return self._shape(self.extrapolated, self.extrapolated_resolution)

    def _shape(self, which: Tensor, resolution: float) -> AlphaShape:
        return alpha_shape(self.position[which].double().numpy(force=True), resolution)

    @property
    def size(self) -> float:
        """Area [m²] of the region, in space its volume [m³]."""
        return self.region.size

    @cached_property
    def unsettled(self) -> str:
        """That a region's size is not known yet, in a sentence; empty where both regions hardly grow any more.

        Of a region that the last quarter of the states made larger by more than 3 %, as many again may well find more.
        """
        shapes = {
            "the region reached": (self.reached, self.region, self.resolution),
            "the extrapolated region": (self.extrapolated, self.extrapolated_region, self.extrapolated_resolution),
        }
        early, words = torch.arange(len(self.code)) < (1 - LATE) * len(self.code), list[str]()
        for name, (which, region, resolution) in shapes.items():
            before = self._shape(which & early.to(which.device), resolution).size
            if before < (1 - GROWN) * region.size:
                words.append(f"{name} was {100 * (1 - before / region.size):.0f} % smaller without them")
        if not words:
            return ""
        return f"not settled: the last quarter of {len(self.code)} states still counts, {' and '.join(words)}"

    def contains(self, points: TensorLike) -> Tensor:
        """(...) which points (..., D) of the world [m] lie within the region.

        Raises:
            ValueError: points have another number of coordinates.
        """
        (given,) = as_floating(points=points)
        if given.ndim < 1 or given.shape[-1] != self.dimension:
            raise ValueError(f"points: must have shape (..., {self.dimension}), got {tuple(given.shape)}")
        return torch.from_numpy(self.region.contains(given.double().numpy(force=True)))

    @property
    def reach(self) -> float:
        """The largest distance of a tip reached from the base [m]; NaN where none is."""
        away = self.position[self.reached] - position_of(self.base_pose)
        return float(away.norm(dim=-1).max()) if len(away) else float("nan")

    @property
    def heights(self) -> tuple[float, float]:
        """The lowest and the highest tip reached, by their y [m]; NaN where none is."""
        height = self.position[self.reached, 1]
        return (float(height.min()), float(height.max())) if len(height) else (float("nan"),) * 2

    @property
    def has_payload(self) -> bool:
        """Whether there is a payload, which can grow."""
        return has_payload(self.load)

    def cells(self, size: float | None = None, extrapolated: bool = False) -> "Cells":
        """What is known of each square (in space cube) in which the tip was reached.

        Args:
            size: of a cell [m]; None takes twice the resolution.
            extrapolated: whether states excluded by range count.

        Raises:
            ValueError: the size is not above 0.
        """
        size = check_above_zero("size", size) or 2 * self.resolution
        which = self.extrapolated if extrapolated else self.reached
        index = (self.position[which].double() / size).floor()
        corner, cell, count = index.unique(dim=0, return_inverse=True, return_counts=True)
        factor, angle = self.payload_factor[which].double(), self.angle[which].double()

        def over(values: Tensor, how: str) -> Tensor:
            return values.new_zeros(len(corner)).scatter_reduce(0, cell, values, how, include_self=False)

        return Cells(size, (corner + 0.5) * size, count, over(factor, "amax"), over(angle, "amin"), over(angle, "amax"))

    def to_dict(self) -> dict[str, list[Any]]:
        """Columns with an entry for each state, in metres, radians and kilopascals."""
        columns = {name: value.tolist() for name, value in self._columns()}
        return {**columns, "status": self.status.tolist()}

    def _columns(self) -> "list[tuple[str, Tensor]]":
        places = zip(("tip_x", "tip_y", "tip_z"), self.position.unbind(-1), strict=False)
        others = [("strain_excess", self.strain_excess)]
        if self.has_payload:
            others.append(("payload_factor", self.payload_factor))
        pressures = ((f"pressure_{index}", own) for index, own in enumerate(self.pressure.unbind(-1), 1))
        return [*places, ("tip_angle", self.angle), *others, *pressures]

    def __repr__(self) -> str:
        """Counts and the region's size."""
        counts = torch.bincount(self.code, minlength=len(STATES)).tolist()
        said = ", ".join(f"{count} {word}" for word, count in zip(STATES, counts, strict=True) if count)
        unit = "m²" if self.dimension == 2 else "m³"
        more = f"; {self.unsettled}: ask for more states" if self.unsettled else ""
        return f"Workspace({len(self.code)} states: {said or 'none'}; {self.size:.3g} {unit}{more})"


@dataclass(frozen=True, eq=False)
class Cells(HoldsTensors):
    """Squares or cubes of a grid through the origin, in which the tip was reached.

    Attributes:
        size: of a side [m].
        centre: (C, D) [m].
        count: (C,) states in each.
        payload_factor: (C,) the largest of its states'.
        angle_min, angle_max: (C,) the least and the largest `Workspace.angle` of its states' [rad].
    """

    size: float
    centre: Tensor
    count: Tensor
    payload_factor: Tensor
    angle_min: Tensor
    angle_max: Tensor
