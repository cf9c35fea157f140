"""Uncertainty by the gradient against perturbed coefficients and drawn ones."""

import numpy as np
import pytest
import torch

import torcharm as ta

TASK = ta.Task(ta.affine_curvature(-1.0, 1.5, length=0.5, nodes=5), ta.sample_loads(6, scale=(30.0, 30.0, 3.0)))


def absolute(model):
    muscle = ta.McKibben()
    return ta.evaluate(ta.ArmDesign([-0.06, 0.0, 0.06], 0.5, [model, muscle, model]), TASK, ("absolute",)).absolute


def test_a_tensor_polynomial_is_the_polynomial():
    model = ta.Bellows(force_scale=1.5)
    tensor = ta.TensorPolynomial(model, ta.coefficient_tensor(model))
    strain, pressure = torch.rand(2, 50, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    expected = model.force(strain, 50 * pressure)
    torch.testing.assert_close(tensor.force(strain, 50 * pressure), expected, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(absolute(tensor).detach(), absolute(model), rtol=1e-10, atol=1e-10)
    assert tensor.pressure_degree == model.pressure_degree


def test_gradients_by_coefficients_are_differences():
    model = ta.Bellows()
    coefficients = ta.coefficient_tensor(model)
    total = absolute(ta.TensorPolynomial(model, coefficients)).sum()
    (gradient,) = torch.autograd.grad(total, coefficients)
    for index in range(len(coefficients)):
        step = 1e-6 * abs(coefficients[index].item())
        moved = [coefficients.detach().clone() for _ in range(2)]
        moved[0][index] += step
        moved[1][index] -= step
        high, low = (absolute(ta.TensorPolynomial(model, c)).sum().item() for c in moved)
        assert gradient[index].item() == pytest.approx((high - low) / (2 * step), rel=1e-4, abs=1e-4)


def test_the_standard_deviation_is_that_of_drawn_coefficients():
    model, random = ta.Bellows(), np.random.default_rng(0)
    mix = 0.002 * random.normal(size=(9, 9)) * np.abs([c for *_, c in model.coefficients])[:, None]
    covariance = mix @ mix.T
    coefficients = ta.coefficient_tensor(model)
    values = absolute(ta.TensorPolynomial(model, coefficients))
    found = ta.standard_deviation(values, coefficients, covariance)
    assert found.shape == values.shape
    drawn = random.multivariate_normal(coefficients.detach().numpy(), covariance, 400)
    spread = torch.stack([absolute(ta.TensorPolynomial(model, torch.from_numpy(c))) for c in drawn]).std(0)
    far = values.detach() > 10 * found  # of its kink at 0 the gradient knows one side
    assert int(far.sum()) >= 3
    torch.testing.assert_close(found[far], spread[far], rtol=0.15, atol=0)


def test_errors_name_the_field():
    model = ta.Bellows()
    with pytest.raises(ValueError, match=r"^coefficients: must have shape \(\.\.\., 9\)"):
        ta.TensorPolynomial(model, torch.zeros(3, dtype=torch.float64))
    coefficients = ta.coefficient_tensor(model)
    with pytest.raises(ValueError, match=r"^covariance: must have shape"):
        ta.standard_deviation(coefficients * 2, coefficients, np.eye(3))
    with pytest.raises(ValueError, match=r"^values: must depend on the coefficients"):
        ta.standard_deviation(torch.zeros(2), coefficients, np.eye(9))
