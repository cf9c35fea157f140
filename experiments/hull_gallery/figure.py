"""The gallery and the violations, as pictures."""

from collections.abc import Sequence
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

import torcharm as ta
from experiments.hull_gallery import scenes
from experiments.hull_gallery.rows import Row, worst
from experiments.hull_gallery.scenes import Array
from experiments.hull_gallery.search import CurveSum, curve_sums, edge_image, examine, extreme_points
from torcharm import plot

HULL, REACTIONS, EDGES, GAP = "#0072B2", "#CC79A7", "#000000", "#D55E00"
CLAIMS = {
    "convex": ("the set is convex", "#D55E00", "o"),
    "boundary": ("its boundary is the image of the box's boundary", "#0072B2", "s"),
    "edges": ("the box's edges give its hull", "#009E73", "^"),
}
LEAST = 1e-4
SHOWN_NODE = 2


def draw_gallery(path: Path | BytesIO) -> None:
    """A row for each shape: the arm, one node's set, and all nodes' sets with the reactions to 150 pressures."""
    arm = ta.antagonistic_arm()
    figure = Figure(figsize=(19, 14.5), layout="constrained")
    pressures = scenes.interior_pressures(arm)
    for place, shape in enumerate(scenes.SHAPES):
        twists = scenes.twists(shape)
        axes = figure.add_subplot(3, 4, 4 * place + 1)
        plot.arm_shape(arm, ta.Task(twists, [0.0, 0.0, 0.0]), ax=axes)
        axes.set_title(f"curvature {shape[0]:g} s {shape[1]:+g}", fontweight="bold")
        reaction = ta.reaction_wrench(arm, twists, pressures).numpy()
        _node(figure.add_subplot(3, 4, 4 * place + 2), arm, shape, reaction[:, SHOWN_NODE - 1])
        for column, relative in ((3, False), (4, True)):
            own = reaction - reaction[:, :1] if relative else reaction
            hulls = ta.wrench_hulls(arm, twists, relative=relative).vertices.numpy()
            deep = figure.add_subplot(3, 4, 4 * place + column, projection="3d")
            _along_arm(deep, hulls, own, relative)
    figure.suptitle(
        "Attainable sets of the antagonistic arm: reactions to 150 pressures fill the hulls, and hardly leave them",
        fontsize="x-large",
        fontweight="bold",
    )
    figure.savefig(path, dpi=75)


def _node(axes: Axes, arm: ta.ArmDesign, shape: tuple[float, float], reaction: Array) -> None:
    sums = curve_sums(arm, scenes.twists(shape).numpy(), relative=False)[SHOWN_NODE - 1]
    corner, _, _ = extreme_points(sums)
    axes.fill(*corner.T, facecolor=HULL, alpha=0.2, label="hull, exact")
    curves = edge_image(sums, 65).reshape(-1, 65, 2)
    for index, curve in enumerate(curves):
        axes.plot(*curve.T, color=EDGES, linewidth=0.8, label="the box's 32 edges" if index == 0 else None)
    points = edge_image(sums, scenes.EDGE_POINTS)
    axes.plot(*points.T, "s", color=HULL, markersize=4, label=f"{scenes.EDGE_POINTS} points an edge")
    axes.plot(*reaction.T, ".", color=REACTIONS, markersize=4, label=f"{len(reaction)} pressures inside")
    axes.set(xlabel=r"force $f_x$ [N]", ylabel=r"moment $m$ [N·m]", title=f"node {SHOWN_NODE}")
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, top + 0.32 * (top - bottom))  # room for the legend
    axes.legend(fontsize="small", loc="upper left")


def _along_arm(axes: Any, hulls: Array, reaction: Array, relative: bool) -> None:
    nodes = np.arange(1.0, len(hulls) + 1)
    for node, ring in zip(nodes, hulls, strict=True):
        corners = np.insert(np.concatenate((ring, ring[:1])), 0, node, axis=1)
        axes.add_collection3d(Poly3DCollection([corners], facecolor=HULL, edgecolor="none", alpha=0.15))
        axes.plot(*corners.T, color=HULL, linewidth=1.2, label="hulls" if node == 1 else None)
    index = np.broadcast_to(nodes[:, None], (*reaction.shape[:-1], 1))
    broken = np.pad(np.concatenate((index, reaction), -1), ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
    if relative:  # as in the paper, points alone
        axes.plot(*broken.reshape(-1, 3).T, ".", color=REACTIONS, markersize=2, label="reactions")
    else:
        axes.plot(*broken.reshape(-1, 3).T, color=REACTIONS, linewidth=0.35, label="reactions, a line a pressure")
    force, moment = (r"$f_x - f_{x,1}$ [N]", r"$m - m_1$ [N·m]") if relative else (r"$f_x$ [N]", r"$m$ [N·m]")
    axes.set(xlabel="node i", ylabel=force, zlabel=moment, title="relative" if relative else "absolute")
    for axis in (axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(3))
    axes.set_box_aspect((1.5, 1.0, 1.0), zoom=0.88)
    axes.view_init(elev=20, azim=-55)
    axes.legend(fontsize="small", loc="upper left")


def draw_violations(rows: Sequence[Row], path: Path) -> None:
    """Left, the worst of each case and claim; right, for each claim the worst of the paper's arms in their ranges."""
    figure = Figure(figsize=(17, 10), layout="constrained")
    panels: Any = figure.subfigures(1, 2, width_ratios=(1.15, 1))
    left, right = panels
    _overview(left.subplots(), rows)
    paper = [row for row in rows if row.case.endswith("(paper)") and row.metric == "absolute"]
    paper = [row for row in paper if row.monotonic and row.in_range]
    for axes, claim in zip(right.subplots(3, 1), CLAIMS, strict=True):
        _example(axes, worst(paper, claim), claim)
    off = max(getattr(row, claim) for row in rows if row.case.endswith("(paper)") for claim in CLAIMS)
    figure.suptitle(f"None of the three claims holds exactly: the paper's arms break them by up to {off:.1f} N")
    figure.savefig(path, dpi=85)


def _overview(axes: Axes, rows: Sequence[Row]) -> None:
    names = list(dict.fromkeys(row.case for row in rows))
    for (claim, (label, colour, marker)), offset in zip(CLAIMS.items(), (-0.25, 0.0, 0.25), strict=True):
        for place, name in enumerate(names):
            own = [row for row in rows if row.case == name]
            fair = [row for row in own if row.monotonic and row.in_range]
            sizes = np.maximum([getattr(row, claim) for row in own], LEAST)
            axes.plot(sizes, np.full(len(sizes), place + offset), marker, color=colour, ms=3, alpha=0.25, mew=0)
            axes.plot(sizes.max(), place + offset, marker, color=colour, ms=9, mfc="none", mew=1.6)
            if fair:
                top = max(getattr(worst(fair, claim), claim), LEAST)
                axes.plot(top, place + offset, marker, color=colour, ms=9, label=label if place == 0 else None)
    for place in range(1, len(names)):
        axes.axhline(place - 0.5, color="0.85", lw=0.7)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xticks([LEAST, 1e-3, 1e-2, 1e-1, 1, 10], ["0", "0.001", "0.01", "0.1", "1", "10"])
    axes.set_xlabel("violation [N, 1 N·m counted as 1 N]")
    axes.set_title("worst: open; among characterised strains and monotonic forces: filled; small: each set")
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), title="claim", loc="lower center", bbox_to_anchor=(0.4, 1.03), ncols=3)


def _example(axes: Axes, row: Row, claim: str) -> None:
    case = next(case for case in scenes.CASES if case.name == row.case)
    shape = (row.slope, row.intercept)
    sums = curve_sums(case.build(), scenes.twists(shape).numpy(), relative=row.metric == "relative")[row.node - 1]
    violation = getattr(examine(sums), claim)
    corner, _, _ = extreme_points(sums)
    ring = np.concatenate((corner, corner[:1]))
    cloud = _cloud(sums)
    axes.plot(*cloud.T, ",", color=REACTIONS)
    axes.plot([], [], "o", color=REACTIONS, ms=3, label="reactions to pressures inside")
    image = edge_image(sums, 129).reshape(-1, 129, 2)
    for index, curve in enumerate(image):
        axes.plot(*curve.T, color=EDGES, lw=0.9, label="to the box's edges" if index == 0 else None)
    axes.plot(*ring.T, color=HULL, lw=1.8, ls="--", label="the set's convex hull")
    ends = np.stack((violation.point, violation.nearest))
    axes.plot(*ends.T, color=GAP, lw=2.5, marker="o", ms=5, label=f"off by {violation.size:.2f} N")
    # A view around the gap, at one scale for newtons and newton-metres.
    middle, reach = ends.mean(0), 2.6 * max(violation.size, 0.05)
    axes.set(xlim=middle[0] + 1.8 * np.array([-reach, reach]), ylim=middle[1] + np.array([-reach, reach]))
    axes.set_aspect("equal", adjustable="box")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set(xlabel=r"force $f_x$ [N]", ylabel=r"moment $m$ [N·m]")
    axes.set_title(
        f"not so: “{CLAIMS[claim][0]}”\n{row.case}, shape ({shape[0]:g}, {shape[1]:g}), node {row.node}",
        fontsize="medium",
    )
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)


def _cloud(sums: CurveSum) -> Array:
    """Reactions to pressures inside the box: a grid and random ones."""
    count = {1: 400, 2: 200, 3: 40, 4: 18}[sums.actuators]
    grid = np.array(list(product(np.linspace(0, 1, count), repeat=sums.actuators)))
    drawn = np.random.default_rng(1).beta(0.3, 0.3, (200_000, sums.actuators))
    return sums.at(np.concatenate((grid, drawn)))
