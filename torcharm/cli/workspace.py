"""`torcharm workspace`: where the arms of a study can reach with a payload."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import count, numbers, say
from torcharm.cli.work import Told, Work, arms_named, read_study

if TYPE_CHECKING:
    from torcharm.study import NamedArm
    from torcharm.workspaces import Workspace

    Found = Sequence[tuple[NamedArm, Workspace]]


def workspace(
    study: options.Study = None,
    payload: Annotated[
        str | None,
        typer.Option(
            "--payload",
            help="At the tip: a mass, 0.2 [kg] or '200 g'; or force x, force y [N], moment [N·m]; in space six.",
            show_default="none",
        ),
    ] = None,
    arm: Annotated[str | None, typer.Option("--arm", help="The name of one.", show_default="all")] = None,
    states: Annotated[int, typer.Option("--states", help="Equilibria of each arm.")] = 20_000,
    nodes: options.Nodes = 10,
    base: Annotated[str, typer.Option("--base", help="How the arm is mounted: hanging, upright, horizontal.")] = (
        "hanging"
    ),
    gravity: Annotated[bool, typer.Option(help="Let the arm, its links and the payload weigh.")] = True,
    show: Annotated[
        str | None,
        typer.Option(
            "--show",
            help="What the figure's colours tell: payload factor, angle range, or reached for none.",
            show_default="payload factor, if there is one",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write a row for every arm and state, to a file .csv or .json.")
    ] = None,
    figure: Annotated[Path | None, options.figure("Draw the arms side by side")] = None,
) -> None:
    """Where can the tip be with a payload, over all pressures, loading from rest? And what could it carry there?

    Ctrl-C ends it and shows what was found until then.
    """
    from torcharm.geometry.rod import HEADINGS
    from torcharm.inputs import check_choice, check_count
    from torcharm.study import RESULT_FORMATS, example_study, workspace_rows

    outputs.check(study, out, figure, RESULT_FORMATS)
    check_count("--states", states, 100)
    check_count("--nodes", nodes, 1)
    check_choice("--base", base, tuple(HEADINGS))
    plan = example_study() if study is None else read_study(study)
    chosen = arms_named(plan, arm)
    _check_figure(chosen, figure, payload, show)
    if payload is not None and "," not in payload:  # a wrench may fit some of the arms
        _payload(payload, chosen[0].design.dimension)
    how, work, started = {"nodes": nodes, "base_pose": base, "gravity": gravity}, Work(), time.perf_counter()
    found = find_workspaces(chosen, payload, states, how, work)
    if found:
        _report(found, time.perf_counter() - started)
        rows = [row for one in found for row in workspace_rows(*one)] if out is not None else []
        drawn = [(figure, lambda path: _draw(path, found, show), ".")] if figure is not None else []
        outputs.save([*outputs.rows(out, rows), *drawn])
    work.finish(found)


def _check_figure(arms: Sequence["NamedArm"], figure: Path | None, payload: str | None, show: str | None) -> None:
    """Raise a ValueError about a figure that cannot be drawn, before the work is done."""
    from torcharm.inputs import check_choice

    if show is not None:
        check_choice("--show", show, ("payload factor", "angle range", "reached"))
        if show == "payload factor" and payload is None:
            raise ValueError("--show: payload factor needs a --payload")
    if figure is not None and len({one.design.dimension for one in arms}) > 1:
        raise ValueError("--figure: must be of arms all in the plane or all in space; choose by --arm")


def find_workspaces(
    arms: Sequence["NamedArm"], payload: str | None, states: int, how: dict[str, Any], work: Work
) -> "list[tuple[NamedArm, Workspace]]":
    """What is found of the arms; `how` has further arguments of `torcharm.workspace`."""
    from torcharm.workspaces import workspace as find_workspace

    def found(arm: "NamedArm", design: Any, told: Told) -> "Iterator[tuple[NamedArm, Workspace]]":
        given = None if payload is None else _payload(payload, design.dimension)
        one = find_workspace(design, given, states=states, callback=lambda done, _: told(done, arm.name), **how)
        yield arm, one
        if one.stopped == "interrupted":
            raise KeyboardInterrupt

    return work.each("workspace", [(arm, arm.design) for arm in arms], found, states)


def _payload(text: str, dimension: int) -> float | list[float]:
    """A mass [kg] or a wrench [N, N·m]."""
    from torcharm.inputs import check_number
    from torcharm.study.units import WRENCHES
    from torcharm.units import MASS

    if "," in text:
        found = numbers("--payload", text, list(WRENCHES[dimension].values()))
        return [check_number("--payload", one) for one in found]
    try:
        mass = numbers("--payload", text, [MASS])[0]
    except ValueError as error:
        example = "0, -2, 0" if dimension == 2 else "0, -2, 0, 0, 0, 0"
        several = f"force and moment as numbers separated by commas, 3 in the plane and 6 in space: {example}"
        raise ValueError(f"{error}; or {several}") from None
    return check_number("--payload", mass, 0.0, unit="kg")


def _report(found: "Found", seconds: float) -> None:
    """A row for each arm, and what the columns mean."""
    print_table(list(_columns(found)))
    say()
    say("reached: by stable equilibria that loading from rest leads to, within characterised strains and")
    say("pressures; extrapolated: beyond these, too. furthest: from the base; lowest, highest: y.")
    shares = [one.shares for _, one in found]
    for word, meaning in MEANINGS.items():
        if any(own[word] > 0 for own in shares):
            say(f"{word}: {meaning}.")
    if any(one.has_payload for _, one in found):
        say("payload x: the largest factor by which the payload could grow anywhere, if each node had pressures")
        say("of its own: an upper bound of what the arm bears.")
    for arm, one in found:
        if one.interruption:
            say(f"{arm.name}: {one.interruption}; the region is smaller or coarser than that of all.")
        if one.unsettled:
            say(f"{arm.name}: {one.unsettled}; ask for more by --states.")
    states = sum(len(one.code) for _, one in found)
    say(f"{count(states, 'state')} in {seconds:.2g} s.")


MEANINGS = {
    "excluded by range": "share of states beyond characterised strains or pressures",
    "snapped": "share of states that the arm gets to by a jump only",
    "unstable": "share of states where the arm would not stay",
    "not converged": "share of pressures for which no equilibrium was found",
    "impossible": "share of pressures for which the only one found leaves a length below 0",
}


def _columns(found: "Found") -> Iterator[Column]:
    from torcharm.inputs import three_digits
    from torcharm.study.results import MM

    yield Column("arm", [arm.name for arm, _ in found], LONGEST_WORD)
    for dimension, unit, scale in ((2, "cm²", 1e4), (3, "dm³", 1e3)):
        own = [one if one.dimension == dimension else None for _, one in found]
        if any(own):
            cells = ["-" if one is None else three_digits(scale * one.size) for one in own]
            yield Column(f"reached\n[{unit}]", cells)
            cells = ["-" if one is None else three_digits(scale * one.extrapolated_region.size) for one in own]
            yield Column(f"extrapolated\n[{unit}]", cells)
    yield Column("furthest\n[mm]", [three_digits(MM * one.reach) for _, one in found])
    for index, word in enumerate(("lowest", "highest")):
        yield Column(f"{word}\n[mm]", [three_digits(MM * one.heights[index]) for _, one in found])
    for word in MEANINGS:
        shares = [100 * one.shares[word] for _, one in found]
        if any(shares):
            title = word.replace("excluded by range", "excluded\nby range").replace("not conv", "not\nconv")
            yield Column(f"{title} [%]" if "\n" in title else f"{title}\n[%]", [*map(three_digits, shares)])
    if any(one.has_payload for _, one in found):
        best = [one.payload_factor[one.reached] for _, one in found]
        yield Column("payload\nx", [three_digits(float(own.max())) if len(own) else "-" for own in best])


def _draw(path: Path, found: "Found", show: str | None) -> None:
    from torcharm.plot import workspace_figure

    workspace_figure([(arm.name, one) for arm, one in found], show).savefig(path)
