"""What this experiment measures, a row each."""

from dataclasses import dataclass

import torcharm as ta


@dataclass(frozen=True)
class ShapeRow:
    """One shape under one load: what is predicted and what the search reaches [m, rad, kPa]."""

    shape: int
    force_x_N: float
    tip_error_m: float
    mean_length_m: float
    predicted_m: float
    reached_m: float
    tip_position_m: float
    tip_heading_rad: float
    converged: bool
    in_range: bool
    pressure_kPa: str


@dataclass(frozen=True)
class MetricRow:
    """One shape's hull metrics under one load [N] or, power 2, [N²]; published values where they are known."""

    shape: int
    force_x_N: float
    hull: str
    power: int
    absolute: float
    relative: float
    published_absolute: float | None
    published_relative: float | None


@dataclass(frozen=True)
class Answer:
    """One shape under one load."""

    number: int
    task: ta.Task
    search: ta.PressureSearch
    row: ShapeRow
