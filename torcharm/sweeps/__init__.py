"""Sweeps: a whole space of designs evaluated, on all cores there are, into a folder that outlives its process."""

from torcharm.sweeps.progress import SweepProgress
from torcharm.sweeps.result import SweepResult, SweepRows, open_sweep
from torcharm.sweeps.running import sweep

__all__ = ["SweepProgress", "SweepResult", "SweepRows", "open_sweep", "sweep"]
