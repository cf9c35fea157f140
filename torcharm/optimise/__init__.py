"""Design optimisation: from a design and tasks to a better design, within constraints."""

from torcharm.optimise.design import METHODS, optimise_design
from torcharm.optimise.objective import Objective
from torcharm.optimise.result import History, OptimisedDesign, load_optimised
from torcharm.optimise.running import Report
from torcharm.optimise.space import DesignSpace

__all__ = [
    "METHODS",
    "DesignSpace",
    "History",
    "Objective",
    "OptimisedDesign",
    "Report",
    "load_optimised",
    "optimise_design",
]
