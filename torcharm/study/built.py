"""What is found of a study's arms as they are built, as tables and as rows of a file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from torcharm.design.scatter import SOURCE_WORDS
from torcharm.design.tolerance_result import BuiltArms
from torcharm.inputs import three_digits
from torcharm.study.data import NamedArm, NamedTask
from torcharm.study.results import MM, file_columns


@dataclass(frozen=True)
class BuiltStudy:
    """What is found of one arm on one task."""

    arm: NamedArm
    task: NamedTask
    built: BuiltArms


def built_columns(found: Sequence[BuiltStudy]) -> Iterator[tuple[str, str, list[str]]]:
    """Titles, units and cells of a table with a row for each arm on one task."""
    every = [one.built for one in found]
    if any(built.interruption for built in every):
        yield "built", "", [f"{len(built.tip_error)} of {built.wanted}" for built in every]
    drawn = [MM * float(np.median(built.nominal_tip_error)) for built in every]
    yield "tip off, drawn", "mm", [three_digits(value) for value in drawn]
    for percent in (50, 95):
        values = [MM * float(built.pooled_percentile(percent)) for built in every]
        yield f"{percent} % within", "mm", [three_digits(value) for value in values]
    each = [100 * float(built.within.double().mean()) for built in every]
    yield "yield, each load", "%", [f"{value:.1f}" for value in each]
    whole = [built.yield_of_all for built in every]
    ends = [f"{100 * one.value:.1f} ({100 * one.low:.1f}-{100 * one.high:.1f})" for one in whole]
    yield "yield, all loads", "%", ends
    yield "what fails", "", [built.failing or "-" for built in every]
    if all(built.margin is not None for built in every):
        low = [float(built.margin.quantile(0.05)) for built in every if built.margin is not None]
        yield "margin, 5 % below", "N", [three_digits(value) for value in low]
    yield "beyond range", "%", [f"{100 * built.extrapolated:.0f}" for built in every]
    yield "what scatters the tip", "", [_shares(built) for built in every]


def _shares(built: BuiltArms) -> str:
    """The largest first."""
    ordered = sorted(built.shares.items(), key=lambda pair: -pair[1])
    return ", ".join(f"{SOURCE_WORDS[name]} {100 * share:.0f} %" for name, share in ordered) if built.decisive else "-"


def built_rows(found: Sequence[BuiltStudy]) -> Iterator[dict[str, Any]]:
    """A row for each arm, task and load."""
    for one in found:
        columns = file_columns(one.arm, one.built.to_dict())
        more = {"samples": len(one.built.tip_error), "stopped": one.built.stopped}
        for load, *values in zip(*columns.values(), strict=True):
            lead = {"arm": one.arm.name, "task": one.task.name, "load": load + 1}
            yield lead | dict(zip(list(columns)[1:], values, strict=True)) | more
