"""`torcharm shape`: the shape an arm takes at a pressure, under a load."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torcharm.cli import options, outputs
from torcharm.cli.terminal import compiling_told, numbers, say
from torcharm.cli.work import arms_named, read_study

if TYPE_CHECKING:
    from torch import Tensor

    from torcharm.equilibrium import Equilibrium
    from torcharm.study import NamedArm


def shape(
    pressure: Annotated[
        str,
        typer.Option(
            "--pressure",
            help="Of each actuator, passive ones left out or 0: 20,10,0,5 [kPa], or '0.2 bar,3 psi,0,5'.",
        ),
    ],
    load: Annotated[
        str,
        typer.Option(
            "--load", help="At the tip: force x, force y [N], moment [N·m]; in space six; or '-200 gf', '30 N mm'."
        ),
    ] = "0",
    study: Annotated[
        Path | None, typer.Option("--study", help="Take the arm from a study.", show_default="the paper's")
    ] = None,
    arm: Annotated[str | None, typer.Option("--arm", help="Its name.", show_default="the first")] = None,
    nodes: options.Nodes = 10,
    gravity: Annotated[bool, typer.Option("--gravity", help="Let the arm and its links weigh.")] = False,
    figure: Annotated[Path | None, options.figure("Draw it")] = None,
) -> None:
    """Solve the forward mechanics of one arm: print the pose of its tip, and draw it on request.

    Each element's wrench is taken at its middle.
    """
    outputs.check(study, None, figure)
    from torcharm.equilibrium import solve_equilibrium
    from torcharm.load import ExternalLoad
    from torcharm.pressure.search import LESS_COMPRESSION
    from torcharm.study import paper_study
    from torcharm.study.units import WRENCHES

    plan = paper_study() if study is None else read_study(study)
    chosen = arms_named(plan, arm)[0]
    limits = chosen.design.max_pressure.tolist()
    pressures = _pressures(pressure, limits)
    units = list(WRENCHES[chosen.design.dimension].values())
    wrench = [0.0] * len(units) if load == "0" else numbers("--load", load, units)
    whole = ExternalLoad(wrench, gravity)
    with compiling_told():
        found = solve_equilibrium(chosen.design, pressures, whole, nodes)
    if not bool(found.converged):
        left = float(found.residual)
        why = f"the imbalance left is {left:.2g} of the load" if left > 1e-10 else "the only one found is folded"
        raise ValueError(
            f"no equilibrium was found for {chosen.name} at --pressure {pressure} under --load {load}: {why}"
        )
    say(f"{chosen.name}: tip at {_place(found.poses[-1])}")
    if not bool(found.continued):
        say("The arm snapped on the way to the full load: other shapes are possible.")
        say(f"To keep it from snapping, try {LESS_COMPRESSION}.")
    if not bool(found.stable):
        say("The arm would not stay there: this equilibrium is not stable.")
    above = [f"{given:g} of {limit:g}" for given, limit in zip(pressures, limits, strict=True) if given > limit]
    if above:
        say(f"Pressures are above the arm's limits: {', '.join(above)} kPa.")
    if not bool(found.in_range):
        excess = float(found.strain_excess)
        what = f"Strains are up to {excess:.2g} out of range" if excess > 1e-9 else "Pressures are out of range"
        say(f"{what}: there the force models are extrapolated.")
    outputs.save([(figure, lambda path: _draw(path, chosen, found), ".")] if figure else [])


def _place(pose: "Tensor") -> str:
    """Where a tip is, and where it points."""
    from torcharm.study.results import DEG, MM

    if pose.shape == (3,):
        x, y, angle = pose.tolist()
        return f"x {MM * x:.6g} mm, y {MM * y:.6g} mm, heading {DEG * angle:.6g}°"
    x, y, z = pose[:3, 3].tolist()
    direction = ", ".join(f"{one:.4g}" for one in pose[:3, 0])
    return f"x {MM * x:.6g} mm, y {MM * y:.6g} mm, z {MM * z:.6g} mm, pointing to ({direction})"


def _pressures(text: str, limits: Sequence[float]) -> list[float]:
    """Of each actuator [kPa]; those of passive ones, whose limit is 0, may be left out."""
    from torcharm.units import PRESSURE

    driven = [index for index, limit in enumerate(limits) if limit > 0]
    given = text.count(",") + 1
    if given != len(driven) or not driven:
        passive = len(limits) - len(driven)
        fewer = f", or {len(driven)} without the {passive} passive" if passive and driven else ""
        if given != len(limits):
            raise ValueError(f"--pressure: must be {len(limits)} numbers with commas between them{fewer}, got {text}")
        driven = list(range(len(limits)))
    found = dict(zip(driven, numbers("--pressure", text, [PRESSURE] * given), strict=True))
    return [found.get(index, 0.0) for index in range(len(limits))]


def _draw(path: Path, arm: "NamedArm", found: "Equilibrium") -> None:
    from matplotlib.figure import Figure

    from torcharm.plot import arm_shape

    figure = Figure(figsize=(6, 6), layout="constrained", dpi=150)
    projection = "3d" if arm.design.dimension == 3 else "rectilinear"
    arm_shape(arm.design, found, ax=figure.add_subplot(projection=projection)).set_title(arm.name)
    figure.savefig(path)
