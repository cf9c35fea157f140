"""Distances and margins against the experiment's other algorithm: curves sampled densely, NNLS, Qhull, longdouble."""

import numpy as np
import pytest
import torch
from oracle import box_points
from scipy.spatial import ConvexHull

from experiments.exactness.models import PAIRS
from experiments.exactness.problems import FAMILIES, make
from experiments.exactness.reference import distances, support
from experiments.exactness.run import PROMISE, answers, compare, family_of
from torcharm.wrench_sets.distance import find_nearest

FEW = 6
SEEDS = (1, 3, *range(0, 2 * len(FAMILIES) - 2, 2))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", SEEDS)
def test_answers_are_right_or_flagged_on_random_problems(dimension, seed):
    row = compare((dimension, seed, FEW))
    assert row.wrong == 0
    assert row.worst <= PROMISE
    assert row.bounds_apart <= PROMISE / 2  # the reference knows it well enough to say so
    assert row.gradients_not_finite == 0
    assert row.worst_margin <= PROMISE
    assert row.flagged == 0 or row.family == "nonsense"


def test_the_seeds_above_cover_all_families():
    assert {family_of(seed) for seed in SEEDS} == set(FAMILIES)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_other_algorithm_sees_a_distance_that_is_wrong(dimension):
    problems = make("ordinary", dimension, FEW, np.random.default_rng(0), ("bellows", "muscle", "quintic"))
    low, high, size = distances(problems.sets)
    _, value, _ = answers(problems)
    off = value + 3e-6 * size
    assert (np.maximum(low - off, off - high) > PROMISE * size).all()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", ["bellows", "muscle", "gridded"])
def test_signed_distances_are_those_to_the_facets_of_all_sums_of_samples(dimension, name):
    """The hull of samples lies within the set, and by the square of a sample's distance only."""
    samples, actuators = (33, 3) if dimension == 2 else (17, 3)
    problems = make("ordinary", dimension, FEW, np.random.default_rng(7), (name,) * actuators)
    sets = problems.sets
    found = find_nearest(
        problems.sections, problems.required, (1.0, 1.0), relative=problems.relative, signed=True, points=False
    )
    value = found.distance[:, 0, 0, -1].numpy()
    for b in range(FEW):
        one = sets.those(np.array([b]))
        curves = []
        for a in range(actuators):
            p = np.concatenate(
                (one.limit[:, a, None] * np.linspace(0, 1, samples), np.array(one.kinks(a)).reshape(1, -1)), -1
            )
            curves.append(one.force(a, p)[0, :, None] * one.lever[0, a] + p[0, :, None] * one.bending[0, a])
        points = sums(curves)
        facets = ConvexHull(points).equations
        size = np.linalg.norm(points - sets.target[b], axis=-1).max()
        depth = -(facets[:, :-1] @ sets.target[b] + facets[:, -1]).max()
        if depth > 0:
            assert depth <= -value[b] + 1e-9 * size
            assert -value[b] <= depth + 2e-3 * size
        else:
            assert value[b] > -2e-3 * size


def sums(curves):
    points = np.zeros((1, curves[0].shape[-1]))
    for curve in curves:
        points = (points[:, None] + curve).reshape(-1, curve.shape[-1])
    return points


def test_sums_are_those_of_the_oracle():
    table = np.random.default_rng(0).normal(size=(3, 4, 2))
    assert (np.sort(sums(table), 0) == np.sort(box_points(table), 0)).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_points_of_the_boundary_are_at_no_distance(dimension):
    generator = np.random.default_rng(3)
    problems = make("ordinary", dimension, 200, generator, tuple(name for name in PAIRS if name != "kinked"))
    normal = generator.normal(size=problems.sets.target.shape)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    point = problems.sets.target + support(problems.sets, normal)[1].astype(float)
    problems.required[:, 0, 0, -1] = torch.from_numpy(point)
    _, value, _ = answers(problems)
    size = np.abs(point).sum(-1) + np.abs(support(problems.sets, -normal)[0]).astype(float)
    assert (value <= 1e-7 * size).all()
