"""optimise_design: arms that come nearer in truth, within constraints, never worse; stopped, checked and told."""

import pickle
import random
from typing import Any

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.design import Progress, optimise, optimise_design, verify_design
from torcharm.design.descent import descend
from torcharm.design.feasible import feasible_designs
from torcharm.design.objective import Objective, Problem, counted
from torcharm.design.space import DesignSpace
from torcharm.design.task_errors import TaskErrors, predicted, searched
from torcharm.pressure.followed import beyond_range
from torcharm.study import example_study

LOADS = ta.sample_loads(2, (20.0, 20.0, 5.0))
BENT = ta.Task(ta.affine_curvature(-3.0, 3.0, nodes=5), LOADS)
HARD = ta.Task(ta.affine_curvature(6.0, -1.5, nodes=5), LOADS)
TASK = ta.Task(ta.affine_curvature([[-3.0], [6.0]], [[3.0], [-1.5]], nodes=5), LOADS)
EASY = ta.Task(ta.affine_curvature(0.1, 0.2, length=0.5, nodes=5), (0.1, 0.0, 0.0))
ARM = ta.antagonistic_arm()
NEWTONS = Objective("unattainability")


@pytest.mark.parametrize(
    ("arm", "task", "held_back"), [(ARM, BENT, True), (ta.bellows_arm(), HARD, False), (ta.mckibben_arm(), HARD, True)]
)
def test_the_paper_s_arms_come_nearer_in_truth(arm: ta.ArmDesign, task: ta.Task, held_back: bool) -> None:
    found = optimise_design(arm, task, starts=2)
    assert found.status.startswith("better, as a pressure search confirms")
    checked = verify_design(found, task)
    assert checked.mean_after < checked.mean_before
    assert not bool(ta.evaluate(arm, task, "absolute").in_range.all())
    assert any("strain" in words for words in found.violated)
    assert bool(ta.evaluate(found.best, task, "absolute").in_range.all())
    assert float(found.best.radii.diff(dim=-1).min()) > 0.005 - 1e-7
    assert bool(found.active) == held_back
    error = ta.predict_error(found.best, task)
    torch.testing.assert_close(found.after.tip_error, error.tip_error)
    beyond = beyond_range(found.best, task, error.twists)
    values = counted(error.shape_error, error.stable, beyond, torch.full_like(beyond, 0.5))
    assert found.value == pytest.approx(float(values.mean()))
    assert found.value >= float(error.shape_error.mean()) * (1 - 1e-9)
    assert found.value == float(found.end_values.min()) < found.given_value


def test_the_best_arms_of_the_first_study_hold_no_fewer_tasks() -> None:
    """Of `torcharm init`: no best is worse in value or in how many tasks it holds, and none leaves the range more."""
    study = example_study()
    for named in study.arms:
        tasks = [one.task for one in study.tasks_of(named)]
        found = optimise_design(named.design, tasks, study.optimisation.space, starts=1, iterations=10)
        assert found.status.startswith("better, as a pressure search confirms")
        assert found.value < found.given_value
        for arm, count in ((found.given, found.given_held), (found.best, found.held)):
            words = [ta.evaluate(arm, task, "predicted_error").verdict for task in tasks]
            assert sum(int((word == "held").sum()) for word in words) == count
        assert found.held >= found.given_held
        assert found.held >= 25, named.name
        assert int(found.after.in_range.sum()) >= int(found.before.in_range.sum())


def test_no_design_that_holds_fewer_tasks_is_best(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the given design holds one task, and those found none; or where one that was found holds one as well."""
    spared: list[torch.Tensor] = []

    def held(arm: ta.ArmDesign, *rest: Any) -> tuple[TaskErrors, int]:
        return predicted(arm, *rest)[0], int(arm is ARM or any(torch.equal(arm.radii, radii) for radii in spared))

    monkeypatch.setattr(optimise, "predicted", held)
    found = optimise_design(ARM, BENT, starts=2, iterations=5)
    assert found.best is ARM
    assert found.value == found.given_value
    assert "it holds 1 task, and those of less value hold 0 at most" in found.status
    spared.append(found.ends[1].radii)
    again = optimise_design(ARM, BENT, starts=2, iterations=5)
    assert torch.equal(again.best.radii, found.ends[1].radii)
    assert again.held == 1


def test_of_comparable_designs_those_that_hold_more_come_first() -> None:
    assert optimise.best_first([1.0, 1.05, 1.2, 3.0], [1, 2, 3, 9]) == [1, 0, 2, 3]
    assert optimise.best_first([-1.0, -0.95, -0.5], [0, 1, 5]) == [1, 0, 2]
    assert optimise.best_first([float("inf"), 2.0, 2.0], [3, 1, 1]) == [1, 2, 0]
    assert optimise.best_first([], []) == []


def test_no_neighbour_of_the_optimum_is_better() -> None:
    for objective, slack in ((NEWTONS, 1e-4), (Objective(), 1e-5)):
        space = DesignSpace(tied="mirror")
        found = optimise_design(ARM, BENT, space, objective, starts=2)
        problem = Problem(feasible_designs(space, ARM, [BENT]), (BENT,), objective)
        generator = np.random.default_rng(0)
        at = problem.designs.free.inverse(optimise.given_values(found.best))[0]
        near = [problem.designs.project(at + 0.005 * generator.normal(size=at.shape)) for _ in range(60)]
        values = problem.value(problem.designs.design(np.array(near)))
        assert float(values.min()) > found.value * (1 - slack)


def test_an_arm_in_space_gets_better() -> None:
    arm = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=3), length=0.4, actuators=ta.Bellows(), diameter=0.02)
    task = ta.Task([[0.42, 0.0, 0.0, 0.0, 0.5, -0.8]] * 4, [4.0, -3.0, 2.0, 0.0, 0.1, 0.1])
    space = DesignSpace(free=("radii", "angles", "length"), tied="none")
    found = optimise_design(arm, task, space, starts=1, iterations=15)
    assert found.value < found.given_value
    place = found.best.offsets
    assert float(torch.pdist(place).min()) >= 0.02 - 1e-7
    ring = optimise_design(arm, task, DesignSpace(free=("radii", "angles"), tied="equal"), starts=1, iterations=15)
    radius = ring.best.offsets.norm(dim=-1)
    torch.testing.assert_close(radius, radius[:1].expand(3))
    assert ring.value <= ring.given_value


def test_segments_in_series_get_better() -> None:
    arm = ta.series([ta.bellows_arm(0.05, 0.02, 0.3), ta.bellows_arm(0.04, 0.015, 0.25)])
    twists = torch.tensor([[0.32, 0.0, 0.4]] * 3 + [[0.27, 0.0, -0.5]] * 3).double()
    task = ta.Task(twists, (4.0, 3.0, 0.5), segment_nodes=(3, 3))
    found = optimise_design(arm, task, DesignSpace(tied="mirror"), starts=1, iterations=15)
    assert isinstance(found.best, ta.ArmSeries)
    assert found.value < found.given_value


def test_modules_in_space_get_better_under_weight_and_stay_rings() -> None:
    lower = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.3, actuators=ta.Bellows(), mass=0.25)
    upper = ta.ArmDesign(offsets=ta.ring(0.04, 3, phase=0.5), length=0.25, actuators=ta.Bellows(), mass=0.15)
    arm = ta.series([lower, ta.RigidLink(length=0.02, mass=0.05), upper])
    bends = [[0.32, 0.0, 0.0, 0.0, 0.3, 0.2]] * 4 + [[0.265, 0.0, 0.0, 0.0, -0.2, 0.3]] * 4
    load = ta.ExternalLoad(gravity=True, points=[ta.PointLoad(mass=0.1, segment=1)])
    task = ta.Task(bends, load=load, segment_nodes=(4, 4))
    found = optimise_design(arm, task, starts=1, iterations=8)
    assert found.status.startswith("better")
    assert isinstance(found.best, ta.ArmSeries)
    for segment in found.best.segments:
        radius = segment.offsets.norm(dim=-1)
        torch.testing.assert_close(radius, radius[:1].expand(3))
    checked = verify_design(found, task)
    assert checked.mean_after < checked.mean_before


def drawn(seed: int) -> tuple[ta.ArmDesign, ta.Task]:
    """An arm of 1 to 4 actuators, and a task near what such arms can do."""
    draw = random.Random(seed)
    count = draw.randint(1, 4)
    radii = sorted(draw.uniform(-0.08, 0.08) for _ in range(count))
    models = [draw.choice((ta.Bellows(), ta.McKibben())) for _ in range(count)]
    slope, intercept, length = draw.uniform(-1.5, 1.5), draw.uniform(-1.5, 1.5), draw.uniform(0.45, 0.56)
    load = [draw.uniform(-most, most) for most in (6.0, 6.0, 0.6)]
    return ta.ArmDesign(radii, 0.5, models), ta.Task(ta.affine_curvature(slope, intercept, length, 6), load)


@pytest.mark.parametrize("seed", range(4, 10))
def test_the_best_is_never_worse_in_truth_than_the_given(seed: int) -> None:
    arm, task = drawn(seed)
    found = optimise_design(arm, task, starts=1, iterations=4)
    before, after = (searched(one, (task,), None) for one in (arm, found.best))
    if bool(before.stable):
        assert float(after.shape_error) <= float(before.shape_error) * (1 + 1e-5)
    assert (found.best is arm) == found.status.startswith("given design kept")
    apart = abs(found.value - float(after.shape_error)) > 0.2 * float(after.shape_error) + 0.01
    assert apart <= (not found.status.startswith("better, as a pressure search confirms")), found.status


def test_no_design_without_an_equilibrium_is_best() -> None:
    """Where no equilibrium is found a prediction is near 0 of itself, and a descent is drawn to it."""
    arm = ta.ArmDesign([0.034, 0.057, 0.066], 0.5, [ta.Bellows(), ta.Bellows(), ta.McKibben()])
    task = ta.Task(ta.affine_curvature(0.601, -0.437, 0.543, 6), (-3.45, 5.75, 0.58))
    found = optimise_design(arm, task, DesignSpace(in_range=False), starts=1, iterations=5)
    best, given = (float(searched(one, (task,), None).shape_error) for one in (found.best, arm))
    assert best <= given * (1 + 1e-5)


def test_the_given_design_is_kept_where_the_search_does_better_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that finds ten times the error with every design but the given one."""

    def other(arm: ta.ArmDesign, tasks: Any, cost: Any) -> TaskErrors:
        found = searched(arm, tasks, cost)
        factor = 1.0 if arm is ARM else 10.0
        return TaskErrors(found.tip_error, factor * found.shape_error, *list(vars(found).values())[2:])

    monkeypatch.setattr(optimise, "searched", other)
    found = optimise_design(ARM, BENT, starts=2, iterations=5)
    assert found.best is ARM
    assert found.value == found.given_value
    assert found.status.startswith("given design kept: a pressure search reaches")
    assert "which it is outside of" in found.status
    assert float(found.end_values.min()) < found.given_value, "what was found is there all the same"


def test_unattainability_may_be_the_objective_and_gains_margin() -> None:
    found = optimise_design(ARM, TASK, objective=NEWTONS, starts=2)
    after = ta.evaluate(found.best, TASK, "absolute").absolute
    assert after is not None
    assert found.value == pytest.approx(float(after.mean()))
    assert found.value < 0.2 * found.given_value
    arm = ta.bellows_arm(outer_radius=0.03, inner_radius=0.01, length=0.45)
    margin = optimise_design(arm, EASY, objective=NEWTONS, starts=1, iterations=15)
    assert margin.given_value < 0
    assert margin.value < 2 * margin.given_value
    kept = optimise_design(arm, EASY, objective=Objective("unattainability", margin=False), starts=1, iterations=3)
    assert kept.value == 0.0
    assert kept.best is arm


@pytest.mark.parametrize("metric", ["unattainability", "predicted_error"])
def test_the_worst_task_may_count(metric: str) -> None:
    objective = Objective(metric, over="worst")
    found = optimise_design(ARM, TASK, objective=objective, starts=2, iterations=20)
    problem = Problem(feasible_designs(DesignSpace(), ARM, [TASK]), (TASK,), objective)
    values = problem.values(found.best)
    assert found.value == pytest.approx(float(values.max()), rel=1e-9)
    assert found.value < found.given_value


def test_limits_may_be_free_and_the_rest_stays() -> None:
    space = DesignSpace(free="max_pressure", bounds={"max_pressure": (10.0, 60.0)}, in_range=False)
    found = optimise_design(ARM, TASK, space, NEWTONS, starts=1, iterations=8)
    assert float(found.best.max_pressure.max()) <= 60.0 + 1e-6
    assert torch.equal(found.best.radii, ARM.radii)
    assert found.value < float(found.given_value)


def test_starts_do_not_know_of_each_other() -> None:
    many = optimise_design(ARM, BENT, starts=3, iterations=6)
    alone = optimise_design(ARM, BENT, starts=1, iterations=6)
    assert float(many.end_values[0]) == float(alone.end_values[0])
    assert many.starts.batch_shape == many.ends.batch_shape == (3,)


def test_all_given_designs_are_starts() -> None:
    arms = ta.antagonistic_arm(outer_radius=torch.tensor([0.03, 0.05, 0.08]).double())
    found = optimise_design(arms, BENT, objective=NEWTONS, starts=2, iterations=3)
    assert found.starts.batch_shape == (3,)
    values = ta.evaluate(arms, BENT, "absolute").absolute
    assert values is not None
    assert found.given_value == pytest.approx(float(values.mean(-1).min()))


def test_single_precision_arms_stay_so() -> None:
    arm = ARM.to(torch.float32)
    found = optimise_design(arm, BENT.to(torch.float32), starts=1, iterations=12)
    double = optimise_design(ARM, BENT, starts=1, iterations=12)
    assert found.best.radii.dtype == torch.float32
    assert found.value == pytest.approx(double.value, rel=0.02)


def test_a_model_without_an_answer_stops_no_descent() -> None:
    class Brittle(ta.Bellows):
        """A model without an answer for long neutral lengths."""

        def force(self, strain: torch.Tensor, pressure: torch.Tensor) -> torch.Tensor:
            return super().force(torch.where(strain < -0.1, torch.nan, strain), pressure)

    arm = ta.ArmDesign([-0.02, -0.01, 0.01, 0.02], 0.5, [Brittle()] * 4)
    problem = Problem(feasible_designs(DesignSpace(free="length", in_range=False), arm, [BENT]), (BENT,), NEWTONS)
    lost, _ = descend(problem, np.ones(4), 5, 1e-6, None)
    assert (lost.value, lost.reason) == (np.inf, "no candidate")
    end, _ = descend(problem, np.full(4, 0.2), 5, 1e-6, None)
    assert np.isfinite(end.value)


def test_it_is_stopped_by_callback_time_and_interrupt() -> None:
    seen: list[int] = []

    def stop(progress: Progress) -> bool:
        seen.append(progress.evaluations)
        return len(seen) == 3

    found = optimise_design(ARM, BENT, objective=NEWTONS, starts=4, callback=stop)
    assert (found.stopped, seen, found.evaluations) == ("callback", [1, 2, 3], 3)
    assert found.reasons[-1] == "stopped"
    assert len(found.reasons) < 4
    timed = optimise_design(ARM, BENT, starts=200, iterations=60, seconds=0.5)
    assert timed.stopped == "time"

    def interrupt(progress: Progress) -> None:
        if progress.evaluations == 2:
            raise KeyboardInterrupt

    part = optimise_design(ARM, BENT, starts=2, callback=interrupt)
    assert part.stopped == "interrupted"
    assert part.value <= part.given_value

    def at_once(_: Progress) -> None:
        raise KeyboardInterrupt

    kept = optimise_design(part.best, BENT, starts=1, callback=at_once)
    assert kept.best is kept.given
    assert kept.status.startswith(
        "given design kept: no better one was found within the constraints before it was interrupted"
    )


def test_a_result_is_short_in_print_and_survives_pickle() -> None:
    found = optimise_design(ARM, BENT, objective=NEWTONS, starts=1, iterations=3)
    assert len(repr(found)) < 500
    assert "mm predicted" in repr(found)
    again = pickle.loads(pickle.dumps(found))
    assert torch.equal(again.best.radii, found.best.radii)
    assert again.after.tip_mm == found.after.tip_mm
    checked = verify_design(found, BENT, starts=1)
    assert "of 2" in repr(checked)
    assert checked.after.pressure.shape == (2, 4)
    fell = (checked.after.shape_error < checked.before.shape_error)[checked.both]
    assert checked.improved == float(fell.double().mean())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"starts": 0}, "starts"),
        ({"seed": -1}, "seed"),
        ({"iterations": 0}, "iterations"),
        ({"seconds": 0.0}, "seconds"),
        ({"space": DesignSpace(bounds={"length": (0.1, 0.2)})}, "in_range = false"),
        ({"task": []}, "at least one task"),
        ({"task": ta.Task([[0.4, 0, 0, 0, 0, 0.0]] * 3, [0.0] * 6)}, "of the arm's dimension"),
    ],
)
def test_arguments_are_checked(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        optimise_design(**({"arm": ARM, "task": TASK} | options))
