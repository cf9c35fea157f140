"""Cubics of sampled models against scipy's, and beyond their ends as tangents."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from torcharm.engine import sections

hermite = sections.hermite.py_func
WIDTH, VALUES, SLOPES = 0.7, (2.0, -1.5), (3.0, 0.4)


@pytest.mark.parametrize("x", [0.0, 0.1, 0.35, 0.69, WIDTH])
def test_between_its_ends_it_is_the_cubic_with_these_values_and_slopes(x):
    cubic = CubicHermiteSpline([0.0, WIDTH], VALUES, SLOPES)
    found = hermite(x, WIDTH, VALUES[0], SLOPES[0], VALUES[1], SLOPES[1])
    assert np.allclose(found, (cubic(x), cubic(x, 1)), rtol=1e-13)


@pytest.mark.parametrize(("x", "end", "at"), [(-0.2, 0, 0.0), (1.3, 1, WIDTH)])
def test_beyond_its_ends_it_goes_on_straight(x, end, at):
    found = hermite(x, WIDTH, VALUES[0], SLOPES[0], VALUES[1], SLOPES[1])
    assert np.allclose(found, (VALUES[end] + SLOPES[end] * (x - at), SLOPES[end]), rtol=1e-13)
