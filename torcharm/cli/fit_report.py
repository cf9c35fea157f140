"""What `torcharm fit` says of a model: its numbers, how good they are, where it was measured, and what was not."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from torcharm.cli.tables import Column, print_table
from torcharm.cli.terminal import count, say

if TYPE_CHECKING:
    from torcharm.actuators import Actuator
    from torcharm.characterise.alignment import Recording
    from torcharm.characterise.choice import Candidate
    from torcharm.characterise.fit import FittedActuator


def report(model: "Actuator", recording: "Recording", compared: Sequence["Candidate"]) -> None:
    """Print all of it.

    Args:
        model: that was fitted.
        recording: to which.
        compared: kinds of models, the chosen one first; none if the kind was given.
    """
    from torcharm.characterise.fit import FittedActuator

    if isinstance(model, FittedActuator):
        print_table(_coefficients(model))
        say()
    for part in (_comparison(recording, compared), _quality(model, recording), _limits(model), _reading(recording)):
        for line in part:
            say(line)


def _coefficients(model: "FittedActuator") -> list[Column]:
    assert model.quality is not None
    terms, values, errors = [], [], [f"{error:.2g}" for error in model.quality.standard_errors]
    for i, j, value in model.coefficients:
        powers = (("ε", i), ("p", j))
        terms.append(" ".join(f"{name}{'' if power == 1 else f'^{power}'}" for name, power in powers if power))
        values.append(f"{value:.5g}")
    return [Column("term", terms, 24), Column("coefficient", values), Column("standard error", errors)]


def _comparison(recording: "Recording", compared: Sequence["Candidate"]) -> Iterator[str]:
    """How each kind of model predicts what it was not fitted to, and why one was chosen."""
    if not compared:
        return
    most = abs(recording.force).max()
    for one in compared:
        off = one.reason or f"{one.rmse:.3g} N off, {100 * one.rmse / most:.2g} % of the largest force"
        yield f"{one.kind} ({count(one.numbers, 'number')}), on samples left out: {off}"
    best = min(compared, key=lambda one: one.rmse)
    why = "least off" if compared[0] is best else f"fewest numbers of those about as good as {best.kind}"
    yield f"Taken: {compared[0].kind}, {why}; --model takes another"


def _quality(model: "Actuator", recording: "Recording") -> Iterator[str]:
    import numpy as np

    from torcharm.characterise.choice import forces
    from torcharm.characterise.fit import FittedActuator

    residual = recording.force - forces(model, recording.strain, recording.pressure)
    worst, most = float(np.abs(residual).max()), float(np.abs(recording.force).max())
    quality = model.quality if isinstance(model, FittedActuator) else None
    rmse, spread = float(np.sqrt((residual**2).mean())), float(recording.force.std())
    yield f"R² {1 - (rmse / spread) ** 2:.5f}, RMSE {rmse:.3g} N, {count(len(residual), 'sample')}"
    yield f"At most {worst:.3g} N off, {100 * worst / most:.2g} % of the largest force"
    for held in quality.hold_out if quality else ():
        yield f"Run {held.run + 1} from the others: R² {held.r_squared:.5f}, RMSE {held.rmse:.3g} N"


def _limits(model: "Actuator") -> Iterator[str]:
    """Where the model was measured, and what it holds that was not."""
    from torcharm.actuators.measured import Measured
    from torcharm.characterise.doubts import covered
    from torcharm.characterise.fit import FittedActuator

    (low, high), (first, last) = model.strain_range, model.pressure_range
    yield f"Characterised for strains from {low:.3f} to {high:.3f}, pressures from {first:.3g} to {last:.3g} kPa"
    region = getattr(model, "region", ())
    if region and isinstance(model, Measured):
        yield f"and in {100 * covered(model):.0f} % of that box: in the region of all samples, which the file holds"
    shape = model.quality.monotonicity if isinstance(model, FittedActuator) and model.quality else None
    if shape is not None and shape.failing_strain is None:
        yield "Monotonic in pressure all over that range"
    elif shape is not None and shape.failing_strain is not None:
        where = "at strains from {:.3f} to {:.3f}".format(*shape.failing_strain)
        yield f"Monotonic in pressure up to {shape.up_to:.1f} kPa; beyond, not everywhere {where}"
    beyond = shape is not None and model.max_pressure > shape.up_to
    why = ", beyond that; --max-pressure sets another" if beyond else ""
    yield f"Highest pressure in use: {model.max_pressure:.1f} kPa{why}"
    if getattr(model.bending_stiffness, "assumed", False):
        yield (
            f"Bending stiffness: {model.bending_stiffness.stiffness:.3g} N·m², which the paper estimated for its own "  # type: ignore[union-attr]
            "bellows and muscles, is assumed: such data do not tell this actuator's; --bending sets it"
        )


def _reading(recording: "Recording") -> Iterator[str]:
    """What was left out, averaged or assumed of the files, and how they were brought together."""
    for name, value in recording.settings:
        if name.startswith(("offset", "smoothing", "notes", "certainty", "positive", "strains", "pressures")):
            yield f"{name[0].upper()}{name[1:]}: {value if isinstance(value, str) else f'{value:.1f}'}"
