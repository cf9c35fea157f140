"""Answers by the number of nodes: predicted errors, distances from sets, and equilibria.

Writes results.csv (one row a scene, quantity and number of nodes) beside this file.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

import torcharm as ta
from experiments.rows import write_rows

HERE = Path(__file__).parent
NODES, QUICK_NODES = (5, 10, 20, 40, 80), (5, 10)
FINEST, QUICK_FINEST = 320, 40
"""Nodes of what equilibria are compared with."""
LOADS, QUICK_LOADS = 20, 2


@dataclass(frozen=True)
class Row:
    """The median over a scene's loads, or the largest where the quantity says so."""

    scene: str
    wrench_at: str
    quantity: str
    unit: str
    nodes: int
    value: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few nodes and loads, no file written")
    options = parser.parse_args()
    nodes, loads = (QUICK_NODES, QUICK_LOADS) if options.quick else (NODES, LOADS)
    rows = [*predicted(nodes, loads), *deflections(nodes, loads, QUICK_FINEST if options.quick else FINEST)]
    Console(width=120).print(table(rows, nodes))
    if not options.quick:
        write_rows(HERE / "results.csv", rows)


def planar(count: int) -> tuple[ta.ArmDesign, ta.ExternalLoad]:
    """The paper's antagonistic arm, narrower, under loads at its tip."""
    arm = ta.antagonistic_arm(outer_radius=0.05, inner_radius=0.015, length=0.5)
    return arm, ta.ExternalLoad(tip=ta.sample_loads(count, scale=(12.0, 12.0, 1.2)))


def heavy(count: int) -> tuple[ta.ArmDesign, ta.ExternalLoad]:
    """Three bellows in a ring that weigh 300 g, with 50 g half-way and loads at the tip."""
    arm = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=3), length=0.4, actuators=ta.Bellows(), mass=0.3)
    forces = ta.sample_loads(count, scale=(1.0, 1.0, 1.0))
    tip = torch.cat((forces, torch.zeros_like(forces)), -1)
    return arm, ta.ExternalLoad(tip=tip, gravity=True, points=[ta.PointLoad(mass=0.05, at=0.5)])


SCENES = {"plane": planar, "space": heavy}


def shape(scene: str, nodes: int) -> Tensor:
    """Twists (N, 3 or 6) of the shape to hold: in the plane its curvature changes along the arm."""
    if scene == "plane":
        return ta.affine_curvature(-1.0, 1.0, length=0.48, nodes=nodes)
    return torch.tensor([[0.45, 0, 0, 0, 0.3, 0.5]], dtype=torch.float64).expand(nodes, 6)


def predicted(nodes: tuple[int, ...], count: int) -> Iterator[Row]:
    """What `evaluate` says of each scene."""
    for scene, made in SCENES.items():
        arm, load = made(count)
        for number in nodes:
            found = ta.evaluate(arm, ta.Task(shape(scene, number), load=load))
            assert found.prediction is not None
            for quantity, unit, factor, value in (
                ("tip error", "mm", 1e3, found.tip_error),
                ("tip rotation error", "°", 180 / math.pi, found.tip_rotation_error),
                ("shape error", "mm", 1e3, found.shape_error),
                ("worst node's miss", "N", 1.0, found.worst_miss),
                ("the paper's cost", "m²", 1.0, found.prediction.cost),
                ("the paper's absolute", "N", 1.0, found.absolute),
            ):
                assert value is not None
                yield Row(scene, "middle", quantity, unit, number, factor * float(value.nanmedian()))


def deflections(nodes: tuple[int, ...], count: int, finest: int) -> Iterator[Row]:
    """How far equilibria's tips are from those of many nodes, over how far the load moves them."""
    for scene, made in SCENES.items():
        arm, load = made(count)
        pressure = 0.3 * arm.max_pressure
        rest = tips(arm, pressure, torch.zeros(3 * arm.dimension - 3, dtype=torch.float64), finest, "middle")
        best = tips(arm, pressure, load, finest, "middle")
        for rule in ("middle", "start"):
            for number in nodes:
                off = (tips(arm, pressure, load, number, rule) - best).norm(dim=-1) / (best - rest).norm(dim=-1)
                yield Row(scene, rule, "tip off by, of its deflection", "%", number, 100 * float(off.median()))
                yield Row(scene, rule, "the same, largest", "%", number, 100 * float(off.max()))


def tips(arm: ta.ArmDesign, pressure: Tensor, load: ta.ExternalLoad | Tensor, nodes: int, rule: str) -> Tensor:
    """Positions (..., 2 or 3) of the tips at equilibrium."""
    held = ta.solve_equilibrium(arm, pressure, load, nodes=nodes, wrench_at=rule, raise_on_failure=True)
    pose = ta.poses(held.twists)[..., -1, :] if arm.dimension == 2 else ta.poses(held.twists)[..., -1, :, :]
    return pose[..., :2] if arm.dimension == 2 else pose[..., :3, 3]


def table(rows: list[Row], nodes: tuple[int, ...]) -> Table:
    shown = Table(box=None, title="By the number of nodes", title_justify="left")
    for heading in ("scene", "wrench at", "quantity", "unit", *map(str, nodes)):
        shown.add_column(heading, justify="right" if heading.isdigit() else "left")
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.wrench_at, row.quantity, row.unit), []).append(row)
    for key, group in groups.items():
        shown.add_row(*key, *(f"{row.value:.4g}" for row in group))
    return shown
