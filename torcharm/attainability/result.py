"""What an evaluation found, and what it means: a verdict for each task, and its reason."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, segments_of
from torcharm.attainability.questions import question
from torcharm.attainability.reasons import NO_CENTRELINE, at_limits, differences, missing, one_design, out_of_range
from torcharm.attainability.verdict import VERDICTS, PoseTolerance, judge, over_tolerance
from torcharm.inputs import HoldsTensors, Tabular
from torcharm.task import Task

if TYPE_CHECKING:
    from torcharm.pressure.predicted_error import PredictedError
    from torcharm.pressure.search import PressureSearch


MUCH = 1.0
"""A lack of a node [N] beyond which it is told beside strains out of range, as a further cause."""

COLUMNS = (
    *("verdict", "tip_error", "tip_rotation_error", "shape_error", "worst_node", "worst_miss", "absolute", "relative"),
    *("capacity_margin", "in_range", "strain_excess", "impossible", "status", "reason"),
)
"""Of an evaluation as a table, besides pressures."""


@dataclass(frozen=True, eq=False, repr=False)
class Attainability(HoldsTensors, Tabular):
    """What `evaluate` found; what was not asked for is None.

    Shapes are (*design batch, *task batch), with N nodes or M actuators added where that is said. Indices count from 0;
    words, as of `reason`, count nodes and actuators from 1 at the base, as the paper does.

    Attributes:
        absolute, relative: unattainability summed over the nodes, the paper's sums, 0 where sets do not exclude the
            task. Their unit is that of `sqrt(k_f f² + k_m m²)`: weights of one mix newtons and newton-metres, as the
            paper does.
        absolute_per_node, relative_per_node: (..., N) each node's distance to its set, in the same unit, not raised to
            a power.
        prediction: all that is known of the predicted error, with what it takes to trust it; or what a search found,
            where that was given in its place.
        strain_excess: largest strain of the task's shape beyond its actuator's characterised range, 0 if none is.
        shape_in_range: whether every strain of the task's shape, and every pressure limit, lies in the characterised
            range.
        impossible: whether the shape leaves an actuator no length, or less, at some node: a strain of -1 or below, as
            of curvatures in degrees or lengths in millimetres. All metrics are infinite there.
        distances_converged: whether every distance is finite and known to within its promise: the gap between its
            bounds is closed, or the solver's answer passed its check.
        signed: whether distances go on below 0 inside.
        weights: k_f [1/N²] and k_m [1/(N·m)²] of distances.
        tolerance: what counts as held.
        arm, task: what was evaluated.

    Example:
        >>> found = ta.evaluate(ta.bellows_arm(), ta.Task(ta.constant_curvature(0.5), tip_load=[1.0, 0.0, 0.0]))
        >>> found.verdict, found.reason.split(";")[0]
        ('missed', 'shape off by 35.3 mm: 6.4 % too long, bends 51 % too little')
    """

    absolute: Tensor | None
    relative: Tensor | None
    absolute_per_node: Tensor | None
    relative_per_node: Tensor | None
    prediction: "PredictedError | PressureSearch | None"
    strain_excess: Tensor
    shape_in_range: Tensor
    impossible: Tensor
    distances_converged: Tensor
    signed: bool
    weights: tuple[float, float]
    tolerance: PoseTolerance
    arm: ArmDesign | ArmSeries
    task: Task

    @property
    def tip_error(self) -> Tensor | None:
        """Distance of the tip from the task's at the predicted equilibrium [m]; infinite where there is none."""
        return None if self.prediction is None else self.prediction.tip_error

    @property
    def tip_rotation_error(self) -> Tensor | None:
        """Turn of the tip from the task's [rad]."""
        return None if self.prediction is None else self.prediction.tip_rotation_error

    @property
    def shape_error(self) -> Tensor | None:
        """The predicted error: the weighted mean distance of the poses from the task's [m]."""
        return None if self.prediction is None else self.prediction.shape_error

    @property
    def over_tolerance(self) -> Tensor | None:
        """The largest of the three errors, each over its tolerance: up to 1 all are within. It has no gradient."""
        found = self.prediction
        return None if found is None else over_tolerance(self.arm, found, self.tolerance).amax(0)

    @property
    def pressure(self) -> Tensor | None:
        """(..., M) the pressure that reaches it [kPa]."""
        return None if self.prediction is None else self.prediction.pressure

    @property
    def in_range(self) -> Tensor:
        """Whether the task's shape, the limits and the shape predicted, if one was, are in the characterised range."""
        found = self.prediction
        return self.shape_in_range if found is None else self.shape_in_range & (found.in_range | ~found.stable)

    @cached_property
    def verdict(self) -> str | NDArray[Any] | None:
        """A word of `VERDICTS`, or an array of them; None where no error was predicted: sets alone only exclude."""
        if self.prediction is None:
            return None
        code = judge(self.arm, self.prediction, self.tolerance, self.in_range, self.impossible).numpy(force=True)
        return VERDICTS[int(code)] if code.ndim == 0 else np.array(VERDICTS)[code]

    @cached_property
    def reason(self) -> str | NDArray[Any]:
        """Why a task is not held, in a sentence for each: the node, the actuator or what was not found; else empty.

        Of what is missed it also says by how much the arm predicted is too short or long, bends too little or much, or
        sideways, and which actuators are at their limit or without pressure. Nodes and actuators are counted from 1 at
        the base, so that "node 1" is `worst_node` 0. What a node lacks is its distance, which mixes N and N·m by the
        weights.
        """
        shape = self.strain_excess.shape
        if not shape:
            return self._reason(())
        found = np.empty(tuple(shape), dtype=object)
        for index in np.ndindex(*shape):
            found[index] = self._reason(index)
        return found.astype(str)

    def _reason(self, index: tuple[int, ...]) -> str:
        """Of one design on one task: an index into design and task batch. Where units are to blame it asks so."""
        verdict = _word(self.verdict, index)
        if verdict == "held":
            return ""
        if verdict == "impossible" and not bool(self.impossible[index]):
            return NO_CENTRELINE
        lead, task, batch = len(self.arm.batch_shape), self.task, self.arm.batch_shape
        segments = [one_design(segment, batch, index[:lead]) for segment in segments_of(self.arm)[0]]
        twists = task.twists.detach().expand(*task.batch_shape, *task.twists.shape[-2:])[index[lead:]]
        nodes = task.nodes_of_segments
        causes = self._causes(verdict, index, segments, twists, nodes)
        asked = question(segments, twists, nodes) if any(causes) else None
        return "; ".join(filter(None, (*causes, asked)))

    def _causes(
        self, verdict: str, index: tuple[int, ...], segments: Sequence[ArmDesign], twists: Tensor, nodes: Sequence[int]
    ) -> Sequence[str]:
        """Parts of a reason, some of them empty; all are where nothing is known to be amiss."""
        found, in_range = self.prediction, bool(self.shape_in_range[index])
        absolute, relative = (
            None if value is None else value[index] for value in (self.absolute_per_node, self.relative_per_node)
        )
        lack, lacking = missing(absolute, relative, self.weights)
        if found is None:
            return (lacking if in_range else out_of_range(segments, twists, nodes),)
        status, reached = _word(self.status, index), found.twists[index].detach()
        doubt = found.DOUBTS.get(status, "")
        besides = f"{lacking} besides" if verdict == "excluded by range" and lack > MUCH else ""
        if not in_range:
            return out_of_range(segments, twists, nodes), doubt if status == "snapped" else "", besides
        if verdict == "excluded by range":
            return f"at the shape found: {out_of_range(segments, reached, nodes)}", doubt, besides
        if verdict == "undecided":
            return (doubt,)
        limits = at_limits(found.pressure[index].detach(), torch.cat([segment.max_pressure for segment in segments]))
        wrong = differences(twists, reached.to(twists), nodes)
        cause = lacking or "no pressure comes close enough, though sets do not exclude it"
        return ": ".join(filter(None, (self._beyond_tolerance(index), wrong))), limits, cause

    def _beyond_tolerance(self, index: tuple[int, ...]) -> str:
        """Which error of a prediction is furthest beyond what is tolerated."""
        assert self.prediction is not None
        found = self.prediction
        over = over_tolerance(self.arm, found, self.tolerance).movedim(0, -1)[index]
        said = (
            f"tip off by {1e3 * float(found.tip_error[index]):.3g} mm",
            f"tip turned by {math.degrees(float(found.tip_rotation_error[index])):.3g}°",
            f"shape off by {1e3 * float(found.shape_error[index]):.3g} mm",
        )
        return said[int(over.argmax())]

    @property
    def not_excluded(self) -> Tensor | None:
        """Whether every distance that was asked for is 0 (signed: or below) and converged: all that sets can say.

        They look at each node alone, so that it does not follow that the task can be held. None where no set was asked.
        """
        if self.absolute is None and self.relative is None:
            return None
        found = self.distances_converged & ~self.impossible
        for value in (self.absolute, self.relative):
            found = found if value is None else found & (value <= 0)
        return found

    @property
    def node_miss(self) -> Tensor | None:
        """(..., N) the distance of each node, by the first of absolute and relative that was asked for."""
        per_node = self.relative_per_node if self.absolute_per_node is None else self.absolute_per_node
        return None if per_node is None else per_node.clamp(min=0)

    @property
    def worst_node(self) -> Tensor | None:
        """The index, from 0 at the base, of the node with the largest distance: in `reason` it is one more."""
        return None if self.node_miss is None else self.node_miss.argmax(-1)

    @property
    def worst_miss(self) -> Tensor | None:
        """The largest distance of a node, which mixes N and N·m by the weights."""
        return None if self.node_miss is None else self.node_miss.amax(-1)

    @property
    def capacity_margin(self) -> Tensor | None:
        """Least distance over the nodes from the requirement to the boundary of its absolute set, above 0 inside.

        None unless evaluated with `signed=True`: margins inside cost more than distances.
        """
        return -self.absolute_per_node.amax(-1) if self.signed and self.absolute_per_node is not None else None

    @property
    def converged(self) -> Tensor:
        """Whether distances, and the prediction if it was asked for, converged, so that both have gradients."""
        prediction = self.prediction
        known = self.distances_converged
        return known if prediction is None else known & prediction.converged & prediction.stable

    @property
    def status(self) -> str | NDArray[Any]:
        """What to think of the computation: the prediction's word, or converged, not converged or impossible."""
        if self.prediction is not None:
            return self.prediction.status
        words = np.where(self.distances_converged.numpy(force=True), "converged", "not converged")
        words = np.where(self.impossible.numpy(force=True), "impossible", words)
        return str(words) if words.ndim == 0 else words

    def to_dict(self) -> dict[str, list[Any]]:
        """Columns with an entry for each design and task, counted from 0 in the order of their flattened batches.

        `worst_node` counts from 0, too, as it does in Python; the words of `reason` and pressures' names from 1.
        """
        designs = self.arm.batch_shape.numel()
        tasks = self.strain_excess.numel() // max(designs, 1)
        columns: dict[str, list[Any]] = {
            "design": [design for design in range(designs) for _ in range(tasks)],
            "task": list(range(tasks)) * designs,
        }
        for name in COLUMNS:
            value = getattr(self, name)
            if value is not None:
                columns[name] = np.ravel(value.numpy(force=True) if isinstance(value, Tensor) else value).tolist()
        if self.pressure is not None:
            for index, pressure in enumerate(self.pressure.detach().reshape(-1, self.pressure.shape[-1]).unbind(-1), 1):
                columns[f"pressure_{index}"] = pressure.tolist()
        return columns

    def __repr__(self) -> str:
        """Shapes and counts, no numbers."""
        shape = tuple(self.strain_excess.shape)
        if self.not_excluded is not None and self.prediction is None:
            return f"Attainability(batch {shape}, {int(self.not_excluded.sum())} not excluded)"
        words, counts = np.unique(np.ravel(np.asarray(self.verdict)), return_counts=True)
        said = ", ".join(f"{count} {word}" for word, count in zip(words, counts, strict=True))
        return f"Attainability(batch {shape}, {said})"


def _word(words: "str | NDArray[Any] | None", index: tuple[int, ...]) -> str:
    """One of an array of words, or the only one."""
    return str(words if words is None or isinstance(words, str) else words[index])
