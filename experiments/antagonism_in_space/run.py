"""Ask in space what the paper asks in the plane: who comes closest, why, and which of its claims hold there.

Writes lengths.csv (one row an arm and length), results.csv (one row an arm, bend and force, at the arm's best length),
hulls.csv and claims.csv (one row a node's set), antagonism_in_space.png and claims.png beside this file.
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

import torcharm as ta
from experiments.antagonism_in_space import scenes
from experiments.antagonism_in_space.claims import Claim, claims
from experiments.antagonism_in_space.hulls import Hull, hulls
from experiments.antagonism_in_space.rows import Length, Result, ranks
from experiments.rows import write_rows

HERE = Path(__file__).parent
COARSE = 12
"""Directions in which lengths are compared and pressures searched: every other one."""
SIDES, NODES = (0, 2, 4), [0, 4, 9]
"""Directions, as their numbers, and nodes whose sets are examined; by symmetry the other directions' are alike."""
ALIKE = -0.06
"""The length at which every strain of every arm is characterised."""
QUICK_ARMS = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few arms and directions, no file written")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    console = Console(width=150)
    from experiments.antagonism_in_space import figure

    arms = dict(list(scenes.arms().items())[: QUICK_ARMS if quick else None])
    lengths = [row for name, arm in arms.items() for row in by_length(name, arm, 1 if quick else COARSE)]
    best = {name: suiting(lengths, name) for name in arms}
    count = 2 if quick else scenes.DIRECTIONS
    results = [row for name, arm in arms.items() for row in by_task(name, arm, best[name], count, 2)]
    sets = [row for name, arm in arms.items() for row in by_set(name, arm, best[name], quick)]
    bodies = [row for name, arm in arms.items() for row in by_body(name, arm, best[name], quick)]
    sets += by_set("3 bellows", scenes.three_bellows(), 0.12, quick)
    for table in (arms_table(lengths, results), bodies_table(bodies), ranks_table(results), claims_table(sets)):
        console.print(table)
    for sentence in (between_arms(results), sampling(results), symmetry(results)):
        console.print(sentence)
    if quick:
        figure.draw_claims(results, sets, BytesIO())
        return
    write_rows(HERE / "lengths.csv", lengths)
    write_rows(HERE / "results.csv", results)
    write_rows(HERE / "hulls.csv", bodies)
    write_rows(HERE / "claims.csv", sets)
    figure.draw(lengths, results, bodies, HERE / "antagonism_in_space.png")
    figure.draw_claims(results, sets, HERE / "claims.png")


def by_length(name: str, arm: ta.ArmDesign, count: int) -> Iterator[Length]:
    """The arm on shapes that are as long as itself, longer and shorter; those beyond its range are only named."""
    for longer in scenes.LENGTHS:
        task = scenes.tasks(longer, count)
        within = bool(ta.evaluate(arm, task, ("absolute",)).shape_in_range.all())
        if not within:
            yield Length(name, longer, within, math.nan, math.nan, math.nan, math.nan, math.nan)
            continue
        found = ta.evaluate(arm, task)
        assert found.shape_error is not None
        assert found.tip_error is not None
        values = (1e3 * found.shape_error, 1e3 * found.tip_error, found.absolute, found.relative)
        medians = [round(float(value.median()), 4) for value in values if value is not None]
        yield Length(name, longer, within, float(np.mean(np.asarray(found.verdict) == "held")), *medians)


def suiting(lengths: Sequence[Length], name: str) -> float:
    """The length at which the arm comes closest, of those whose strains are characterised."""
    own = [row for row in lengths if row.arm == name and row.in_range]
    return min(own, key=lambda row: row.shape_mm).longer


def by_task(name: str, arm: ta.ArmDesign, longer: float, count: int, every: int) -> Iterator[Result]:
    """Every bend under every force; of every other bend the search, and the paper's sampling."""
    task = scenes.tasks(longer, count)
    found = ta.evaluate(arm, task)
    few = scenes.tasks(longer, count // every)
    searched = ta.search_pressure(arm, few)
    sampled = ta.evaluate(arm, few, ("absolute",), hull="edges", samples=3).absolute
    assert found.prediction is not None
    assert found.absolute is not None
    assert found.relative is not None
    assert sampled is not None
    verdict = np.asarray(found.verdict)
    for side, towards in enumerate(scenes.directions(count).tolist()):
        for index, force in enumerate(scenes.force_ways()):
            looked, own = side % every == 0, (side // every, index)
            error = float(searched.shape_error[own]) if looked else math.nan
            numbers = (
                1e3 * float(found.prediction.shape_error[side, index]),
                1e3 * float(found.prediction.tip_error[side, index]),
                math.degrees(float(found.prediction.tip_rotation_error[side, index])),
                float(found.absolute[side, index]),
                float(found.relative[side, index]),
                1e3 * error if math.isfinite(error) else math.nan,
            )
            shape, tip, turn, absolute, relative, reached = (round(number, 4) for number in numbers)
            yield Result(
                name,
                longer,
                round(math.degrees(towards), 6),
                force,
                str(verdict[side, index]),
                shape,
                tip,
                turn,
                absolute,
                relative,
                reached,
                bool(looked and searched.converged[own]),
                round(float(sampled[own]), 4) if looked else math.nan,
            )


def by_set(name: str, arm: ta.ArmDesign, longer: float, quick: bool) -> Iterator[Claim]:
    """The sets of some nodes, bent to some sides."""
    twists = scenes.tasks(longer).twists[:, 0]
    for side in SIDES[:1] if quick else SIDES:
        angle = 360.0 * side / scenes.DIRECTIONS
        yield from claims(name, arm, twists[side], angle, NODES[1:2] if quick else NODES)


def by_body(name: str, arm: ta.ArmDesign, longer: float, quick: bool) -> Iterator[Hull]:
    """Where the same sets lie, under a hanging weight."""
    task = scenes.tasks(longer)
    down = list(scenes.force_ways()).index("down")
    assert task.load.tip is not None
    for side in SIDES[:1] if quick else SIDES:
        load = ta.ExternalLoad(tip=task.load.tip[side, down], gravity=True)
        angle = 360.0 * side / scenes.DIRECTIONS
        yield from hulls(name, arm, task.twists[side, 0], load, angle, NODES[1:2] if quick else NODES)


# ---- what rows say ------------------------------------------------------------------------------


def between_arms(results: Sequence[Result]) -> str:
    """Rank correlations, over the arms, of metrics' medians with the median error that searches reach."""
    names = list(dict.fromkeys(row.arm for row in results))
    searched = [row for row in results if math.isfinite(row.searched_mm)]

    def medians(field: str) -> list[float]:
        return [float(np.median([getattr(row, field) for row in searched if row.arm == name])) for name in names]

    found = {
        metric: float(spearmanr(medians(metric), medians("searched_mm")).statistic)
        for metric in ("absolute", "relative", "shape_mm")
    }
    return f"between the arms' medians, rank correlation: {', '.join(f'{k} {v:+.2f}' for k, v in found.items())}"


def sampling(results: Sequence[Result]) -> str:
    """By how much the paper's three points an edge overstate absolute unattainability."""
    more = np.array([row.edges - row.absolute for row in results if math.isfinite(row.edges)])
    return f"three points an edge overstate absolute unattainability by at most {more.max():.2f} N"


def symmetry(results: Sequence[Result]) -> str:
    """Arms of threefold symmetry must err alike when they bend to sides 120° apart: how far predictions differ."""
    found: dict[tuple[str, str, float], list[float]] = {}
    for row in results:
        found.setdefault((row.arm, row.force, row.direction % 120), []).append(row.shape_mm)
    spread = np.array([max(own) - min(own) for own in found.values() if np.isfinite(own).all()])
    return (
        f"sides 120° apart: predictions alike within 0.1 mm in {100 * (spread < 0.1).mean():.0f} % of "
        f"{len(spread)} groups, largest difference {spread.max():.0f} mm"
    )


def arms_table(lengths: Sequence[Length], results: Sequence[Result]) -> Table:
    table = Table(title="each arm at the length that suits it: medians over bends and forces", title_justify="left")
    headings = ("arm", "longer", "held", "shape [mm]", "tip [mm]", "tip [°]", "searched [mm]", "off")
    for heading in (*headings, "absolute [N]", "relative [N]", "at -6 % [mm]"):
        table.add_column(heading, justify="left" if heading == "arm" else "right")
    for name in dict.fromkeys(row.arm for row in results):
        own = [row for row in results if row.arm == name]
        looked = [row for row in own if math.isfinite(row.searched_mm)]
        off = [abs(row.shape_mm - row.searched_mm) for row in looked]
        held = sum(row.verdict == "held" for row in own) / len(own)
        medians = [np.median([getattr(row, field) for row in own]) for field in ("shape_mm", "tip_mm", "tip_deg")]
        sets = [np.median([getattr(row, field) for row in own]) for field in ("absolute", "relative")]
        searched = np.median([row.searched_mm for row in looked])
        table.add_row(
            name,
            f"{100 * own[0].longer:+.0f} %",
            f"{100 * held:.0f} %",
            *(f"{value:.1f}" for value in (*medians, searched, np.median(off))),
            *(f"{value:.2f}" for value in sets),
            *(f"{row.shape_mm:.1f}" for row in lengths if row.arm == name and row.longer == ALIKE),
        )
    return table


def bodies_table(bodies: Sequence[Hull]) -> Table:
    title = "where sets lie; moments at the force that weight asks for, medians"
    table = Table(title=title, title_justify="left")
    for heading in ("arm", "forces [N]", "asked for [N]", "moments range over [N·m]", "volume [N·(N·m)²]"):
        table.add_column(heading, justify="left" if heading == "arm" else "right")
    for name in dict.fromkeys(row.arm for row in bodies):
        own = [row for row in bodies if row.arm == name]
        table.add_row(
            name,
            f"{min(row.force_min for row in own):.0f} to {max(row.force_max for row in own):.0f}",
            f"{min(row.required for row in own):.1f} to {max(row.required for row in own):.1f}",
            f"{np.median([row.moment for row in own]):.2f}",
            f"{np.median([row.volume for row in own]):.0f}",
        )
    return table


def ranks_table(results: Sequence[Result]) -> Table:
    table = Table(title="which metric knows the searched error? rank correlation, pairs in order", title_justify="left")
    for heading in ("arm", "searches", "absolute", "relative", "predicted"):
        table.add_column(heading, justify="left" if heading == "arm" else "right")
    for name in dict.fromkeys(row.arm for row in results):
        cells = [f"{rank:+.2f}, {100 * pairs:.0f} %" for rank, pairs in ranks(results, name).values()]
        count = sum(math.isfinite(row.searched_mm) for row in results if row.arm == name)
        table.add_row(name, str(count), *cells)
    return table


def claims_table(sets: Sequence[Claim]) -> Table:
    table = Table(title="sets: half-sums outside, and how far edges fall short [N]", title_justify="left")
    headings = ("arm", "metric", "nodes with one outside", "half-sums outside", "by at most", "of the size")
    for heading in (*headings, "edges", "three points"):
        table.add_column(heading, justify="left" if heading in ("arm", "metric") else "right")
    for name in dict.fromkeys(row.arm for row in sets):
        for metric in ("absolute", "relative"):
            own = [row for row in sets if (row.arm, row.metric) == (name, metric)]
            nodes = sum(row.outside > 0 for row in own)
            outside, tried = sum(row.outside for row in own), sum(row.tried for row in own)
            share = max(row.outside_by / row.size for row in own)
            table.add_row(
                name,
                metric,
                f"{nodes} of {len(own)}",
                f"{100 * outside / tried:.0f} %",
                f"{max(row.outside_by for row in own):.3f}",
                f"{100 * share:.2f} %",
                f"{max(row.edges for row in own):.3f}",
                f"{max(row.three for row in own):.3f}",
            )
    return table
