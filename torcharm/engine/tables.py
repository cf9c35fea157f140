"""Tables of what the engine does not know itself: any force model by strain and pressure, bending laws by curvature.

Forces are bicubic between grid points, by values and slopes there, refined until the middles of cells are good to
`ACCURACY`; beyond the grid they go on linearly. What is solved on a table is corrected on the model itself.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from torcharm.actuators import Actuator, force_slopes
from torcharm.actuators.bending import (
    ConstantBending,
    LinearBending,
    active_moment,
    bending_model,
    passive_moment,
    reference_pressure,
)
from torcharm.actuators.inspection import follows
from torcharm.actuators.protocol import pressure_knots, sampled_of
from torcharm.engine.arrays import Array
from torcharm.engine.forces import SAMPLED, Models
from torcharm.engine.references import by_reference
from torcharm.inputs import plain_number
from torcharm.statics.cross_section import group_alike

ACCURACY = 1e-6
"""Of the largest force at a strain: steps of Newton's method on the model itself then gain six digits each."""
LEAST_FORCE = 1e-2
"""Of the median over strains of that: a largest force so small is taken for one."""
FIRST_CELLS, MOST_CELLS = 16, 200
"""Cells of a grid along one axis: enough to see what a model looks like, and what is still sampled in milliseconds."""
SHORTEST = -0.95
"""The least strain of a grid: at -1 an actuator has no length."""
DIFFERENCE = 1e-5
"""Of the range of strains: the step by which the slope of a slope is found, which only Newton's steps depend on."""
CURVIEST, BENDING_CELLS = 80.0, 640
"""Material curvature [rad/m] up to which bending laws are sampled, either way: a radius of 12 mm. And the number of
cells for it: eighths of a radian a metre."""


@by_reference
class Tables(NamedTuple):
    """Sampled models of M actuators: S of forces on E strains and P pressures, T of bending laws."""

    force: Int64[Array, "M"]  # which of the S models of forces
    strain: Float64[Array, "S E"]  # grid, the last one repeated
    pressure: Float64[Array, "S P"]  # grid, the last one repeated [kPa]
    value: Float64[Array, "S E P 4"]  # f, ∂f/∂ε, ∂f/∂p and ∂²f/∂ε∂p
    bent: Int64[Array, "M"]  # which of the T bending laws, or -1 for a stiffness
    moment: Float64[Array, "T K 4"]  # τ_0, its slope by material curvature, and both of τ_1 for 1 kPa [N·m]

    @property
    def is_empty(self) -> bool:
        """Whether nothing is sampled."""
        return bool((self.bent < 0).all() and (self.force < 0).all())


def tables_of(actuators: Sequence[Actuator], models: Models, highest: Array) -> Tables:
    """Sample what the engine does not know, each model once.

    Args:
        actuators: M of them.
        models: the same as numbers.
        highest: (M,) the highest pressures in use [kPa].

    Raises:
        ValueError: a model cannot be sampled.
    """
    force, bent = np.full(len(actuators), -1), np.full(len(actuators), -1)
    grids: list[tuple[Array, Array, Array]] = []
    laws: list[Array] = []
    for model, members in group_alike(actuators):
        if models.kind[members[0]] == SAMPLED:
            most = float(max(highest[members]))
            force[members] = len(grids)
            grids.append(sampled_of(f"actuators[{members[0]}]", _grid, model, most))
    for a, model in enumerate(actuators):
        if is_sampled(model):
            bent[a] = len(laws)
            laws.append(sampled_of(f"actuators[{a}].bending_stiffness", _law, model))
    longest = [max([2, *(len(grid[axis]) for grid in grids)]) for axis in (0, 1)]
    strain, pressure = np.zeros((max(1, len(grids)), longest[0])), np.zeros((max(1, len(grids)), longest[1]))
    value = np.zeros((len(strain), *longest, 4))
    for s, (e, p, values) in enumerate(grids):
        strain[s], pressure[s] = e[-1], p[-1]
        strain[s, : len(e)], pressure[s, : len(p)] = e, p
        value[s, : len(e), : len(p)] = values
    return Tables(force, strain, pressure, value, bent, np.stack(laws) if laws else np.zeros((1, 1, 4)))


def is_sampled(model: Actuator) -> bool:
    """Whether a model's bending law is none of a stiffness at the reference pressure, and of one at any."""
    bending = bending_model(model.bending_stiffness)
    return bending is not None and not (
        follows(bending, LinearBending, "active", "passive") or follows(bending, ConstantBending, "active", "passive")
    )


def _grid(model: Actuator, highest: float) -> tuple[Array, Array, Array]:
    """Strains, pressures and values of one model's grid: its range, and as much again on either side."""
    low, high = (plain_number(end) for end in model.strain_range)
    span = max(high - low, 0.1)
    ends = max(low - span, min(SHORTEST, low)), high + span
    strain = np.unique(np.concatenate((np.linspace(*ends, FIRST_CELLS + 1), [low, high])))
    most = max(highest, plain_number(model.max_pressure)) * (1 + 1e-9)
    middle = torch.tensor([0.5 * (low + high)], dtype=torch.float64)
    kinks = pressure_knots(model, middle).detach().numpy().ravel()
    kinks = kinks[(kinks > 0) & (kinks < most)]
    pressure = np.unique(np.concatenate((np.linspace(0, most, FIRST_CELLS // 2 + 1), kinks)))
    while True:
        value = _values(model, strain, pressure, span)
        own = np.abs(value[..., 0]).max(1)  # at one strain: far out of range forces may be of another size
        limit = ACCURACY * np.maximum(own, LEAST_FORCE * np.median(own) + 1e-300)[:, None]
        wide, tall = _errors(model, strain, pressure, value)
        wide, tall = (wide / np.minimum(limit[1:], limit[:-1])).max(1), (tall / limit).max(0)
        finer = _halved(strain, wide), _halved(pressure, tall)
        if len(finer[0]) == len(strain) and len(finer[1]) == len(pressure):
            return strain, pressure, value
        strain, pressure = finer


def _halved(axis: Array, excess: Array) -> Array:
    """An axis with the cells halved whose error is beyond its limit, the worst of them if there is no room for all."""
    free = max(MOST_CELLS + 1 - len(axis), 0)
    worst = np.argsort(-excess, kind="stable")[:free]
    worst = worst[excess[worst] > 1.0]
    return np.sort(np.concatenate((axis, 0.5 * (axis[worst] + axis[worst + 1]))))


def _ask(model: Actuator, strain: Array, pressure: Array) -> tuple[Array, Array, Array]:
    """f, ∂f/∂ε and ∂f/∂p at pairs."""
    found = force_slopes(model, torch.from_numpy(strain.copy()), torch.from_numpy(pressure.copy()))
    force, by_strain, by_pressure = (np.asarray(part.expand(strain.shape), dtype=float) for part in found)
    return force, by_strain, by_pressure


def _values(model: Actuator, strain: Array, pressure: Array, span: float) -> Array:
    at, by = (axis.copy() for axis in np.meshgrid(strain, pressure, indexing="ij"))
    step = DIFFERENCE * span
    sides = [_ask(model, at + sign * step, by)[2] for sign in (1, -1)]
    return np.stack((*_ask(model, at, by), (sides[0] - sides[1]) / (2 * step)), -1)


def _errors(model: Actuator, strain: Array, pressure: Array, value: Array) -> tuple[Array, Array]:
    """The errors in the middles of the edges of cells: (E - 1, P) along strain and (E, P - 1) along pressure."""
    middle = 0.5 * (strain[:-1] + strain[1:])
    at, by = (axis.copy() for axis in np.meshgrid(middle, pressure, indexing="ij"))
    wide = np.diff(strain)[:, None]
    guess = 0.5 * (value[:-1, :, 0] + value[1:, :, 0]) + wide / 8 * (value[:-1, :, 1] - value[1:, :, 1])
    first = np.abs(guess - _ask(model, at, by)[0])
    middle = 0.5 * (pressure[:-1] + pressure[1:])
    at, by = (axis.copy() for axis in np.meshgrid(strain, middle, indexing="ij"))
    guess = 0.5 * (value[:, :-1, 0] + value[:, 1:, 0]) + np.diff(pressure) / 8 * (value[:, :-1, 2] - value[:, 1:, 2])
    return first, np.abs(guess - _ask(model, at, by)[0])


def _law(model: Actuator) -> Array:
    """(K, 4) moments and slopes of a bending law."""
    pressure = plain_number(reference_pressure(model.bending_stiffness, model.max_pressure))
    curvature = torch.linspace(-CURVIEST, CURVIEST, BENDING_CELLS + 1, dtype=torch.float64).requires_grad_()
    columns: list[Tensor] = []
    with torch.enable_grad():
        for moment, factor in (
            (passive_moment(model.bending_stiffness, curvature), 1.0),
            (active_moment(model.bending_stiffness, curvature), 1 / pressure),
        ):
            moment = torch.zeros_like(curvature) if moment is None else moment.expand_as(curvature)
            slope = torch.zeros_like(curvature)
            if moment.requires_grad:
                (slope,) = torch.autograd.grad(moment.sum(), curvature, allow_unused=True, materialize_grads=True)
            columns += [moment.detach() * factor, slope * factor]
    return torch.stack(columns, -1).numpy()
