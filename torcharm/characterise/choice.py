"""Which kind of force model describes samples best: each predicts samples that it was not fitted to.

Kinds are compared by their error on strains and pressures, runs or times that were left out, and not by how well they
follow the samples that they were given: a grid follows anything.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torcharm.actuators.protocol import Actuator
from torcharm.characterise.alignment import MOST_LEVELS, Recording, is_table
from torcharm.characterise.fit import fit_recording, provenance_of
from torcharm.characterise.gridded_fit import fit_gridded_model
from torcharm.characterise.least_squares import Array, Powers, exponents
from torcharm.inputs import check_choice

MCKIBBEN: Powers = ((0, 1), (1, 1), (2, 1), (1, 0), (2, 0), (3, 0))
"""Terms of a McKibben-type model: a pull in proportion to pressure, `p (a + b ε + c ε²)`, as follows from a braid's
geometry (Chou and Hannaford 1996, Tondu and Lopez 2000), and the tube's own elasticity, a cubic."""
GRID = 12
"""Strains and pressures of the grid for samples that are no table."""
BLOCKS = 5
"""Parts of a single run, one after the other in time, that are left out in turn."""
ALIKE = 1.1
"""Errors within this factor of the least are alike: the model of fewest numbers is taken then."""
SHARED = ("max_pressure", "bending_stiffness")
"""Options of polynomials that a grid has, too."""
EXACT = 1e-3
"""Of the largest force, an error that is as good as none: tables are printed to about as much."""


@dataclass(frozen=True)
class Candidate:
    """A kind of model, and how it predicts what it was not fitted to.

    Attributes:
        kind: polynomial, mckibben or gridded.
        numbers: how many the model holds.
        rmse: of the forces left out [N]; infinite where it cannot be fitted.
        reason: why it cannot be, or "".
    """

    kind: str
    numbers: int
    rmse: float
    reason: str = ""


def fit_kind(recording: Recording, kind: str, degree: int = 3, **options: Any) -> Actuator:
    """A model of a kind, with the recording's files and settings as provenance.

    Args:
        recording: to fit to.
        kind: polynomial, mckibben or gridded.
        degree: of the polynomial.
        **options: of `fit_force_model`; a grid takes those on limits, bending and provenance alone.

    Raises:
        ValueError: unknown kind; or as for `fit_force_model` and `fit_gridded_model`.
    """
    check_choice("model", kind, _kinds(options))
    if kind != "gridded":
        return fit_recording(recording, degree, terms=MCKIBBEN if kind == "mckibben" else None, **options)
    own = (*provenance_of(recording), *options.pop("provenance", ()))
    samples = recording.strain, recording.pressure, recording.force
    shared = {key: options[key] for key in SHARED if options.get(key) is not None}
    return fit_gridded_model(*samples, *map(_axis, samples[:2]), provenance=own, **shared)


def best_fit(recording: Recording, degree: int = 3, **options: Any) -> tuple[list[Candidate], Actuator]:
    """Each kind of model by its error on samples left out, and a model of the first, which is taken.

    That is the kind of fewest numbers among those about as good as the best; others follow by their errors. The model's
    provenance holds all errors.

    Args:
        recording, degree, **options: as for `fit_recording`.

    Returns:
        The kinds with the root mean square error of forces left out, `rmse` [N], the best first; and the model.

    Raises:
        ValueError: no kind can be fitted.

    Example:
        >>> rows = [f"{e / 9},{p},{p * (0.9 - e / 9) - 30 * e / 9}" for e in range(5) for p in range(0, 60, 10)]
        >>> _ = (path := folder / "data.csv").write_text("\\n".join(["strain,p [kPa],F [N]", *rows, ""]))
        >>> [kind.kind for kind in ta.best_fit(ta.read_table(path, positive="push"))[0]]  # by fewest numbers
        ['mckibben', 'polynomial', 'gridded']
    """
    grid = [len(_axis(values)) for values in (recording.strain, recording.pressure)]
    counts = {"mckibben": len(MCKIBBEN), "polynomial": len(exponents(degree)), "gridded": math.prod(grid)}
    left_out, found = list(_left_out(recording)), []
    for kind in _kinds(options):
        try:
            squares = [_squared_errors(recording, out, kind, degree, options) for out in left_out]
            found.append(Candidate(kind, counts[kind], math.sqrt(float(np.concatenate(squares).mean()))))
        except ValueError as error:
            found.append(Candidate(kind, counts[kind], math.inf, str(error)))
    least = max(ALIKE * min(one.rmse for one in found), EXACT * float(np.abs(recording.force).max()))
    found.sort(key=lambda one: (one.rmse > least, one.numbers if one.rmse <= least else one.rmse))
    if not found[0].rmse < math.inf:
        raise ValueError(found[0].reason)
    errors = tuple((f"RMSE of {one.kind} on samples left out, N", one.rmse) for one in found if one.rmse < math.inf)
    own = (("kind, by samples left out", found[0].kind), *errors, *options.pop("provenance", ()))
    return found, fit_kind(recording, found[0].kind, degree, provenance=own, **options)


def _kinds(options: Mapping[str, Any]) -> list[str]:
    """The kinds that options of polynomials leave: a grid is neither robust nor held monotonic."""
    free = not options.get("monotonic") and options.get("loss", "linear") == "linear"
    return ["mckibben", "polynomial", *(["gridded"] if free else [])]


def _left_out(recording: Recording) -> Iterator[NDArray[np.bool_]]:
    """Samples that are left out together: a run; a strain or pressure of a table, but for its ends; or a part."""
    if int(recording.run.max()) > 0:
        yield from (recording.run == run for run in range(int(recording.run.max()) + 1))
    elif is_table(recording):
        levels = [
            (values, level) for values in (recording.strain, recording.pressure) for level in np.unique(values)[1:-1]
        ]
        if not levels:
            raise ValueError("strain, pressure: must take three values each for any to be left out")
        yield from (values == level for values, level in levels)
    else:
        part = np.arange(len(recording.force)) * BLOCKS // len(recording.force)
        yield from (part == block for block in range(BLOCKS))


def _squared_errors(
    recording: Recording, out: NDArray[np.bool_], kind: str, degree: int, options: dict[str, Any]
) -> Array:
    """Of the forces [N²] that are left out, as a model of the others predicts them."""
    model = fit_kind(recording.only(~out), kind, degree, **options)
    squares: Array = (recording.force[out] - forces(model, recording.strain[out], recording.pressure[out])) ** 2
    return squares


@torch.no_grad()
def forces(model: Actuator, strain: Array, pressure: Array) -> Array:
    """A model's forces [N]."""
    return np.asarray(model.force(torch.from_numpy(strain), torch.from_numpy(pressure)).detach())


def _axis(values: Array) -> Array:
    """Grid lines: the distinct values of a table, else evenly over their range."""
    levels = np.unique(values)
    return levels if len(levels) <= MOST_LEVELS else np.linspace(levels[0], levels[-1], GRID)
