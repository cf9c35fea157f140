"""Find the workspaces of antagonistic arms and of arms of one kind, and look by brute force for tips beyond them.

Prints a table, and writes results.csv and figures beside this file; goes on where it was interrupted.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from itertools import combinations
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
STATES, PRESSURES = 20_000, 1_000_000
QUICK = 200
"""By which a smoke run divides them."""
AT_ONCE = 20_000
OVERHANG = 0.25
"""By which random pressures overshoot their range, where they are held: each is at an end of it in a third of all, so
that nine of ten lie on faces, edges and corners of a box of six."""
NEAR = 2e-3
"""What counts as near [m]."""
FACETS = 30
"""Of the boundary, those with the nearest middles, from which distances are measured."""
NEIGHBOURS, MIXES = 8, 100
"""Near a place of the boundary at which no random pressure arrived, so many mixes of the pressures of so many tips
around it are tried."""

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
        outside: of its tips in range, how many are more than 2 mm outside [%].
        empty: how far the boundary's furthest place is from all of its tips in range [mm].
        doubtful: the same, with mixes of pressures tried around places further than 2 mm.
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
    outside: float
    empty: float
    doubtful: float


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
        pressures = PRESSURES // (QUICK if quick else 1)
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
    place = random_places(arm, pressures)
    tips, codes, kept = brute_force(arm, hanging(arm, weight), place)
    apart = beyond(tips[codes == 0], found.region)
    empty, doubtful = unconfirmed(arm, hanging(arm, weight), found, tips[codes == 0], place[kept][codes == 0])
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
        outside=round(100 * float((apart > NEAR).mean()) if len(apart) else 0.0, 4),
        empty=round(1e3 * empty, 2),
        doubtful=round(1e3 * doubtful, 2),
    )


def random_places(arm: ta.ArmDesign, count: int) -> Array:
    """Normalised pressures (P, M)."""
    random = np.random.default_rng(5).random((count, arm.actuator_count))
    return ((1 + 2 * OVERHANG) * random - OVERHANG).clip(0, 1)


def brute_force(arm: ta.ArmDesign, wrench: list[float], place: Array, nodes: int = 10) -> tuple[Array, Array, Array]:
    """The tips (T, D) that normalised pressures (P, M) reach from rest along one branch, and stay at; 0 for each in
    range, 1 for the others; and which of the pressures these are."""
    tips, codes, kept = [], [], []
    load = ta.ExternalLoad(wrench, gravity=True)
    for first in range(0, len(place), AT_ONCE):
        own = torch.from_numpy(place[first : first + AT_ONCE])
        found = ta.solve_equilibrium(arm, own * arm.max_pressure, load, nodes)
        stays = found.continued & found.stable
        pose = found.poses[stays, -1]
        tips.append((pose[:, :2] if arm.dimension == 2 else pose[:, :3, 3]).numpy())
        codes.append((~found.in_range[stays]).numpy().astype(int))
        kept.append(first + np.flatnonzero(stays.numpy()))
    return np.concatenate(tips), np.concatenate(codes), np.concatenate(kept)


def unconfirmed(
    arm: ta.ArmDesign, wrench: list[float], found: ta.Workspace, tips: Array, place: Array
) -> tuple[float, float]:
    """How far the middle of a facet of the boundary is from known tips (T, D) in range, at most [m]; and the same, once
    mixes of the pressures (T, M) of tips around those further than 2 mm are tried."""
    region = found.region
    middle = region.points[region.facets].mean(1)
    if not len(middle) or not len(tips):
        return np.nan, np.nan
    away = cKDTree(tips).query(middle)[0]
    far, least = np.flatnonzero(away > NEAR), away.copy()
    if len(far):
        tips = np.concatenate((tips, region.points))
        place = np.concatenate((place, (found.pressure / arm.max_pressure)[found.reached].numpy()))
        around = place[cKDTree(tips).query(middle[far], NEIGHBOURS)[1]]
        mixes = np.random.default_rng(6).dirichlet(np.full(NEIGHBOURS, 0.5), (len(far), MIXES)) @ around
        more, codes, kept = brute_force(arm, wrench, mixes.reshape(-1, mixes.shape[2]))
        owner = far[kept[codes == 0] // MIXES]
        np.minimum.at(least, owner, np.linalg.norm(more[codes == 0] - middle[owner], axis=1))
    return float(away.max()), float(least.max())


def beyond(points: Array, region: AlphaShape) -> Array:
    """(P,) how far points (P, D) lie outside of a region: from its boundary's nearest facet; or from what is too thin
    for an area (a volume), its nearest state, or line between neighbours, which an alpha shape holds; 0 within."""
    away = np.zeros(len(points))
    outside = np.flatnonzero(~region.contains(points))
    if len(outside):
        away[outside] = cKDTree(region.points).query(points[outside])[0]
    facets = np.concatenate((region.facets, lines_of_spikes(region)))
    if len(outside) and len(facets):
        corners = region.points[facets]
        near = cKDTree(corners.mean(1)).query(points[outside], min(FACETS, len(corners)))[1]
        for own in near.reshape(len(outside), -1).T:
            away[outside] = np.minimum(away[outside], to_facet(points[outside], corners[own]))
    return away


def lines_of_spikes(region: AlphaShape) -> Array:
    """(L, D) both ends of Delaunay's lines no longer than 2 α from points that are no corner of the region; the second
    again where three corners are asked for."""
    if region.triangulation is None:
        return region.facets[:0]
    simplices = region.triangulation.simplices
    lines = np.concatenate([simplices[:, pair] for pair in combinations(range(simplices.shape[1]), 2)])
    lines = np.unique(np.sort(lines[~region.filled[lines].all(1)], 1), axis=0)
    long = np.linalg.norm(region.points[lines[:, 0]] - region.points[lines[:, 1]], axis=1)
    lines = lines[long <= 2 * region.radius]
    return lines[:, (0, 1, 1)[: region.points.shape[1]]]


def to_facet(points: Array, corners: Array) -> Array:
    """(P,) distances of points (P, D) from lines or triangles (P, D, D) with these corners."""
    least, count = np.full(len(points), np.inf), corners.shape[1]
    for one, other in combinations(range(count), 2):
        start, way = corners[:, one], corners[:, other] - corners[:, one]
        along = ((points - start) * way).sum(1) / np.maximum((way**2).sum(1), 1e-300)
        least = np.minimum(least, np.linalg.norm(points - start - along.clip(0, 1)[:, None] * way, axis=1))
    if count == 3:
        edges, way = corners[:, 1:] - corners[:, :1], points - corners[:, 0]
        share = np.einsum("pdk,pd->pk", np.linalg.pinv(edges), way)
        inside = (share >= 0).all(1) & (share.sum(1) <= 1)
        height = np.linalg.norm(way - np.einsum("pk,pkd->pd", share, edges), axis=1)
        least = np.where(inside, np.minimum(least, height), least)
    return least


def as_table(found: list[Row]) -> Table:
    """A row a scene."""
    table = Table(title=r"reached: cm² in the plane, dm³ in space; beyond: mm outside, by brute force")
    for heading in (
        *("arm", "dim.", "N", "reached", "extrapolated", "furthest", "lowest", "highest", "factor", "snapped %"),
        *("unstable %", "s", "pressures", "beyond", "extrapolated", "outside %", "empty", "doubtful"),
    ):
        table.add_column(heading, justify="right")
    for row in found:
        table.add_row(*(str(value) for value in vars(row).values()))
    return table
