"""From a design and tasks to a better design, within constraints, and to shapes that an arm can hold."""

from torcharm.design.architectures import Architectures, optimise_architectures
from torcharm.design.descent import Progress
from torcharm.design.objective import Objective
from torcharm.design.optimise import optimise_design
from torcharm.design.result import OptimisedDesign
from torcharm.design.space import DesignSpace
from torcharm.design.verification import Verification, verify_design

__all__ = [
    "Architectures",
    "DesignSpace",
    "Objective",
    "OptimisedDesign",
    "Progress",
    "Verification",
    "optimise_architectures",
    "optimise_design",
    "verify_design",
]
