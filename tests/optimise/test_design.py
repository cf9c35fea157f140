"""optimise_design: how good, how robust, and how it is stopped, saved and taken up again."""

import time
from pathlib import Path
from typing import Any

import pytest
import torch

import torcharm as ta
from torcharm.optimise import DesignSpace, Objective, Report, load_optimised, optimise_design
from torcharm.optimise import design as design_module
from torcharm.optimise.descent import begin
from torcharm.optimise.feasible import feasible_designs
from torcharm.optimise.objective import Problem

SHAPES = ta.affine_curvature([[-3.0], [6.0]], [[3.0], [-1.5]], nodes=4)
TASK = ta.Task(SHAPES, ta.sample_loads(2, (20.0, 20.0, 5.0)))
EASY = ta.Task(ta.affine_curvature(0.1, 0.2, length=0.5, nodes=5), (0.1, 0.0, 0.0))
ARM = ta.antagonistic_arm()


@pytest.mark.parametrize("arm", [ta.antagonistic_arm(), ta.bellows_arm(), ta.mckibben_arm()])
def test_the_paper_s_arms_get_better_and_stay_in_range(arm: ta.ArmDesign) -> None:
    found = optimise_design(arm, TASK, starts=2, iterations=8)
    before = ta.evaluate(arm, TASK, "absolute")
    after = ta.evaluate(found.best, TASK, "absolute")
    assert not bool(before.in_range.all()), "a start with strains out of range"
    assert bool(after.in_range.all())
    assert found.in_range
    assert found.violation < 1e-8
    assert before.absolute is not None
    assert after.absolute is not None
    torch.testing.assert_close(found.after["absolute"], after.absolute.flatten())
    torch.testing.assert_close(found.before["absolute"], before.absolute.flatten())
    assert found.value == pytest.approx(float(after.absolute.mean()))
    assert found.value < float(found.start_values[0])


def test_the_optimum_is_stationary_and_no_neighbour_is_better() -> None:
    space = DesignSpace(tied="mirror")
    found = optimise_design(ARM, TASK, space, starts=1)
    assert found.stationarity < 1e-6
    polytope = feasible_designs(space, ARM, [TASK])
    problem = Problem((polytope,), (TASK,), Objective())
    at = polytope.nearest(found.best)
    generator = torch.Generator().manual_seed(0)
    around = at + 0.01 * torch.randn(300, at.shape[-1], generator=generator, dtype=torch.float64)
    values = problem.judge(polytope.project(around), torch.zeros(300).long(), torch.ones(300).double(), gradient=False)
    assert float(values.value.min()) > found.value - 1e-6


@pytest.mark.parametrize(
    "method", ["adam", "slsqp", "nelder_mead", "differential_evolution", "batched_differential_evolution"]
)
def test_other_methods_reach_no_lower(method: str) -> None:
    space = DesignSpace(tied="mirror")
    ours = optimise_design(ARM, TASK, space, starts=2)
    iterations = {"adam": 60, "slsqp": None, "nelder_mead": 60}.get(method, 10)
    theirs = optimise_design(ARM, TASK, space, method=method, starts=1, iterations=iterations)
    assert theirs.value > ours.value * (1 - 1e-5)
    assert theirs.value < ours.value * 1.05, "and they search the same designs"
    assert theirs.in_range


def test_an_attainable_start_gains_margin() -> None:
    arm = ta.bellows_arm(outer_radius=0.03, inner_radius=0.01, length=0.45)
    found = optimise_design(arm, EASY, starts=1, iterations=15)
    assert float(found.before["absolute"].max()) == 0.0
    assert float(found.after["absolute"].max()) == 0.0
    assert found.given_value < 0
    assert found.value < 2 * found.given_value
    kept = optimise_design(arm, EASY, objective=Objective(margin=False), starts=1, iterations=3)
    assert kept.value == 0.0


@pytest.mark.parametrize("over", ["mean", "worst", "cvar", "count"])
def test_every_aggregate_falls(over: str) -> None:
    found = optimise_design(ARM, TASK, objective=Objective(over=over), starts=2, iterations=8)
    assert found.value < float(found.start_values.min())
    assert found.history.best.diff().max() <= 0
    reached = Objective(over=over)
    assert found.value == pytest.approx(float(reached.total(reached.per_task(found.best, (TASK,)))), rel=1e-9)


def test_size_costs() -> None:
    wide = optimise_design(ARM, TASK, starts=1, iterations=20)
    slim = optimise_design(ARM, TASK, objective=Objective(size_weight=1000.0), starts=1, iterations=20)
    assert float(slim.best.radii.max() - slim.best.radii.min()) < float(wide.best.radii.max() - wide.best.radii.min())


def test_limits_may_be_free() -> None:
    space = DesignSpace(free="max_pressure", bounds={"max_pressure": (10.0, 60.0)}, in_range=False)
    found = optimise_design(ARM, TASK, space, starts=1, iterations=8)
    assert float(found.best.max_pressure.max()) <= 60.0 + 1e-6
    assert torch.equal(found.best.radii, ARM.radii)
    assert found.value < float(found.start_values[0])


@pytest.mark.parametrize("loads", [1, 500])
def test_one_task_and_a_thousand(loads: int) -> None:
    task = ta.Task(SHAPES, ta.sample_loads(loads)) if loads > 1 else ta.Task(SHAPES[0, 0], ta.sample_loads(1)[0])
    found = optimise_design(ARM, task, starts=1, iterations=4)
    assert found.after["absolute"].numel() == (2 * loads if loads > 1 else 1)
    assert found.value < float(found.start_values[0])


def test_a_thousand_random_starts_are_numbers() -> None:
    polytope = feasible_designs(DesignSpace(free=("radii", "length", "max_pressure")), ARM, [TASK])
    task = ta.Task(SHAPES[:, 0], ta.sample_loads(2, (20.0, 20.0, 5.0)))
    problem = Problem((polytope,), (task,), Objective(relative_weight=0.1))
    state = begin(problem, polytope.sample(1000, seed=5), torch.zeros(1000, dtype=torch.long))
    assert bool(state.smooth.isfinite().all())
    assert bool(state.gradient.isfinite().all())
    assert bool((state.reason == 0).all())


def test_starts_do_not_know_of_each_other() -> None:
    many = optimise_design(ARM, TASK, starts=3, iterations=6, seed=3)
    alone = optimise_design(ARM, TASK, starts=1, iterations=6)
    torch.testing.assert_close(many.end_values[0], alone.end_values[0], rtol=1e-6, atol=0)


def test_the_start_nearest_to_the_given_design_descends_first() -> None:
    alone = optimise_design(ARM, TASK, starts=1, iterations=6)
    many = optimise_design(ARM, TASK, starts=6, iterations=6, seed=4)
    first = len(alone.history.seconds)
    assert torch.equal(many.history.values[:first, 0], alone.history.values[:, 0])
    assert bool(many.history.values[:first, 1:].isinf().all())
    assert bool(many.history.values[-1].isfinite().all())
    assert many.evaluations > alone.evaluations + 4


@pytest.mark.parametrize("method", ["bfgs", "differential_evolution", "batched_differential_evolution"])
def test_a_time_limit_stops_the_search(method: str) -> None:
    found = optimise_design(ARM, TASK, method=method, starts=200, iterations=100_000, seconds=0.4)
    assert found.stopped == "time"
    assert 0.4 <= found.seconds < 10.0
    assert found.value <= float(found.start_values[0])
    with pytest.raises(ValueError, match="seconds"):
        optimise_design(ARM, TASK, method=method, seconds=0.0)


def test_seconds_count_from_the_call(monkeypatch: pytest.MonkeyPatch) -> None:
    prepare = design_module.feasible_designs

    def slow(*arguments: Any) -> Any:
        time.sleep(0.3)
        return prepare(*arguments)

    monkeypatch.setattr(design_module, "feasible_designs", slow)
    for method in ("bfgs", "slsqp"):
        found = optimise_design(ARM, TASK, method=method, starts=1, iterations=1)
        assert float(found.history.seconds[0]) > 0.3


def test_all_given_designs_are_starts() -> None:
    arms = ta.antagonistic_arm(outer_radius=torch.tensor([0.03, 0.05, 0.08]).double())
    found = optimise_design(arms, TASK, starts=2, iterations=3)
    assert found.starts.batch_shape == (3,)
    values = ta.evaluate(arms, TASK, "absolute").absolute
    assert values is not None
    assert found.given_value == pytest.approx(float(values.flatten(1).mean(-1).min()))


def test_single_precision_arms_stay_so() -> None:
    arm = ta.ArmDesign(ARM.radii.float(), ARM.length.float(), ARM.actuators, ARM.max_pressure.float())
    found = optimise_design(arm, TASK.to(torch.float32), starts=1, iterations=12, tolerance=1e-4)
    double = optimise_design(ARM, TASK, starts=1, iterations=12)
    assert found.best.radii.dtype == torch.float32
    assert found.value == pytest.approx(double.value, rel=0.05)


# ---- stopped, saved, resumed -----------------------------------------------------------------


def _same(a: ta.ArmDesign, b: ta.ArmDesign) -> bool:
    return torch.equal(a.radii, b.radii) and torch.equal(a.length, b.length) and a.actuators == b.actuators


def test_an_interrupted_run_that_goes_on_ends_at_the_same_design(tmp_path: Path) -> None:
    whole = optimise_design(ARM, TASK, starts=2, seed=2, iterations=12)

    def interrupt(report: Report) -> None:
        if report.iteration == 4:
            raise KeyboardInterrupt

    file = tmp_path / "run.npz"
    part = optimise_design(ARM, TASK, starts=2, seed=2, iterations=12, checkpoint=file, callback=interrupt)
    assert part.stopped == "interrupted"
    assert part.value > whole.value
    assert float(part.history.values.shape[0]) == 5
    resumed = optimise_design(ARM, TASK, starts=2, seed=2, iterations=12, checkpoint=file)
    assert resumed.stopped == "finished"
    assert _same(resumed.best, whole.best)
    assert resumed.reasons == whole.reasons
    assert torch.equal(resumed.history.values, whole.history.values)
    assert torch.equal(resumed.history.evaluations, whole.history.evaluations)
    assert bool((resumed.history.seconds.diff() >= 0).all())


def test_a_checkpoint_of_another_problem_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    optimise_design(ARM, TASK, starts=1, iterations=2, checkpoint=file)
    with pytest.raises(ValueError, match="another problem"):
        optimise_design(ARM, TASK, starts=1, iterations=2, checkpoint=file, seed=1)
    file.write_text("not an archive")
    with pytest.raises(ValueError, match="no optimisation"):
        optimise_design(ARM, TASK, starts=1, iterations=2, checkpoint=file)


@pytest.mark.parametrize("method", ["bfgs", "slsqp", "nelder_mead", "differential_evolution"])
def test_a_callback_stops_every_method(method: str) -> None:
    seen: list[Report] = []

    def watch(report: Report) -> bool:
        seen.append(report)
        return len(seen) == 3

    found = optimise_design(ARM, TASK, method=method, starts=1, callback=watch)
    assert found.stopped == "callback"
    assert len(seen) == 3
    assert found.value == seen[-1].value
    assert seen[0].evaluations <= seen[-1].evaluations


def test_a_result_is_saved_and_loaded_whole(tmp_path: Path) -> None:
    space = DesignSpace(tied={"radii": "mirror"}, bounds={"length": (0.3, 0.7)}, spacing=0.002)
    found = optimise_design(ARM, TASK, space, Objective(relative_weight=0.1), starts=2, iterations=5)
    found.save(tmp_path / "found.npz")
    again = load_optimised(tmp_path / "found.npz")
    for name, value in vars(found).items():
        other = getattr(again, name)
        if isinstance(value, ta.ArmDesign):
            assert _same(value, other), name
        elif isinstance(value, torch.Tensor):
            assert torch.equal(value, other), name
        elif name in ("before", "after"):
            assert value.keys() == other.keys()
            assert all(torch.equal(value[key], other[key]) for key in value)
        elif name == "history":
            assert all(torch.equal(entry, vars(other)[key]) for key, entry in vars(value).items())
        else:
            assert value == other, name


def test_models_of_one_s_own_are_given_again(tmp_path: Path) -> None:
    class Mine(ta.Bellows):
        pass

    arm = ta.ArmDesign(ARM.radii, 0.5, [Mine()] * 4)
    found = optimise_design(arm, TASK, starts=1, iterations=2)
    found.save(tmp_path / "found.npz")
    with pytest.raises(ValueError, match="pass actuators"):
        load_optimised(tmp_path / "found.npz")
    assert load_optimised(tmp_path / "found.npz", arm.actuators).best.actuators == arm.actuators


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "newton"}, "method"),
        ({"starts": 0}, "starts"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"iterations": 0}, "iterations"),
        ({"method": "slsqp", "checkpoint": "x.npz"}, "checkpoint"),
        ({"space": DesignSpace(bounds={"length": (0.1, 0.2)})}, "characterised range"),
    ],
)
def test_arguments_are_checked(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        optimise_design(ARM, TASK, **options)


def test_no_task_is_an_error() -> None:
    with pytest.raises(ValueError, match="at least one task"):
        optimise_design(ARM, [])
