"""Force models of fluid-driven actuators."""

from torcharm.actuators.bending import Bending, BendingFunction, ConstantBending, LinearBending
from torcharm.actuators.mckibben import McKibben
from torcharm.actuators.polynomial import Bellows, PolynomialActuator
from torcharm.actuators.protocol import (
    Actuator,
    check_actuator,
    force_slopes,
    is_linear_in_pressure,
    is_passive,
    model_name,
    pressure_degree,
    pressure_knots,
    want_gradients,
)
from torcharm.actuators.ready import Chamber, ElasticCore, chamber, elastic_core
from torcharm.actuators.shipped import SHIPPED, model_of

__all__ = [
    "SHIPPED",
    "Actuator",
    "Bellows",
    "Bending",
    "BendingFunction",
    "Chamber",
    "ConstantBending",
    "ElasticCore",
    "LinearBending",
    "McKibben",
    "PolynomialActuator",
    "chamber",
    "check_actuator",
    "elastic_core",
    "force_slopes",
    "is_linear_in_pressure",
    "is_passive",
    "model_name",
    "model_of",
    "pressure_degree",
    "pressure_knots",
    "want_gradients",
]
