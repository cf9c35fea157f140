"""Design optimisation: from a design and tasks to a better design, within constraints."""

from torcharm.optimise.architectures import Architectures, optimise_architectures
from torcharm.optimise.design import METHODS, optimise_design
from torcharm.optimise.objective import Objective
from torcharm.optimise.result import History, OptimisedDesign, load_optimised
from torcharm.optimise.running import Report
from torcharm.optimise.space import DesignSpace
from torcharm.optimise.verification import Verification, verify_design

__all__ = [
    "METHODS",
    "Architectures",
    "DesignSpace",
    "History",
    "Objective",
    "OptimisedDesign",
    "Report",
    "Verification",
    "load_optimised",
    "optimise_architectures",
    "optimise_design",
    "verify_design",
]
