"""Find the workspaces of antagonistic arms and of arms of one kind, and look by brute force for tips beyond them.

Prints a table, and writes results.csv and figures beside this file; goes on where it was interrupted.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

import torcharm as ta
from experiments.antagonism_in_space.scenes import arms as rings
from experiments.rows import read_rows, write_rows
from torcharm.geometry.alpha_shape import AlphaShape

HERE = Path(__file__).parent
PLANE = {"antagonistic": ta.antagonistic_arm(), "bellows only": ta.bellows_arm(), "muscles only": ta.mckibben_arm()}
"""The paper's arms, which weigh nothing."""
SPACE = {
    "antagonistic rings": rings()["3 bellows outside, 3 muscles between"],
    "ring of bellows": rings()["6 bellows on the outer ring"],
    "ring of muscles": rings()["6 muscles on the outer ring"],
}
"""Of six actuators, 0.3 kg each."""
WEIGHTS = (0.0, 2.0, 5.0)
"""What hangs from the tip [N];"""
WEIGHTS_IN_SPACE = (2.0,)
"""of arms in space."""
STATES, PRESSURES, PRESSURES_IN_SPACE = 20_000, 1_000_000, 20_000
QUICK = 200
"""By which a smoke run divides them."""
AT_ONCE = 20_000
OVERHANG = 0.25
"""By which random pressures overshoot their range, where they are held: a third lie on the box's faces."""

Array = NDArray[Any]


@dataclass(frozen=True)
class Row:
    """One arm with one weight.

    Attributes:
        arm, dimension, weight: which [N].
        size, extrapolated: area [cm²] or volume [dm³] reached, and where models may be extrapolated.
        furthest, lowest, highest: tips reached, from the base and by their y [mm].
        factor: the median over the region's cells of the largest factor by which the weight could grow.
        snapped, unstable: of the states [%].
        seconds: of one core that it took.
        pressures: of the brute force.
        beyond, beyond_extrapolated: how far its furthest tip lies outside of each region [mm].
        closer: of its tips in range, how many are inside or at most 2 mm outside [%].
    """

    arm: str
    dimension: int
    weight: float
    size: float
    extrapolated: float
    furthest: float
    lowest: float
    highest: float
    factor: float
    snapped: float
    unstable: float
    seconds: float
    pressures: int
    beyond: float
    beyond_extrapolated: float
    closer: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few states, no file written")
    parser.add_argument("--fresh", action="store_true", help="measure again what results.csv holds")
    options = parser.parse_args()
    torch.set_num_threads(1)
    from experiments.workspace import figure

    known: list[Row] = [] if options.quick or options.fresh else read_rows(HERE / "results.csv", Row)
    for row in rows(options.quick, {(row.arm, row.weight) for row in known}):
        known.append(row)
        if not options.quick:
            write_rows(HERE / "results.csv", known)
    Console(width=200).print(as_table(known))
    states = STATES // (QUICK if options.quick else 1)
    for number, arms in enumerate((PLANE, SPACE)):
        path = BytesIO() if options.quick else HERE / ("plane.png", "space.png")[number]
        figure.draw(arms, (WEIGHTS, WEIGHTS_IN_SPACE)[number], states, path)
    figure.draw_loads(PLANE, BytesIO() if options.quick else HERE / "loads.png", 5 if options.quick else 21)


def rows(quick: bool, known: set[tuple[str, float]]) -> Iterator[Row]:
    """All that are not known yet."""
    for name, arm in (PLANE | SPACE).items():
        pressures = (PRESSURES if arm.dimension == 2 else PRESSURES_IN_SPACE) // (QUICK if quick else 1)
        ta.workspace(arm, hanging(arm, 1.0), states=100)  # compiled
        for weight in WEIGHTS if arm.dimension == 2 else WEIGHTS_IN_SPACE:
            if (name, weight) not in known:
                yield measured(name, arm, weight, STATES // (QUICK if quick else 1), pressures)


def hanging(arm: ta.ArmDesign, weight: float) -> list[float]:
    """The wrench of a weight at the tip."""
    return [0.0, -weight, *[0.0] * (1 if arm.dimension == 2 else 4)]


def measured(name: str, arm: ta.ArmDesign, weight: float, states: int, pressures: int) -> Row:
    """One arm with one weight."""
    begun = time.process_time()
    found = ta.workspace(arm, hanging(arm, weight), states=states)
    seconds = time.process_time() - begun
    tips, codes = brute_force(arm, hanging(arm, weight), pressures)
    apart = beyond(tips[codes == 0], found.region)
    scale = 1e4 if arm.dimension == 2 else 1e3
    low, high = found.heights
    cells = found.cells()
    return Row(
        arm=name,
        dimension=arm.dimension,
        weight=weight,
        size=round(scale * found.size, 2),
        extrapolated=round(scale * found.extrapolated_region.size, 2),
        furthest=round(1e3 * found.reach, 1),
        lowest=round(1e3 * low, 1),
        highest=round(1e3 * high, 1),
        factor=round(float(cells.payload_factor.median()) if len(cells.count) and weight else np.inf, 2),
        snapped=round(100 * found.shares["snapped"], 2),
        unstable=round(100 * found.shares["unstable"], 2),
        seconds=round(seconds, 1),
        pressures=pressures,
        beyond=round(1e3 * float(apart.max(initial=0)), 2),
        beyond_extrapolated=round(1e3 * float(beyond(tips, found.extrapolated_region).max(initial=0)), 2),
        closer=round(100 * float((apart < 2e-3).mean()) if len(apart) else 100.0, 3),
    )


def brute_force(arm: ta.ArmDesign, wrench: list[float], count: int, nodes: int = 10) -> tuple[Array, Array]:
    """The tips (T, D) that random pressures reach from rest along one branch, and stay at; and 0 for each in range, 1
    for the others."""
    draw, tips, codes = np.random.default_rng(5), [], []
    load = ta.ExternalLoad(wrench, gravity=True)
    for first in range(0, count, AT_ONCE):
        size = min(AT_ONCE, count - first), arm.actuator_count
        place = ((1 + 2 * OVERHANG) * draw.random(size) - OVERHANG).clip(0, 1)
        found = ta.solve_equilibrium(arm, torch.from_numpy(place) * arm.max_pressure, load, nodes)
        stays = found.continued & found.stable
        pose = found.poses[stays, -1]
        tips.append((pose[:, :2] if arm.dimension == 2 else pose[:, :3, 3]).numpy())
        codes.append((~found.in_range[stays]).numpy().astype(int))
    return np.concatenate(tips), np.concatenate(codes)


def beyond(points: Array, region: AlphaShape) -> Array:
    """(P,) how far points (P, D) lie outside of a region, by places spread over its boundary, or of its nearest state
    where that is nearer, as at the end of a spike too thin for an area; 0 within."""
    away = np.zeros(len(points))
    outside = ~region.contains(points)
    if outside.any():
        ends = region.points[region.facets]
        mixed = np.random.default_rng(0).dirichlet(np.ones(points.shape[1]), 21)
        boundary = np.einsum("km,fmd->kfd", mixed, ends).reshape(-1, points.shape[1])
        away[outside] = cKDTree(np.concatenate((boundary, region.points))).query(points[outside])[0]
    return away


def as_table(found: list[Row]) -> Table:
    """A row a scene."""
    table = Table(title=r"reached: cm² in the plane, dm³ in space; beyond: mm outside, by brute force")
    for heading in (
        *("arm", "dim.", "N", "reached", "extrapolated", "furthest", "lowest", "highest", "factor", "snapped %"),
        *("unstable %", "s", "pressures", "beyond", "extrapolated", "within 2 mm %"),
    ):
        table.add_column(heading, justify="right")
    for row in found:
        table.add_row(*(str(value) for value in vars(row).values()))
    return table
