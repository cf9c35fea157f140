"""The README's tables, from the rows."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from experiments.error_vs_runtime.rows import HERE, Row

README = HERE / "README.md"
START, END = "<!-- tables: written by the script -->", "<!-- end of tables -->"
MEASURED = ("µs a problem", "with gradient", "p50", "p99", "max", "≤ 1e-6", "≤ 1e-9", "MiB")
"""Headings of what `_numbers` says."""


def update(rows: Sequence[Row]) -> None:
    """Replace what stands between the README's marks."""
    before, rest = README.read_text().split(START)
    _, after = rest.split(END)
    README.write_text(f"{before}{START}\n\n{tables(rows)}\n{END}{after}")


def tables(rows: Sequence[Row]) -> str:
    """Sampling, worst of its cases, and solvers."""
    sets = {row.method: None for row in rows if row.family == "sets"}
    parts = [
        "Attainable sets, batch of 2,000, and in brackets the ten problems of one scene; times are means over the six",
        "cases, errors the largest of them:",
        "",
        *_head("method", "setting", "dtype", *MEASURED),
    ]
    for method in sets:
        own = [row for row in rows if row.family == "sets" and row.method == method]
        for setting, dtype in dict.fromkeys((row.setting, row.dtype) for row in own):
            alike = [row for row in own if (row.setting, row.dtype) == (setting, dtype)]
            large = [row for row in alike if row.batch > 100]
            small = [row for row in alike if row.batch <= 100]
            parts.append(_line([method, setting, dtype, *_numbers(large, small)]))
    parts += ["", *_turns([row for row in rows if row.family == "in turn"])]
    for case in dict.fromkeys(row.case for row in rows if row.family == "solvers"):
        own = [row for row in rows if row.family == "solvers" and row.case == case]
        parts += [
            "",
            f"Solvers, {case}; in brackets one problem a call:",
            "",
            *_head(
                "method", "setting", "dtype", "batch", *MEASURED, "primal", "dual", "gap", "resolved", "∇ p50", "∇ max"
            ),
        ]
        for row in own:
            if row.batch == 1:
                continue
            same = (row.method, row.setting, row.dtype)
            single = [one for one in own if one.batch == 1 and (one.method, one.setting, one.dtype) == same]
            residuals = [_short(value) for value in (row.primal_max, row.dual_max, row.gap_max)]
            slopes = [_short(value) for value in (row.slope_error_p50, row.slope_error_max)]
            cells = [*same, str(row.batch), *_numbers([row], single), *residuals, _share([row.resolved]), *slopes]
            parts.append(_line(cells))
    return "\n".join(parts)


def _turns(rows: Sequence[Row]) -> list[str]:
    """Times of polishing over those of samples, forward and with gradients."""
    polished = [method for method in dict.fromkeys(row.method for row in rows) if "polished" in method]
    batches = list(dict.fromkeys(row.batch for row in rows))
    parts = [
        "Time over that of 9 points a curve, forward / with gradient, measured in turn:",
        "",
        *_head("case", *(f"{method}, {batch:,}" for method in polished for batch in batches)),
    ]
    for case in dict.fromkeys(row.case for row in rows):
        cells = []
        for method in polished:
            for batch in batches:
                alike = [row for row in rows if (row.case, row.batch) == (case, batch)]
                (own,) = [row for row in alike if row.method == method]
                (other,) = [row for row in alike if row.method not in polished]
                forward = own.forward_median_s / other.forward_median_s
                gradient = own.gradient_median_s / other.gradient_median_s
                cells.append(f"{forward:.2f} / {gradient:.2f}")
        parts.append(_line([case, *cells]))
    return parts


def _numbers(large: Sequence[Row], small: Sequence[Row]) -> list[str]:
    forward = _time(row.forward_us_a_problem for row in large)
    gradient = _time(row.gradient_us_a_problem for row in large)
    if small:
        forward += f" ({_time(row.forward_us_a_problem for row in small)})"
        gradient += f" ({_time(row.gradient_us_a_problem for row in small)})" if gradient else ""
    errors = [_short(max(getattr(row, name) for row in large)) for name in ("error_p50", "error_p99", "error_max")]
    success = [_share([row.success_1e6 for row in large]), _share([row.success_1e9 for row in large])]
    return [forward, gradient, *errors, *success, f"{max(row.memory_mib for row in large):.0f}"]


def _time(values: Iterable[float]) -> str:
    mean = float(np.mean(list(values)))
    return "" if math.isnan(mean) else f"{mean:,.0f}" if mean >= 10 else f"{mean:.1f}"


def _short(value: float) -> str:
    return "" if math.isnan(value) else "0" if value == 0 else f"{value:.0e}"


def _share(values: Sequence[float]) -> str:
    mean = float(np.mean(values))
    return "" if math.isnan(mean) else f"{100 * mean:.4g} %"


def _head(*names: str) -> list[str]:
    return [_line(names), "|---" * len(names) + "|"]


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
