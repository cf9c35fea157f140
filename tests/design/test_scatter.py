"""Built arms: how parameters are drawn, and what they change."""

import math

import pytest
import torch

import torcharm as ta
from torcharm.design.scatter import built_arms, normal_numbers, scattered

ARM = ta.antagonistic_arm()


def drawn(scatter, arm=ARM, count=4096, **options):
    sources = scatter.sources(arm)
    return sources, scattered(sources, normal_numbers(sources, count, 0, **options))


@pytest.mark.parametrize("quasi", [True, False])
@pytest.mark.parametrize(("kind", "factor"), [("normal", 1.0), ("uniform", 1 / math.sqrt(3))])
def test_samples_have_the_spread_and_the_correlation_that_was_asked_for(kind, factor, quasi):
    scatter = ta.Scatter(radii=1e-3, force=[0.01, 0.02, 0.03, 0.0], distribution=kind, correlated={"force": 0.6})
    (radii, force), (by_radii, by_force) = drawn(scatter, count=2**15, quasi=quasi)
    assert (radii.name, force.name) == ("radii", "force")
    for source, values in ((radii, by_radii), (force, by_force)):
        wanted = source.size * factor
        torch.testing.assert_close(values.std(0), wanted, rtol=0.02, atol=1e-9)
        torch.testing.assert_close(source.covariance.diagonal().sqrt(), wanted)
        sample = torch.cov(values.mT)
        assert float((sample - source.covariance).abs().max()) < 0.03 * float(source.covariance.max())
    alike = torch.corrcoef(by_force[:, :3].mT)[0, 1]
    assert abs(float(alike) - (0.6 if kind == "normal" else 6 / math.pi * math.asin(0.3))) < 0.02
    if kind == "uniform":
        assert float(by_radii.abs().max()) <= 1e-3


def test_full_correlation_moves_all_alike():
    _, (values,) = drawn(ta.Scatter(limits=1.0, correlated={"limits": 1.0}))
    torch.testing.assert_close(values, values[:, :1].expand_as(values))


def test_built_arms_differ_from_the_drawn_one_by_what_was_drawn():
    scatter = ta.Scatter(radii=1e-3, length=2e-3, limits=2.0, force=0.05, force_offset=0.1, bending=0.2)
    sources, values = drawn(scatter, count=16)
    by_name = dict(zip((source.name for source in sources), values, strict=True))
    built = built_arms(ARM, sources, values)
    assert built.batch_shape == (16,)
    torch.testing.assert_close(built.radii - ARM.radii, by_name["radii"])
    torch.testing.assert_close(built.length - ARM.length, by_name["length"])
    torch.testing.assert_close(built.max_pressure - ARM.max_pressure, by_name["limits"])
    torch.testing.assert_close(built.deviation.force_scale, 1 + by_name["force"])
    torch.testing.assert_close(built.deviation.bending_scale, 1 + by_name["bending"])
    torch.testing.assert_close(built.deviation.terms[0], by_name["force_offset"])
    assert built_arms(ARM, *drawn(ta.Scatter(radii=1e-3), count=4)).deviation is None


def test_in_space_and_in_series_each_segment_takes_its_own_part():
    lower = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=3), length=0.3, actuators="bellows")
    arm = ta.series([lower, ta.ArmDesign(offsets=ta.ring(radius=0.03, count=4), length=0.2, actuators="bellows")])
    sources, values = drawn(ta.Scatter(radii=1e-3, force=[0.01] * 3 + [0.02] * 4), arm, 64)
    by_radii, by_force = values
    assert by_radii.shape == (64, 14)
    built = built_arms(arm, sources, values)
    first, second = built.segments
    torch.testing.assert_close(second.radii - arm.segments[1].radii, by_radii[:, 3:7])
    torch.testing.assert_close(second.out_of_plane - arm.segments[1].out_of_plane, by_radii[:, 10:])
    torch.testing.assert_close(first.deviation.force_scale, 1 + by_force[:, :3])
    torch.testing.assert_close(second.deviation.force_scale, 1 + by_force[:, 3:])


def test_what_is_moulded_in_one_body_has_one_length_and_passive_limits_stay_zero():
    arm = ta.silicone_arm()
    sources, values = drawn(ta.Scatter(length=1e-3, limits=1.0), arm, 8)
    by_name = dict(zip((source.name for source in sources), values, strict=True))
    counts = [one.actuator_count for one in arm.segments]
    bodies = by_name["length"].split(counts, -1)
    assert all(bool((body == body[:, :1]).all()) for body in bodies)
    assert bool((bodies[0][:, 0] != bodies[1][:, 0]).all())
    built = built_arms(arm, sources, values)
    assert bool((arm.max_pressure == 0).any())
    assert bool((built.max_pressure[:, arm.max_pressure == 0] == 0).all())


def fitted_arm(share=0.02):
    generator = torch.Generator().manual_seed(0)
    strain = torch.rand(400, generator=generator, dtype=torch.float64) * 0.5 - 0.1
    pressure = torch.rand(400, generator=generator, dtype=torch.float64) * 50
    force = 0.9 * pressure - 12 * strain - 0.4 * strain * pressure
    force = force + share * force.abs().max() * torch.randn(400, generator=generator, dtype=torch.float64)
    model = ta.fit_force_model(strain, pressure, force, degree=2, correlated=1)
    return ta.ArmDesign(radii=[-0.04, 0.0, 0.04], length=0.4, actuators=[model, "mckibben", model])


def test_a_fitted_model_is_scattered_by_its_own_covariance_for_all_actuators_that_have_it():
    arm = fitted_arm()
    sources, values = drawn(ta.Scatter(model_covariance=True), arm, 2**14)
    (source,) = sources
    wanted = torch.tensor(arm.actuators[0].quality.covariance, dtype=torch.float64)
    torch.testing.assert_close(source.covariance, wanted, rtol=1e-9, atol=1e-12)
    scale = wanted.diagonal().sqrt()
    assert float(((torch.cov(values[0].mT) - wanted) / scale / scale.unsqueeze(-1)).abs().max()) < 0.05
    built = built_arms(arm, sources, values)
    assert built.deviation.powers[1:] == source.powers
    for term, own in zip(built.deviation.terms[1:], values[0].unbind(-1), strict=True):
        assert bool((term[:, 1] == 0).all())
        torch.testing.assert_close(term[:, 0], own)
        torch.testing.assert_close(term[:, 2], own)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "scatter: must have one of"),
        ({"radii": -1e-3}, "radii: must be a finite number and at least 0 m"),
        ({"radii": 1.0}, "radii: must be at most 0.1 m"),
        ({"force": 5.0}, r"force: must be at most 1 \(is it in percent"),
        ({"length": [1e-3, 2e-3]}, "length: must be one number, or one for each of 4 actuators"),
        ({"length": 0.09}, "length: must be below a sixth of the shortest"),
        ({"radii": 1e-3, "distribution": "even"}, "distribution: must be one of normal, uniform"),
        ({"radii": 1e-3, "correlated": {"radius": 0.5}}, "correlated: must be one of radii"),
        ({"radii": 1e-3, "correlated": {"radii": 1.5}}, "correlated.radii: must be from 0 to 1"),
        ({"model_covariance": True}, "model_covariance: must be False for arms without a fitted model"),
    ],
)
def test_what_makes_no_sense_is_refused_by_its_name(options, words):
    with pytest.raises(ValueError, match=words):
        ta.Scatter(**options).sources(ARM)


def test_an_arm_that_deviates_already_is_not_scattered_again():
    built = built_arms(ARM, *drawn(ta.Scatter(force=0.1), count=1))[0]
    with pytest.raises(ValueError, match="arm: must be as it was drawn"):
        ta.Scatter(force=0.1).sources(built)


def test_limits_of_an_arm_without_pressure_are_refused():
    arm = ta.ArmDesign([-0.03, 0.03], 0.3, "bellows", max_pressure=0.0)
    with pytest.raises(ValueError, match="limits: must be of actuators that are driven"):
        ta.Scatter(limits=1.0).sources(arm)


def test_a_correlation_of_what_is_not_scattered_is_refused():
    with pytest.raises(ValueError, match=r"correlated\.length: must be of what is scattered, got 1 with length=0"):
        ta.Scatter(radii=1e-3, correlated={"length": 1.0})
