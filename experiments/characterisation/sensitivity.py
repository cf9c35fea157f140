"""How much the paper's validation study moves with the bellows' force model."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

import torcharm as ta
from experiments.paper import paper_task

SHAPE = ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=10)
"""The validation study's; it squeezes an outer bellows by 48 %, characterised to 17 %."""
MILD = ta.affine_curvature(-1.0, 1.0, length=0.5, nodes=10)
"""A shape that strains every actuator within its characterised range."""
METRICS = ("absolute", "relative")
ARMS = ("antagonistic", "bellows-only")


def validation(model: ta.Actuator, loads: int = 100, shape: Tensor = SHAPE) -> dict[tuple[str, str], Tensor]:
    """Unattainability (loads) of both arms on a shape by both metrics, with this model for their bellows."""
    muscle = ta.McKibben()
    kinds = {"antagonistic": (model, muscle, muscle, model), "bellows-only": (model,) * 4}
    task = paper_task(shape, ta.sample_loads(100)[:loads])
    found = {}
    for name in ARMS:
        result = ta.evaluate(ta.ArmDesign([-0.08, -0.015, 0.015, 0.08], 0.5, kinds[name]), task, METRICS)
        for metric in METRICS:
            found[name, metric] = getattr(result, metric)
    return found


@dataclass(frozen=True)
class Spread:
    """Values (loads) and their standard deviations for one arm and metric."""

    values: Tensor
    deviation: Tensor


def uncertain_validation(model: ta.FittedActuator, loads: int = 100) -> dict[tuple[str, str], Spread]:
    """The study with standard deviations from the covariance of the fit's coefficients, by the gradient."""
    assert model.quality is not None
    coefficients = ta.coefficient_tensor(model)
    found = validation(ta.TensorPolynomial(model, coefficients), loads)
    return {
        key: Spread(value.detach(), ta.standard_deviation(value, coefficients, model.quality.covariance))
        for key, value in found.items()
    }


def drawn_deviation(model: ta.FittedActuator, loads: int, draws: int) -> dict[tuple[str, str], Tensor]:
    """The same deviations (loads) by drawing coefficients: what the gradient is checked against."""
    assert model.quality is not None
    random = np.random.default_rng(0)
    own = np.array([c for *_, c in model.coefficients])
    drawn = random.multivariate_normal(own, np.array(model.quality.covariance), draws, method="cholesky")
    answers = [validation(ta.TensorPolynomial(model, torch.from_numpy(c)), loads) for c in drawn]
    return {key: torch.stack([answer[key] for answer in answers]).std(0) for key in answers[0]}
