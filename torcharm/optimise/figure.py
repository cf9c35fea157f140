"""A picture of an optimisation: how the values fell, and the arm's section before and after."""

from typing import TYPE_CHECKING

from torcharm.arm import ArmDesign
from torcharm.optimise.result import OptimisedDesign

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def optimisation_figure(result: OptimisedDesign, title: str = "") -> "Figure":
    """Values of all starts against the iterations, and radii against lengths of the given and the best design."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    history, section = figure.subplots(1, 2)
    values = result.history.values
    history.plot(values.numpy(), color="0.75", linewidth=1)
    history.plot(result.history.best.numpy(), color="black", linewidth=2, label="best of all starts")
    history.set(xlabel="iteration", ylabel="value", title=title)
    if bool((values > 0).all()) and float(values.max() / values.min()) > 20:
        history.set_yscale("log")
    history.legend(frameon=False)
    kinds = list(dict.fromkeys(type(model).__name__ for model in result.best.actuators))
    for arm, filled in ((result.given, False), (result.best, True)):
        _draw_section(section, arm, kinds, filled)
    section.set(xlabel="radius [mm]", ylabel="neutral length [mm]", title="open: given; filled: best")
    section.legend(frameon=False)
    return figure


def _draw_section(axes: "Axes", arm: ArmDesign, kinds: list[str], filled: bool) -> None:
    for index, kind in enumerate(kinds):
        own = [place for place, model in enumerate(arm.actuators) if type(model).__name__ == kind]
        colour = COLOURS[index % len(COLOURS)]
        face = colour if filled else "none"
        radii, length = 1e3 * arm.radii[own].numpy(), 1e3 * arm.length[own].numpy()
        axes.scatter(radii, length, s=80, edgecolors=colour, facecolors=face, label=kind if filled else None)
