"""Evaluate three arms on three shapes under 100 loads, and measure where their attainable sets lie.

Writes results.csv (one row an arm, shape and load), hulls.csv (one row an arm, shape and node), antagonism.png and
why.png beside this file.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, fields
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from torch import Tensor

import torcharm as ta
from experiments.antagonism.rows import ARMS, SHAPES, Hull, Result, chosen, twists_of
from experiments.paper import paper_task, paper_wrench
from experiments.rows import write_rows
from torcharm.actuators.bending import Bending, Number

HERE = Path(__file__).parent
Array = NDArray[np.float64]
HELD = "antagonistic, muscles held"
"""The antagonistic arm with its muscles' forces, beyond the characterised strains, as at the nearest of these."""
SPREAD = (20.0, 20.0, 5.0)
"""Loads are uniform within half of this either way [N, N, N·m]."""
LOADS, QUICK_LOADS = 100, 12
TIE = 1e-9
"""Unattainabilities [N] this close count as alike."""


@dataclass(frozen=True)
class Held:
    """A force model that does not extrapolate in strain."""

    model: ta.Actuator

    @property
    def bending_stiffness(self) -> Number | Bending:
        return self.model.bending_stiffness

    @property
    def max_pressure(self) -> Number:
        return self.model.max_pressure

    @property
    def strain_range(self) -> tuple[float, float]:
        return self.model.strain_range

    @property
    def pressure_range(self) -> tuple[float, float]:
        return self.model.pressure_range

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        return self.model.force(strain.clamp(*self.strain_range), pressure)


def held_arm() -> ta.ArmDesign:
    arm = ta.antagonistic_arm()
    return ta.ArmDesign(
        arm.radii, arm.length, [Held(model) if isinstance(model, ta.McKibben) else model for model in arm.actuators]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few loads, no file written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=150)
    from experiments.antagonism import figure

    loads = ta.sample_loads(LOADS, SPREAD)[: QUICK_LOADS if options.quick else LOADS]
    results = evaluate(loads)
    hulls = [hull for name in ARMS for shape in SHAPES for hull in node_hulls(name, shape, loads)]
    for table in (medians(results), winners(results), positions(hulls)):
        console.print(table)
    if options.quick:
        figure.draw_why(hulls, loads, BytesIO())
        return
    write_rows(HERE / "results.csv", results)
    write_rows(HERE / "hulls.csv", hulls)
    figure.draw_hulls(results, loads, HERE / "antagonism.png")
    figure.draw_why(hulls, loads, HERE / "why.png")
    console.print(f"wrote {len(results)} rows to results.csv, {len(hulls)} to hulls.csv, and two figures")


def evaluate(loads: Tensor) -> list[Result]:
    """Every arm on every shape under every load."""
    shapes = torch.stack([twists_of(shape) for shape in SHAPES])
    task = paper_task(shapes.unsqueeze(1), loads)
    builds = ARMS | {HELD: held_arm}
    exact = {name: ta.evaluate(build(), task, ("absolute", "relative")) for name, build in builds.items()}
    paper = {name: ta.evaluate(build(), task, ("absolute",), hull="edges", samples=3) for name, build in builds.items()}
    best = torch.stack([_absolute(exact[name]) for name in ARMS]).amin(0)
    rows = []
    for name, found in exact.items():
        reused = with_first_vertices(builds[name](), shapes, loads)
        assert found.relative is not None
        for place, shape in enumerate(SHAPES):
            for index, (force_x, force_y, moment) in enumerate(loads.tolist()):
                value = _absolute(found)[place, index].item()
                rows.append(
                    Result(
                        name,
                        *shape,
                        index + 1,
                        force_x,
                        force_y,
                        moment,
                        value,
                        found.relative[place, index].item(),
                        _absolute(paper[name])[place, index].item(),
                        reused[place, index].item(),
                        bool(found.converged[place, index]),
                        bool(found.in_range[place, index]),
                        value <= best[place, index].item() + TIE,
                    )
                )
    return rows


def _absolute(found: ta.Attainability) -> Tensor:
    assert found.absolute is not None
    return found.absolute


def with_first_vertices(arm: ta.ArmDesign, shapes: Tensor, loads: Tensor) -> Tensor:
    """Sums of distances (S, L) to hulls of the pressures that make the vertices of node 1's, of 3 points an edge.

    The published code finds which samples are vertices at node 1, and keeps to these at every node. Elsewhere they
    span less than the hull, so that distances come out too large.
    """
    pressure = ta.wrench_hulls(arm, shapes, hull="edges", samples=3).pressure[:, 0]  # (S, V, M)
    vertices = ta.reaction_wrench(arm, shapes.unsqueeze(1), pressure).transpose(1, 2)  # (S, N, V, 2)
    required = paper_wrench(shapes.unsqueeze(1), loads)[..., (0, 2)]  # (S, L, N, 2)
    return ta.distance_to_hull(required, vertices.unsqueeze(1)).sum(-1)


def node_hulls(name: str, shape: tuple[float, float], loads: Tensor) -> list[Hull]:
    """Where each node's set lies."""
    arm, twists = ARMS[name](), twists_of(shape)
    vertices = ta.wrench_hulls(arm, twists, samples=129).vertices
    required = paper_wrench(twists, loads)[..., (0, 2)].clone().requires_grad_()
    distance = ta.distance_to_hull(required, vertices.unsqueeze(0))
    (direction,) = torch.autograd.grad(distance.sum(), required)
    square = (distance.detach().unsqueeze(-1) * direction).square().sum(0)  # (N, 2)
    origin = ta.distance_to_hull(torch.zeros(2, dtype=vertices.dtype), vertices, signed=True)
    x, y = vertices.unbind(-1)
    area = 0.5 * (x * y.roll(-1, -1) - y * x.roll(-1, -1)).sum(-1)
    own = twists[:, :1] - arm.radii * twists[:, 2:]
    strain = (own - arm.length) / arm.length
    columns = [
        x.amin(-1),
        x.amax(-1),
        y.amin(-1),
        y.amax(-1),
        area,
        origin,
        (distance <= 0).double().mean(0),
        distance.detach().mean(0),
        square[:, 0] / square.sum(-1),
        strain.amin(-1),
        strain.amax(-1),
    ]
    return [Hull(name, *shape, node + 1, *row) for node, row in enumerate(torch.stack(columns, -1).tolist())]


# ---- tables ----------------------------------------------------------------------------------


def medians(rows: Sequence[Result]) -> Table:
    table = Table(title="unattainability [N]: medians over the loads", title_justify="left")
    headings = (
        "shape",
        "arm",
        "absolute",
        "attainable",
        "paper's edges",
        "node 1's vertices reused",
        "relative",
        "converged",
        "in range",
    )
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("shape", "arm") else "right")
    for shape in SHAPES:
        for name in (*ARMS, HELD):
            own = chosen(rows, name, shape)
            held = sum(row.absolute <= 0 for row in own)
            table.add_row(
                f"({shape[0]:g}, {shape[1]:g})",
                name,
                f"{median(own, 'absolute'):.2f}",
                f"{held} of {len(own)}",
                f"{median(own, 'absolute_paper'):.2f}",
                f"{median(own, 'absolute_reused'):.2f}",
                f"{median(own, 'relative'):.2f}",
                f"{sum(row.converged for row in own)}",
                "yes" if all(row.in_range for row in own) else "no",
            )
    return table


def median(rows: Sequence[Any], column: str) -> float:
    return float(np.median([getattr(row, column) for row in rows]))


def winners(rows: Sequence[Result]) -> Table:
    table = Table(title="loads on which an arm misses by least (ties count for each)", title_justify="left")
    for heading in ("shape", *ARMS):
        table.add_column(heading, justify="left" if heading == "shape" else "right")
    for shape in SHAPES:
        counts = [str(sum(row.wins for row in chosen(rows, name, shape))) for name in ARMS]
        table.add_row(f"({shape[0]:g}, {shape[1]:g})", *counts)
    return table


def positions(hulls: Sequence[Hull]) -> Table:
    """Means over the nodes."""
    table = Table(title="where the sets lie: means over the nodes", title_justify="left")
    headings = ("f from [N]", "to [N]", "origin [N]", "origin inside", "area [N²·m]", "held", "miss [N]", "of it force")
    for heading in ("shape", "arm", *headings):
        table.add_column(heading, justify="left" if heading in ("shape", "arm") else "right")
    for shape in SHAPES:
        for name in ARMS:
            own = chosen(hulls, name, shape)
            mean = {field.name: np.nanmean([getattr(row, field.name) for row in own]) for field in fields(Hull)[3:]}
            missed = sum(row.miss**2 for row in own)
            share = sum(row.miss**2 * row.miss_force for row in own if row.miss > 0) / missed if missed else 0.0
            table.add_row(
                f"({shape[0]:g}, {shape[1]:g})",
                name,
                f"{mean['force_min']:.1f}",
                f"{mean['force_max']:.1f}",
                f"{mean['origin']:.1f}",
                f"{sum(row.origin <= 0 for row in own)} of {len(own)}",
                f"{mean['area']:.0f}",
                f"{100 * mean['held']:.0f} %",
                f"{mean['miss']:.2f}",
                f"{100 * share:.0f} %",
            )
    return table
