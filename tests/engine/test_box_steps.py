import numpy as np
from scipy.optimize import lsq_linear

from torcharm.engine.box_steps import box_steps


def test_steps_are_those_of_bounded_least_squares():
    draw = np.random.default_rng(0)
    slope, way, place = draw.normal(size=(40, 3, 5)), draw.normal(size=(40, 3)), draw.random((40, 5))
    gradient = -(slope.swapaxes(1, 2) @ way[..., None])[..., 0]
    damping = 1e-3
    steps = box_steps(gradient, slope.swapaxes(1, 2) @ slope, place, damping)
    for a, b, u, step in zip(slope, way, place, steps, strict=True):
        stacked = np.concatenate((a, np.sqrt(damping) * np.eye(5)))
        best = lsq_linear(stacked, np.append(b, np.zeros(5)), (-u, 1 - u), tol=1e-12).x
        np.testing.assert_allclose(step, best, atol=1e-5)
