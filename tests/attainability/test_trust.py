"""What is not an answer says so: predictions without equilibrium, equilibria that are none, impossible geometries."""

import csv
import math
from dataclasses import dataclass

import pytest
import torch
from typer.testing import CliRunner

import torcharm as ta
from experiments.trust.agreement import ARMS, counted
from experiments.trust.run import EACH
from torcharm.cli.app import app
from torcharm.study import evaluate_study, parse_study, write_results

D = torch.float64
LOADS = torch.tensor([15.0, 15.0, 3.0], dtype=D)
METRICS = ("absolute", "relative", "predicted_error")
NAMES = {"predicted_error": "shape_error"}  # of what a metric yields, where that is another


def uniform(generator, low, high, *shape):
    return low + (high - low) * torch.rand(shape, generator=generator, dtype=D)


def random_arm(generator, count):
    kinds = [(ta.Bellows, ta.McKibben)[kind]() for kind in torch.randint(2, (count,), generator=generator).tolist()]
    return ta.ArmDesign(uniform(generator, -0.08, 0.08, count), uniform(generator, 0.45, 0.55, count), kinds)


def random_tasks(generator, arm, count):
    """Half of the shapes are drawn, the others are equilibria of the arm, stable or not."""
    loads = uniform(generator, -1.0, 1.0, count, 3) * LOADS
    numbers = uniform(generator, -3.0, 3.0, count, 2).tolist()
    drawn = torch.stack([ta.affine_curvature(slope, intercept, 0.5, 6) for slope, intercept in numbers])
    pressure = arm.max_pressure * uniform(generator, 0.0, 1.0, count, arm.actuator_count)
    made = ta.solve_equilibrium(arm, pressure, loads, 6)
    kept = made.converged & (torch.arange(count) % 2 == 1)
    return ta.Task(torch.where(kept[:, None, None], made.twists, drawn), loads)


def largest_real_part(arm, twists, pressure, load):
    def balance(unknowns):
        length, curvature = unknowns.view(-1, 2).unbind(-1)
        shape = torch.stack((length, torch.zeros_like(length), curvature), -1)
        return (ta.reaction_wrench(arm, shape, pressure) - ta.required_wrench(shape, load)[..., [0, 2]]).flatten()

    jacobian = torch.autograd.functional.jacobian(balance, twists[:, [0, 2]].flatten())
    return float(torch.linalg.eigvals(jacobian).real.max())


# Predictions


def lone_muscles(count):
    """Single muscles, each on a shape that it cannot hold."""
    generator = torch.Generator().manual_seed(3)
    arm = ta.ArmDesign(uniform(generator, -0.08, 0.08, count, 1), 0.5, [ta.McKibben()])
    load = torch.tensor([-9.0, 7.0, 1.2], dtype=D)
    return arm, ta.Task(ta.affine_curvature(1.4, -0.3, 0.44, 6), load)


def test_where_no_equilibrium_is_found_the_error_is_infinite_and_its_gradient_no_number():
    arm, task = lone_muscles(12)
    radii = arm.radii.clone().requires_grad_()
    found = ta.evaluate(ta.ArmDesign(radii, arm.length, arm.actuators), task, metrics=("predicted_error",))
    prediction = found.prediction
    lost = ~prediction.stable
    assert int(lost.sum()) >= 5, lost
    assert bool((found.shape_error.isinf() == lost).all())
    assert bool((found.prediction.per_node[lost] == math.inf).all())
    assert bool(prediction.pose_errors[lost].isnan().all())
    assert not bool((found.converged & lost).any())
    unknown = ~found.converged
    (slope,) = torch.autograd.grad(found.shape_error.sum(), radii, retain_graph=True)
    assert bool((slope[:, 0].isnan() == unknown).all())
    kept = torch.where(found.converged, found.shape_error, 0.0)
    (slope,) = torch.autograd.grad(kept.sum(), radii)
    assert bool(slope.isfinite().all())


def test_an_unknown_gradient_leaves_those_of_other_tasks_alone():
    arm = ta.antagonistic_arm()
    loads = torch.cat((ta.sample_loads(8), torch.tensor([[0.0, 1e4, 0.0]], dtype=D)))
    slopes = []
    for chosen in (slice(None), slice(0, 8)):
        radii = arm.radii.clone().requires_grad_()
        design = ta.ArmDesign(radii, arm.length, arm.actuators)
        found = ta.evaluate(design, ta.Task(ta.affine_curvature(1.0, 1.5), loads[chosen]), metrics=("predicted_error",))
        known = found.converged
        assert 3 <= int(known.sum()) < len(known) or len(known) == 8
        slopes.append(torch.autograd.grad(found.shape_error[known].sum(), radii)[0])
    assert bool(slopes[0].isfinite().all())
    torch.testing.assert_close(slopes[0], slopes[1], rtol=1e-6, atol=1e-9)


@dataclass(frozen=True)
class Own:
    """A force model whose stiffness is anything."""

    stiffness: float
    bending_stiffness: float = 0.0
    max_pressure: float = 50.0
    strain_range: tuple = (-0.5, 0.5)
    pressure_range: tuple = (0.0, 50.0)

    def force(self, strain, pressure):
        return pressure * 0.0 - self.stiffness * strain


@pytest.mark.parametrize("stiffness", [0.0, math.nan, math.inf])
@pytest.mark.parametrize("radii", [[0.03], [-0.05, 0.05]])
@pytest.mark.parametrize("load", [[0.0, 0.0, 0.0], [1.0, -2.0, 0.1]])
def test_models_that_resist_nothing_or_have_no_number_hold_nothing(stiffness, radii, load):
    arm = ta.ArmDesign(radii, 0.5, [Own(stiffness)] * len(radii))
    found = ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 0.5, nodes=4), load), metrics=("predicted_error",))
    assert float(found.shape_error) == math.inf
    assert not bool(found.converged)
    solved = ta.solve_equilibrium(arm, torch.zeros(len(radii), dtype=D), load, 4)
    assert not bool(solved.stable)


def test_small_predictions_are_confirmed_by_the_search():
    generator = torch.Generator().manual_seed(11)
    looked_at = 0
    for count in (1, 2, 3, 4):
        arm = random_arm(generator, count)
        task = random_tasks(generator, arm, 10)
        found = ta.evaluate(arm, task, metrics=("predicted_error",))
        small = (found.shape_error < 1e-3) & found.converged & found.prediction.reached
        if bool(small.any()):
            searched = ta.search_pressure(arm, ta.Task(task.twists[small], task.tip_load[small]), starts=4)
            assert bool(((searched.cost.sqrt() - found.shape_error[small]).abs() <= 0.01).all())
        looked_at += int(small.sum())
    assert looked_at >= 10


# Equilibria


def test_arms_that_snapped_are_called_stable_only_if_they_are():
    generator = torch.Generator().manual_seed(2)
    at_rest = unstable = stable = 0
    for radii, kinds in (([-0.077, 0.075], (ta.McKibben, ta.McKibben)), ([-0.08, 0.08], (ta.Bellows, ta.McKibben))):
        arm = ta.ArmDesign(radii, [0.484, 0.521], [kind() for kind in kinds])
        pressure = arm.max_pressure * uniform(generator, 0.0, 1.0, 400, 2)
        loads = uniform(generator, -1.0, 1.0, 400, 3) * LOADS
        loads[:, 1] = loads[:, 1].abs()  # upwards: the arm is compressed
        found = ta.solve_equilibrium(arm, pressure, loads, 5)
        for index in (found.converged & ~found.continued).nonzero().flatten().tolist():
            largest = largest_real_part(arm, found.twists[index], pressure[index], loads[index])
            assert not (bool(found.stable[index]) and largest > 0), (index, largest)
            at_rest, unstable = at_rest + 1, unstable + int(largest > 0)
            stable += int(found.stable[index])
    assert at_rest >= 8, at_rest
    assert unstable >= 2, unstable
    assert stable >= 2, stable


def test_folded_arms_do_not_converge():
    """A lone bellows without pressure hardly resists bending: it balances a load by lengths below 0."""
    arm = ta.ArmDesign([0.05], 0.5, (ta.Bellows(),))
    loads = ta.sample_loads(40, seed=7)
    found = ta.solve_equilibrium(arm, torch.tensor([0.2], dtype=D), loads)
    length, curvature = found.twists[..., 0], found.twists[..., 2]
    folded = (torch.minimum(length, length - 0.05 * curvature) <= 0).any(-1)
    assert bool((folded & (found.residual <= 1e-10)).any())
    assert torch.equal(found.converged, (found.residual <= 1e-10) & ~folded)
    assert not bool(((found.stable | found.continued) & folded).any())


def test_a_search_converges_only_to_what_is_stable():
    arm = ta.bellows_arm()
    found = ta.search_pressure(arm, ta.Task(ta.affine_curvature(1.0, 1.5, nodes=5), ta.sample_loads(10)), starts=2)
    assert not bool((found.converged & ~found.stable).any())
    for index in found.stable.nonzero().flatten().tolist():
        load = ta.sample_loads(10)[index]
        assert largest_real_part(arm, found.twists[index], found.pressure[index], load) <= 0


# Impossible geometries


@dataclass(frozen=True)
class Logarithmic:
    """A force that is no number where the actuator has no length."""

    bending_stiffness: float = 0.0
    max_pressure: float = 60.0
    strain_range: tuple = (-0.9, 2.0)
    pressure_range: tuple = (0.0, 60.0)

    def force(self, strain, pressure):
        return pressure - 30 * torch.log(1 + strain)


@pytest.mark.parametrize(
    ("options", "model"),
    [
        ({"metrics": METRICS}, Logarithmic()),
        ({"metrics": METRICS}, ta.McKibben()),
        ({"chunk_size": 1}, ta.McKibben()),
        ({"distance": "scipy"}, Logarithmic()),
        ({"signed": True}, ta.Bellows()),
        ({"hull": "edges", "power": 2}, Logarithmic()),
    ],
    ids=str,
)
def test_impossible_shapes_are_infinitely_far_and_leave_the_others_alone(options, model):
    fine, degrees = ta.affine_curvature(1.0, 1.5, nodes=4), ta.affine_curvature(57.3, 85.9, nodes=4)
    edge = ta.affine_curvature(0.0, 8.0, nodes=4)  # an actuator of length 0
    slopes = []
    for shapes in (torch.stack((fine, degrees, edge)), fine[None]):
        radii = torch.tensor([-0.0625, 0.01, 0.0625], dtype=D, requires_grad=True)
        arm = ta.ArmDesign(radii, 0.5, [model] * 3)
        found = ta.evaluate(arm, ta.Task(shapes, [3.0, -2.0, 0.5]), **{"metrics": METRICS[:2], **options})
        slopes.append(torch.autograd.grad(found.absolute[0] + found.relative[0], radii, retain_graph=True)[0])
        if len(shapes) == 1:
            continue
        assert found.impossible.tolist() == [False, True, True]
        for metric in options.get("metrics", METRICS[:2]):
            assert getattr(found, NAMES.get(metric, metric)).isfinite().tolist() == [True, False, False], metric
            assert getattr(found, NAMES.get(metric, metric))[1:].tolist() == [math.inf] * 2
        assert not bool((found.in_range | found.converged)[1:].any())
        assert found.prediction is None or not bool(found.prediction.stable[1:].any())
        assert bool((found.strain_excess[1:] > 0.05).all())
        infinite = found.absolute[1:].sum() + found.relative[1:].sum()
        (slope,) = torch.autograd.grad(infinite, radii, retain_graph=True)
        if not options.get("signed"):
            assert slope.tolist() == [0.0, 0.0, 0.0]
        assert bool(slope.isfinite().all())
    assert bool(slopes[0].isfinite().all())
    torch.testing.assert_close(slopes[0], slopes[1])


def test_radii_in_millimetres_are_impossible_for_those_designs_only():
    designs = ta.ArmDesign(torch.tensor([[-80.0, 80.0], [-0.08, 0.08]]).double(), 0.5, [ta.Bellows()] * 2)
    task = ta.Task(ta.affine_curvature(1.0, 1.5), ta.sample_loads(3))
    found = ta.evaluate(designs, task, ("absolute", "relative"))
    assert found.impossible.tolist() == [[True] * 3, [False] * 3]
    assert bool(found.absolute[0].isinf().all())
    alone = ta.evaluate(designs[1], task, ("absolute", "relative"))
    torch.testing.assert_close(found.absolute[1], alone.absolute)
    assert torch.equal(
        ta.evaluate(designs, task, ("absolute", "relative"), chunk_size=1).absolute.isinf(), found.absolute.isinf()
    )


# Rounding


@pytest.mark.parametrize("kind", ["antagonistic", "mckibben"])
@pytest.mark.parametrize("options", [{}, {"hull": "edges"}, {"distance": "scipy"}, {"weights": (0.01, 1.0)}], ids=str)
def test_weights_on_a_straight_hanging_arm_are_attainable(kind, options):
    arm = {"antagonistic": ta.antagonistic_arm, "mckibben": ta.mckibben_arm}[kind]()
    weight = torch.linspace(0.0, 20.0, 21, dtype=D)
    loads = torch.stack((0 * weight, -weight, 0 * weight), -1)
    found = ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 0.0), loads), ("absolute", "relative"), **options)
    assert bool((found.absolute == 0).all())
    assert bool((found.relative == 0).all()), found.relative
    # what is more than rounding stays: a moment of a billionth of that
    pushed = loads + torch.tensor([1e-9, 0.0, 0.0], dtype=D)
    off = ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 0.0), pushed), ("absolute", "relative"), **options)
    assert bool((off.relative > 0).all())


# Studies and the command


STUDY = """
name = "trust"
[[arm]]
name = "muscle"
radii = [-0.052]
length = 0.5
actuators = ["mckibben"]
[[arm]]
name = "pair"
radii = [-0.08, 0.08]
length = 0.5
actuators = ["bellows", "bellows"]
[[task]]
name = "bent"
shape = { kind = "affine", slope = 1.43, intercept = -0.27, length = 0.439, nodes = 6 }
loads = [[-8.89, 6.93, 1.18]]
[[task]]
name = "coiled"
shape = { kind = "affine", slope = 0.0, intercept = 12.0 }
loads = [[0, -1, 0]]
[[task]]
name = "at rest"
twists = [[0.5, 0, 0], [0.5, 0, 0]]
loads = [[0, 0, 0]]
[evaluate]
metrics = ["predicted_error"]
"""


def test_a_study_counts_and_writes_only_what_can_be_trusted(tmp_path):
    results = list(evaluate_study(parse_study(STUDY)))
    verdicts = [result.verdicts[0] for result in results]
    assert verdicts[0] == "undecided"
    assert verdicts[2:4] == ["impossible", "impossible"] or verdicts[3] == "impossible"
    assert verdicts[5] == "held"
    assert "held" not in verdicts[:4]
    write_results(tmp_path / "out.csv", results)
    with (tmp_path / "out.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    first, coiled, last = rows[0], rows[3], rows[5]
    assert [first[name] for name in ("tip_error_mm", "pressure_1_kPa", "pressure_2_kPa")] == ["", "", ""]
    assert first["reason"].startswith("no stable equilibrium near the task's shape was found")
    assert "would have no length" in coiled["reason"]
    assert coiled["status"] == "impossible"
    assert last["reason"] == ""
    found = results[5].attainability.pressure[0].tolist()
    assert [float(last[name]) for name in ("pressure_1_kPa", "pressure_2_kPa")] == found


def test_the_command_says_what_is_impossible_and_asks_about_units(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    done = CliRunner().invoke(app, ["evaluate", str(path)], env={"COLUMNS": "300"})
    assert done.exit_code == 0, done.output
    assert "pair: actuator 2 would have no length at node 1" in done.stdout
    assert "impossible: an actuator would have no length." in done.stdout
    path.write_text(STUDY.replace("12.0", "90.0"), encoding="utf-8")
    refused = CliRunner().invoke(app, ["evaluate", str(path)], env={"COLUMNS": "300"})
    assert refused.exit_code == 2
    assert "are curvatures in degrees?" in refused.stderr


def test_trusted_predictions_agree_with_the_search():
    rows = [row for row in counted(range(ARMS)) if row.status in ("converged", "at a kink")]
    tasks = sum(row.tasks for row in rows)
    assert tasks > 0.6 * ARMS * EACH
    assert sum(row.prediction_larger + row.search_larger for row in rows) <= 0.01 * tasks
