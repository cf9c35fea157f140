"""Cubic pieces of pressure curves, and where they reach furthest, against the equations of the forces."""

import numpy as np
import pytest
import torch

import torcharm as ta
from experiments.exactness.models import PAIRS, QUINTIC, KinkedModel, SmoothModel, kinked, mckibben, polynomial, smooth
from torcharm.engine.compilation import kernel
from torcharm.engine.curves import (
    HIGH_DEGREE_PIECES,
    MUSCLE_PIECES,
    copy_curve,
    furthest,
    make_curves,
    sides,
    write_curve,
    write_difference,
)
from torcharm.engine.forces import models_of
from torcharm.wrench_sets.curves import ACCURACY, MOST_PIECES, sample_pieces


@kernel
def reach(strain, first, limit, by_force, by_pressure, relative, own, other, change, found):
    """The pressures, forces and falls (B, 3) of B curves of one actuator."""
    for b in range(len(strain)):
        write_curve(own, 0, strain[b], limit, own.control[0, :0])
        write_curve(other, 0, first[b], limit, own.control[0, :0])
        if relative:
            write_difference(change, 0, own, other)
        else:
            copy_curve(change, 0, own)
        change.side[0] = sides(change, 0)
        p, f, fall = furthest(change, 0, by_force[b], by_pressure[b])
        found[b, 0], found[b, 1], found[b, 2] = p, f, fall


def hermite(pieces, count=33):
    """Pressures and the cubics' forces (..., K, count) of pieces (..., K, 6)."""
    begin, end, force, slope, force_end, slope_end = (column[..., None] for column in np.moveaxis(pieces, -1, 0))
    t = np.linspace(0, 1, count)
    s, span = 1 - t, end - begin
    value = s * s * (1 + 2 * t) * force + t * t * (3 - 2 * t) * force_end
    return begin + t * span, value + s * t * span * (s * slope - t * slope_end)


@pytest.mark.parametrize(
    ("model", "force", "strains", "limit"),
    [
        *((pair.actuator, pair.model.force, pair.strains, pair.limit) for pair in (make() for make in PAIRS.values())),
        (ta.McKibben(), mckibben().force, (0.0, 1e-3), 100.0),
        (ta.McKibben(), mckibben().force, (0.05, 0.3), 100.0),
        (ta.Bellows(), PAIRS["bellows"]().model.force, (-0.9, 3.0), 300.0),
        (ta.PolynomialActuator(QUINTIC, (-1, 1), (0, 99), 99.0), polynomial(QUINTIC).force, (-0.9, 0.9), 99.0),
        (SmoothModel(), smooth().force, (-0.9, 0.9), 150.0),
        (KinkedModel(), kinked().force, (-0.9, 0.9), 150.0),
    ],
)
def test_sampled_pieces_are_good_to_what_they_promise(model, force, strains, limit):
    strain = torch.linspace(*strains, 301, dtype=torch.float64)
    pieces = sample_pieces(model, strain, torch.full_like(strain, limit)).numpy()
    pressure, value = hermite(pieces)
    true = force(strain.numpy()[:, None, None], pressure)
    largest = np.abs(true).max((1, 2))
    off = np.abs(value - true).max((1, 2))
    assert (off <= 1.5 * ACCURACY * np.maximum(largest, np.median(largest))).all()
    assert pieces.shape[-2] <= MOST_PIECES + 1
    assert (pieces[:, 0, 0] == 0).all()
    assert (pieces[:, -1, 1] == limit).all()


def test_no_limit_and_strains_of_nonsense_do_not_spoil_the_pieces_of_others():
    strain = torch.linspace(-0.2, 0.2, 50, dtype=torch.float64)
    spoilt = torch.cat((strain, strain.new_tensor((1e8, -1e8))))
    pieces = sample_pieces(SmoothModel(), spoilt, torch.full_like(spoilt, 60.0)).numpy()[:50]
    pressure, value = hermite(pieces)
    true = smooth().force(strain.numpy()[:, None, None], pressure)
    assert np.abs(value - true).max() <= 2 * ACCURACY * np.abs(true).max()
    nothing = sample_pieces(SmoothModel(), strain, torch.zeros_like(strain)).numpy()
    assert (nothing[..., :2] == 0).all()
    assert np.isfinite(nothing).all()


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize(
    ("actuator", "model", "strains", "limit"),
    [
        (ta.Bellows(), PAIRS["bellows"]().model, (-0.16, 0.66), 50.0),
        (PAIRS["quintic"]().actuator, PAIRS["quintic"]().model, (-0.3, 0.3), 60.0),
        (ta.McKibben(), mckibben(), (-0.5, 0.05), 100.0),
        (ta.McKibben(force_scale=2.0), mckibben(2.0), (0.0, 0.3), 100.0),
        (ta.McKibben(), mckibben(), (-1e-3, 1e-3), 100.0),
    ],
)
def test_the_engine_finds_how_far_forces_reach(actuator, model, strains, limit, relative):
    generator, count = np.random.default_rng(5), 200
    strain, first = generator.uniform(*strains, (2, count))
    by_force = generator.normal(size=count)

    def force(pressure):
        value = model.force(strain[:, None], pressure)
        return value - model.force(first[:, None], pressure) if relative else value

    slope = np.diff(force(np.array([[0.0, limit]])), axis=-1)[:, 0] / limit
    by_pressure = -by_force * slope * generator.uniform(0.0, 2.0, count)
    models, found = models_of([actuator]), np.zeros((count, 3))
    most = max(MUSCLE_PIECES, HIGH_DEGREE_PIECES)
    own, other = (make_curves(models, 2, most) for _ in range(2))
    change = make_curves(models, 2, 2 * most, terms=2 if relative else 1)
    reach(strain, first, limit, by_force, by_pressure, relative, own, other, change, found)

    grid = np.linspace(0, 1, 1001)
    pressure = limit * np.append(grid, grid**4)[None]
    dense = (by_force[:, None] * force(pressure) + by_pressure[:, None] * pressure).max(-1)
    p, f, fall = found.T
    largest = np.abs(force(limit * np.linspace(0, 1, 9)[None])).max(-1)
    size = np.abs(by_force) * largest + np.abs(by_pressure) * limit
    assert ((p >= 0) & (p <= limit)).all()
    assert np.abs(f - force(p[:, None])[:, 0]) == pytest.approx(np.zeros(count), abs=1e-12 * size.max())
    assert (by_force * f + by_pressure * p >= dense - 1e-10 * size).all()
    assert (fall >= 0).all()
    assert (fall > 0).any()
