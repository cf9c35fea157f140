"""The step in the box, against conditions of optimality and scipy's bounded least squares."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from torcharm.engine.arrays import make
from torcharm.engine.box_step import BoxStep, write_box_step
from torcharm.engine.compilation import kernel


@kernel
def take_steps(box, gradients, curvatures, extra, places, damping, steps, promises):
    for b in range(len(places)):
        promises[b] = write_box_step(box, gradients[b], curvatures[b], extra, True, places[b], damping)
        for m in range(places.shape[1]):
            steps[b, m] = box.step[m]


def taken(gradients, curvatures, places, damping=0.0, extra=None):
    count, size = places.shape
    steps, promises = np.zeros((count, size)), np.zeros(count)
    extra = np.zeros((size, size)) if extra is None else extra
    take_steps(make(BoxStep, {"M": size}), gradients, curvatures, extra, places, damping, steps, promises)
    return steps, promises


def problems(size, count=200):
    """Least squares `½|A (u - u0) + r|²`, of places of which some are at bounds."""
    rng = np.random.default_rng(size)
    matrix, residual = rng.normal(size=(count, size + 2, size)), rng.normal(size=(count, size + 2))
    places = np.clip(rng.uniform(-0.4, 1.4, (count, size)), 0, 1)
    return matrix, residual, places


@pytest.mark.parametrize("size", [1, 2, 4, 7])
def test_the_step_is_scipys(size):
    matrix, residual, places = problems(size)
    gradients = np.einsum("bri,br->bi", matrix, residual)
    curvatures = np.einsum("bri,brj->bij", matrix, matrix)
    steps, promises = taken(gradients, curvatures, places)
    for a, r, place, step, promised in zip(matrix, residual, places, steps, promises, strict=True):
        theirs = lsq_linear(a, a @ place - r, bounds=(0, 1), tol=1e-14)
        np.testing.assert_allclose(place + step, theirs.x, rtol=0, atol=1e-6)
        value, start = 0.5 * np.sum((a @ step + r) ** 2), 0.5 * np.sum(r**2)
        assert start - value == pytest.approx(promised, rel=1e-9, abs=1e-12)
        assert ((place + step >= 0) & (place + step <= 1)).all()


def test_models_that_are_not_convex_are_damped_until_they_are():
    matrix, residual, places = problems(4)
    gradients = np.einsum("bri,br->bi", matrix, residual)
    curvatures = np.einsum("bri,brj->bij", matrix, matrix)
    _, promises = taken(gradients, curvatures, places, extra=-3.0 * np.eye(4))
    assert np.isfinite(promises).all()
    assert (promises >= 0).all()


def test_damping_shortens_the_step():
    matrix, residual, places = problems(4)
    gradients = np.einsum("bri,br->bi", matrix, residual)
    curvatures = np.einsum("bri,brj->bij", matrix, matrix)
    lengths = [np.linalg.norm(taken(gradients, curvatures, places, damping)[0], axis=-1) for damping in (0.0, 10.0)]
    assert (lengths[1] <= lengths[0] + 1e-12).all()
