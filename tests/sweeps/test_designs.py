import numpy as np
import pytest
import torch
from sweep_cases import SPACE, arm, task

import torcharm as ta
from torcharm.design.feasible import feasible_designs
from torcharm.sweeps.designs import DesignPoints, GridPoints, points_from_json, sobol_points


def designs_and_points(own, space, what, count, seed):
    designs = feasible_designs(space, own, (what,))
    return designs, DesignPoints(designs.free, sobol_points(designs.dimension, seed, count), designs.order)


@pytest.fixture
def swept():
    return designs_and_points(arm(), SPACE, task(), 1000, 5)


@pytest.mark.parametrize(("dimension", "seed", "count"), [(1, 0, 1), (3, 7, 2), (8, 1, 5000)])
def test_sobol_points_are_those_of_the_engine(dimension, seed, count):
    engine = torch.quasirandom.SobolEngine(dimension, scramble=True, seed=seed)
    expected = engine.draw(count, dtype=torch.float64).numpy()
    found = sobol_points(dimension, seed, count)(np.arange(count))
    assert (found[1:] == expected[1:]).all()
    assert np.allclose(found[0], expected[0], atol=1e-7)  # which the engine rounds to single precision


def test_sobol_points_leave_torchs_generator_alone():
    before = torch.get_rng_state()
    sobol_points(3, 0, 100)
    assert (torch.get_rng_state() == before).all()


def test_points_before_do_not_depend_on_how_many_follow():
    some = np.array([0, 1, 17, 99])
    assert (sobol_points(4, 2, 100)(some) == sobol_points(4, 2, 100_000)(some)).all()


def test_a_grid_holds_all_combinations_once():
    points = GridPoints((3, 1, 2))(np.arange(6))
    assert points.tolist() == [[a, 0.5, b] for a in (0.0, 0.5, 1.0) for b in (0.0, 1.0)]


def test_a_design_is_the_same_alone_in_a_batch_and_after_json(swept):
    designs, points = swept
    indices = np.array([3, 999, 0, 512, 3])
    some = points(indices)
    assert (some[0] == some[-1]).all()
    assert (np.concatenate([points(indices[i : i + 1]) for i in range(5)]) == some).all()
    assert (points_from_json(points.to_json())(indices) == some).all()
    many = designs.design(points(np.arange(1000))).radii
    assert (designs.design(some).radii == many[torch.from_numpy(indices)]).all()


def test_radii_are_in_the_arms_order_and_values_those_of_the_designs(swept):
    designs, points = swept
    indices = np.arange(1000)
    radii = points.values(indices)[:, 0]
    assert (np.argsort(radii, axis=1) == np.argsort(arm().radii.numpy())).all()
    assert np.allclose(designs.design(points(indices)).radii.numpy(), radii, atol=1e-15)


def test_what_is_allowed_is_what_breaks_no_constraint():
    space = ta.DesignSpace(bounds={"radii": (-0.08, 0.08), "length": (0.4, 0.6)})
    spatial = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.4, actuators=ta.Bellows())
    bend = ta.Task(ta.constant_curvature(0.5, 0.4, nodes=3, direction=0.4))
    for own, where, what in ((arm(), space, task()), (spatial, ta.DesignSpace(tied="none"), bend)):
        designs, points = designs_and_points(own, where, what, 300, 0)
        some = points(np.arange(300))
        allowed = designs.allows(some)
        assert allowed.tolist() == [designs.violation(point) <= 2e-8 for point in some]
        assert 0 < allowed.sum() < 300
