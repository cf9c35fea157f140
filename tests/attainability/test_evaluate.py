"""What evaluation makes of distances: metrics, sums and margins over the nodes, ranges and dtypes."""

import numpy as np
import pytest
import torch
from hull_cases import attainable_scene, double, random_scene

import torcharm as ta

METRICS = ("absolute", "relative")
every_metric = pytest.mark.parametrize("metric", METRICS)


def test_a_metric_that_was_not_asked_for_is_none():
    scene = random_scene("antagonistic", designs=2, tasks=3, nodes=4)
    both, one = scene.evaluate(), scene.evaluate(metrics="relative")
    assert one.absolute is None
    assert one.absolute_per_node is None
    torch.testing.assert_close(one.relative, both.relative, rtol=1e-11, atol=1e-12)
    turned = scene.evaluate(metrics=("relative", "absolute"))
    torch.testing.assert_close(turned.absolute, both.absolute, rtol=1e-11, atol=1e-12)


# --- margins ---


@pytest.mark.parametrize("power", [1, 2])
def test_an_attainable_task_has_minus_its_smallest_margin(power):
    scene = attainable_scene(loads=1)
    result = scene.evaluate(signed=True, power=power)
    assert result.absolute_per_node.max() < 0
    assert result.absolute == -(result.absolute_per_node.abs().amin(-1) ** power)
    assert result.relative_per_node[0, 0] == 0
    assert result.relative_per_node[0, 1] < 0
    assert result.relative == -(result.relative_per_node[:, 1].abs() ** power)
    unsigned = scene.evaluate(power=power)
    assert unsigned.absolute == 0
    assert unsigned.relative == 0


@every_metric
def test_signed_is_negative_if_and_only_if_every_node_is_inside(metric):
    result = attainable_scene(loads=400, spread=[10.0, 10.0, 0.5]).evaluate(signed=True)
    total, per_node = getattr(result, metric), getattr(result, metric + "_per_node")
    free = per_node if metric == "absolute" else per_node[..., 1:]
    inside = (free < 0).all(-1)
    assert 20 < inside.sum() < 380
    assert torch.equal(total < 0, inside)
    torch.testing.assert_close(total[inside], free[inside].amax(-1))
    torch.testing.assert_close(total[~inside], per_node[~inside].clamp(min=0).sum(-1))


@every_metric
@torch.no_grad()
def test_signed_is_continuous_across_the_boundary(metric):
    scene = attainable_scene(loads=1)
    shares = torch.linspace(0, 1, 2001, dtype=torch.float64)[:, None]
    loads = scene.leaves["tip_load"] + shares * double([30.0, 40.0, 5.0])
    total = getattr(scene.evaluate({"tip_load": loads}, signed=True, metrics=metric), metric)
    assert total[0] < 0 < total[-1]
    required = ta.required_wrench(scene.leaves["twists"], loads)[..., [0, 2]]
    if metric == "relative":
        required = required - required[:, :1]
    steps = required.diff(dim=0).norm(dim=-1).sum(-1)  # no distance changes by more than its wrench moves
    assert torch.all(total.diff().abs() <= steps + 1e-12)


def test_one_node_has_no_relative_margin():
    result = random_scene("antagonistic", designs=1, tasks=5, nodes=1).evaluate(signed=True)
    assert torch.equal(result.relative, torch.zeros(1, 5, dtype=torch.float64))


# --- what to trust ---


@pytest.mark.parametrize("arm", [ta.bellows_arm(), ta.antagonistic_arm(), ta.mckibben_arm()])
def test_the_papers_validation_is_out_of_range(arm):
    result = ta.evaluate(arm, ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(2)), METRICS)
    assert not result.in_range.any()


def test_the_papers_inner_muscle_is_strained_four_per_cent_too_far():
    arm = ta.ArmDesign([-0.015, 0.015], 0.5, [ta.McKibben(), ta.McKibben()])
    result = ta.evaluate(arm, ta.Task(ta.affine_curvature(-3.0, 3.0), [[0.0, 0.0, 0.0]]), METRICS)
    np.testing.assert_allclose(result.strain_excess, [0.09 - 0.05], rtol=1e-12)
    assert not result.in_range.any()


@pytest.mark.parametrize(
    ("length", "excess"),
    [(0.5, 0.0), (0.5 * 1.668, 0.0), (0.5 * (1 - 0.167), 0.0), (0.5 * 1.768, 0.1), (0.5 * 0.733, 0.1)],
)
def test_strain_excess_is_the_largest_strain_beyond_the_range(length, excess):
    arm = ta.ArmDesign([-0.01, 0.01], 0.5, [ta.Bellows(), ta.Bellows()])
    twists = double([[0.5, 0.0, 0.0], [length, 0.0, 0.0]])
    result = ta.evaluate(arm, ta.Task(twists, [[0.0, 1.0, 0.0]]), METRICS)
    np.testing.assert_allclose(result.strain_excess, [excess], atol=1e-15)
    assert result.in_range.tolist() == [excess == 0.0]


def test_range_is_judged_for_every_design_and_shape():
    arm = ta.ArmDesign(double([[-0.01, 0.01], [-0.1, 0.1]]), 0.5, [ta.Bellows(), ta.Bellows()])
    twists = torch.stack([ta.affine_curvature(0.0, turn, nodes=3) for turn in (0.0, 1.0, 9.0)])[:, None]
    result = ta.evaluate(arm, ta.Task(twists, ta.sample_loads(2)), METRICS)
    expected = [[True, True, False], [True, False, False]]  # strains of r κ / l̂ against -0.167
    assert result.in_range.tolist() == [[[each] * 2 for each in row] for row in expected]
    np.testing.assert_allclose(result.strain_excess[1, 1], 0.2 - 0.167)


@pytest.mark.parametrize(("limit", "in_range"), [(92.0, True), (92.5, False)])
def test_a_pressure_limit_beyond_the_characterisation_is_out_of_range(limit, in_range):
    arm = ta.ArmDesign([-0.01, 0.01], 0.5, [ta.Bellows(), ta.Bellows()], [limit, 10.0])
    result = ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 0.0), [[0.0, 1.0, 0.0]]), METRICS)
    assert result.in_range.tolist() == [in_range]
    assert result.strain_excess.tolist() == [0.0]


# --- dtype ---


def in_both_precisions(**options):
    """Six designs on twelve tasks in single and in double precision; of each its leaves and what was found."""
    scene = random_scene("antagonistic", designs=6, tasks=12, nodes=4)
    for dtype in (torch.float32, torch.float64):
        leaves = {name: leaf.to(dtype).requires_grad_() for name, leaf in scene.leaves.items()}
        yield leaves, scene.evaluate(leaves, **options)


@pytest.mark.parametrize("options", [{"signed": True}, {"hull": "edges"}])
def test_float32_stays_float32_and_near_float64(options):
    (_, single), (_, exact) = in_both_precisions(**options)
    for field in (*METRICS, "absolute_per_node", "relative_per_node", "strain_excess"):
        value = getattr(single, field)
        assert value.dtype == torch.float32
        assert (value.double() - getattr(exact, field)).abs().max() < 1e-3
    assert torch.equal(single.in_range, exact.in_range)


def test_float32_gradients_are_near_those_of_float64():
    gradients = []
    for leaves, found in in_both_precisions():
        gradients.append(torch.autograd.grad((found.absolute + found.relative).sum(), list(leaves.values())))
    for single, exact in zip(*gradients, strict=True):
        assert single.dtype == torch.float32
        assert (single.double() - exact).norm() < 5e-3 * exact.norm()
