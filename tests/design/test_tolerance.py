"""What built arms do: yields, percentiles and slopes against plain samples and finite differences."""

import dataclasses
import math
import pickle
import sys

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.design.scatter import built_arms, normal_numbers, scattered
from torcharm.design.sensitivity import tip_places, tip_slopes
from torcharm.design.tolerance_result import Yield
from torcharm.pressure.at_pressure import error_at_pressure

ARM = ta.antagonistic_arm()
TASK = ta.Task(ta.affine_curvature(0.5, 0.5, length=0.5), ta.sample_loads(2, (2, 2, 0.2)))
LOOSE = ta.PoseTolerance(tip=0.015, rotation=math.radians(10), shape=0.015)
ENDS = 2e-9
"""How close [m] descents end at a minimum, at most: what differences of their tips are good to."""
SPREAD = {"radii": 1e-3, "length": 2e-3, "force": 0.05}


def spatial_arm():
    lower = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=4), length=0.3, actuators=["bellows", "mckibben"] * 2)
    return ta.series(
        [lower, ta.RigidLink(length=0.02), ta.ArmDesign(offsets=ta.ring(0.04, 3), length=0.2, actuators="bellows")]
    )


def spatial_task():
    shape = torch.tensor([[0.31, 0, 0, 0, 0.1, 0.2]] * 3 + [[0.21, 0, 0, 0, -0.05, 0.1]] * 3, dtype=torch.float64)
    return ta.Task(shape, [[0.2, -0.5, 0.1, 0, 0, 0], [0.0, -1.0, 0.0, 0, 0, 0.0]], segment_nodes=[3, 3])


@pytest.mark.parametrize(("arm", "task"), [(ARM, TASK), (spatial_arm(), spatial_task())], ids=["plane", "space"])
def test_kept_pressures_lead_where_the_forward_mechanics_say(arm, task):
    result = ta.tolerance(arm, task, **SPREAD, samples=8, seed=3)
    sources = ta.Scatter(**SPREAD).sources(arm)
    values = scattered(sources, normal_numbers(sources, 8, 3))
    beside = built_arms(arm, sources, [value.unsqueeze(1) for value in values])
    pressure = ta.predict_error(arm, task).pressure
    found = ta.solve_equilibrium(beside, pressure, task.load, task.segment_nodes or task.nodes)
    assert bool(found.continued.all())
    links = [link and link.end(3) for link in arm.links] if isinstance(arm, ta.ArmSeries) else None
    wanted = ta.poses(task.twists, task.base_pose, segment_nodes=task.segment_nodes, links=links)
    tip, goal = found.poses[..., -1, :2], wanted[..., -1, :2]
    if arm.dimension == 3:
        tip, goal = found.poses[..., -1, :3, 3], wanted[..., -1, :3, 3]
    torch.testing.assert_close(result.tip_error, (tip - goal).norm(dim=-1), rtol=0, atol=1e-9)
    apart = result.tip - result.tip[:1]
    torch.testing.assert_close(apart.norm(dim=-1), (tip - tip[:1]).norm(dim=-1), rtol=0, atol=1e-9)


def test_compensated_arms_are_evaluated_as_any_arm_is():
    result = ta.tolerance(ARM, TASK, **SPREAD, samples=8, seed=3, compensated=True, tolerance=LOOSE, margin=True)
    sources = ta.Scatter(**SPREAD).sources(ARM)
    built = built_arms(ARM, sources, scattered(sources, normal_numbers(sources, 8, 3)))
    found = ta.evaluate(built, TASK, ("absolute", "predicted_error"), tolerance=LOOSE, signed=True)
    torch.testing.assert_close(result.tip_error, found.tip_error)
    torch.testing.assert_close(result.margin, found.capacity_margin)
    assert result.verdict.tolist() == found.verdict.tolist()
    assert bool((result.within == torch.from_numpy(found.verdict == "held")).all())


@pytest.mark.parametrize(("compensated", "plain", "quasi"), [(False, 4000, 1024), (True, 400, 256)])
def test_yields_are_those_of_plain_samples_within_their_confidence(compensated, plain, quasi):
    sources = ta.Scatter(**SPREAD).sources(ARM)
    built = built_arms(ARM, sources, scattered(sources, normal_numbers(sources, plain, 1, quasi=False)))
    if compensated:
        found = ta.predict_error(built, TASK)
    else:
        found = error_at_pressure(built, TASK, ta.predict_error(ARM, TASK).pressure)
    most = float(found.tip_error[:, 0].quantile(0.6))
    options = {"compensated": compensated, "tolerance": ta.PoseTolerance(tip=most, rotation=1.0, shape=1.0)}
    result = ta.tolerance(ARM, TASK, **SPREAD, **options, samples=quasi)
    for own, other in zip(result.within.unbind(-1), (found.tip_error <= most).unbind(-1), strict=True):
        one, reference = Yield.of(own, 0.999), Yield.of(other, 0.999)
        assert max(one.low, reference.low) <= min(one.high, reference.high)
    assert 0.5 < result.yields[0].value < 0.7
    torch.testing.assert_close(result.percentiles([50])[0], found.tip_error.quantile(0.5, dim=0), rtol=0.1, atol=0)


@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize(("arm", "task"), [(ARM, TASK), (spatial_arm(), spatial_task())], ids=["plane", "space"])
def test_slopes_are_those_of_finite_differences(arm, task, compensated):
    scatter = ta.Scatter(**SPREAD, force_offset=0.1, bending=0.1, limits=1.0)
    sources = scatter.sources(arm)
    drawn = ta.predict_error(arm, task)
    slopes = tip_slopes(arm, task, sources, drawn, None, compensated=compensated)
    sizes = [len(source.size) for source in sources]
    step = {"radii": 1e-5, "length": 1e-5, "limits": 1e-3, "force": 1e-4, "force_offset": 1e-3, "bending": 1e-3}
    compared = 0
    for g, source in enumerate(sources):
        for k in range(0, sizes[g], 3):
            moves = [torch.zeros(2, size, dtype=torch.float64) for size in sizes]
            moves[g][:, k] = torch.tensor([1.0, -1.0]) * step[source.name]
            built = built_arms(arm, sources, moves)
            found = ta.predict_error(built, task) if compensated else error_at_pressure(built, task, drawn.pressure)
            ahead, behind = (tip_places(found.pose_errors)[side] - tip_places(drawn.pose_errors) for side in (0, 1))
            numeric = (ahead - behind) / (2 * step[source.name])
            smooth = (ahead + behind).abs().amax(-1) <= 0.05 * (ahead - behind).abs().amax(-1) + 1e-9
            smooth &= drawn.converged & found.converged.all(0)
            exact = slopes[g][..., k]
            allowed = 2e-2 * slopes[g].abs().amax((-2, -1)) + ENDS / step[source.name]
            assert bool(((numeric - exact).abs().amax(-1) <= allowed)[smooth].all()), (source.name, k)
            compared += int(smooth.sum())
    assert compared > 10


def test_gradients_and_samples_agree_where_the_tip_moves_in_proportion():
    result = ta.tolerance(ARM, TASK, radii=1e-4, length=2e-4, force=0.005, samples=512)
    torch.testing.assert_close(result.deviation_by_gradient, result.deviation_by_samples, rtol=0.02, atol=0)
    for name, share in result.shares.items():
        assert abs(share - result.shares_by_samples[name]) < 0.03
    assert sum(result.shares.values()) == pytest.approx(1.0)
    assert bool((result.explained > 0.99).all())
    assert result.decisive == max(result.shares, key=result.shares.get)
    assert "linear" in result.agreement
    assert "only part" not in result.agreement
    assert result.sensitivity("radii").shape == (2, 4)


@pytest.mark.parametrize("after", [1, 2, 3])
def test_an_interrupted_run_is_that_of_fewer_built_arms(monkeypatch, after):
    monkeypatch.setattr(sys.modules["torcharm.design.tolerance"], "AT_ONCE", 32)  # 16 built arms

    def callback(done, _):
        if done == 16 * after:  # as Ctrl-C, once
            raise KeyboardInterrupt

    whole = ta.tolerance(ARM, TASK, radii=1e-3, force=0.05, samples=64)
    found = ta.tolerance(ARM, TASK, radii=1e-3, force=0.05, samples=64, callback=callback)
    count = 16 * after
    assert found.stopped == "interrupted"
    assert f"interrupted: {count} of 64 built arms" in repr(found)
    torch.testing.assert_close(found.tip_error, whole.tip_error[:count])
    assert found.yields[0] == Yield.of(whole.within[:count, 0])


def test_what_fails_is_counted_for_each_criterion():
    result = ta.tolerance(ARM, TASK, **SPREAD, samples=64)
    built = built_arms(ARM, *(lambda s: (s, scattered(s, normal_numbers(s, 64, 0))))(ta.Scatter(**SPREAD).sources(ARM)))
    found = error_at_pressure(built, TASK, ta.predict_error(ARM, TASK).pressure)
    most = {"tip": 0.01, "turn": math.radians(5), "shape": 0.01}
    errors = {"tip": found.tip_error, "turn": found.tip_rotation_error, "shape": found.shape_error}
    counts = {name: int((errors[name] > most[name]).sum()) for name in most}
    for name, count in counts.items():
        assert f"{name} {count}" in result.failing
    first = max(counts, key=counts.get)
    assert result.failing.startswith(f"{first} {counts[first]} of 128")
    assert f"not within tolerance: {result.failing}" in repr(result)
    assert result.to_dict()["failed_shape"] == (found.shape_error > 0.01).double().mean(0).tolist()


def test_margins_of_scattered_coefficients_are_refused():
    with pytest.raises(ValueError, match="margin: must be False with model_covariance"):
        ta.tolerance(ARM, TASK, model_covariance=True, margin=True)


def test_where_no_shape_is_stable_nothing_is_told_to_decide():
    coiled = ta.Task(ta.affine_curvature(0.0, 9.0, length=0.5), [0.0, 0.0, 0.0])
    result = ta.tolerance(ARM, coiled, **SPREAD, samples=8)
    assert (result.decisive, result.yield_of_all.value) == ("", 0.0)
    assert bool(result.percentiles().isinf().all())
    assert "no task has a stable shape" in result.agreement
    assert result.failing == "no stable shape 8 of 8"
    assert "decides" not in repr(result)


def test_slopes_of_an_arm_that_never_has_a_stable_shape_decide_nothing():
    result = ta.tolerance(ARM, TASK, **SPREAD, samples=8)
    assert result.decisive
    never = {"tip_error": torch.full_like(result.tip_error, math.inf), "tip": torch.full_like(result.tip, math.nan)}
    lost = dataclasses.replace(result, **never)
    assert lost.decisive == ""
    assert all(math.isnan(share) for share in lost.shares.values())


def test_of_few_samples_no_fit_is_told():
    result = ta.tolerance(ARM, TASK, **SPREAD, samples=4)
    assert all(math.isnan(share) for share in result.shares_by_samples.values())
    assert "too few samples" in result.agreement


def test_a_calibrated_controller_reaches_more_than_kept_pressures():
    kept, found = (ta.tolerance(ARM, TASK, **SPREAD, samples=64, compensated=flag) for flag in (False, True))
    assert bool((found.percentiles([95]) < 0.5 * kept.percentiles([95])).all())


def test_percentiles_are_ordered_and_infinite_where_arms_have_no_shape():
    result = ta.tolerance(ARM, TASK, **SPREAD, samples=100)
    low, middle, high = result.percentiles((5, 50, 95))
    assert bool((low < middle).all() & (middle < high).all())
    torch.testing.assert_close(result.percentiles([100])[0], result.tip_error.amax(0))
    assert int((result.tip_error[:, 0] <= middle[0]).sum()) == 50
    lost = ta.BuiltArms(**{**vars(result), "tip_error": torch.full_like(result.tip_error, torch.inf)})
    assert bool(lost.percentiles().isinf().all())


def test_lists_of_tasks_and_chunks_change_nothing(monkeypatch):
    module = sys.modules["torcharm.design.tolerance"]
    whole = ta.tolerance(ARM, TASK, **SPREAD, samples=20)
    told = []
    monkeypatch.setattr(module, "AT_ONCE", 12)
    tasks = [ta.Task(TASK.twists, TASK.tip_load[:1]), ta.Task(TASK.twists, TASK.tip_load[1])]
    parts = ta.tolerance(ARM, tasks, **SPREAD, samples=20, callback=lambda done, total: told.append((done, total)))
    torch.testing.assert_close(parts.tip_error, whole.tip_error, rtol=0, atol=1e-12)
    torch.testing.assert_close(parts.variance_by_gradient, whole.variance_by_gradient)
    assert told == [(6, 20), (12, 20), (18, 20), (20, 20)]


def test_a_fitted_model_scatters_the_tip_by_what_its_covariance_predicts():
    generator = torch.Generator().manual_seed(0)
    strain = torch.rand(300, generator=generator, dtype=torch.float64) * 0.5 - 0.1
    pressure = torch.rand(300, generator=generator, dtype=torch.float64) * 50
    noise = torch.randn(300, generator=generator, dtype=torch.float64)
    force = 0.9 * pressure - 12 * strain - 0.4 * strain * pressure + 0.5 * noise
    model = ta.fit_force_model(strain, pressure, force, degree=2, correlated=1)
    arm = ta.ArmDesign(radii=[-0.04, 0.0, 0.04], length=0.4, actuators=[model, "mckibben", model])
    task = ta.Task(ta.affine_curvature(0.2, 0.2, length=0.45), [0.5, -0.5, 0.0])
    result = ta.tolerance(arm, task, model_covariance=True, samples=256)
    coefficients = ta.coefficient_tensor(model)
    own = ta.TensorPolynomial(model, coefficients)
    other = ta.ArmDesign(radii=[-0.04, 0.0, 0.04], length=0.4, actuators=[own, "mckibben", own])
    found = ta.solve_equilibrium(other, ta.predict_error(arm, task).pressure, task.load, task.nodes)
    place = found.poses[-1, :2]
    spread = ta.standard_deviation(place, coefficients, model.quality.covariance)
    torch.testing.assert_close(result.deviation_by_gradient[0], spread.norm(), rtol=1e-6, atol=0)
    torch.testing.assert_close(result.deviation_by_samples[0], spread.norm(), rtol=0.05, atol=0)
    assert result.shares == {"model": pytest.approx(1.0)}


def test_bounds_of_yields_are_those_of_clopper_and_pearson():
    from scipy.stats import beta

    found = Yield.of(torch.arange(50) < 40)
    assert (found.count, found.samples, found.value) == (40, 50, 0.8)
    assert found.low == pytest.approx(beta.ppf(0.025, 40, 11))
    assert found.high == pytest.approx(beta.ppf(0.975, 41, 10))
    assert str(found).startswith("80.0 % (66")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"samples": 1}, "samples: must be an integer of at least 2"),
        ({"seed": -1}, "seed: must be an integer of at least 0"),
        ({"tolerance": -0.1}, "tolerance: must be a finite number and above 0"),
    ],
)
def test_what_makes_no_sense_is_refused(options, words):
    with pytest.raises(ValueError, match=words):
        ta.tolerance(ARM, TASK, radii=1e-3, **options)


def test_a_batch_of_designs_is_refused():
    with pytest.raises(ValueError, match=r"arm: must be one ArmDesign or ArmSeries, as arm\[0\]"):
        ta.tolerance(ta.antagonistic_arm(outer_radius=torch.tensor([0.05, 0.06])), TASK, radii=1e-3)


def test_results_survive_pickle_and_move_to_another_dtype():
    result = ta.tolerance(ARM, TASK, **SPREAD, samples=8)
    again = pickle.loads(pickle.dumps(result))
    torch.testing.assert_close(again.tip_error, result.tip_error)
    assert again.scatter == result.scatter
    assert result.to(torch.float32).tip_error.dtype == torch.float32
    assert result.to(torch.float32).within.dtype == torch.bool
    built = built_arms(ARM, *(lambda s: (s, scattered(s, normal_numbers(s, 2, 0))))(ta.Scatter(force=0.1).sources(ARM)))
    torch.testing.assert_close(pickle.loads(pickle.dumps(built)).deviation.force_scale, built.deviation.force_scale)


def test_columns_and_words():
    result = ta.tolerance(ARM, TASK, **SPREAD, samples=64)
    columns = result.to_dict()
    assert columns["task"] == [0, 1]
    assert np.allclose(columns["tip_error_p50"], result.percentiles([50])[0])
    assert sum(columns[f"share_{name}"][0] for name in SPREAD) == pytest.approx(1.0)
    assert repr(result).startswith("BuiltArms(64 arms on 2 tasks, yield ")
