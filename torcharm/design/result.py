"""What an optimisation found."""

from dataclasses import dataclass

from torch import Tensor

from torcharm.design.objective import Objective
from torcharm.design.space import Arm, DesignSpace
from torcharm.design.task_errors import TaskErrors
from torcharm.inputs import HoldsTensors


@dataclass(frozen=True, eq=False, repr=False)
class OptimisedDesign(HoldsTensors):
    """The outcome of `optimise_design`.

    Attributes:
        given: the design to improve on (of a batch, the one of the best value).
        best: the best design found; the given one where no better was found.
        given_value, value: the objective of the two.
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

    def __repr__(self) -> str:
        """Values, no tensors."""
        count = len(self.after.stable)
        return (
            f"OptimisedDesign({self.best!r}, {objective_words(self.objective)} of {count} task{'s' * (count != 1)} "
            f"{_shown(self.given_value, self.objective)} → {_shown(self.value, self.objective)}, tip error "
            f"{self.before.tip_mm:.3g} → {self.after.tip_mm:.3g} mm predicted, held {self.given_held} → {self.held}, "
            f"{self.status}; {self.stopped})"
        )


def objective_words(objective: Objective) -> str:
    """What the values of an objective are."""
    over = {"mean": "mean", "worst": "largest"}[objective.over]
    if objective.metric == "predicted_error":
        return f"{over} predicted shape error"
    relative = f" + {objective.relative_weight:g} relative" if objective.relative_weight else ""
    return f"{over} absolute{relative} unattainability"


def _shown(value: float, objective: Objective) -> str:
    return f"{1e3 * value:.4g} mm" if objective.metric == "predicted_error" else f"{value:.4g} N"
