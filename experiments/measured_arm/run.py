"""Compare the tip of a measured silicone module with the model's, by published constants and by fitted hypotheses.

Reads measured_arms/silicone_module.csv of $TORCHARM_DATA; writes results.csv (one row a state and hypothesis),
limits.csv (the rod against closed forms) and measured_arm.png beside this file. Without the data only the limits.
"""

import argparse
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize_scalar

from experiments.measured_arm import figure
from experiments.measured_arm.limits import Limit, limits
from experiments.measured_arm.module import END_LENGTH, LENGTH, Hypothesis, States, read_states, tips
from experiments.measured_arm.rows import Row
from experiments.rows import write_rows

HERE = Path(__file__).parent
PUBLISHED = "published"
SHORT = Hypothesis(short_of_tip=1.0)
HYPOTHESES: dict[str, tuple[str, tuple[float, float], Hypothesis]] = {
    "Young's modulus": ("young", (0.5, 3.0), Hypothesis()),
    "chambers thin or swell": ("thinning", (-3.0, 3.0), Hypothesis()),
    "stiffer with pressure": ("stiffening", (0.0, 10.0), Hypothesis()),
    "twists": ("twisting", (0.0, 3.0), Hypothesis()),
    "pulled short of the tip": ("short_of_tip", (0.0, 1.0), Hypothesis()),
    "pulled there, and chambers swell": ("thinning", (-3.0, 3.0), SHORT),
}
"""Names, the field that is fitted, between which values, and what else is assumed."""
ACCURACY = 1e-3
"""Of a fitted value."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: one hypothesis, no file written")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    console = Console(width=120)
    found = list(limits())
    console.print(limits_table(found))
    if not quick:
        write_rows(HERE / "limits.csv", found)
    path = Path(os.environ.get("TORCHARM_DATA", "")) / "measured_arms" / "silicone_module.csv"
    if not path.is_file():
        console.print("TORCHARM_DATA names no folder with measured_arms: the limits only.")
        return
    states = read_states(path)
    rows = list(compared(states, dict(list(HYPOTHESES.items())[:1]) if quick else HYPOTHESES))
    console.print(table(rows))
    if not quick:
        write_rows(HERE / "results.csv", rows)
        figure.draw(states, tips(Hypothesis(), states), rows).savefig(HERE / "measured_arm.png", dpi=110)


def compared(
    states: States, hypotheses: dict[str, tuple[str, tuple[float, float], Hypothesis]] = HYPOTHESES
) -> Iterator[Row]:
    """The published model, then each hypothesis fitted on every other state and judged on the rest, both ways."""
    count = len(states.case)
    yield from rows_of(PUBLISHED, states, Hypothesis(), 0.0, range(count))
    for name, (field, ends, base) in hypotheses.items():
        for first in (0, 1):
            seen, unseen = range(first, count, 2), range(1 - first, count, 2)
            value = fitted(states, field, ends, list(seen), base)
            yield from rows_of(name, states, replace(base, **{field: value}), value, unseen)


def fitted(states: States, field: str, ends: tuple[float, float], seen: list[int], base: Hypothesis) -> float:
    """The value with the least mean tip error on the states seen."""

    def missed(value: float) -> float:
        apart = (tips(replace(base, **{field: value}), states) - states.tip)[seen].norm(dim=-1)
        return float(apart.nan_to_num(1.0).mean())

    return float(minimize_scalar(missed, bounds=ends, method="bounded", options={"xatol": ACCURACY}).x)


def rows_of(name: str, states: States, how: Hypothesis, value: float, which: range) -> Iterator[Row]:
    straight = torch.tensor([0.0, -(LENGTH + END_LENGTH), 0.0], dtype=torch.float64)
    apart, moved = (tips(how, states) - states.tip).norm(dim=-1), (states.tip - straight).norm(dim=-1)
    for index in which:
        errors = 1e3 * float(apart[index]), 1e3 * float(moved[index])
        yield Row(name, states.case[index], states.number[index], bool(states.pulled[index]), value, *errors)


def table(rows: list[Row]) -> Table:
    shown = Table(box=None, title="Tip errors, mm; fitted ones on states that were not seen", title_justify="left")
    for heading in ("", "value", "not pulled: median", "largest", "pulled: median", "largest", "all: mean"):
        shown.add_column(heading, justify="right" if heading else "left")
    for name in dict.fromkeys(row.hypothesis for row in rows):
        own = [row for row in rows if row.hypothesis == name]
        cells: list[str] = []
        for pulled in (False, True):
            errors = [row.tip_error_mm for row in own if row.pulled is pulled]
            cells += [f"{np.median(errors):.1f}", f"{np.max(errors):.1f}"]
        values = ", ".join(f"{value:.2f}" for value in dict.fromkeys(row.value for row in own))
        mean = f"{np.mean([row.tip_error_mm for row in own]):.1f}"
        shown.add_row(name, "-" if name == PUBLISHED else values, *cells, mean)
    return shown


def limits_table(found: list[Limit]) -> Table:
    shown = Table(box=None, title="The rod against closed forms", title_justify="left")
    for heading in ("limit", "closed form", "nodes", "model", "off by"):
        shown.add_column(heading, justify="left" if heading in ("limit", "closed form") else "right")
    for one in found:
        off = f"{one.off:.1e}"
        shown.add_row(one.name, one.formula, str(one.nodes), f"{one.model:.6g} {one.unit}", off)
    return shown
