"""Can these designs hold these shapes under these loads, and by how much do they miss?"""

from torcharm.attainability.evaluation import (
    CHOICES,
    PREDICTED,
    check_measure,
    check_power,
    evaluate,
    over_nodes,
    scale_of,
)
from torcharm.attainability.result import Attainability
from torcharm.attainability.verdict import VERDICTS, PoseTolerance

__all__ = [
    "CHOICES",
    "PREDICTED",
    "VERDICTS",
    "Attainability",
    "PoseTolerance",
    "check_measure",
    "check_power",
    "evaluate",
    "over_nodes",
    "scale_of",
]
