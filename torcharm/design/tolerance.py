"""`tolerance`: what the errors of a design will be once it is built."""

from collections.abc import Callable, Iterator, Mapping, Sequence
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
from torcharm.design.space import Arm, fitting_tasks
from torcharm.design.tolerance_result import CRITERIA, BuiltArms
from torcharm.inputs import check_count, check_flag, shown
from torcharm.pressure.at_pressure import error_at_pressure
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.predicted_error import PredictedError, predict_error
from torcharm.task import Task

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
        callback: is told how many built arms are done, and of how many.

    After Ctrl-C the result is of the arms built by then, with the wider bounds of their number; where no arm is built
    yet, KeyboardInterrupt goes on.

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
    tasks = _checked_tasks(arm, task)
    check_flag("compensated", compensated)
    check_flag("margin", margin)
    if margin and model_covariance:
        raise ValueError(
            "margin: must be False with model_covariance: sets do not know scattered coefficients, got True"
        )
    sources = scatter.sources(arm)
    normal = normal_numbers(sources, check_count("samples", samples, 2), check_count("seed", seed, 0))
    how = Evaluation(tasks, nominal_tolerance(arm, tolerance), pose_cost, margin)
    parts, stopped = list[dict[str, Tensor]](), "finished"
    with torch.no_grad():
        drawn = how.predicted(arm, None)
        kept = None if compensated else [found.pressure for found in drawn]
        if kept is not None:  # the drawn arm is loaded from rest, as the built ones are
            drawn = how.predicted(arm, kept)
        nominal = how.of_found(arm, drawn)["tip_error"][0]
        try:
            for part in how.chunks(arm, sources, normal, kept):
                parts.append(part)
                if callback is not None:
                    callback(sum(len(one["tip"]) for one in parts), samples)
        except KeyboardInterrupt:
            if not parts:
                raise
            stopped = "interrupted"
    each = [
        tip_slopes(arm, one, sources, found, pose_cost, compensated=compensated)
        for one, found in zip(tasks, drawn, strict=True)
    ]
    slopes = [torch.cat([part.reshape(-1, *part.shape[-2:]) for part in column]) for column in zip(*each, strict=True)]
    asked = {"scatter": scatter, "tolerance": how.tolerance, "compensated": compensated, "wanted": samples}
    return _result(arm, sources, normal, nominal, joined(parts), slopes, stopped=stopped, **asked)


def _result(
    arm: Arm,
    sources: Sequence[Source],
    normal: Tensor,
    nominal: Tensor,
    built: Mapping[str, Tensor],
    slopes: Sequence[Tensor],
    **asked: Any,
) -> BuiltArms:
    """All of it together, with the fit to the samples."""
    fits = [fitted_slopes(tip, sources, normal[: len(tip)]) for tip in built["tip"].unbind(1)]
    return BuiltArms(
        tip_error=built["tip_error"],
        failed=built["failed"],
        verdict_code=built["verdict"],
        tip=built["tip"],
        margin=built.get("margin"),
        nominal_tip_error=nominal,
        sources=tuple(source.name for source in sources),
        slopes=tuple(slopes),
        variance_by_gradient=variances(slopes, sources),
        variance_by_samples=torch.stack([variances(own, sources) for own, _ in fits], -1),
        explained=torch.stack([share for _, share in fits]),
        arm=arm,
        **asked,
    )


def joined(parts: Sequence[Mapping[str, Tensor]]) -> dict[str, Tensor]:
    """Columns of all chunks of built arms."""
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}


def _checked_tasks(arm: object, task: Task | Sequence[Task]) -> tuple[Task, ...]:
    """The tasks that one design is to meet."""
    if not isinstance(arm, (ArmDesign, ArmSeries)) or arm.batch_shape:
        raise ValueError(f"arm: must be one ArmDesign or ArmSeries, as arm[0] of a batch, got {shown(arm)}")
    return fitting_tasks(arm, task)


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

    def predicted(self, arm: Arm, kept: Sequence[Tensor] | None) -> list[PredictedError]:
        """What is predicted of arms for each batch of tasks, at the pressures (*task batch, M) kept [kPa] of each; None
        finds the best of each arm."""
        if kept is None:
            return [predict_error(arm, task, self.pose_cost) for task in self.tasks]
        pairs = zip(self.tasks, kept, strict=True)
        return [error_at_pressure(arm, task, pressure, self.pose_cost) for task, pressure in pairs]

    def chunks(
        self, arm: Arm, sources: Sequence[Source], normal: Tensor, kept: Sequence[Tensor] | None
    ) -> Iterator[dict[str, Tensor]]:
        """Of arms built from normal numbers (S, ΣL), chunk by chunk, for `joined`: columns (S of the chunk, T, ...)."""
        count = sum(task.batch_shape.numel() for task in self.tasks)
        for own in normal.split(max(1, AT_ONCE // count)):
            built = built_arms(arm, sources, scattered(sources, own))
            yield self.of_found(built, self.predicted(built, kept))

    def of_found(self, arm: Arm, found: Sequence[PredictedError]) -> dict[str, Tensor]:
        """Columns (B, T, ...) of what was found of arms (B,), or of one, for each batch of tasks."""
        parts = [self._of_batch(arm, task, one) for task, one in zip(self.tasks, found, strict=True)]
        return {name: torch.cat([part[name] for part in parts], 1) for name in parts[0]}

    def _of_batch(self, arm: Arm, task: Task, found: PredictedError) -> dict[str, Tensor]:
        metrics = ("absolute",) if self.margin else (PREDICTED,)
        seen = evaluate(arm, task, metrics, found=found, tolerance=self.tolerance, signed=self.margin)
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
