"""Pictures: who comes closest, at which length, towards which side and under which force; and which claims hold."""

import math
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

import torcharm as ta
from experiments.antagonism_in_space import scenes
from experiments.antagonism_in_space.claims import Claim
from experiments.antagonism_in_space.hulls import Hull
from torcharm import plot

if TYPE_CHECKING:
    from experiments.antagonism_in_space.rows import Length, Result

COLOURS = dict(zip(("antagonistic", "bellows", "muscles"), plot.ARM_COLOURS, strict=False))
MARKERS = {"antagonistic": "o", "bellows": "s", "muscles": "^"}
SHOWN = {
    "3 bellows outside, 3 muscles behind": "antagonistic",
    "6 bellows on the outer ring": "bellows",
    "6 muscles on the outer ring": "muscles",
}
"""The best of each kind, of six actuators."""
PICTURED = "to one side"
"""The force under which arms are drawn."""
METRICS = {"absolute": "absolute [N]", "relative": "relative [N]", "shape_mm": "predicted error [mm]"}


def draw(
    lengths: "Sequence[Length]", results: "Sequence[Result]", bodies: Sequence[Hull], path: Path | BytesIO
) -> None:
    """Three arms at what they reach, and their errors by length, side and force."""
    figure = Figure(figsize=(19, 13.5), layout="constrained")
    parts: Any = figure.subfigures(3, 1, height_ratios=(0.22, 1.15, 1))
    head, upper, lower = parts
    for place, name in enumerate(SHOWN):
        _arm(upper.add_subplot(1, 3, place + 1, projection="3d"), name, results)
    grid = lower.add_gridspec(1, 4, width_ratios=(1, 1, 1, 0.7))
    _by_length(lower.add_subplot(grid[0]), lengths)
    _by_side(lower.add_subplot(grid[1], projection="polar"), results)
    _by_force(lower.add_subplot(grid[2]), results)
    _moments(lower.add_subplot(grid[3]), bodies)
    medians = [f"{kind} {_median(results, name):.0f} mm" for name, kind in SHOWN.items()]
    head.suptitle(
        "In space, too, the antagonistic arm comes closest: bends to 24 sides, under 2 N from 14\n"
        f"median shape errors, each at the length that suits it: {', '.join(medians)}",
        fontsize="x-large",
        fontweight="bold",
    )
    figure.savefig(path, dpi=75)


def _median(results: "Sequence[Result]", name: str) -> float:
    return float(np.median([row.shape_mm for row in results if row.arm == name]))


def _arm(axes: Any, name: str, results: "Sequence[Result]") -> None:
    """An arm on the first bend, at what it is predicted to reach."""
    longer = next(row.longer for row in results if row.arm == name)
    arm, tasks, index = scenes.arms()[name], scenes.tasks(longer, 1), list(scenes.force_ways()).index(PICTURED)
    assert tasks.load.tip is not None
    load = ta.ExternalLoad(tip=tasks.load.tip[0, index], gravity=True)
    task = ta.Task(tasks.twists[0, 0], load=load)
    found = ta.predict_error(arm, task)
    plot.arm_shape(arm, task, reached=found.twists, ax=axes)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.05), fontsize="small", ncols=3, frameon=False)
    turned = math.degrees(float(found.tip_rotation_error))
    asked = f"asked to be {100 * (1 + longer):.0f} % as long as at rest"
    off = f"shape {1e3 * float(found.shape_error):.0f} mm off, tip turned by {turned:.0f}°"
    axes.set_title(f"{name}\n{asked}:\n{off}", fontweight="bold")
    axes.locator_params(axis="x", nbins=4)
    axes.locator_params(axis="y", nbins=3)


def _by_length(axes: Any, lengths: "Sequence[Length]") -> None:
    for name in dict.fromkeys(row.arm for row in lengths):
        own = [row for row in lengths if row.arm == name and row.in_range]
        kind, bold = scenes.kind_of(name), name in SHOWN
        axes.plot(
            [100 * row.longer for row in own],
            [row.shape_mm for row in own],
            color=COLOURS[kind],
            marker=MARKERS[kind],
            linewidth=2.5 if bold else 0.8,
            markersize=7 if bold else 4,
            alpha=1.0 if bold else 0.6,
            label=f"{name} (bold)" if bold else None,
        )
    axes.set(
        xlabel="shape longer than the arm at rest [%]",
        ylabel="median predicted shape error [mm]",
        title="Each kind has a length that suits it\n(all ten arms, characterised strains only)",
        ylim=(0, 190),  # room for the legend above the lines
    )
    axes.legend(fontsize="small")


def _by_side(axes: Any, results: "Sequence[Result]") -> None:
    for name, kind in SHOWN.items():
        sides: dict[float, list[float]] = {}
        for row in results:
            if row.arm == name:
                sides.setdefault(math.radians(row.direction), []).append(row.shape_mm)
        angles = [*sides, next(iter(sides))]
        axes.plot(
            angles, [np.median(sides[angle]) for angle in angles], color=COLOURS[kind], marker=MARKERS[kind], label=kind
        )
    bellows = np.arange(3) * 2 * math.pi / 3
    axes.plot(bellows, np.full(3, axes.get_rmax()), "k*", markersize=10, linestyle="", label="outer bellows")
    axes.set_title("By the side it bends to: median over forces [mm]")
    axes.set_rlabel_position(80)
    axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(-0.3, 1.08))


def _by_force(axes: Any, results: "Sequence[Result]") -> None:
    """Medians over bends, of the six forces along axes."""
    forces = [name for name in scenes.force_ways() if "," not in name]
    for shift, (name, kind) in zip((-0.25, 0, 0.25), SHOWN.items(), strict=True):
        values = [np.median([row.shape_mm for row in results if (row.arm, row.force) == (name, way)]) for way in forces]
        bars = axes.bar(np.arange(len(forces)) + shift, values, 0.25, color=COLOURS[kind], label=kind)
        axes.bar_label(bars, fmt="%.0f", fontsize="x-small")
    axes.set_xticks(range(len(forces)), [name.replace(" ", "\n") for name in forces])
    axes.tick_params(axis="x", labelsize="small")
    axes.set(ylabel="median predicted shape error [mm]", title="By the force of 2 N at the tip, seen from the bend")
    axes.legend(fontsize="small")


def _moments(axes: Any, bodies: Sequence[Hull]) -> None:
    """How far sets extend in moment at the force that weight asks for."""
    for place, (name, kind) in enumerate(SHOWN.items()):
        own = [row for row in bodies if row.arm == name]
        bar = axes.bar(place, np.median([row.moment for row in own]), color=COLOURS[kind])
        axes.bar_label(bar, fmt="%.1f")
    low, high = min(row.required for row in bodies), max(row.required for row in bodies)
    axes.set_xticks(range(len(SHOWN)), SHOWN.values())
    axes.set(ylabel="range of moments, weakest direction [N·m]")
    axes.set_title(f"Why: moment left at the\nforce of the weight, {low:.0f} to {high:.0f} N")


def draw_claims(results: "Sequence[Result]", sets: Sequence[Claim], path: Path | BytesIO) -> None:
    """Metrics against what searches reach, and by how much sets break the claims."""
    from experiments.antagonism_in_space.rows import ranks

    figure = Figure(figsize=(16, 10), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.15, 1))
    upper, lower = parts
    above, below = upper.subplots(1, 3, sharey=True), lower.subplots(1, 3, sharey=True)
    names = [name for name in SHOWN if any(row.arm == name for row in results)]
    for axes, (metric, label) in zip(above, METRICS.items(), strict=True):
        for name in names:
            own = [row for row in results if row.arm == name and math.isfinite(row.searched_mm)]
            rank, pairs = ranks(results, name)[metric]
            kind = SHOWN[name]
            axes.plot(
                [max(getattr(row, metric), 1e-2) for row in own],
                [row.searched_mm for row in own],
                MARKERS[kind],
                color=COLOURS[kind],
                markersize=4,
                alpha=0.6,
                label=f"{kind}: rank {rank:+.2f}, {100 * pairs:.0f} % of pairs in order",
            )
        axes.set(xlabel=label, xscale="log", yscale="log")
        axes.legend(fontsize="small")
    above[0].set_ylabel("shape error that a search reaches [mm]")
    above[0].set_title("Within an arm absolute unattainability ranks tasks,\nbetween arms it does not")
    above[1].set_title("Relative unattainability does not either:\nmuscles lack as little as the antagonistic arm")
    above[2].set_title("The predicted error is the error")
    _claim(
        below[0], sets, "outside_by", "half-sum of two reactions, outside by at most [N]", "Sets are not quite convex"
    )
    _claim(below[1], sets, "edges", "edges of the box fall short by at most [N]", "Edges do not quite bound them")
    _claim(below[2], sets, "three", "three points an edge fall short by at most [N]", "Three points do hardly worse")
    figure.savefig(path, dpi=75)


def _claim(axes: Any, sets: Sequence[Claim], field: str, label: str, title: str) -> None:
    names = list(dict.fromkeys(row.arm for row in sets))
    for shift, metric, colour, hatch in ((-0.2, "absolute", "0.35", ""), (0.2, "relative", "0.75", "//")):
        worst = [max(getattr(row, field) for row in sets if (row.arm, row.metric) == (name, metric)) for name in names]
        axes.barh(np.arange(len(names)) + shift, worst, 0.4, color=colour, hatch=hatch, edgecolor="white", label=metric)
    axes.set_yticks(range(len(names)), names, fontsize="small")
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set(xlabel=label, title=title)
    axes.legend(fontsize="small")
