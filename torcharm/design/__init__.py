"""From a design and tasks to a better design, within constraints, and to shapes that an arm can hold."""

from torcharm.design.architectures import (
    Architectures as Architectures,
    optimise_architectures as optimise_architectures,
)
from torcharm.design.descent import Progress as Progress
from torcharm.design.objective import Objective as Objective
from torcharm.design.optimise import optimise_design as optimise_design
from torcharm.design.result import OptimisedDesign as OptimisedDesign
from torcharm.design.space import DesignSpace as DesignSpace
from torcharm.design.verification import Verification as Verification, verify_design as verify_design
