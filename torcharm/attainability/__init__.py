"""Can these designs hold these shapes under these loads, and by how much do they miss?"""

from torcharm.attainability.evaluation import (
    CHOICES as CHOICES,
    PREDICTED as PREDICTED,
    check_measure as check_measure,
    check_power as check_power,
    evaluate as evaluate,
    over_nodes as over_nodes,
    scale_of as scale_of,
)
from torcharm.attainability.result import Attainability as Attainability
from torcharm.attainability.verdict import VERDICTS as VERDICTS, PoseTolerance as PoseTolerance
