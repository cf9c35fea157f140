"""Least squares for polynomials of strain and pressure: robust, constrained, and with honest errors.

Monomials are scaled to [-1, 1] while they are worked on. A fit under inequality constraints is Lawson and
Hanson's least-distance problem, which scipy's `nnls` solves exactly; a robust one repeats weighted fits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Powers = tuple[tuple[int, int], ...]

Ends = tuple[float, float]
Constraints = tuple[Array, Array]
"""G (C, K) and h (C) of `G θ ≥ h`."""

LOSSES: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "linear": (np.ones_like, np.ones_like),
    "huber": (lambda z: 1 / np.sqrt(np.maximum(z, 1.0)), lambda z: (z <= 1).astype(np.float64)),
    "soft_l1": (lambda z: 1 / np.sqrt(1 + z), lambda z: (1 + z) ** -1.5),
    "cauchy": (lambda z: 1 / (1 + z), lambda z: (1 - z) / (1 + z) ** 2),
}
"""By name, of `z = (r/s)²`: the weight ρ' of a squared residual, and how fast `ρ' r` grows with r."""
ROUNDS = 100
SETTLED = 1e-10
"""By so much of the force's size may the last round still move a robust fit."""
DEPENDENT = 1e-10
"""Below so much of its column a pivot says that the data do not determine the coefficients."""
MARGIN = 1e-4
"""The slope of a fit that is held monotonic is at least so much of its mean slope."""
FINE = 81
"""Strains, and pressures, of the grid on which it is looked at."""
INLIERS = 1.345
"""Robust losses bend at so many standard deviations: 95 % as efficient as least squares on Gaussian noise."""
MAD = 1.4826
"""The standard deviation of Gaussian noise in medians of its absolute value."""


def exponents(degree: int) -> Powers:
    """Powers (i, j) of strain and pressure of total degree 1 to `degree`: by degree, strain first; no constant."""
    return tuple((total - j, j) for total in range(1, degree + 1) for j in range(total + 1))


@dataclass(frozen=True)
class Monomials:
    """Monomials `ε^i p^j`, divided by their largest size.

    Attributes:
        powers: (i, j) of each.
        strain, pressure: by which strain and pressure are divided.
    """

    powers: Powers
    strain: float
    pressure: float

    @classmethod
    def for_data(cls, powers: Powers, strain: Array, pressure: Array) -> "Monomials":
        """Scaled so that none exceeds 1 on the data."""
        return cls(powers, float(np.abs(strain).max()) or 1.0, float(np.abs(pressure).max()) or 1.0)

    @property
    def scale(self) -> Array:
        """What a coefficient of a scaled monomial is divided by to give that of the monomial itself."""
        return np.array([self.strain**i * self.pressure**j for i, j in self.powers])

    def values(self, strain: Array, pressure: Array) -> Array:
        """(n, K)."""
        x, y = self._ladders(strain, pressure)
        out = np.empty((len(strain), len(self.powers)), order="F")
        for column, (i, j) in enumerate(self.powers):
            np.multiply(x[i], y[j], out=out[:, column])
        return out

    def slopes(self, strain: Array, pressure: Array) -> Array:
        """Derivatives (n, K) with respect to pressure [1/kPa]."""
        x, y = self._ladders(strain, pressure)
        zero = np.zeros_like(strain)
        columns = [j * x[i] * y[j - 1] / self.pressure if j else zero for i, j in self.powers]
        return np.stack(columns, -1)

    def _ladders(self, strain: Array, pressure: Array) -> tuple[list[Array], list[Array]]:
        highest = max(max(pair) for pair in self.powers)
        ladders: list[list[Array]] = []
        for value in (strain / self.strain, pressure / self.pressure):
            ladder = [np.ones_like(value)]
            for _ in range(highest):
                ladder.append(ladder[-1] * value)
            ladders.append(ladder)
        return ladders[0], ladders[1]


def least_squares_loss(strain: Array, pressure: Array, force: Array, powers: Powers) -> float:
    """Sum of squared residuals of the least-squares fit [N²], from normal equations: quick, to six digits or so."""
    from scipy.linalg import lstsq

    matrix = Monomials.for_data(powers, strain, pressure).values(strain, pressure)
    right = matrix.T @ force
    return float(force @ force - right @ lstsq(matrix.T @ matrix, right)[0])


@dataclass(frozen=True)
class Solution:
    """Coefficients of scaled monomials, and what they were solved from.

    Attributes:
        matrix: (n, K).
        coefficients: (K).
        residual: (n) [N].
        active: (A, K) constraints that hold with equality.
        loss, scale [N]: of residuals.
    """

    matrix: Array
    coefficients: Array
    residual: Array
    active: Array
    loss: str = "linear"
    scale: float = 1.0

    @property
    def weight(self) -> Array:
        """(n) of the squares of residuals."""
        return LOSSES[self.loss][0]((self.residual / self.scale) ** 2)

    @property
    def hessian(self) -> Array:
        """(K, K) of half the loss."""
        curved = LOSSES[self.loss][1]((self.residual / self.scale) ** 2)
        product: Array = self.matrix.T @ (self.matrix * curved[:, None])
        return product


def solve(matrix: Array, force: Array, weight: Array | None = None, constraints: Constraints | None = None) -> Solution:
    """The coefficients of least weighted squares subject to `G θ ≥ h`.

    Args:
        matrix: (n, K).
        force: (n).
        weight: (n) of the squares; None for ones.
        constraints: None for none.

    Raises:
        ValueError: the data do not determine the coefficients, or the constraints contradict each other.
    """
    from scipy.linalg import qr, solve_triangular

    rows = np.column_stack((matrix, force))
    if weight is not None:
        rows *= np.sqrt(weight)[:, None]
    (triangle_,) = qr(rows, mode="r", overwrite_a=True, check_finite=False)
    count = matrix.shape[1]
    triangle, right = triangle_[:count, :count], triangle_[:count, count]
    pivots = np.abs(np.diag(triangle))
    if len(rows) < count or (pivots <= DEPENDENT * np.linalg.norm(triangle, axis=0)).any():
        raise ValueError(
            f"strain, pressure: must vary enough to determine {count} coefficients, got {len(rows)} samples that do "
            "not; take a lower degree or record more strains and pressures"
        )
    bound, level = constraints or (np.empty((0, count)), np.empty(0))
    theta, held = solve_triangular(triangle, right), np.zeros(len(bound), bool)
    if not (bound @ theta >= level).all():
        theta, held = _least_distance(triangle, theta, bound, level)
    return Solution(matrix, theta, force - matrix @ theta, bound[held])


def _least_distance(triangle: Array, free: Array, bound: Array, level: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The point of `G θ ≥ h` nearest to `free` in the norm of R, and which constraints hold it (Lawson, Hanson)."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    size = np.linalg.norm(bound, axis=1)
    across = solve_triangular(triangle, (bound / size[:, None]).T, trans="T")  # (K, C): G R⁻¹, transposed
    lacking = level / size - (bound / size[:, None]) @ free
    length = np.abs(lacking).max()
    system = np.vstack((across, lacking / length))
    target = np.zeros(len(system))
    target[-1] = 1.0
    weights, _ = nnls(system, target, maxiter=50 * system.shape[1])
    gap = system @ weights - target
    if -gap[-1] < 1e-12:
        raise ValueError("monotonic: no polynomial of this degree meets the constraint on this box")
    moved = -gap[:-1] / gap[-1] * length
    return free + solve_triangular(triangle, moved), weights > 0


def robust(
    matrix: Array, force: Array, loss: str, scale: float | None = None, constraints: Constraints | None = None
) -> Solution:
    """A fit under a loss of residuals r, `Σ s² ρ((r/s)²)` as of scipy's `least_squares`, by weighted fits repeated.

    Raises:
        ValueError: as for `solve`; or the rounds do not settle.
    """
    found = solve(matrix, force, None, constraints)
    if loss == "linear":
        return found
    size = max(float(np.abs(force).max()), float(np.finfo(np.float64).tiny))
    if scale is None:
        spread: float = np.median(np.abs(found.residual)).item()
        scale = max(INLIERS * MAD * spread, 1e-9 * size)
    for _ in range(ROUNDS):
        before = replace(found, loss=loss, scale=scale)
        found = solve(matrix, force, before.weight, constraints)
        if np.abs(found.residual - before.residual).max() <= SETTLED * size:
            return replace(found, loss=loss, scale=scale)
    raise ValueError(f"loss: the fit with {loss!r} did not settle in {ROUNDS} rounds; take 'huber' or a larger scale")


def covariance(found: Solution, runs: Sequence[slice], length: int) -> Array:
    """The coefficients' covariance (K, K), robust to noise that is uneven and correlated in time.

    The sandwich `H⁻¹ S H⁻¹` with Newey and West's S: products of scores up to `length - 1` samples apart in the
    same run count, with weights that fall linearly (Bartlett). It is worked out as a mean over all windows of
    `length` samples. Constraints that hold with equality are taken as if they were to hold in every repetition.
    """
    from scipy.linalg import null_space

    count, size = found.matrix.shape
    score = found.matrix * (found.weight * found.residual)[:, None]
    spread = np.zeros((size, size))
    for run in runs:
        own = score[run]
        total = np.vstack((np.zeros((1, size)), own.cumsum(0)))
        reach = min(length, len(own))
        low = np.clip(np.arange(1 - reach, len(own)), 0, None)
        high = np.clip(np.arange(1, len(own) + reach), None, len(own))
        window = total[high] - total[low]
        spread += window.T @ window / reach
    active = found.active / np.linalg.norm(found.active, axis=1, keepdims=True)
    free = null_space(active) if len(active) else np.eye(size)
    half = free @ np.linalg.pinv(free.T @ found.hessian @ free, hermitian=True) @ free.T
    result: Array = half @ spread @ half * (count / max(count - free.shape[1], 1))
    return (result + result.T) / 2


def correlation_length(residual: Array, runs: Sequence[slice]) -> int:
    """Andrews' (1991) window for Bartlett weights, from the residuals' correlation from one sample to the next.

    At most a quarter of the shortest run; 1 where residuals are independent.
    """
    product = sum(float(residual[run][1:] @ residual[run][:-1]) for run in runs)
    square = sum(float(residual[run] @ residual[run]) for run in runs)
    rho = min(max(product / square if square > 0 else 0.0, -0.999999), 0.999999)
    alpha = 4 * rho**2 / ((1 - rho) * (1 + rho)) ** 2
    shortest = min(run.stop - run.start for run in runs)
    return max(1, min(round(1.1447 * (alpha * len(residual)) ** (1 / 3)), shortest // 4))


def held_monotonic(
    monomials: Monomials, free: Solution, box: tuple[Ends, Ends], fit: Callable[[Constraints], Solution]
) -> Solution:
    """The fit whose slope in pressure has one sign all over a box, that which the free fit's mean slope has there.

    It is held at points that are added where the fit under the former ones falls short, until it does so nowhere on a
    fine grid.

    Args:
        monomials: of the polynomial.
        free: without constraints.
        box: ranges of strain and pressure.
        fit: under constraints.

    Raises:
        ValueError: it never ends, or as for `fit`.
    """
    mean = float((_slope_grid(monomials, box, 41) @ free.coefficients).mean())
    margin = max(MARGIN * abs(mean), float(np.finfo(np.float64).tiny))
    used, fine = ((1 if mean >= 0 else -1) * _slope_grid(monomials, box, count) for count in (9, FINE))
    along = np.arange(FINE)
    for _ in range(ROUNDS):
        found = fit((used, np.full(len(used), margin)))
        slope = fine @ found.coefficients
        if slope.min() >= 0.5 * margin:
            return found
        grid = slope.reshape(FINE, FINE)
        worst = np.unique(np.concatenate((grid.argmin(0) * FINE + along, along * FINE + grid.argmin(1))))
        used = np.concatenate((used, fine[worst[slope[worst] < 0.5 * margin]]))
    raise ValueError(f"monotonic: the constrained fit did not settle in {ROUNDS} rounds")


def _slope_grid(monomials: Monomials, box: tuple[Ends, Ends], count: int) -> Array:
    strain, pressure = np.meshgrid(*(np.linspace(*ends, count) for ends in box), indexing="ij")
    return monomials.slopes(strain.ravel(), pressure.ravel())
