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
    make_curves,
    most_pieces,
    write_curve,
    write_difference,
)
from torcharm.engine.forces import SAMPLED, Models, models_of
from torcharm.engine.reach import furthest, sides
from torcharm.wrench_sets.curves import ACCURACY, as_samples, sample_curves


class KinkedByStrain(SmoothModel):
    """A force whose slope by strain jumps at a strain that is none of a grid's."""

    def force(self, strain, pressure):
        return super().force(strain, pressure) + pressure * (strain - 0.0123).clamp(min=0) + strain.clamp(max=1e3)


class Root(SmoothModel):
    """A force whose slope at no pressure is infinite."""

    def force(self, strain, pressure):
        return 5 * pressure.sqrt() * (1 - strain) - 20 * strain


@kernel
def reach(samples, strain, first, limit, by_force, by_pressure, relative, own, other, change, found):
    """The pressures, forces and falls (B, 3) of B curves of one actuator."""
    for b in range(len(strain)):
        write_curve(own, 0, strain[b], limit, samples, b, not relative)
        write_curve(other, 0, first[b], limit, samples, b, not relative)
        if relative:
            write_difference(change, 0, own, other)
        else:
            copy_curve(change, 0, own)
        change.side[0] = sides(change, 0)
        p, f, fall = furthest(change, 0, by_force[b], by_pressure[b])
        found[b, 0], found[b, 1], found[b, 2] = p, f, fall


@kernel
def write_all(samples, strain, limit, curves, edges, control):
    """Where the pieces of B sampled curves end (B, K + 1), and their Bezier coefficients (B, K, 4)."""
    for b in range(len(strain)):
        write_curve(curves, 0, strain[b], limit[b], samples, b, True)
        for k in range(edges.shape[1] - 1):
            own = min(k, curves.pieces[0] - 1)
            edges[b, k + 1] = curves.edge[0, own + 1]
            for j in range(4):
                control[b, k, j] = curves.control[0, own, j if own == k else 3]


def sampled(model, strain, limit):
    """Pressures and forces (B, K, 33) along the cubics that the engine makes of a model's samples."""
    samples = as_samples([sample_curves(model, strain, limit)])
    count = most_pieces(samples)
    models = Models(np.array([SAMPLED]), np.zeros((1, 2, 1)), np.ones(1))
    edges, control = np.zeros((len(strain), count + 1)), np.zeros((len(strain), count, 4))
    write_all(samples, strain.numpy(), limit.numpy(), make_curves(models, 2, count), edges, control)
    t = np.linspace(0, 1, 33)
    c0, c1, c2, c3 = (control[..., j, None] for j in range(4))
    value = (1 - t) ** 3 * c0 + 3 * t * (1 - t) ** 2 * c1 + 3 * t**2 * (1 - t) * c2 + t**3 * c3
    return edges[:, :-1, None] + t * np.diff(edges)[..., None], value


@pytest.mark.parametrize("count", [101, 5001])
@pytest.mark.parametrize(
    ("model", "force", "strains", "limit"),
    [
        *((pair.actuator, pair.model.force, pair.strains, pair.limit) for pair in (make() for make in PAIRS.values())),
        (ta.McKibben(), mckibben().force, (0.0, 1e-3), 100.0),
        (ta.McKibben(), mckibben().force, (0.05, 0.3), 100.0),
        (ta.McKibben(), mckibben().force, (-0.3, 0.3), 100.0),
        (ta.Bellows(), PAIRS["bellows"]().model.force, (-0.9, 3.0), 300.0),
        (ta.PolynomialActuator(QUINTIC, (-1, 1), (0, 99), 99.0), polynomial(QUINTIC).force, (-0.9, 0.9), 99.0),
        (SmoothModel(), smooth().force, (-0.9, 0.9), 150.0),
        (Root(), lambda e, p: 5 * np.sqrt(p) * (1 - e) - 20 * e, (-0.9, 0.9), 150.0),
        (KinkedModel(), kinked().force, (-0.9, 0.9), 150.0),
    ],
)
def test_sampled_pieces_are_good_to_what_they_promise(model, force, strains, limit, count):
    strain = torch.linspace(*strains, count, dtype=torch.float64)
    limits = limit * torch.linspace(0.2, 1.0, count, dtype=torch.float64).roll(count // 3)
    some = slice(None, None, max(1, count // 500))  # all are made together, and some looked at
    pressure, value = (found[some] for found in sampled(model, strain, limits))
    strain, limits = strain[some], limits[some]
    true = force(strain.numpy()[:, None, None], pressure)
    largest = np.abs(true).max((1, 2))
    off = np.abs(value - true).max((1, 2))
    assert (off <= 2 * ACCURACY * np.maximum(largest, np.median(largest))).all()
    assert (pressure[:, -1, -1] == limits.numpy()).all()
    assert (np.diff(pressure[:, :, 0]) >= 0).all()


def test_many_curves_follow_from_few_whatever_bends_by_strain():
    """A kink that the model does not name, strains alike, and one far from all others."""
    for strain in (torch.linspace(-0.3, 0.3, 5000), torch.full((5000,), 0.1), torch.linspace(0, 1, 5000) ** 40 * 1e3):
        strain = strain.double()
        curves = sample_curves(KinkedByStrain(), strain, torch.full_like(strain, 60.0))
        assert curves.grid is not None
        pressure, value = sampled(KinkedByStrain(), strain, torch.full_like(strain, 60.0))
        true = KinkedByStrain().force(strain[:, None, None], torch.from_numpy(pressure)).numpy()
        largest = np.abs(true).max((1, 2))
        assert (np.abs(value - true).max((1, 2)) <= 2 * ACCURACY * np.maximum(largest, np.median(largest))).all()


def test_no_limit_and_strains_of_nonsense_do_not_spoil_the_pieces_of_others():
    strain = torch.linspace(-0.2, 0.2, 50, dtype=torch.float64)
    spoilt = torch.cat((strain, strain.new_tensor((1e8, -1e8))))
    pressure, value = (part[:50] for part in sampled(SmoothModel(), spoilt, torch.full_like(spoilt, 60.0)))
    true = smooth().force(strain.numpy()[:, None, None], pressure)
    assert np.abs(value - true).max() <= 2 * ACCURACY * np.abs(true).max()
    pressure, value = sampled(SmoothModel(), strain, torch.zeros_like(strain))
    assert (pressure == 0).all()
    assert value == pytest.approx(np.broadcast_to(smooth().force(strain.numpy()[:, None, None], 0.0), value.shape))


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
    reach(as_samples([None]), strain, first, limit, by_force, by_pressure, relative, own, other, change, found)

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
