"""What an optimisation found."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import rebuilt, segments_of
from torcharm.design.objective import Objective
from torcharm.design.space import Arm, DesignSpace
from torcharm.design.task_errors import TaskErrors
from torcharm.design.tolerance_result import BuiltArms
from torcharm.inputs import HoldsTensors, three_digits


@dataclass(frozen=True, eq=False, repr=False)
class OptimisedDesign(HoldsTensors):
    """The outcome of `optimise_design`.

    Attributes:
        given: the design to improve on (of a batch, the one of the best value).
        best: the best design found; the given one where no better was found.
        given_value, value: the objective of the two, which they were compared by: of predicted errors with what they
            count more beyond the characterised range (see `Objective`); plain errors are those of before and after.
        given_held, held: of how many tasks the verdict on the two is "held".
        before, after: what is predicted of the two on every task: errors of tip and shape [m].
        status: what to think of it, in words: "better", or that and what is doubtful, or why the given design was kept.
        active: the bounds and constraints that hold the best design back, in words.
        violated: those that the given design breaks, in words.
        starts: (S,) designs from which descents began; the first are the feasible ones nearest to the given.
        ends: (S,) designs at which they ended.
        end_values: (S,) the objective there; infinite of a start that found no candidate.
        reasons: S words on why each ended.
        evaluations, seconds: how many designs on all tasks, and how long.
        stopped: "finished", or what stopped it: "interrupted", "callback" or "time".
        space, objective: what was asked for.
        built_before, built_after: of a robust objective, what `torcharm.tolerance` finds of the two on samples of their
            own, with yields; else None.

    Example:
        >>> arm, task = ta.bellows_arm(), ta.Task(ta.constant_curvature(1.0, nodes=3), tip_load=[1.0, -1.0, 0.0])
        >>> ta.optimise_design(arm, task, starts=1, iterations=2).buildable  # the best arm, rounded
        ArmDesign(planar, 4 bellows, batch (), torch.float64)
    """

    given: Arm
    best: Arm
    given_value: float
    value: float
    given_held: int
    held: int
    before: TaskErrors
    after: TaskErrors
    status: str
    active: tuple[str, ...]
    violated: tuple[str, ...]
    starts: Arm
    ends: Arm
    end_values: Tensor
    reasons: tuple[str, ...]
    evaluations: int
    seconds: float
    stopped: str
    space: DesignSpace
    objective: Objective
    built_before: BuiltArms | None = None
    built_after: BuiltArms | None = None

    def __repr__(self) -> str:
        """Values, no tensors."""
        count = len(self.after.stable)
        return (
            f"OptimisedDesign({self.best!r}, of {count} task{'s' * (count != 1)} {self._values()}tip error "
            f"{self.before.tip_mm:.3g} → {self.after.tip_mm:.3g} mm predicted, held {self.given_held} → {self.held}, "
            f"{self.status}; {self.stopped})"
        )

    @property
    def buildable(self) -> Arm:
        """The best design with what was free rounded: places and lengths to 0.01 mm, limits down to 0.01 kPa.

        The given design stays as it is where it was kept.
        """
        if self.best is self.given:
            return self.best
        return rebuilt(self.best, [_rounded(segment, self.space.free) for segment in segments_of(self.best)[0]])

    def _values(self) -> str:
        """What was made small, plain: without what errors count more beyond the range."""
        words, over = objective_words(self.objective), self.objective.over
        if self.objective.metric == "predicted_error":
            shape = " → ".join(three_digits(side.shape_mm(over)) for side in (self.before, self.after))
            return f"{words} {shape} mm, "
        return f"{words} {self.given_value:.4g} → {self.value:.4g} N, "


def _rounded(arm: ArmDesign, free: Sequence[str]) -> ArmDesign:
    """A segment with its free values rounded."""
    places = arm.radii, arm.out_of_plane
    if {"radii", "angles"} & set(free):
        places = arm.radii.round(decimals=5), None if arm.out_of_plane is None else arm.out_of_plane.round(decimals=5)
    length = arm.length.round(decimals=5) if "length" in free else arm.length
    limit = arm.max_pressure
    if "max_pressure" in free:
        limit = torch.floor(100 * limit + 1e-6) / 100
    return arm.with_values(places[0], length, limit, places[1])


def objective_words(objective: Objective) -> str:
    """What the values of an objective are."""
    over = {"mean": "mean", "worst": "largest"}[objective.over]
    if objective.metric == "predicted_error":
        robust = objective.robust
        built = (
            ""
            if robust is None
            else " of built arms, "
            + ("their mean" if robust.quantile is None else f"what {100 * robust.quantile:g} % stay below")
        )
        return f"{over} predicted shape error{built}"
    relative = f" + {objective.relative_weight:g} relative" if objective.relative_weight else ""
    return f"{over} absolute{relative} unattainability"


def compared_words(before: TaskErrors, after: TaskErrors, over: str) -> str:
    """How plain shape errors, and the tasks that are none, went from one design to another."""
    tasks, (old, new) = len(before.stable), (side.shape_mm(over) for side in (before, after))
    words = f"shape off by {'' if over == 'mean' else 'at most '}{three_digits(old)} → {three_digits(new)} mm"
    gap = ", "
    if new > old:
        gains = after.out_of_range < before.out_of_range or after.lost < before.lost
        nearer = not gains and float(after.beyond.amax()) < float(before.beyond.amax())
        words += ", which is more, but less far beyond the range" if nearer else ", which is more"
        gap = ", but " if gains else gap
    for name, first, last in (
        ("out of range", before.out_of_range, after.out_of_range),
        ("without a stable equilibrium", before.lost, after.lost),
    ):
        if first or last:
            words, gap = f"{words}{gap}{name} on {first} → {last} of {tasks} task{'s' * (tasks != 1)}", ", "
    return words


def yield_words(before: BuiltArms, after: BuiltArms) -> str:
    """How the share of built arms within tolerance on a task, and on all tasks, went from one design to another."""
    each = " → ".join(f"{100 * float(side.within.double().mean()):.1f}" for side in (before, after))
    old, new = before.yield_of_all, after.yield_of_all
    words = (
        f"built arms are within tolerance on {each} % of tasks, and on all tasks {old} → {new}, by samples of their own"
    )
    return words if new.value > old.value or after.within.sum() > before.within.sum() else f"{words}, which is no gain"


def reached_words(side: TaskErrors, over: str) -> str:
    """The plain shape errors of one design, and on how many tasks they are a guess or none."""
    words = f"{'' if over == 'mean' else 'at most '}{three_digits(side.shape_mm(over))} mm"
    words += f", out of range on {side.out_of_range}" if side.out_of_range else ""
    return words + (f", without a stable equilibrium on {side.lost}" if side.lost else "")
