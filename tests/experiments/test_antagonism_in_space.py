"""The tasks turn as they should, and what is said of sets and ranks is what is known by hand."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull

import torcharm as ta
from experiments.antagonism_in_space import scenes
from experiments.antagonism_in_space.claims import (
    OUTSIDE,
    WAYS,
    convexity,
    curve_sums,
    edges_fall_short,
    nearest,
)
from experiments.antagonism_in_space.hulls import hulls, moment_range
from experiments.antagonism_in_space.rows import pairs_in_order
from experiments.hull_gallery.search import FINE, CurveSum

U = np.linspace(0.0, 1.0, FINE)
CHORD, BULGE = np.array([10.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def bent(*heights, chord=CHORD, up=BULGE):
    """Curves along one chord that bulge by these heights in the middle."""
    curves = [U[:, None] * chord + (4 * height * U * (1 - U))[:, None] * up for height in heights]
    return CurveSum(np.stack(curves), True, True)


def test_forces_are_unit_vectors_and_the_hanging_weight_hangs_at_every_bend():
    ways = scenes.force_ways()
    assert len(ways) == 14
    assert torch.stack(list(ways.values())).norm(dim=-1).allclose(torch.ones(14, dtype=torch.float64))
    tip = scenes.tasks(0.0, 5).load.tip
    down = tip[:, list(ways).index("down")]
    assert down.allclose(torch.tensor([0.0, -scenes.FORCE, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64).expand(5, 6))


def test_a_force_towards_the_bend_points_to_where_the_shape_goes():
    task = scenes.tasks(0.0, 7)
    toward = task.load.tip[:, list(scenes.force_ways()).index("towards the bend"), :3]
    aside = ta.poses(task.twists[:, 0])[:, -1, :3, 3] * torch.tensor([1.0, 0.0, 1.0], dtype=torch.float64)
    assert torch.linalg.cross(toward, aside).norm(dim=-1).max() < 1e-12
    assert bool(((toward * aside).sum(-1) > 0).all())


@pytest.mark.parametrize("name", scenes.arms())
def test_arms_of_threefold_symmetry_lack_alike_at_sides_120_degrees_apart(name):
    found = ta.evaluate(scenes.arms()[name], scenes.tasks(-0.06, 12), ("absolute", "relative"))
    for value in (found.absolute, found.relative):
        torch.testing.assert_close(value[:4], value[4:8], rtol=1e-9, atol=1e-9)
        if scenes.kind_of(name) == "antagonistic":
            assert (value[0] - value[1]).abs().max() > 1e-4, "sides 30° apart are not alike"


def test_arms_are_of_equal_size():
    for arm in scenes.arms().values():
        assert float(arm.offsets.norm(dim=-1).max()) == pytest.approx(scenes.OUTER)
        assert arm.actuator_count in (6, 9)


def test_the_middle_of_a_bent_curve_s_ends_is_outside_by_its_bulge():
    sums = bent(0.3)
    away = nearest(sums, np.array([[5.0, 0.0, 0.0]]), np.full((1, 4, 1), 0.3))
    assert away == pytest.approx(0.3, abs=1e-5)
    size, found = convexity(sums)
    assert size == pytest.approx(10.0)
    assert set(np.round(found, 4)) == {0.0, 0.3}


def test_two_curves_that_bulge_apart_fill_their_hull_and_straight_ones_too():
    apart = CurveSum(np.concatenate((bent(0.3).curves, bent(-0.3).curves)), True, True)
    straight = CurveSum(np.stack([U[:, None] * np.eye(3)[k] for k in range(3)]), True, True)
    for sums in (apart, straight):
        size, away = convexity(sums)
        assert away.max() < OUTSIDE * size


def test_half_sums_of_three_bellows_against_trying_all_pressures():
    twists = scenes.tasks(0.12, 1).twists[0, 0]
    sums = curve_sums(scenes.three_bellows(), twists, relative=True)[9]
    size, away = convexity(sums)
    ends = np.random.default_rng(0).integers(0, 2, (2, len(away), 3)).astype(float)
    goals = 0.5 * (sums.at(ends[0]) + sums.at(ends[1]))
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 61)] * 3, indexing="ij"), -1).reshape(-1, 3)
    points = sums.at(grid)
    brute = np.array([np.linalg.norm(points - goal, axis=1).min() for goal in goals])
    step = np.linalg.norm(sums.slopes(grid), axis=-1).sum(-1).max() / 120
    assert away.max() > 0.02 * size
    assert bool((away <= brute + 1e-9).all())
    assert bool((away >= brute - step).all())


def test_edges_miss_what_parallel_curves_add_together():
    assert edges_fall_short(bent(0.3), FINE) == pytest.approx(0.0, abs=1e-12)
    assert edges_fall_short(bent(0.3, 0.2), FINE) == pytest.approx(0.2, rel=1e-2)
    assert edges_fall_short(bent(0.3, 0.2), 3) == pytest.approx(0.2, rel=1e-2)  # the middle is a sample


def test_edges_fall_short_by_as_much_as_the_library_s_own_edges():
    arm, twists = scenes.arms()["6 muscles on the outer ring"], scenes.tasks(-0.12, 1).twists[0, 0]
    own = edges_fall_short(curve_sums(arm, twists, relative=False)[0], 3)
    edges = ta.wrench_hulls(arm, twists, hull="edges", samples=3).vertices[0].numpy()
    exact = ta.wrench_hulls(arm, twists).vertices[0].numpy()
    step = np.arange(8 * WAYS)
    height = 1 - 2 * (step + 0.5) / len(step)
    turn = step * math.pi * (3 - 5**0.5)
    way = np.stack((height, np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn)), -1)
    way = way / np.ptp(exact, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    gap = ((exact @ way.T).max(0) - (edges @ way.T).max(0)).max()
    assert own == pytest.approx(gap, rel=0.05)
    assert ConvexHull(exact).volume > ConvexHull(edges).volume


def test_moments_at_a_force_of_a_box_and_of_a_pyramid():
    box = np.array([(f, y, z) for f in (-1.0, 3.0) for y in (-2.0, 2.0) for z in (-0.5, 0.5)])
    assert moment_range(box, 0.4) == pytest.approx(1.0)
    assert moment_range(box, 3.5) == 0.0
    pyramid = np.concatenate((box[:4], [[3.0, 0.0, 0.0]]))  # its base at -1, its top at 3
    assert moment_range(pyramid, 1.0) == pytest.approx(0.5)


def test_weight_asks_the_base_for_all_of_its_pull():
    arm, task = scenes.arms()["6 bellows on the outer ring"], scenes.tasks(0.12, 1)
    down = list(scenes.force_ways()).index("down")
    load = ta.ExternalLoad(tip=task.load.tip[0, down], gravity=True)
    (found,) = hulls("", arm, task.twists[0, 0], load, 0.0, [0])
    # The first element's middle is tilted by a twentieth of its curvature; a twentieth of the arm hangs before it.
    pull = scenes.FORCE + 0.95 * 9.81 * scenes.MASS
    assert found.required == pytest.approx(-pull * math.cos(scenes.BEND[1] / 20), rel=1e-9)
    assert found.force_min < found.required < found.force_max


def test_pairs_in_order():
    assert pairs_in_order([1.0, 2.0, 3.0], [10.0, 30.0, 20.0]) == pytest.approx(2 / 3)
    assert pairs_in_order([1.0, 1.0, 2.0], [5.0, 6.0, 7.0]) == 1.0  # equal ones make no pair
    assert math.isnan(pairs_in_order([0.0, 0.0], [1.0, 2.0]))
