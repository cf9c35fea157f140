"""How much of a payload a design can bear at a shape: where a growing payload leaves the attainable sets.

The wrench that a node requires is linear in the payload: `t` times the payload requires the wrench of the arm's own
weight and `t` times the payload's. It moves along a line, and a convex set cuts an interval of factors out of that
line. An arm bears the factors that lie in the intervals of all its nodes.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.inputs import HoldsTensors, check_choice, check_count, shapes_only
from torcharm.load import ExternalLoad
from torcharm.statics.cross_section import CrossSections
from torcharm.task import Task
from torcharm.wrench_sets.design_task_grid import (
    DesignTaskGrid,
    design_task_grid,
    fitted,
    limits_in_range,
    map_chunks,
    without_link_masses,
)
from torcharm.wrench_sets.node_distances import (
    METRICS,
    SetOptions,
    any_sampled,
    default_chunk,
    lack_in_words,
    node_distances,
    possible_sections,
    strain_excess,
    wants_gradient,
)
from torcharm.wrench_sets.rays import evaluate_ends, find_ends, meet_points

INEXACT = (
    "no pressures hold this very shape under any multiple of the payload, so that it cannot be scaled: as it is, "
    "{}; evaluate tells what is held within a tolerance"
)
IMPOSSIBLE = "the shape leaves an actuator no length"
"""Why there is no factor."""


@dataclass(frozen=True, eq=False, repr=False)
class LoadCapacity(HoldsTensors):
    """What `load_capacity` found. Shapes are (*design batch, *task batch), with N nodes added per node.

    Factors multiply the task's payload: its tip load and its point loads, wrenches and masses. Where no factor serves,
    they are NaN, and `reason` says why; a bound that there is not is infinite.

    Attributes:
        factor: the largest factor of at least 0 that the sets of all nodes allow.
        t_min, t_max: the least and the largest factor, of either sign, that they allow. An arm may need a load:
            then `t_min` is above 0.
        t_min_per_node, t_max_per_node: the same for each node alone.
        limiting_node: the index, from 0 at the base, of the node that sets `factor`; -1 where none does.
        attainable: whether there is a factor of at least 0.
        attainable_unloaded: whether factor 0 is allowed.
        unbounded: whether `factor` is infinite, as that of a payload that asks nothing of any set.
        in_range: whether every strain and every pressure limit lies in the range of its force model.
        impossible: whether the shape leaves an actuator no length, or less, at some node; no factor serves there.
        converged: whether every node's answer is known to rounding.
        arm, task, metric: what was asked.

    Example:
        >>> found = ta.load_capacity(ta.antagonistic_arm(), ta.Task(ta.affine_curvature(1.0, 1.5), [0.5, -0.5, 0.0]))
        >>> round(float(found.factor), 2), int(found.limiting_node)  # the node that gives up first
        (3.34, 5)
    """

    factor: Tensor
    t_min: Tensor
    t_max: Tensor
    t_min_per_node: Tensor
    t_max_per_node: Tensor
    limiting_node: Tensor
    attainable: Tensor
    attainable_unloaded: Tensor
    unbounded: Tensor
    in_range: Tensor
    impossible: Tensor
    converged: Tensor
    arm: ArmDesign | ArmSeries
    task: Task
    metric: str

    def __repr__(self) -> str:
        """Of one task the factor, or why there is none; of several the shapes."""
        if self.factor.ndim:
            return shapes_only(self)
        factor, why = float(self.factor), str(self.reason)
        if not why:
            why = f"limited by node {int(self.limiting_node) + 1} from the base" if factor < torch.inf else "no limit"
        return f"LoadCapacity(factor {factor:.4g}, {why})"

    @property
    def factor_per_node(self) -> Tensor:
        """(..., N) the largest factor of at least 0 that each node's set allows; NaN where there is none."""
        return torch.where(self.t_max_per_node >= 0, self.t_max_per_node, torch.nan)

    @cached_property
    def reason(self) -> str | NDArray[Any]:
        """Why there is no factor, in a sentence for each; else empty.

        It tells the node, counted from 1 at the base, that lacks most of what the payload as it is requires, N·m
        counted as N.
        """
        batch = self.attainable.shape
        found = np.full(tuple(batch), "", dtype=object)
        if not bool(self.attainable.all()):
            grid = design_task_grid(*fitted(self.arm, self.task))
            with torch.no_grad():
                miss = node_distances(grid, SetOptions((self.metric,), (1.0, 1.0))).distance[..., 0, :]
            most, node = (value.expand(batch).numpy(force=True) for value in grid.unflatten(miss).max(-1))
            lost = self.impossible.numpy(force=True)
            for index in map(tuple, np.argwhere(~self.attainable.numpy(force=True))):
                size, where = float(most[index]), int(node[index])
                lacking = lack_in_words(where, size, (1.0, 1.0), relative=self.metric == "relative")
                found[index] = IMPOSSIBLE if lost[index] else INEXACT.format(lacking)
        return str(found[()]) if not batch else found.astype(str)


def load_capacity(
    arm: ArmDesign | ArmSeries, task: Task, metric: str = "absolute", *, chunk_size: int | None = None
) -> LoadCapacity:
    """The largest factor by which every task's payload can grow, at its shape, for every design.

    The payload is the tip load and all point loads, their wrenches and their masses. What the arm and its links weigh
    under gravity stays the same at every factor.

    Along the outward normal n where the line `w_0 + t w` leaves a node's set, `t = (h(n) - n·w_0)/(n·w)`, with h the
    set's support function. Sets are those of `evaluate`, exact for any force model. Differentiable once with respect
    to radii, offsets, lengths, pressure limits, masses, twists, loads and whatever force models hold, by the same
    formula with the normal held; where a corner or two nodes limit alike there is a kink, and the gradient is a
    one-sided one.

    Where all actuators are passive each set is one point: the factor is 0 where the arm is at rest at the shape without
    the payload, 1 with it, infinite where the payload asks nothing of any node, and NaN at other shapes.

    As all that sets say, the factor is an upper bound: every node's requirement can be met below it, each by a
    pressure of its own. Verdicts of `evaluate` are another question: the factor is of the very shape, without any
    tolerance. So a task may be held within its tolerance where the factor is below 1 or NaN, and missed where it is
    above, as one pressure must then serve all nodes. Where it is NaN, `reason` says why: mostly an arm comes close to
    the shape, but not to the very shape, as every node of a curve asks for a wrench of its own.

    Args:
        arm: designs, of any batch shape; or segments in series.
        task: tasks, of any batch shape, of the arm's dimension. Loads that share a shape share its sets.
        metric: "absolute", or "relative" for differences from the first node of the same segment.
        chunk_size: (design, shape, load) triples worked on at once; None chooses. Bounds memory.

    Raises:
        ValueError: an argument is none of those allowed, arm and task do not fit, or there is no payload to scale.

    Example:
        >>> tasks = ta.Task(ta.affine_curvature(1.0, 1.5), tip_load=[[0.5, -0.5, 0.0], [0.0, -0.5, 0.0]])
        >>> ta.load_capacity(ta.antagonistic_arm(), tasks).factor.round(decimals=2).tolist()  # times these loads
        [3.34, 3.3]
    """
    check_choice("metric", metric, METRICS)
    if chunk_size is not None:
        check_count("chunk_size", chunk_size, 1)
    arm, task, grid, direction = _prepared(arm, task)
    ends = _per_node(grid, direction, metric == "relative", chunk_size)
    low, high, slack, converged, excess, impossible = (grid.unflatten(part) for part in ends)
    asked = {"arm": arm, "task": task, "metric": metric}
    return _over_nodes(low, high, slack, converged, excess, impossible, limits_in_range(grid), asked)


def _prepared(arm: ArmDesign | ArmSeries, task: Task) -> tuple[ArmDesign | ArmSeries, Task, DesignTaskGrid, Tensor]:
    """Arm and task, once they are known to fit; the sets and wrenches without the payload; and what that adds to them.

    Raises:
        ValueError: they do not fit, or there is no payload.
    """
    arm, task = fitted(arm, task)
    if task.load.tip is None and not task.load.points:
        raise ValueError("load: must hold a payload to scale, a tip load or point loads, got none")
    nothing = task.twists.new_zeros(task.twists.shape[-1]).expand(*task.batch_shape, -1)
    weight = ExternalLoad(nothing, task.load.gravity)
    own = Task(task.twists, None, task.base_pose, weight, task.wrench_at, task.segment_nodes)
    grid = design_task_grid(arm, own)
    direction = design_task_grid(without_link_masses(arm), task).external
    return arm, task, grid, direction


@torch.no_grad()
def held_factor(arm: ArmDesign | ArmSeries, task: Task) -> Tensor:
    """The `factor` of `load_capacity` at shapes that are known to be held under the payload as it is, such as
    equilibria: at least 1, in a quarter of the time, and without gradients.

    Where no pressures but one hold a shape, rounding may leave a set without the very requirement: that counts as 1.

    Returns:
        (*design batch, *task batch).

    Raises:
        ValueError: as of `load_capacity`.
    """
    _, _, grid, direction = _prepared(arm, task)
    whole, found = slice(None), torch.full(grid.sizes, torch.inf, dtype=grid.twists.dtype)
    for segment, nodes in enumerate(grid.nodes):
        start = grid.required(whole, whole, whole, nodes)
        sections, _ = possible_sections(grid.sections(segment, whole, whole))
        own = direction[..., nodes, :]
        ends = find_ends(sections, start, own, relative=False, points=any_sampled(sections), least=True)
        leave = ends.factor[:, 1]
        passive = (sections.limit == 0).all(-1, keepdim=True)
        if bool(passive.any()):
            leave = torch.where(passive, meet_points(sections, start, own, relative=False)[1], leave)
        found = torch.minimum(found, leave.amin(-1))
    return grid.unflatten(found.clamp(min=1.0))


def _over_nodes(
    low: Tensor,
    high: Tensor,
    slack: Tensor,
    converged: Tensor,
    excess: Tensor,
    impossible: Tensor,
    limits: Tensor,
    asked: dict[str, Any],
) -> LoadCapacity:
    """Intersect the nodes' intervals (..., N), known to within `slack`; one that is empty has `low > high`.

    Those that are points meet each other, and 0, to within what is known of them.
    """
    least, latest = low.max(-1)
    most, limiting = high.min(-1)
    either = torch.stack((latest, limiting), -1)
    possible = (low <= high).all(-1) & (least - most <= slack.gather(-1, either).sum(-1)) & ~impossible
    least = torch.minimum(least, most)
    near = slack.gather(-1, either)
    serves = possible & (most >= -near[..., 1])
    nothing = most.abs() <= near[..., 1]
    factor = torch.where(serves, torch.where(nothing, most - most.detach(), most), torch.nan)
    unbounded = factor == torch.inf
    own = (low <= high) & ~impossible.unsqueeze(-1)
    return LoadCapacity(
        factor=factor,
        t_min=torch.where(possible, least, torch.nan),
        t_max=torch.where(possible, most, torch.nan),
        t_min_per_node=torch.where(own, low, torch.nan),
        t_max_per_node=torch.where(own, high, torch.nan),
        limiting_node=torch.where(serves & ~unbounded, limiting, -1),
        attainable=serves,
        attainable_unloaded=possible & (least <= near[..., 0]) & (most >= -near[..., 1]),
        unbounded=unbounded,
        in_range=(excess <= 16 * torch.finfo(excess.dtype).eps) & limits & ~impossible,
        impossible=impossible,
        converged=converged.all(-1) & ~impossible,
        **asked,
    )


def _per_node(grid: DesignTaskGrid, direction: Tensor, relative: bool, chunk_size: int | None) -> tuple[Tensor, ...]:
    """Ends of the nodes' intervals (B, P, L, N), how well they are known, and whether they converged; then (B, P, L)
    the strain excess, and whether the shape is impossible."""
    if 0 in grid.sizes:
        real = grid.twists.new_zeros(*grid.sizes, grid.twists.shape[-2])
        flag = torch.zeros_like(real, dtype=torch.bool)
        return real, real, real, ~flag, real[..., 0], flag[..., 0]
    designs, shapes, loads = grid.sizes
    size = chunk_size or default_chunk(grid)
    again = designs * shapes * loads > size

    def work(*place: slice) -> tuple[Tensor, ...]:
        parts = [
            _segment(grid, s, place, direction[place[1], place[2], grid.nodes[s]], relative, again)
            for s in range(len(grid.segments))
        ]
        *nodes, excess, lost = zip(*parts, strict=True)
        return *(torch.cat(part, -1) for part in nodes), torch.stack(excess).amax(0), torch.stack(lost).any(0)

    return map_chunks(grid, size, work)


def _segment(
    grid: DesignTaskGrid, segment: int, place: tuple[slice, ...], direction: Tensor, relative: bool, again: bool
) -> tuple[Tensor, ...]:
    """The columns of `_per_node` of the nodes of one segment.

    Args:
        again: whether a graph is built when it is needed instead of kept.
    """
    designs, shapes, loads = place
    start = grid.required(designs, shapes, loads, grid.nodes[segment])

    def prepare() -> tuple[CrossSections, Tensor, Tensor]:
        sections = grid.sections(segment, designs, shapes)
        return *possible_sections(sections), strain_excess(sections)

    with torch.no_grad():
        sections, lost, excess = prepare()
    followed = wants_gradient(grid, segment) or (torch.is_grad_enabled() and direction.requires_grad)
    points = followed or any_sampled(sections)
    ends = find_ends(sections, start, direction, relative=relative, points=points)

    def replay() -> tuple[Tensor, Tensor]:
        own, _, beyond = prepare()
        return evaluate_ends(own, start, direction, ends, relative=relative), beyond

    factor = ends.factor
    if followed:
        factor, excess = checkpoint(replay, use_reentrant=False) if again else replay()
    elif points:
        factor = evaluate_ends(sections, start, direction, ends, relative=relative)
    low, high = _met_in_one_point(factor[:, 0], factor[:, 1], ends.slack.sum(1))
    slack = ends.slack.amax(1)
    passive = (sections.limit == 0).all(-1, keepdim=True)
    if bool(passive.any()):
        met = meet_points(prepare()[0] if followed else sections, start, direction, relative=relative)
        low, high, slack = (torch.where(passive, *pair) for pair in zip(met, (low, high, slack), strict=True))
    shape = (*excess.shape, direction.shape[1])
    columns = (low, high, slack, ends.certified.all(1) | passive)
    return *columns, excess.unsqueeze(-1).expand(shape), lost.unsqueeze(-1).expand(shape)


def _met_in_one_point(low: Tensor, high: Tensor, slack: Tensor) -> tuple[Tensor, Tensor]:
    """The ends of intervals, those that rounding has turned round, as of sets without area, as one point."""
    turned = (low > high) & (low - high <= slack) & low.isfinite() & high.isfinite()
    middle = torch.where(turned, 0.5 * (low + high), 0.0)
    return torch.where(turned, middle, low), torch.where(turned, middle, high)
