"""Can these designs hold these shapes under these loads, and by how much do they miss?"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torcharm._compiled import check_compiled
from torcharm._inputs import check_choice, check_count, check_flag, shown
from torcharm._node_distances import Check, Residuals, node_distances
from torcharm._outer import OuterProduct, check_arm_and_task, map_blocks, outer_product
from torcharm._sampled_distances import impossible_nodes, required_by_metric, strain_excess
from torcharm.arm import ArmDesign
from torcharm.distance import DistanceFunction, find_solver
from torcharm.hulls import cross_sections, sample_count, slot_count
from torcharm.pose_cost import PoseCost
from torcharm.task import Task
from torcharm.wrenches import along

if TYPE_CHECKING:
    from torcharm.prediction import PredictedError

METRICS = ("absolute", "relative")
"""Of wrenches, by hulls."""
PREDICTED = "predicted_error"
CHOICES = (*METRICS, PREDICTED)
"""All metrics there are."""
BLOCK_ELEMENTS = 300_000
"""Hull slots × points in one block: a tensor of them is 2.4 MB, small enough for the caches."""
IMPOSSIBLE_ELEMENTS = 1_000_000
"""Sections whose actuators' lengths are looked at at once (8 MB)."""
POLISHED_SAMPLES, POLISHING_SAMPLES = 3, 3
"""Samples a curve to polish from; and as how many more polishing counts in sizing blocks."""
SOLVER_ELEMENTS = 3_000_000
"""Hull slots² × points in one block of a solver, which holds matrices over the vertices."""


@dataclass(frozen=True, eq=False)
class Attainability:
    """What `evaluate` found; a metric that was not asked for is None.

    Shapes are (*design batch, *task batch), with N nodes added per node. The unit of a distance
    is that of `sqrt(k_f f² + k_m m²)`: with weights of one it mixes newtons and newton-metres, as
    the paper does.

    Attributes:
        absolute, relative: unattainability summed over the nodes, 0 if attainable.
        absolute_per_node, relative_per_node: each node's distance to its hull, not raised to a power.
        predicted_error: the shape error to expect [m], square root of the weighted cost of the poses; infinite where
            no stable equilibrium was found.
        predicted_error_per_node: (..., N+1) each pose's own part of it, `sqrt(eᵀ K e)` [m]; the last is the tip's.
        predicted_pressure: (..., M) that reaches it [kPa].
        prediction: all that is known of the predicted error, with what it takes to trust it.
        strain_excess: largest strain beyond its actuator's characterised range, 0 if none is.
        in_range: whether every strain, and every pressure limit, lies in the characterised range.
        impossible: whether the shape leaves an actuator no length, or less, at some node: a strain of -1 or below, as
            of curvatures in degrees or lengths in millimetres. All metrics are infinite there.
        distances_converged: whether every distance is finite and, where residuals were asked for or a
            solver was, each node's answer passed its check.
        converged: the same, and whether the prediction, if it was asked for, converged to a stable shape. Only what
            converged may be called attainable.
        residuals: for each metric of wrenches, those of every node's distance, if they were asked for.
    """

    absolute: Tensor | None
    relative: Tensor | None
    absolute_per_node: Tensor | None
    relative_per_node: Tensor | None
    predicted_error: Tensor | None
    predicted_error_per_node: Tensor | None
    predicted_pressure: Tensor | None
    prediction: "PredictedError | None"
    strain_excess: Tensor
    in_range: Tensor
    impossible: Tensor
    distances_converged: Tensor
    converged: Tensor
    residuals: dict[str, Residuals] | None


def evaluate(
    arm: ArmDesign,
    task: Task,
    metrics: Sequence[str] = METRICS,
    *,
    hull: str = "exact",
    samples: int | None = None,
    distance: str | DistanceFunction = "closed_form",
    weights: tuple[float, float] = (1.0, 1.0),
    power: int = 1,
    signed: bool = False,
    polish: bool = False,
    compiled: bool = False,
    residuals: bool = False,
    pose_cost: PoseCost | None = None,
    steps: int | None = None,
    chunk_size: int | None = None,
) -> Attainability:
    """Unattainability of every design on every task.

    At each node the reaction must equal the wrench that the load requires. *Absolute*
    unattainability is the distance from the required wrench to the hull of the wrenches that
    pressures can provide, summed over the nodes; *relative* unattainability is the same for
    differences from node 1. Both zero: as far as hulls can tell, the arm can hold the shape. Distances
    within 16 roundings of the node's largest wrench, required or provided, are zero. A shape that leaves an
    actuator no length is impossible: all of its distances are infinite, with a gradient of zero.

    Differentiable with respect to radii, lengths, pressure limits, twists, loads and whatever force models hold
    (tensors in their fields, parameters of modules, what their functions captured): twice with
    the closed form, once through solvers, by plain autograd; transforms of torch.func and forward mode are
    refused, with a RuntimeError. Where the distance has a kink, the gradient is one of its
    one-sided derivatives: inside a hull and on its boundary that of the inside, 0 (signed: that of the
    nearest face); between two faces equally near, that of either; where one of two actuators that are alike
    changes, and their parallel faces part, one between the two; where a force model has a kink, that of the
    side on which the model puts the point. At a corner of the hull there is no kink outside. The gradient of a
    predicted error that is not converged and stable is NaN, unless nothing depends on it: see `predict_error`.

    A process forked after a large call hangs at its own, as PyTorch's threads are not forked: start processes by
    "spawn" or "forkserver", or call `torch.set_num_threads(1)` before forking or first in each forked process.

    Args:
        arm: designs, of any batch shape.
        task: tasks, of any batch shape. Loads that share a shape share its hulls.
        metrics: which of "absolute", "relative" to compute.
        hull: "exact", or "edges" as the paper samples.
        samples: points on each actuator's curve (exact) or on each edge of the pressure box
            (edges; the paper's 3); None chooses.
        distance: "closed_form"; "qpth", the differentiable QP layer; "scipy", the slow reference; or a
            function of points and vertices such as `partial(qp_distance, form="halfspaces")`.
        weights: k_f [1/N²] and k_m [1/(N·m)²] of the distance `sqrt(k_f f² + k_m m²)`.
        power: 1 sums distances (the paper's text), 2 their squares (the paper's table).
        signed: gives attainable tasks a negative value: where every node is inside its hull, minus
            the smallest margin along the arm (to the power). Node 1 has no part in the relative
            margin. Needs the closed form.
        polish: go on from the sampled polygons (3 samples are enough, and chosen; from outside, laws choose their own
            points) to the sets themselves: exact to 1e-8 N for force models that write out their `pressure_law`, as
            this package's do; for others if they are smooth between the kinks they name, within their characterised
            range. A node that does not converge keeps its sampled distance and clears `converged`. Compiled it takes
            less time than 9 samples; else a batch of 2,000 takes 0.8 to 1.1 times (absolute) and 1.4 to 1.6 times
            (relative) that, with gradients 0.7 to 1.0 times, a sweep of designs less, one small call 1.2 to 2.3
            times. Searches run on the CPU. Needs hull="exact" and the closed form; second derivatives hold the
            pressures.
        compiled: whether polishing runs as machine code compiled by numba (`pip install 'torcharm[compiled]'`): in 0.4
            to 0.8 times the time of 9 samples, forward and with gradients, whatever the batch. The first call of
            all takes ten to twenty seconds to compile, the first of a process half a second. What it does not
            know, NumPy answers as if it were False: other numbers than float64, other devices than the CPU, force
            models without a `pressure_law` up to their limits or with parameters that want a gradient, and
            calls with residuals; and it does nothing where nothing is polished.
        residuals: whether to report each node's optimality residuals, as of the sampled polygons.
        pose_cost: what the predicted error measures; None is the paper's `PoseCost()`.
        steps: of the predicted error: None solves the balance itself; 1 carries the load to first order from the
            task's shape, each further step from where the last one led.
        chunk_size: (design, shape, load) triples worked on at once; None chooses. Bounds memory.

    Raises:
        ValueError: an argument is none of those allowed, numba is not installed, or arm and task differ in dtype or
            device.
    """
    _check_arguments(arm, task, power, signed)
    check_flag("residuals", residuals)
    solver = None if distance == "closed_form" else find_solver(distance)
    if signed and solver is not None:
        raise ValueError("signed: True needs distance='closed_form'; solvers know no distance inside a hull")
    if not isinstance(polish, bool) or (polish and (solver is not None or hull != "exact")):
        raise ValueError(
            f"polish: must be True or False, and True needs hull='exact' and the closed form, got {polish}"
        )
    check_compiled("compiled", compiled)
    asked = _metrics(metrics)
    auditor = (solver or find_solver("closed_form")) if residuals else None
    samples = sample_count(arm, hull, POLISHED_SAMPLES if polish and samples is None else samples)
    hulls = tuple(name for name in asked if name in METRICS)
    check = Check(hulls, hull, samples, scale_of(weights), signed, polish, compiled, solver, auditor)
    outer = outer_product(arm, task)
    prediction = _predict(outer, pose_cost, steps, chunk_size) if PREDICTED in asked else None
    excess, per_node, solved, *audit = _per_node(outer, check, chunk_size)
    found = {metric: per_node[..., index, :] for index, metric in enumerate(check.metrics)}
    total = {metric: over_nodes(value, metric, power, signed=signed) for metric, value in found.items()}
    audits = {
        metric: Residuals(*(column[..., index, :] for column in audit))
        for index, metric in enumerate(check.metrics if residuals else ())
    }
    converged = (per_node.isfinite() & solved).flatten(-2).all(-1)
    impossible = _impossible(outer)
    converged = distances_converged = converged & ~impossible
    if prediction is not None:
        converged = converged & prediction.converged & prediction.stable
    return Attainability(
        absolute=total.get("absolute"),
        relative=total.get("relative"),
        absolute_per_node=found.get("absolute"),
        relative_per_node=found.get("relative"),
        predicted_error=None if prediction is None else prediction.error,
        predicted_error_per_node=None if prediction is None else prediction.per_node,
        predicted_pressure=None if prediction is None else prediction.pressure,
        prediction=prediction,
        strain_excess=excess,
        in_range=(excess <= 16 * torch.finfo(excess.dtype).eps) & limits_in_range(outer) & ~impossible,
        impossible=impossible,
        distances_converged=distances_converged,
        converged=converged,
        residuals=audits if residuals else None,
    )


def _predict(
    outer: OuterProduct, pose_cost: PoseCost | None, steps: int | None, chunk_size: int | None
) -> "PredictedError":
    from torcharm.prediction import predict_outer  # loads when it is first asked for

    return predict_outer(outer, pose_cost, steps, chunk_size)


def _check_arguments(arm: ArmDesign, task: Task, power: int, signed: bool) -> None:
    check_arm_and_task(arm, task)
    check_flag("signed", signed)
    if isinstance(power, bool) or not isinstance(power, int) or power not in (1, 2):
        raise ValueError(f"power: must be 1 or 2, got {shown(power)}")


def _metrics(metrics: Sequence[str]) -> tuple[str, ...]:
    """The metrics asked for, once each."""
    names = (metrics,) if isinstance(metrics, str) else metrics
    if not isinstance(names, (list, tuple, set, frozenset)) or not names:
        raise ValueError(f"metrics: must name at least one of {', '.join(CHOICES)}, got {shown(metrics)}")
    for name in names:
        check_choice("metrics", name, CHOICES)
    return tuple(dict.fromkeys(names))


def scale_of(weights: tuple[float, float]) -> tuple[float, float]:
    """Factors on force and moment, checked."""
    try:
        force, moment = (float(weight) for weight in weights)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"weights: must be two numbers (k_f, k_m), got {shown(weights)}") from None
    if not (0 < force < float("inf") and 0 < moment < float("inf")):
        raise ValueError(f"weights: must be finite and above 0, got {(force, moment)}")
    return force**0.5, moment**0.5


def _per_node(outer: OuterProduct, check: Check, chunk_size: int | None) -> tuple[Tensor, ...]:
    """The strain excess (*design batch, *task batch), distances (..., K, N) of the K metrics, and residuals."""
    if not check.metrics:
        return _no_distances(outer)
    if chunk_size is None:
        samples = check.samples + (POLISHING_SAMPLES if check.polish else 0)
        chunk_size = block_size(outer, check.hull, samples, through_solver=check.solver is not None)
    check_count("chunk_size", chunk_size, 1)
    if 0 in outer.sizes:
        sizes = (*outer.sizes, len(check.metrics), outer.nodes)
        real = outer.arm.radii.new_zeros(sizes)
        flag = torch.zeros(sizes, dtype=torch.bool, device=real.device)
        audit = [] if check.auditor is None else [real, real, real, flag, flag]
        blocks: tuple[Tensor, ...] = (real.new_zeros(outer.sizes), real, ~flag, *audit)
    else:
        recompute = prod(outer.sizes) > chunk_size
        sampled = check.solver is None and (check.compiled or not check.polish)
        required = required_by_metric(outer, check.metrics, check.scale) if sampled else {}
        blocks = map_blocks(outer, chunk_size, lambda block: node_distances(block, required, check, recompute))
    return tuple(outer.unflatten(block) for block in blocks)


def block_size(outer: OuterProduct, hull: str, samples: int, *, through_solver: bool = False) -> int:
    """(design, shape, load) triples worked on at once."""
    slots = slot_count(outer.arm.actuator_count, hull, samples)
    elements = SOLVER_ELEMENTS // slots if through_solver else BLOCK_ELEMENTS
    return max(1, elements // (slots * outer.nodes))


def _impossible(outer: OuterProduct) -> Tensor:
    """(*design batch, *task batch) whether an actuator has no length somewhere."""
    if 0 in outer.sizes:
        return outer.unflatten(torch.zeros(outer.sizes, dtype=torch.bool, device=outer.twists.device))
    at_once = max(1, IMPOSSIBLE_ELEMENTS // max(1, outer.twists[..., 0].numel()))
    lost = [impossible_nodes(radii, outer.twists).any(1) for radii in outer.arm.radii.split(at_once)]
    return outer.unflatten(torch.cat(lost, -1).T.unsqueeze(-1).expand(outer.sizes))


def _no_distances(outer: OuterProduct) -> tuple[Tensor, ...]:
    """As `_per_node` where no hulls are asked for."""
    excess = strain_excess(cross_sections(outer.arm, outer.twists)).T.unsqueeze(-1).expand(outer.sizes)
    none = excess.new_zeros(*outer.sizes, 0, outer.nodes)
    return tuple(outer.unflatten(part) for part in (excess, none, torch.ones_like(none, dtype=torch.bool)))


def limits_in_range(outer: OuterProduct) -> Tensor:
    """Whether every pressure limit lies in its model's characterised range."""
    highest = along([model.pressure_range[1] for model in outer.arm.actuators], outer.arm.radii, -1)
    inside = (outer.arm.max_pressure <= highest).all(-1)
    return outer.unflatten(inside.view(-1, 1, 1).expand(outer.sizes))


def over_nodes(distance: Tensor, metric: str, power: int, *, signed: bool, dim: int = -1) -> Tensor:
    """The sum of distances to a power over the nodes, along `dim`; where all are inside, minus the least margin."""
    miss = distance.clamp(min=0) if signed else distance
    total = (miss if power == 1 else miss.pow(power)).sum(dim)
    if not signed:
        return total
    nodes = distance.shape[dim]
    free = distance.narrow(dim, 1, nodes - 1) if metric == "relative" and nodes > 1 else distance
    with torch.no_grad():
        held = bool((free.amax(dim) < 0).any())
    if not held:
        return total
    nearest = free.amax(dim)
    return torch.where(nearest < 0, -nearest.abs().pow(power), total)
