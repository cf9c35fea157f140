"""torcharm: can a soft continuum arm do the job? Attainability from a model, with gradients."""

from typing import TYPE_CHECKING, Any

from torcharm._node_distances import Residuals
from torcharm.actuators import Actuator, Bellows, McKibben, PolynomialActuator
from torcharm.arm import ArmDesign, antagonistic_arm, bellows_arm, mckibben_arm
from torcharm.attainability import Attainability, evaluate
from torcharm.distance.closed_form import distance_to_hull
from torcharm.hulls import WrenchHulls, wrench_hulls
from torcharm.rod import poses
from torcharm.task import Task, affine_curvature, cubic_curvature, sample_loads
from torcharm.wrenches import reaction_wrench, required_wrench

if TYPE_CHECKING:
    from torcharm.capacity import LoadCapacity, load_capacity
    from torcharm.distance.planar import planar_distance
    from torcharm.distance.qp import qp_distance
    from torcharm.distance.result import HullDistance, kkt_residuals
    from torcharm.distance.scipy_solvers import nnls_distance, slsqp_distance

__version__ = "0.1.0"

__all__ = [
    "Actuator",
    "ArmDesign",
    "Attainability",
    "Bellows",
    "HullDistance",
    "LoadCapacity",
    "McKibben",
    "PolynomialActuator",
    "Residuals",
    "Task",
    "WrenchHulls",
    "affine_curvature",
    "antagonistic_arm",
    "bellows_arm",
    "cubic_curvature",
    "distance_to_hull",
    "evaluate",
    "kkt_residuals",
    "load_capacity",
    "mckibben_arm",
    "nnls_distance",
    "planar_distance",
    "poses",
    "qp_distance",
    "reaction_wrench",
    "required_wrench",
    "sample_loads",
    "slsqp_distance",
    "wrench_hulls",
]

_LATER = {
    "HullDistance": "distance.result",
    "LoadCapacity": "capacity",
    "kkt_residuals": "distance.result",
    "load_capacity": "capacity",
    "nnls_distance": "distance.scipy_solvers",
    "planar_distance": "distance.planar",
    "qp_distance": "distance.qp",
    "slsqp_distance": "distance.scipy_solvers",
}


def __getattr__(name: str) -> Any:
    """What loads when it is first used."""
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"torcharm.{_LATER[name]}"), name)
