"""Pictures of force models and of the recordings they were fitted to.

As in `torcharm.plot`, nothing is shown, and no setting is changed.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.stats import binned_statistic_2d

from torcharm.actuators import Actuator
from torcharm.arm import find_model
from torcharm.characterise.alignment import Recording, held_strains
from torcharm.characterise.fit import FittedActuator
from torcharm.characterise.monotonicity import monotonicity
from torcharm.plot._common import Array, axes_or_new

ModelLike = Actuator | str | Path
"""A force model, the name of a shipped one, or the path of its file."""

MODEL, DATA, WARNING = "#D55E00", "#0072B2", "#CC79A7"
STRAINS = "viridis"
"""Colour map of held strains; its lightness alone tells the order."""
RESIDUALS = "PuOr"
"""Colour map of residuals, white at zero."""
POINTS = 81
FEW = 500
"""Samples up to which each has a dot that is seen by itself."""
MOST_DOTS = 4000
"""Samples drawn as dots; of more, every so many."""
NEUTRAL = 0.005
"""Strains up to which samples are shown as those at the neutral length."""


def force_at_held_strains(
    model: ModelLike, recording: Recording, *, ax: Axes | None = None, max_pressure: float | None = None
) -> Axes:
    """Force against pressure at each strain that was held: dots are samples, lines the model, colour the strain.

    Args:
        model: any force model, or what stands for one in an arm.
        recording: in which strains are held (see `held_strains`).
        ax: 2-D axes to draw in; None makes some.
        max_pressure: where lines end [kPa]; None ends each where its samples do.

    Raises:
        ValueError: no strain is held, or the axes are not 2-D.
    """
    model = find_model("model", model)
    holds = held_strains(recording)
    if not holds:
        raise ValueError("recording: must hold the strain still at times, got none that does")
    axes = axes_or_new(ax)
    levels = [float(np.median(recording.strain[hold])) for hold in holds]
    norm = Normalize(min(levels), max(levels) if len(levels) > 1 else min(levels) + 1)
    colours = colormaps[STRAINS]
    every = max(1, sum(map(len, holds)) // (3 * MOST_DOTS))
    for level, hold in zip(levels, holds, strict=True):
        colour = colours(norm(level))
        pressure, force = recording.pressure[hold], recording.force[hold]
        style: dict[str, Any] = {"markersize": _dot(recording), "alpha": 0.35}
        if _is_few(recording):
            style |= {"alpha": 1.0, "zorder": 3}
        axes.plot(pressure[::every], force[::every], ".", color=colour, **style)
        line = np.linspace(0, pressure.max() if max_pressure is None else max_pressure, POINTS)
        axes.plot(line, _force(model, np.full(POINTS, level), line), color="white", linewidth=3.2)
        axes.plot(line, _force(model, np.full(POINTS, level), line), color=colour, linewidth=1.8)
    scale: Any = axes.figure.colorbar(ScalarMappable(norm, colours), ax=axes, label="held strain ε")
    scale.set_ticks(levels, labels=[f"{level:.2f}" for level in levels])
    axes.plot([], [], ".", color="0.4", label="recorded")
    axes.plot([], [], color="0.4", linewidth=1.8, label="model")
    axes.set(xlabel="pressure p [kPa]", ylabel="force f of one actuator [N]")
    axes.legend(loc="best" if _is_few(recording) else "upper left", frameon=False)
    return axes


def characterisation_figure(model: ModelLike, recording: Recording) -> Figure:
    """One page on a fit, for `figure.savefig(path)`: held strains, surface, residuals, free strain, blocked force.

    Where no strain is held, the surface has their place.
    """
    model = find_model("model", model)
    figure = Figure(figsize=(15.0, 9.5), layout="constrained")
    grid = figure.add_gridspec(2, 6)
    held = bool(held_strains(recording))
    if held:
        force_at_held_strains(model, recording, ax=figure.add_subplot(grid[0, :3]))
    _draw_surface(figure.add_subplot(grid[0, 3 * held :], projection="3d"), model, recording)
    _draw_residuals(figure.add_subplot(grid[1, :2]), model, recording)
    _draw_free_strain(figure.add_subplot(grid[1, 2:4]), model)
    _draw_blocked_force(figure.add_subplot(grid[1, 4:]), model, recording)
    figure.suptitle(_findings(model, recording), fontweight="bold")
    return figure


def _draw_surface(axes: Any, model: Actuator, recording: Recording) -> None:
    """Force over the characterised box as a surface, with the samples that it was fitted to, in 3-D axes."""
    strain, pressure, force = _surface(model)
    colours = {"color": MODEL, "alpha": 0.45, "edgecolor": MODEL, "linewidth": 0.3}
    axes.plot_surface(strain, pressure, force, rcount=17, ccount=17, shade=False, label="model", **colours)
    few = slice(None, None, max(1, len(recording.force) // MOST_DOTS))
    dots = (recording.strain[few], recording.pressure[few], recording.force[few])
    axes.plot(*dots, ".", color=DATA, markersize=_dot(recording), alpha=0.5, label="recorded")
    axes.set(xlabel="strain ε", ylabel="pressure p [kPa]", zlabel="force f [N]")
    axes.view_init(elev=22, azim=-125)
    axes.legend(loc="upper left", fontsize="small", frameon=False, markerscale=1 if _is_few(recording) else 6)


def _draw_residuals(axes: Any, model: Actuator, recording: Recording) -> None:
    """Mean residual, recorded minus model, over strain and pressure; white where it is zero, blank without samples.

    A line goes around the region over which the model says it was measured.
    """
    residual = recording.force - _force(model, recording.strain, recording.pressure)
    counts = [min(most, len(np.unique(own))) for own, most in ((recording.pressure, 45), (recording.strain, 21))]
    mean, *edges, _ = binned_statistic_2d(recording.pressure, recording.strain, residual, bins=counts)
    mean = np.ma.masked_invalid(mean)  # of bins without samples
    # lopsided outliers are drawn as the end of the scale
    most = float(np.percentile(np.abs(mean.compressed()), 98)) or 1.0
    mesh = axes.pcolormesh(*edges, mean.T, cmap=RESIDUALS, vmin=-most, vmax=most)
    axes.set_facecolor("0.93")
    axes.figure.colorbar(mesh, ax=axes, extend="both", label="recorded - model [N]")
    region = getattr(model, "region", ())
    if region:
        strains, pressures = zip(*region, region[0], strict=True)
        axes.plot(pressures, strains, color=MODEL, linewidth=1.5, clip_on=False)
    rmse, outlined = float(np.sqrt((residual**2).mean())), "; outlined: where measured" if region else ""
    axes.set(xlabel="pressure p [kPa]", ylabel="strain ε", title=f"residuals, RMSE {rmse:#.3g} N{outlined}")


def _draw_free_strain(axes: Any, model: Actuator) -> None:
    """Strain at which the actuator pushes and pulls on nothing: a muscle's free contraction, a bellows' extension.

    Where the model is not monotonic in pressure the background is hatched.
    """
    strain, pressure, force = _surface(model)
    if force.min() < 0 < force.max():
        axes.contour(pressure, strain, force, [0.0], colors=MODEL, linewidths=2.5)
        axes.plot([], [], color=MODEL, linewidth=2.5, label="no force")
    else:
        axes.plot([], [], " ", label="force is never 0 in this range")
    shape = monotonicity(model)
    if not shape.monotonic:
        assert shape.failing_strain is not None
        assert shape.failing_pressure is not None
        (left, right), (low, high) = shape.failing_pressure, shape.failing_strain
        box = {"facecolor": "none", "edgecolor": WARNING, "hatch": "///", "linewidth": 0}
        axes.fill_between([left, right], low, high, label="not monotonic in p, within", **box)
    axes.set(xlabel="pressure p [kPa]", ylabel="free strain ε", ylim=model.strain_range)
    axes.set_xlim(*model.pressure_range)
    axes.legend(loc="best", frameon=False)


def _draw_blocked_force(axes: Any, model: Actuator, recording: Recording) -> None:
    """Force at the neutral length against pressure, with samples near it."""
    near = np.flatnonzero(np.abs(recording.strain) <= NEUTRAL)
    near = near[:: max(1, len(near) // MOST_DOTS)]
    style: dict[str, Any] = {"color": DATA, "markersize": _dot(recording), "label": f"recorded, |ε - 0| ≤ {NEUTRAL:g}"}
    axes.plot(recording.pressure[near], recording.force[near], ".", alpha=0.5, **style)
    pressure = np.linspace(*model.pressure_range, POINTS)
    axes.plot(pressure, _force(model, np.zeros(POINTS), pressure), color=MODEL, linewidth=2.5, label="model")
    axes.set(xlabel="pressure p [kPa]", ylabel="blocked force at ε = 0 [N]")
    axes.legend(loc="best", frameon=False, markerscale=1 if _is_few(recording) else 4)


def _findings(model: Actuator, recording: Recording) -> str:
    quality = model.quality if isinstance(model, FittedActuator) else None
    count = f"{len(recording.force):,} samples, {int(recording.run.max()) + 1} run(s)"
    if quality is None:
        return count
    shape = quality.monotonicity
    trend = "everywhere" if shape.monotonic else f"up to {shape.up_to:.1f} kPa"
    held_out = "".join(f", run {one.run + 1} from the others {one.r_squared:.4f}" for one in quality.hold_out)
    return f"R² {quality.r_squared:.4f}{held_out}; RMSE {quality.rmse:#.3g} N; monotonic in pressure {trend}; {count}"


def _is_few(recording: Recording) -> bool:
    """Whether samples are so few, as of a table, that each is to be seen."""
    return len(recording.force) <= FEW


def _dot(recording: Recording) -> float:
    """The size of a sample's dot."""
    return 7.0 if _is_few(recording) else 1.5


def _surface(model: Actuator) -> tuple[Array, Array, Array]:
    """Strains, pressures and forces (POINTS, POINTS) over the model's characterised box."""
    axes = (np.linspace(*ends, POINTS) for ends in (model.strain_range, model.pressure_range))
    strain, pressure = np.meshgrid(*axes, indexing="ij")
    return strain, pressure, _force(model, strain, pressure)


@torch.no_grad()
def _force(model: Actuator, strain: Array, pressure: Array) -> Array:
    return np.asarray(model.force(torch.from_numpy(strain), torch.from_numpy(pressure)).detach().cpu())
