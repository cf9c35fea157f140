"""`tolerance`: what the errors of a design will be once it is built."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.attainability import PREDICTED, PoseTolerance, evaluate
from torcharm.attainability.evaluation import as_tolerance
from torcharm.attainability.verdict import judge, over_tolerance
from torcharm.design.scatter import Scatter, Sizes, Source, built_arms, normal_numbers, scattered
from torcharm.design.sensitivity import fitted_slopes, tip_places, tip_slopes, variances
from torcharm.design.sobol import index_numbers, sobol_indices
from torcharm.design.space import Arm
from torcharm.design.tolerance_result import CRITERIA, BuiltArms
from torcharm.inputs import check_count, check_flag, shown
from torcharm.pressure.at_pressure import error_at_pressure
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.predicted_error import PredictedError, predict_error
from torcharm.task import Task, task_list
from torcharm.wrench_sets.design_task_grid import fitted

SAMPLES = 1000
"""Built arms: 95 % of yields are then known to within 3 percentage points."""
AT_ONCE = 4096
"""Pairs of a built arm and a task that are worked on together: some 100 MB of an arm in space."""

Told = Callable[[int, int], object]
"""Is told how many built arms are done, and of how many."""


def tolerance(
    arm: ArmDesign | ArmSeries,
    task: Task | Sequence[Task],
    *,
    radii: Sizes = 0.0,
    length: Sizes = 0.0,
    limits: Sizes = 0.0,
    force: Sizes = 0.0,
    force_offset: Sizes = 0.0,
    bending: Sizes = 0.0,
    model_covariance: bool = False,
    distribution: str = "normal",
    correlated: Mapping[str, float] | None = None,
    compensated: bool = False,
    samples: int = SAMPLES,
    seed: int = 0,
    tolerance: PoseTolerance | float | None = None,
    pose_cost: PoseCost | None = None,
    margin: bool = False,
    sobol: bool = False,
    callback: Told | None = None,
) -> BuiltArms:
    """How far off a design's tip will be once it is built, how often it is within tolerance, and what decides that.

    "Good to 1 mm" is a standard deviation, unless `distribution="uniform"` makes it a half width. Built arms are drawn
    by scrambled Sobol' numbers and evaluated together; beside them stand slopes at the drawn arm by exact gradients.

    Args:
        arm: one design; in the plane or in space, or segments in series.
        task: tasks of any batch shape, or several such; T in all.
        radii, length, limits, force, force_offset, bending, model_covariance, distribution, correlated: what is
            scattered and how far, as of `Scatter`: offsets and lengths [m], limits [kPa], the force's scale in parts of
            1, an offset of the force [N], the bending moment's scale in parts of 1, and fitted models by their own
            covariance.
        compensated: False keeps the pressures that are best for the drawn arm: each built arm goes where loading from
            rest leads at these. True finds the best pressures of each built arm: what a calibrated controller reaches.
        samples: S, built arms.
        seed: of the samples.
        tolerance: how far off a pose may be for an arm to count in the yield, as for `torcharm.evaluate`; without it
            2 % of the drawn arm's length, and 5°.
        pose_cost: what pressures minimise; None is `PoseCost()`.
        margin: whether to measure the capacity margin of each built arm, too, which costs more than all else; not with
            `model_covariance`.
        sobol: whether to find Sobol' indices of what is scattered, too, for which G names need G + 2 times the built
            arms.
        callback: is told how many built arms are done, and of how many.

    After Ctrl-C the result is of the arms built by then, with the wider bounds of their number, and without Sobol'
    indices that no whole sample tells; where no arm is built yet, KeyboardInterrupt goes on.

    Raises:
        ValueError: an argument is none of those allowed, or arm and tasks do not fit.

    Example:
        >>> task = ta.Task(ta.constant_curvature(0.5, nodes=4), [1.0, 0.0, 0.0])
        >>> found = ta.tolerance(ta.antagonistic_arm(), task, radii=1e-3, length=2e-3, samples=64)
        >>> found.decisive, f"{found.yield_of_all.value:.0%}"  # which tolerance matters, and how many arms will do
        ('radii', '92%')
    """
    spread = (radii, length, limits, force, force_offset, bending)
    scatter = Scatter(*spread, model_covariance, distribution, {} if correlated is None else correlated)
    options: dict[str, Any] = {"tolerance": tolerance, "pose_cost": pose_cost, "margin": margin, "sobol": sobol}
    return built_as(arm, task, scatter, compensated, samples, seed, **options, callback=callback)


def built_as(
    arm: Arm,
    task: Task | Sequence[Task],
    scatter: Scatter,
    compensated: bool,
    samples: int = SAMPLES,
    seed: int = 0,
    *,
    tolerance: PoseTolerance | float | None = None,
    pose_cost: PoseCost | None = None,
    margin: bool = False,
    sobol: bool = False,
    callback: Told | None = None,
) -> BuiltArms:
    """The same for a `Scatter`; arguments and errors as of `tolerance`."""
    tasks = checked_tasks(arm, task)
    for name, flag in (("compensated", compensated), ("margin", margin), ("sobol", sobol)):
        check_flag(name, flag)
    if margin and scatter.model_covariance:
        raise ValueError(
            "margin: must be False with model_covariance: sets do not know scattered coefficients, got True"
        )
    sources = scatter.sources(arm)
    normal = normal_numbers(sources, check_count("samples", samples, 2), check_count("seed", seed, 0))
    more = index_numbers(sources, samples, seed + 1) if sobol else normal[:0]
    how = Evaluation(tasks, nominal_tolerance(arm, tolerance), pose_cost, margin)
    with torch.no_grad():
        drawn = [predict_error(arm, one, pose_cost) for one in tasks]
        kept = None if compensated else [found.pressure for found in drawn]
        if kept is not None:  # the drawn arm is loaded from rest, as the built ones are
            drawn = [error_at_pressure(arm, one, own, pose_cost) for one, own in zip(tasks, kept, strict=True)]
        nominal = how.of_found(arm, drawn)
        every = len(normal) + len(more)
        parts, stopped = _until_interrupted(how.chunks(arm, sources, normal, kept, _teller(callback, 0, every)))
        if not parts:
            raise KeyboardInterrupt
        built, others = joined(parts), list[dict[str, Tensor]]()
        if not stopped:
            told = _teller(callback, len(normal), every)
            others, stopped = _until_interrupted(replace(how, margin=False).chunks(arm, sources, more, kept, told))
    both = [
        tip_slopes(arm, one, sources, found, pose_cost, compensated=compensated)
        for one, found in zip(tasks, drawn, strict=True)
    ]
    slopes = [torch.cat([part.reshape(-1, *part.shape[-2:]) for part in column]) for column in zip(*both, strict=True)]
    result = _result(arm, scatter, sources, normal, how.tolerance, compensated, nominal, built, slopes)
    result = replace(result, stopped="interrupted" if stopped else "finished")
    tips = joined(others)["tip"] if others else more[:0]
    whole = len(tips) // (len(result.names) + 2)
    if not whole:
        return result
    first, total = sobol_indices(tips[: whole * (len(result.names) + 2)], len(result.names))
    return replace(result, first_order=first, total_order=total, sobol_samples=whole)


def _until_interrupted(parts: Iterable[dict[str, Tensor]]) -> tuple[list[dict[str, Tensor]], bool]:
    """Those finished before Ctrl-C, and whether it came."""
    done = []
    try:
        for part in parts:
            done.append(part)
    except KeyboardInterrupt:
        return done, True
    return done, False


def joined(parts: Sequence[Mapping[str, Tensor]]) -> dict[str, Tensor]:
    """Columns of all chunks of built arms."""
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}


def _teller(callback: Told | None, before: int, every: int) -> Told | None:
    """Tells of a part of all arms that are built."""
    return None if callback is None else lambda done, _: callback(before + done, every)


def _result(
    arm: Arm,
    scatter: Scatter,
    sources: Sequence[Source],
    normal: Tensor,
    tolerance: PoseTolerance,
    compensated: bool,
    nominal: Mapping[str, Tensor],
    built: Mapping[str, Tensor],
    slopes: Sequence[Tensor],
) -> BuiltArms:
    """All of it together, with the fit to the samples."""
    drawn = normal[: len(built["tip"])]
    fits = [fitted_slopes(built["tip"][:, t], sources, drawn) for t in range(built["tip"].shape[1])]
    by_samples = torch.stack([variances(own, sources) for own, _ in fits], -1)
    return BuiltArms(
        tip_error=built["tip_error"],
        failed=built["failed"],
        verdict_code=built["verdict"],
        tip=built["tip"],
        margin=built.get("margin"),
        nominal_tip_error=nominal["tip_error"][0],
        nominal_failed=nominal["failed"][0],
        nominal_verdict_code=nominal["verdict"][0],
        sources=tuple(source.name for source in sources),
        slopes=tuple(slopes),
        variance_by_gradient=variances(slopes, sources),
        variance_by_samples=by_samples,
        explained=torch.stack([share for _, share in fits]),
        scatter=scatter,
        tolerance=tolerance,
        compensated=compensated,
        arm=arm,
        wanted=len(normal),
    )


def checked_tasks(arm: object, task: Task | Sequence[Task]) -> tuple[Task, ...]:
    """The tasks that one design is to meet.

    Raises:
        ValueError: it is a batch, or they do not fit.
    """
    if not isinstance(arm, (ArmDesign, ArmSeries)) or arm.batch_shape:
        raise ValueError(f"arm: must be one ArmDesign or ArmSeries, as arm[0] of a batch, got {shown(arm)}")
    tasks = task_list(task)
    if any(0 in one.batch_shape for one in tasks):
        raise ValueError("task: must hold at least one task, got none")
    return tuple(fitted(arm, one)[1] for one in tasks)


def nominal_tolerance(arm: Arm, tolerance: PoseTolerance | float | None) -> PoseTolerance:
    """What counts as held, in metres: by the drawn arm's length, which built ones do not change."""
    given = as_tolerance(tolerance)
    tip, shape = given.lengths(arm)
    return replace(given, tip=float(tip), shape=float(shape))


@dataclass(frozen=True)
class Evaluation:
    """What is found of arms on all tasks, flattened to T.

    Attributes:
        tasks: batches of tasks.
        tolerance: what counts as within, in metres.
        pose_cost: what pressures minimise.
        margin: whether capacity margins are measured.
    """

    tasks: tuple[Task, ...]
    tolerance: PoseTolerance
    pose_cost: PoseCost | None
    margin: bool

    def chunks(
        self, arm: Arm, sources: Sequence[Source], normal: Tensor, kept: Sequence[Tensor] | None, told: Told | None
    ) -> Iterator[dict[str, Tensor]]:
        """Of built arms, chunk by chunk, for `joined`: columns (S of the chunk, T, ...).

        Args:
            normal: (S, ΣL) from which they are built.
            kept: for each batch of tasks the pressures (*task batch, M) [kPa]; None finds the best of each arm.
        """
        count = sum(task.batch_shape.numel() for task in self.tasks)
        step = max(1, AT_ONCE // count)
        for first in range(0, len(normal), step):
            built = built_arms(arm, sources, scattered(sources, normal[first : first + step]))
            found: list[PredictedError] = []
            for index, task in enumerate(self.tasks):
                if kept is None:
                    found.append(predict_error(built, task, self.pose_cost))
                else:
                    found.append(error_at_pressure(built, task, kept[index], self.pose_cost))
            yield self.of_found(built, found)
            if told is not None:
                told(min(first + step, len(normal)), len(normal))

    def of_found(self, arm: Arm, found: Sequence[PredictedError]) -> dict[str, Tensor]:
        """Columns (B, T, ...) of what was found of arms (B,), or of one, for each batch of tasks."""
        parts = [self._of_batch(arm, task, one) for task, one in zip(self.tasks, found, strict=True)]
        return {name: torch.cat([part[name] for part in parts], 1) for name in parts[0]}

    def _of_batch(self, arm: Arm, task: Task, found: PredictedError) -> dict[str, Tensor]:
        metrics = ("absolute",) if self.margin else (PREDICTED,)
        options: dict[str, Any] = {"signed": True} if self.margin else {}
        seen = evaluate(arm, task, metrics, found=found, tolerance=self.tolerance, **options)
        held = found.stable & found.reached & found.possible
        columns = {
            "tip_error": found.tip_error,
            "verdict": judge(arm, found, self.tolerance, seen.in_range, seen.impossible),
        }
        if seen.capacity_margin is not None:
            columns["margin"] = seen.capacity_margin
        designs = arm.batch_shape.numel()
        flat = {name: column.reshape(designs, -1) for name, column in columns.items()}
        beyond = ~(over_tolerance(arm, found, self.tolerance) <= 1) & held  # of no shape no error counts
        flat["failed"] = torch.stack((*beyond, ~held), -1).reshape(designs, -1, len(CRITERIA))
        return flat | {"tip": tip_places(found.pose_errors).reshape(designs, -1, arm.dimension)}
