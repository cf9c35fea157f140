import pytest
import torch

import torcharm as ta


def polynomial(*terms):
    return ta.PolynomialActuator(terms, (0.0, 1.0), (0.0, 10.0), 10.0)


def test_a_force_that_turns_at_a_known_pressure():
    # f = p (8 - ε) - p²/2 rises to p = 8 - ε
    found = ta.monotonicity(polynomial((0, 1, 8.0), (1, 1, -1.0), (0, 2, -0.5)), points=401)
    assert not found.monotonic
    assert found.rising
    assert found.up_to == pytest.approx(7.0, abs=1e-6)
    assert found.failing_strain == (0.0, 1.0)
    assert found.failing_pressure == pytest.approx((7.0, 10.0), abs=0.03)
    assert found.failing_share == pytest.approx(0.25, abs=0.005)
    assert found.worst_slope == pytest.approx(-3.0)
    assert (found.worst_strain, found.worst_pressure) == (1.0, 10.0)


def test_monotonic_models():
    up = ta.monotonicity(polynomial((0, 1, 1.0)))
    assert up.monotonic
    assert up.rising
    assert (up.up_to, up.failing_share, up.failing_strain) == (10.0, 0.0, None)
    down = ta.monotonicity(polynomial((0, 1, -1.0)))
    assert down.monotonic
    assert not down.rising
    assert ta.monotonicity(polynomial((1, 0, 5.0))).monotonic  # does not depend on pressure


def test_the_papers_models():
    assert ta.monotonicity(ta.Bellows(), pressure_range=(0.0, 50.0)).monotonic
    full = ta.monotonicity(ta.Bellows())
    assert ta.monotonicity("bellows") == full
    assert not full.monotonic
    assert 80 < full.up_to < 92
    muscle = ta.monotonicity(ta.McKibben(), (-0.3, 0.05))
    assert muscle.monotonic
    assert not muscle.rising
    assert not ta.monotonicity(ta.McKibben()).monotonic  # squeezed below -0.303


def test_bad_boxes():
    with pytest.raises(ValueError, match=r"^strain_range: must be two finite numbers"):
        ta.monotonicity(ta.Bellows(), (0.5, 0.1))
    with pytest.raises(ValueError, match=r"^points: must be an integer of at least 2"):
        ta.monotonicity(ta.Bellows(), points=1)


def test_no_gradient_mode_does_not_matter():
    with torch.no_grad():
        assert ta.monotonicity(ta.Bellows()) == ta.monotonicity(ta.Bellows())
