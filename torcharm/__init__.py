"""torcharm: can a soft continuum arm do the job? Attainability from a model, with gradients."""

from torcharm.actuators import Actuator, Bellows, McKibben, PolynomialActuator
from torcharm.arm import ArmDesign, antagonistic_arm, bellows_arm, mckibben_arm
from torcharm.attainability import Attainability, evaluate
from torcharm.distance.closed_form import distance_to_hull
from torcharm.hulls import WrenchHulls, wrench_hulls
from torcharm.rod import poses
from torcharm.task import Task, affine_curvature, cubic_curvature, sample_loads
from torcharm.wrenches import reaction_wrench, required_wrench

__version__ = "0.1.0"

__all__ = [
    "Actuator",
    "ArmDesign",
    "Attainability",
    "Bellows",
    "McKibben",
    "PolynomialActuator",
    "Task",
    "WrenchHulls",
    "affine_curvature",
    "antagonistic_arm",
    "bellows_arm",
    "cubic_curvature",
    "distance_to_hull",
    "evaluate",
    "mckibben_arm",
    "poses",
    "reaction_wrench",
    "required_wrench",
    "sample_loads",
    "wrench_hulls",
]
