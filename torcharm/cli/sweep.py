"""`torcharm sweep`: a whole space of designs evaluated on the tasks of a study, into a folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.tables import Column, print_table
from torcharm.cli.terminal import compiling_told, count, say
from torcharm.cli.work import Work, arms_named, read_study

if TYPE_CHECKING:
    from torcharm.study import NamedArm, Study
    from torcharm.sweeps import SweepResult, SweepRows

COUNT = "1e6"
"""Designs, unless told otherwise."""
SHOWN = 10
"""Rows of the tables, unless told otherwise."""


def sweep(
    study: Annotated[
        Path | None, typer.Argument(help="A study, as TOML; its table [optimise] says what may change, and how far.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="The folder of the results. The same command goes on where it ended.")
    ] = None,
    number: Annotated[
        str | None, typer.Option("--count", help="Designs, up to 1e9.", metavar="NUMBER", show_default=COUNT)
    ] = None,
    levels: Annotated[
        int | None, typer.Option("--levels", help="A grid of so many levels of each free value, instead of --count.")
    ] = None,
    arm: Annotated[str | None, typer.Option("--arm", help="Name of the [[arm]].", show_default="the only one")] = None,
    metrics: Annotated[
        str | None,
        typer.Option("--metrics", help="absolute, relative, predicted_error; or some.", show_default="the study's"),
    ] = None,
    reduce: Annotated[
        str, typer.Option("--reduce", help="What is kept of all tasks: mean, worst, or a quantile such as 0.9.")
    ] = "mean",
    seed: Annotated[
        int | None, typer.Option("--seed", help="Of the designs drawn.", show_default="the study's")
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", help="Processes of this machine.", show_default="one for each core")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", help="Run on a Dask cluster, at this address: tcp://10.0.0.1:8786.")
    ] = None,
    shard: Annotated[
        str | None, typer.Option("--shard", help="Compute one part only: 3/64 is the third of 64.", metavar="K/N")
    ] = None,
    show: Annotated[Path | None, typer.Option("--show", help="Show what a folder holds, and compute nothing.")] = None,
    by: Annotated[
        str | None, typer.Option("--by", help="The column that ranks designs.", show_default="the first metric")
    ] = None,
    rows: Annotated[int, typer.Option("--rows", min=1, help="Of the tables.")] = SHOWN,
    figure: Annotated[Path | None, options.figure("Draw that column against size")] = None,
) -> None:
    """Evaluate a whole space of designs of an arm, on all tasks of a study.

    Results are kept in shards: Ctrl-C, or whatever ends it, costs none that is finished, and the same command goes on.
    Prints the best designs, and those that no other beats in both the metric and the size.
    """
    from torcharm.sweeps import open_sweep

    outputs.check(study, None, figure)
    if show is not None:
        others = {"STUDY": study, "--out": out, "--shard": shard, "--scheduler": scheduler}
        given = [name for name, value in others.items() if value is not None]
        if given:
            raise ValueError(f"--show: stands alone, got {show} and {' and '.join(given)}")
        _tell(open_sweep(show), by, rows, figure)
        return
    if study is None or out is None:
        missing = "STUDY" if study is None else "--out"
        raise ValueError(f"{missing}: must be given, unless --show is")
    how: dict[str, Any] = {"workers": workers, "executor": scheduler, "shard": _part(shard), "out": out}
    how |= {"reduce": _reduce(reduce)} | _sampling(number, levels)
    plan = read_study(study)
    chosen = arms_named(plan, arm)
    if len(chosen) > 1:
        raise ValueError(f"--arm: must name one of the study's arms: {', '.join(one.name for one in chosen)}")
    result = _run(plan, chosen[0], metrics, seed, how)
    _tell(result, by, rows, figure)
    Work(interrupted=result.interrupted).finish(range(result.finished))


def _run(plan: "Study", arm: "NamedArm", metrics: str | None, seed: int | None, options: dict[str, Any]) -> Any:
    """Sweep an arm's space on its tasks, with a bar."""
    from torcharm.sweeps import sweep as sweep_designs

    how, settings = plan.optimisation, plan.settings
    for name, value, only in (("hull", settings.hull, "exact"), ("distance", settings.distance, "gjk")):
        if value != only:
            raise ValueError(f"evaluate.{name}: must be {only} for a sweep, got {value}")
    options |= {name: getattr(settings, name) for name in ("tolerance", "weights", "power")}
    options["metrics"] = settings.metrics if metrics is None else [name.strip() for name in metrics.split(",")]
    options["seed"] = how.seed if seed is None else seed
    tasks = [named.task for named in plan.tasks_of(arm)]
    with compiling_told():
        return sweep_designs(arm.design, how.space, tasks, **options)


def _part(shard: str | None) -> tuple[int, int] | None:
    if shard is None:
        return None
    first, _, last = shard.partition("/")
    if not (first.isdecimal() and last.isdecimal() and 1 <= int(first) <= int(last)):
        raise ValueError(f"--shard: must be K/N with K from 1 to N, such as 3/64, got {shard}")
    return int(first), int(last)


def _reduce(given: str) -> str | float:
    try:
        return float(given)
    except ValueError:
        return given


def _sampling(number: str | None, levels: int | None) -> dict[str, Any]:
    if levels is not None:
        if number is not None:
            raise ValueError(f"--count: must be left out where --levels is given, got {number}")
        return {"sampling": "grid", "levels": levels}
    try:
        whole = float(COUNT if number is None else number)
        if not whole.is_integer() or whole < 1:
            raise ValueError
    except (ValueError, OverflowError):
        raise ValueError(f"--count: must be a whole number of at least 1, such as 1e6, got {number}") from None
    return {"count": int(whole)}


def _tell(result: "SweepResult", by: str | None, rows: int, figure: Path | None) -> None:
    """Counts, the best designs and the Pareto set; and a figure, once a design is feasible."""
    from torcharm.sweeps.ranking import label, rankings

    column = rankings(result.columns)[0] if by is None else result.column(by)
    share = 100 * result.feasible / max(result.finished, 1)
    say(f"{result.finished:,} of {result.count:,} designs, {result.feasible:,} ({share:.3g} %) feasible.")
    tasks = count(result.manifest.tasks, "task")
    said = ", ".join(f"{number:,} {name.replace('_', ' ')}" for name, number in result.verdicts.items() if number)
    say(f"Each feasible one on {tasks}: {said or 'nothing yet'}.")
    best = result.best(rows, column)
    if len(best):
        say()
        say(f"The best by {label(column)}:")
        print_table(_columns(result, best))
    front = result.pareto(column, "size") if column in result.manifest.numbers else None
    if front is not None and len(front) and column != "size_mm":
        say()
        thinned = f"{rows} of {len(front)}" if len(front) > rows else len(front)
        say(f"No other is both smaller and better by {label(column)}: {thinned}")
        places = sorted({round(place * (len(front) - 1) / max(rows - 1, 1)) for place in range(rows)})
        print_table(_columns(result, front.taken(places)))
    if not result.complete:
        say()
        missing = result.manifest.shards - len(result.summary.shards)
        say(f"{missing:,} of {count(result.manifest.shards, 'shard')} are missing: the same command goes on.")
    if figure is not None:
        outputs.save([(figure, lambda path: result.plot("size", column).savefig(path), ".")])


def _columns(result: "SweepResult", found: "SweepRows") -> list[Column]:
    """Designs, what was found of them, and their free values."""
    from torcharm.sweeps.ranking import label

    table = {name: found[name] for name in result.columns if name != "feasible"} | result.free_columns(found.indices)
    lengths = ("size_mm", *result.free_values)
    return [
        Column(label(name, "\n"), _cells(values.tolist(), ".1f" if name in lengths else ".4g"))
        for name, values in table.items()
        if name not in result.manifest.counts or values.any()
    ]


def _cells(values: Sequence[float], form: str) -> list[str]:
    return [str(value) if isinstance(value, int) else format(value, form) for value in values]
