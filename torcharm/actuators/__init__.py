"""Force models of fluid-driven actuators."""

from torcharm.actuators.bending import (
    Bending as Bending,
    BendingFunction as BendingFunction,
    ConstantBending as ConstantBending,
    LinearBending as LinearBending,
)
from torcharm.actuators.mckibben import McKibben as McKibben
from torcharm.actuators.polynomial import Bellows as Bellows, PolynomialActuator as PolynomialActuator
from torcharm.actuators.protocol import (
    Actuator as Actuator,
    check_actuator as check_actuator,
    force_slopes as force_slopes,
    is_linear_in_pressure as is_linear_in_pressure,
    is_passive as is_passive,
    model_name as model_name,
    pressure_degree as pressure_degree,
    pressure_knots as pressure_knots,
    want_gradients as want_gradients,
)
from torcharm.actuators.ready import (
    Chamber as Chamber,
    ElasticCore as ElasticCore,
    chamber as chamber,
    elastic_core as elastic_core,
)
from torcharm.actuators.shipped import SHIPPED as SHIPPED, model_of as model_of
