"""torcharm: can a soft continuum arm do the job? Attainability from a model, with gradients."""

from typing import TYPE_CHECKING, Any

from torcharm._node_distances import Residuals
from torcharm.actuators import Actuator, Bellows, McKibben, PolynomialActuator
from torcharm.arm import ArmDesign, antagonistic_arm, bellows_arm, mckibben_arm
from torcharm.attainability import Attainability, evaluate
from torcharm.distance.closed_form import distance_to_hull
from torcharm.equilibrium import Equilibrium, NotConvergedError, solve_equilibrium
from torcharm.hulls import WrenchHulls, wrench_hulls
from torcharm.pose_cost import PoseCost
from torcharm.prediction import PredictedError, predict_error
from torcharm.pressure_fit import PressureFit, fit_pressure
from torcharm.rod import poses
from torcharm.search import PressureSearch, search_pressure
from torcharm.task import Task, affine_curvature, cubic_curvature, sample_loads
from torcharm.wrenches import reaction_wrench, required_wrench

if TYPE_CHECKING:
    from torcharm.distance.planar import planar_distance
    from torcharm.distance.qp import qp_distance
    from torcharm.distance.result import HullDistance, kkt_residuals
    from torcharm.distance.scipy_solvers import nnls_distance, slsqp_distance
    from torcharm.optimise import (
        Architectures,
        DesignSpace,
        Objective,
        OptimisedDesign,
        load_optimised,
        optimise_architectures,
        optimise_design,
        verify_design,
    )
    from torcharm.planning import PlannedShape, Smoothness, plan_shape

__version__ = "0.1.0"

__all__ = [
    "Actuator",
    "Architectures",
    "ArmDesign",
    "Attainability",
    "Bellows",
    "DesignSpace",
    "Equilibrium",
    "HullDistance",
    "McKibben",
    "NotConvergedError",
    "Objective",
    "OptimisedDesign",
    "PlannedShape",
    "PolynomialActuator",
    "PoseCost",
    "PredictedError",
    "PressureFit",
    "PressureSearch",
    "Residuals",
    "Smoothness",
    "Task",
    "WrenchHulls",
    "affine_curvature",
    "antagonistic_arm",
    "bellows_arm",
    "cubic_curvature",
    "distance_to_hull",
    "evaluate",
    "fit_pressure",
    "kkt_residuals",
    "load_optimised",
    "mckibben_arm",
    "nnls_distance",
    "optimise_architectures",
    "optimise_design",
    "plan_shape",
    "planar_distance",
    "poses",
    "predict_error",
    "qp_distance",
    "reaction_wrench",
    "required_wrench",
    "sample_loads",
    "search_pressure",
    "slsqp_distance",
    "solve_equilibrium",
    "verify_design",
    "wrench_hulls",
]

_LATER = {
    "Architectures": "optimise",
    "DesignSpace": "optimise",
    "HullDistance": "distance.result",
    "Objective": "optimise",
    "OptimisedDesign": "optimise",
    "PlannedShape": "planning",
    "Smoothness": "planning",
    "kkt_residuals": "distance.result",
    "load_optimised": "optimise",
    "nnls_distance": "distance.scipy_solvers",
    "optimise_architectures": "optimise",
    "optimise_design": "optimise",
    "plan_shape": "planning",
    "planar_distance": "distance.planar",
    "qp_distance": "distance.qp",
    "slsqp_distance": "distance.scipy_solvers",
    "verify_design": "optimise",
}


def __getattr__(name: str) -> Any:
    """Distance solvers and optimisers, which load when they are first used."""
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"torcharm.{_LATER[name]}"), name)
