"""A picture of an optimisation: errors on every task, and the arm's section, before and after."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torcharm.actuators import model_name
from torcharm.arm import ArmDesign
from torcharm.design.result import OptimisedDesign
from torcharm.plot._common import ARM_COLOURS, ATTAINABLE, UNATTAINABLE, mark_inks
from torcharm.statics.balance import segments_of


def optimisation_figure(result: OptimisedDesign, title: str = "") -> Figure:
    """Tip errors predicted on every task, in ascending order, and where actuators sit, of the given and best design.

    The section shows radii against lengths of an arm in the plane, and offsets in space.
    """
    figure = Figure(figsize=(10, 4), layout="constrained")
    errors, section = figure.subplots(1, 2)
    for side, name, colour, dash in (
        (result.before, "given", UNATTAINABLE, "--"),
        (result.after, "best", ATTAINABLE, "-"),
    ):
        found = side.tip_error[side.stable]
        values = (1e3 * found.sort().values).tolist()
        left = (
            f", {len(side.stable) - len(values)} without a stable equilibrium" if len(values) < len(side.stable) else ""
        )
        label = f"{name}: mean {side.tip_mm:.3g} mm{left}"
        dots = {"marker": "o", "markersize": 3} if len(values) == 1 else {}  # a line of one point is none
        errors.step(range(1, len(values) + 1), values, where="mid", color=colour, linestyle=dash, label=label, **dots)
    errors.set(xlabel="tasks, the nearest first", ylabel="predicted tip error [mm]", title=title, ylim=(0, None))
    errors.legend(frameon=False)
    planar = result.best.dimension == 2
    names = ("radius [mm]", "neutral length [mm]") if planar else ("offset y [mm]", "offset z [mm]")
    kinds = list(dict.fromkeys(map(model_name, result.best.actuators)))
    for arm, filled in ((result.given, False), (result.best, True)):
        for segment in segments_of(arm)[0]:
            _draw_section(section, segment, kinds, filled)
    section.set(xlabel=names[0], ylabel=names[1], title="open: given; filled: best")
    labels: dict[str, Any] = dict(zip(*reversed(section.get_legend_handles_labels()), strict=True))
    section.legend(labels.values(), labels.keys(), frameon=False)
    return figure


def _draw_section(axes: Axes, arm: ArmDesign, kinds: list[str], filled: bool) -> None:
    for index, kind in enumerate(kinds):
        own = [place for place, model in enumerate(arm.actuators) if model_name(model) == kind]
        colour = ARM_COLOURS[index % len(ARM_COLOURS)]
        other = arm.length if arm.out_of_plane is None else arm.out_of_plane
        across, along = (1e3 * value.detach()[own].numpy(force=True) for value in (arm.radii, other))
        axes.scatter(across, along, s=80, label=kind if filled else None, **mark_inks(colour, filled))
