"""Sobol' indices against those of a function known in closed form, and of scipy."""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from torcharm.design.scatter import Source, scattered
from torcharm.design.sobol import index_numbers, sobol_indices

NAMES = ("first", "second", "third")
SOURCES = [Source(name, torch.eye(1).double(), torch.tensor([math.pi]).double(), True) for name in NAMES]
FIRST, TOTAL = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)
"""Of the function of T. Ishigami and T. Homma, 1990, at a = 7 and b = 0.1."""


def ishigami(numbers):
    """(n, 1, 2) places, of which one coordinate has twice the other."""
    one, two, three = (own.squeeze(-1) for own in scattered(SOURCES, numbers))
    value = one.sin() + 7 * two.sin() ** 2 + 0.1 * three**4 * one.sin()
    return torch.stack((value, 2 * value), -1).unsqueeze(1)


@pytest.mark.parametrize("lost", [0, 500])
def test_indices_of_a_known_function(lost):
    places = ishigami(index_numbers(SOURCES, 9000, 0))
    assert len(places) == 5 * 8192
    places[:lost] = torch.nan
    first, total = sobol_indices(places, 3)
    assert first.squeeze(1).tolist() == pytest.approx(FIRST, abs=0.02)
    assert total.squeeze(1).tolist() == pytest.approx(TOTAL, abs=0.02)


def test_indices_are_those_of_scipy():
    places = ishigami(index_numbers(SOURCES, 256, 3))
    one, other, *mixed = places[:, 0, 0].reshape(256, 5).mT.unsqueeze(1).numpy()
    middle = np.stack((one, other)).mean()  # which older scipy leaves in
    shifted = {"f_A": one - middle, "f_B": other - middle, "f_AB": np.stack(mixed) - middle}
    found = stats.sobol_indices(func=shifted, n=256)
    for own, its in zip(sobol_indices(places, 3), (found.first_order, found.total_order), strict=True):
        torch.testing.assert_close(own.squeeze(1), torch.from_numpy(its).squeeze(0))


def test_sources_of_one_name_are_one_group():
    alike = [SOURCES[0], Source("first", torch.eye(2).double(), torch.ones(2).double(), False), SOURCES[1]]
    one, other, first, second = index_numbers(alike, 8, 0).reshape(8, 4, 4).unbind(1)
    assert torch.equal(first, torch.cat((other[:, :3], one[:, 3:]), -1))
    assert torch.equal(second, torch.cat((one[:, :3], other[:, 3:]), -1))
