import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from torcharm import PolynomialActuator
from torcharm.actuators import is_linear_in_pressure

RANGES = {"strain_range": (-0.2, 0.6), "pressure_range": (0.0, 50.0), "max_pressure": 50.0}


def polynomial(*terms, **changes):
    return PolynomialActuator(terms, **{**RANGES, **changes})


powers = st.integers(0, 4)
terms = st.lists(st.tuples(powers, powers, st.floats(-5, 5)), max_size=8)


@given(terms=terms, strain=st.floats(-1, 1), pressure=st.floats(0, 3))
def test_force_is_the_polynomial(terms, strain, pressure):
    table = np.zeros((5, 5))
    size = 1.0
    for i, j, c in terms:
        table[i, j] += c
        size += abs(c * strain**i * pressure**j)
    force = polynomial(*terms).force(*(torch.tensor(v, dtype=torch.float64) for v in (strain, pressure)))
    assert force.item() == pytest.approx(np.polynomial.polynomial.polyval2d(strain, pressure, table), abs=1e-14 * size)


def test_terms_of_equal_powers_add():
    force = polynomial((1, 1, 2.0), (1, 1, 3.0)).force(torch.tensor(2.0), torch.tensor(10.0))
    assert force.item() == 100.0


def test_a_constant_fills_the_broadcast_shape():
    force = polynomial((0, 0, 7.0)).force(torch.zeros(3, 1), torch.zeros(4))
    assert torch.equal(force, torch.full((3, 4), 7.0))


def test_no_terms_are_no_force():
    force = polynomial().force(torch.ones(3, 1), torch.ones(4))
    assert torch.equal(force, torch.zeros(3, 4))


@pytest.mark.parametrize(
    "terms", [((2, 0, 1.0),), ((0, 2, 1.0),), ((1, 1, 1.0), (0, 3, -1.0)), ((0, 0, 1.0),)], ids=str
)
@pytest.mark.parametrize(
    ("strain", "pressure"), [((), ()), ((3, 1), (4,)), ((4,), (3, 1)), ((0, 2), ()), ((2, 1, 1), (5, 1))], ids=str
)
def test_strain_and_pressure_broadcast(terms, strain, pressure):
    force = polynomial(*terms).force(torch.ones(strain), torch.ones(pressure))
    assert force.shape == torch.broadcast_shapes(strain, pressure)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype_is_kept(dtype):
    assert polynomial((1, 1, 1.0)).force(torch.ones(2, dtype=dtype), torch.ones(2, dtype=dtype)).dtype == dtype


@pytest.mark.parametrize(
    ("terms", "linear"),
    [
        ((), True),
        (((3, 0, 1.0),), True),
        (((3, 1, 1.0), (0, 0, 1.0)), True),
        (((0, 2, 0.0), (0, 1, 1.0)), True),
        (((0, 2, 1e-9),), False),
        (((5, 0, 1.0), (1, 3, 1.0)), False),
    ],
)
def test_linear_in_pressure_tells_whether_a_higher_power_acts(terms, linear):
    model = polynomial(*terms)
    assert is_linear_in_pressure(model) is linear


def test_force_is_differentiable_twice():
    model = polynomial((0, 0, 1.0), (3, 1, 2.0), (1, 2, -0.5), (0, 3, 0.1))
    strain = torch.tensor([[0.0], [0.5]], dtype=torch.float64, requires_grad=True)
    pressure = torch.tensor([0.0, 2.0, 5.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(model.force, (strain, pressure))
    assert torch.autograd.gradgradcheck(model.force, (strain, pressure))


def test_force_scale_multiplies_every_term():
    strain, pressure = torch.tensor(0.3, dtype=torch.float64), torch.tensor(12.0, dtype=torch.float64)
    terms = (0, 0, 1.0), (2, 1, 2.0)
    single, scaled = (
        polynomial(*terms).force(strain, pressure),
        polynomial(*terms, force_scale=3.0).force(strain, pressure),
    )
    assert scaled.item() == pytest.approx(3 * single.item(), rel=1e-15)


@pytest.mark.parametrize("term", [(-1, 0, 1.0), (0, -2, 1.0)], ids=str)
def test_negative_powers_are_refused(term):
    with pytest.raises(ValueError, match=r"^coefficients: powers must be whole and at least 0, got \("):
        polynomial((1, 1, 1.0), term)


def test_a_polynomial_is_hashable_and_equal_to_its_copies():
    assert polynomial((1, 2, 3.0)) == polynomial((1, 2, 3.0))
    assert hash(polynomial((1, 2, 3.0))) == hash(polynomial((1, 2, 3.0)))
    assert polynomial((1, 2, 3.0)) != polynomial((1, 2, 4.0))
