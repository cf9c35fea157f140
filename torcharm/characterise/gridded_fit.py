"""Force models on a grid of strains and pressures, fitted to scattered samples."""

from typing import Any

import numpy as np

from torcharm.actuators.gridded import GriddedActuator, grid_axis
from torcharm.actuators.measured import measured_region
from torcharm.characterise.fit import check_informative, checked_samples, known_bending
from torcharm.inputs import TensorLike, check_number

SMOOTHNESS = 1e-6
"""Weight of roughness against the mean square of the residuals."""


def fit_gridded_model(
    strain: TensorLike,
    pressure: TensorLike,
    force: TensorLike,
    strains: TensorLike,
    pressures: TensorLike,
    *,
    smoothness: float = SMOOTHNESS,
    **options: Any,
) -> GriddedActuator:
    """The bicubic spline on a grid that fits scattered samples best, smoothed where they are few.

    Minimises the mean squared residual plus `smoothness` times the mean squared second differences of force from one
    grid point to the next (in units of their index), which also settles cells without samples.

    Args:
        strain, pressure [kPa], force [N]: n samples each.
        strains, pressures [kPa]: the grid.
        smoothness: above 0.
        **options: further fields of `GriddedActuator`; `max_pressure` is the grid's highest unless told, and the
            paper's bending stiffness is assumed.

    Raises:
        ValueError: samples do not match in number, are not finite or tell nothing; or as for `GriddedActuator`.

    Example:
        >>> model = ta.fit_gridded_model([0, 0.1, 0, 0.1], [0, 0, 50, 50], [0, -3, 45, 42], [0, 0.1], [0, 50])
        >>> round(float(model.force(torch.tensor(0.05), torch.tensor(25.0))), 1)  # between the samples [N]
        21.0
    """
    from scipy.interpolate import CubicSpline
    from scipy.linalg import solve

    x, y, f = checked_samples(strain, pressure, force)
    check_informative(x, y, f)
    check_number("smoothness", smoothness, 0.0, strict=True)
    axes = grid_axis("strains", strains), grid_axis("pressures", pressures)
    bases = [
        CubicSpline(axis, np.eye(len(axis)))(np.clip(value, axis[0], axis[-1]))
        for axis, value in zip(axes, (x, y), strict=True)
    ]
    count = len(axes[0]) * len(axes[1])
    gram, right = np.zeros((count, count)), np.zeros(count)
    for start in range(0, len(f), 20_000):  # bounds memory
        part = slice(start, start + 20_000)
        rows = (bases[0][part, :, None] * bases[1][part, None, :]).reshape(-1, count)
        gram += rows.T @ rows
        right += rows.T @ f[part]
    bends = [np.diff(np.eye(len(axis)), 2, axis=0) for axis in axes]
    roughness = np.kron(bends[0].T @ bends[0], np.eye(len(axes[1]))) + np.kron(
        np.eye(len(axes[0])), bends[1].T @ bends[1]
    )
    system = gram / len(f) + smoothness * roughness
    try:
        values = solve(system, right / len(f), assume_a="pos")
    except np.linalg.LinAlgError:
        raise ValueError(
            "strain, pressure: must vary enough to determine the grid's forces, got samples that do not"
        ) from None
    forces = values.reshape(len(axes[0]), len(axes[1]))
    fields = {"max_pressure": axes[1][-1], "region": measured_region(x, y.clip(min=0)), **options}
    fields["bending_stiffness"] = known_bending(fields.get("bending_stiffness"))
    return GriddedActuator(axes[0], axes[1], tuple(map(tuple, forces.tolist())), **fields)
