"""Can these designs hold these shapes under these loads, and by how much do they miss?"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, overload

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.attainability.result import Attainability
from torcharm.attainability.verdict import PoseTolerance
from torcharm.inputs import check_choice, check_count, check_flag, check_number, shown
from torcharm.pressure.pose_cost import PoseCost
from torcharm.statics.cross_section import RANGE_SLACK
from torcharm.task import Task, for_each_task
from torcharm.wrench_sets.design_task_grid import DesignTaskGrid, design_task_grid, limits_in_range
from torcharm.wrench_sets.node_distances import METRICS, NodeDistances, SetOptions, node_distances
from torcharm.wrench_sets.vertex_sets import DistanceFunction, VertexSets, check_sets

if TYPE_CHECKING:
    from torcharm.pressure.predicted_error import PredictedError
    from torcharm.pressure.search import PressureSearch

PREDICTED = "predicted_error"
CHOICES = (*METRICS, PREDICTED)
"""All metrics there are."""


class Options(TypedDict, total=False):
    """The keywords of `evaluate`."""

    tolerance: PoseTolerance | float | None
    hull: str
    samples: int | None
    distance: str | DistanceFunction
    weights: tuple[float, float]
    power: int
    signed: bool
    pose_cost: PoseCost | None
    found: "PressureSearch | PredictedError | None"
    chunk_size: int | None


@overload
def evaluate(
    arm: ArmDesign | ArmSeries, task: Task, metrics: Sequence[str] = ..., **options: Unpack[Options]
) -> Attainability: ...


@overload
def evaluate(
    arm: ArmDesign | ArmSeries, task: Sequence[Task], metrics: Sequence[str] = ..., **options: Unpack[Options]
) -> tuple[Attainability, ...]: ...


def evaluate(
    arm: ArmDesign | ArmSeries,
    task: Task | Sequence[Task],
    metrics: Sequence[str] = CHOICES,
    *,
    tolerance: PoseTolerance | float | None = None,
    hull: str = "exact",
    samples: int | None = None,
    distance: str | DistanceFunction = "gjk",
    weights: tuple[float, float] = (1.0, 1.0),
    power: int = 1,
    signed: bool = False,
    pose_cost: PoseCost | None = None,
    found: "PressureSearch | PredictedError | None" = None,
    chunk_size: int | None = None,
) -> Attainability | tuple[Attainability, ...]:
    """Unattainability of every design on every task, in the plane and in space.

    At each node the reaction must equal the wrench that the load requires. *Absolute* unattainability is the distance
    from the required wrench to the convex hull of the wrenches that pressures can provide, summed over the nodes;
    *relative* unattainability is the same for differences from the first node of the same segment. Both zero: as far as
    sets can tell, the arm can hold the shape. Sets are exact, for any force model, and distances are known to 1e-12 of
    their largest wrench; below 16 roundings of it they are zero. A shape that leaves an actuator no length is
    impossible: all of its distances are infinite, with a gradient of zero.

    Differentiable once with respect to radii, offsets, lengths, pressure limits, masses, twists, loads and whatever
    force models hold, by the envelope theorem: the normals, weights and pressures of the nearest points are held. Where
    the distance has a kink, the gradient lies between its one-sided derivatives: inside a set and on its boundary it is
    that of the inside, 0 (signed: that of the nearest face); where a force model has a kink, that of the side on which
    the model puts the point. Relative sets have one where all nodes are bent alike: they are points then. The
    gradient of a predicted error that is not converged and stable is NaN, unless nothing depends on it: sum only what
    is, `found.shape_error[found.converged].sum()`; see `predict_error`. Plain autograd does it; transforms of
    torch.func are refused, with a RuntimeError.

    A process forked after a large call hangs at its own, as PyTorch's threads are not forked: start processes by
    "spawn" or "forkserver", or call `torch.set_num_threads(1)` before forking or first in each forked process.

    Args:
        arm: designs, of any batch shape; or segments in series.
        task: tasks, of any batch shape, of the arm's dimension. Loads that share a shape share its sets. Or a list of
            such, which may differ in their numbers of nodes and in their loads.
        metrics: which of "absolute", "relative", "predicted_error" to compute. Sets cost microseconds a task,
            the predicted error, which the verdict needs, some hundred.
        tolerance: how far off a pose may be and still counts as held; a number is the tip's [m].
        hull: "exact", or "edges" as the paper samples.
        samples: points on each edge of the pressure box (edges; the paper's 3), or on each actuator's curve where a
            solver needs vertices of exact sets; None chooses.
        distance: "gjk", the exact one; "qpth", the differentiable QP layer; "scipy", the slow reference, non-negative
            least squares; or a function of points and vertices such as `slsqp_distance`. All but "gjk" measure sets
            of vertices: of hull="exact" they take samples of each actuator's curve, 9 unless told, and give each curve
            its own simplex of weights, for which a function needs the keyword `groups`.
        weights: k_f [1/N²] and k_m [1/(N·m)²] of the distance `sqrt(k_f f² + k_m m²)`.
        power: 1 sums distances (the paper's text), 2 their squares (the paper's table).
        signed: gives attainable tasks a negative value: where every node is inside its set, minus the smallest margin
            along the arm (to the power). First nodes have no part in the relative margin. Needs hull="exact" and "gjk".
        pose_cost: what the predicted error measures; None is `PoseCost()`.
        found: what `search_pressure` found of a single `Task` takes the place of a predicted error, so that verdict and
            reason are of that; or errors at pressures that are given.
        chunk_size: (design, shape, load) triples worked on at once; None chooses. Bounds memory.

    Returns:
        What was found; of a list of tasks a tuple, with what was found for each, in their order.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task do not fit.

    Example:
        >>> task = ta.Task(ta.constant_curvature(0.5), tip_load=[1.0, -1.0, 0.0])
        >>> found = ta.evaluate(ta.antagonistic_arm(), task)
        >>> found.verdict, round(1e3 * float(found.tip_error), 1)  # and how far off the tip will be [mm]
        ('held', 0.4)
    """
    asked = check_metrics(metrics)
    measured, tolerated = tuple(name for name in asked if name in METRICS), as_tolerance(tolerance)
    check_flag("signed", signed)
    check_power(power)
    if chunk_size is not None:
        check_count("chunk_size", chunk_size, 1)
    scale = scale_of(weights)
    _check_found(found, arm, task)

    def evaluate_one(own: Task) -> Attainability:
        prediction = found
        if found is None and PREDICTED in asked:
            from torcharm.pressure.predicted_error import predict_error  # loads when it is first asked for

            prediction = predict_error(arm, own, pose_cost)
        grid = design_task_grid(arm, own)
        check_measure(arm, hull, samples, distance, signed)
        vertices = None if hull == "exact" and distance == "gjk" else VertexSets.of(hull, samples, distance)
        options = SetOptions(measured, scale, signed, vertices)
        return Attainability(
            **_by_sets(grid, node_distances(grid, options, chunk_size), options, power),
            prediction=prediction,
            signed=signed,
            weights=(float(weights[0]), float(weights[1])),
            tolerance=tolerated,
            arm=arm,
            task=own,
        )

    return for_each_task(task, evaluate_one)


def _check_found(
    found: "PressureSearch | PredictedError | None", arm: ArmDesign | ArmSeries, task: Task | Sequence[Task]
) -> None:
    """Raise a ValueError unless what was found is of the arm and the task."""
    if found is None:
        return
    if not isinstance(task, Task):
        raise ValueError("found: must be left out for a list of tasks: evaluate each with what was found for it")
    shape = (*arm.batch_shape, *task.batch_shape)
    if found.tip_error.shape != shape:
        raise ValueError(f"found: must have the batch shape {shape}, got {tuple(found.tip_error.shape)}")


def _by_sets(grid: DesignTaskGrid, nodes: NodeDistances, options: SetOptions, power: int) -> dict[str, Any]:
    """What distances of nodes say, by the names of `Attainability`'s attributes."""
    converged = (nodes.converged & nodes.distance.isfinite()).flatten(-2).all(-1) & ~nodes.impossible
    converged, impossible, excess = (grid.unflatten(x) for x in (converged, nodes.impossible, nodes.strain_excess))
    found: dict[str, Any] = dict.fromkeys((*METRICS, *(f"{name}_per_node" for name in METRICS)))
    firsts = [part.start for part in grid.nodes]
    for k, name in enumerate(options.metrics):
        found[f"{name}_per_node"] = value = grid.unflatten(nodes.distance[..., k, :])
        found[name] = over_nodes(value, name, power, signed=options.signed, firsts=firsts)
    return found | {
        "strain_excess": excess,
        "shape_in_range": (excess <= RANGE_SLACK) & limits_in_range(grid) & ~impossible,
        "impossible": impossible,
        "distances_converged": converged,
    }


def as_tolerance(tolerance: PoseTolerance | float | None) -> PoseTolerance:
    """What counts as held; a number is the tip's."""
    if tolerance is None or isinstance(tolerance, PoseTolerance):
        return tolerance or PoseTolerance()
    return PoseTolerance(tip=check_number("tolerance", tolerance, 0.0, strict=True))


def check_measure(
    arm: ArmDesign | ArmSeries, hull: str, samples: int | None, distance: str | DistanceFunction, signed: bool
) -> None:
    """Raise a ValueError unless these arguments of `evaluate` go together."""
    check_sets(arm, hull, samples, distance)
    if hull == "exact" and distance == "gjk":
        if samples is not None:
            raise ValueError(
                f"samples: must be left out for hull='exact' and distance='gjk', which is exact, got {samples}"
            )
    elif signed:
        raise ValueError("signed: must be False except for hull='exact' and distance='gjk', got True")


def check_metrics(metrics: Sequence[str]) -> tuple[str, ...]:
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


def check_power(power: object) -> None:
    """Raise a ValueError unless it is a power of distances that can be summed."""
    if isinstance(power, bool) or not isinstance(power, int) or power not in (1, 2):
        raise ValueError(f"power: must be 1 or 2, got {shown(power)}")


def over_nodes(
    distance: Tensor, metric: str, power: int, *, signed: bool, dim: int = -1, firsts: Sequence[int] = (0,)
) -> Tensor:
    """The sum of distances to a power over the nodes, along `dim`; where all are inside, minus the least margin.

    Args:
        firsts: the first nodes of segments, whose relative margin is nothing.
    """
    miss = distance.clamp(min=0) if signed else distance
    total = (miss if power == 1 else miss.pow(power)).sum(dim)
    if not signed:
        return total
    nodes = distance.shape[dim]
    kept = [i for i in range(nodes) if metric != "relative" or i not in firsts] or list(range(nodes))
    free = distance if len(kept) == nodes else distance.index_select(dim, torch.tensor(kept, device=distance.device))
    with torch.no_grad():
        inside = bool((free.amax(dim) < 0).any())
    if not inside:
        return total
    nearest = free.amax(dim)
    return torch.where(nearest < 0, -nearest.abs().pow(power), total)
