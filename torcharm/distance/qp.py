"""Distance as a quadratic programme, on the differentiable solver qpth.

It answers what the closed form answers, more slowly: for wrenches of more than two components, and
for comparison. qpth says nothing of its failures, so every answer is checked from its weights.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm._inputs import check_choice, check_count
from torcharm.distance.planar import PlanarEdges, planar_weights
from torcharm.distance.result import (
    TOLERANCE,
    HullAnswer,
    HullDistance,
    HullProblem,
    mix,
    offset_residuals,
    solve_hulls,
)
from torcharm.distance.scipy_solvers import nnls_weights

FORMS = ("vertices", "halfspaces")
GRADIENTS = ("kkt", "envelope")
CHUNK = 1000
REGULARISATION = 1e-10
"""ε of the first solve: the least that stays clear of qpth's rounding."""
PROXIMITY = 1e-4
"""ρ of the solve that is differentiated: large enough for qpth's backward pass to keep its digits."""
SHARPNESS = 1e-2
"""Largest error of a nearest point over its distance: larger, and the gradient's direction suffers."""
FAR = 100
"""Distances of fewer blurs than this are left to the exact method, which knows where the boundary is."""
ANSWERED = 1e-3
"""Duality gap over ε within which the programme with ε counts as solved."""
RETRY_SHARE = 0.1
"""If more of a group fails, one of its members may have ended the others' iterations: try again, apart."""

Layer = Callable[..., Tensor]


def qp_distance(
    point: Float[Tensor, "*#batch D"],
    vertices: Float[Tensor, "*#batch V D"],
    *,
    form: str = "vertices",
    gradient: str = "kkt",
    regularisation: float = REGULARISATION,
    chunk_size: int | None = None,
) -> HullDistance:
    """Distance from points to convex hulls by qpth's interior-point method, in float64.

    *Vertices*: `min_s ½‖H̃ᵀ s‖² + ½ ε‖s‖²` over the simplex, with H̃ = (H - w) / max|H - w|, so that neither units
    nor a far-off origin matter. *Half-spaces* (in the plane): `min_x ½‖x‖², A x ≤ b` with the
    edges of the same scaled polygon.

    Every answer is checked by its residuals. It is kept if the point is certainly outside, the distance
    good to 1e-6 of max|H - w| and the nearest point to 1e-2 of the distance; or if the exact method finds
    the point inside or on the boundary. All others are answered by the exact method and marked
    `resolved`: the closed form in the plane, else non-negative least squares. So the value is exactly 0
    where the closed form's is; a small residual alone never counts as touching.

    The value is differentiable with respect to point and vertices, once (a second derivative
    raises). "envelope" holds the weights. "kkt" goes through qpth's own backward pass. In the vertex
    form that pass cannot be taken at the small ε that the value needs: it loses all digits, and at a
    larger ε the solution is another one. So it is taken through one proximal step from the
    solution, `min_s ½‖H̃ᵀ s‖² + ½ ρ‖s - s*‖²`, whose solution is s* again and whose ρ may be large; a second
    solve, made only where gradients are wanted. Elements touching the hull have gradient 0; resolved
    ones have the envelope's. Where several weights are optimal (duplicated vertices), the gradient
    in the vertices is one of several.

    Measured on 2000 hulls of V = 48 vertices (forces of some 100 N, moments of 5 N·m), without re-solves, for
    points outside. Largest error of the value over max|H - w|, and median and largest error of the
    gradient in w, whose length is 1; "direct" is a KKT gradient at the ε of the value:

        ε                1e-6           1e-8           1e-10          1e-12          half-spaces
        value            1e-4           2e-6           9e-8           1e-1           4e-13
        "kkt", direct    8e-6, 9e-1     8e-4, 2        3e1, 2e4                      9e-7, 8e-4
        "kkt", proximal                                2e-6, 2e-3
        re-solved        59 %           8 %            1 %            0.3 %          0

    Half-spaces of hulls with nearly parallel edges, such as those of real arms, are answered less well: up to the
    1e-6 at which an answer is kept.

    With the re-solves the largest errors at ε = 1e-10 are 7e-9 (value), 5e-4 ("kkt") and 5e-6 ("envelope"). The
    1e-6 that remain of "kkt" are qpth's: its backward pass lifts multipliers and slacks to 1e-8. Between
    edges almost in line the gradients in single vertices may differ by more, their sum does not.

    Args:
        point: where from.
        vertices: V points in any order, duplicates allowed.
        form: "vertices", or "halfspaces" for D = 2.
        gradient: "kkt" or "envelope".
        regularisation: ε of the vertex form.
        chunk_size: problems that qpth is given at once; None for 1000.

    Raises:
        ValueError: qpth is not installed, an argument is none of those allowed, there is no vertex, or
            dimensions or batches do not fit.
    """
    check_choice("form", form, FORMS)
    check_choice("gradient", gradient, GRADIENTS)
    if not 0 < regularisation < float("inf"):
        raise ValueError(f"regularisation: must be finite and above 0, got {regularisation}")
    if form == "halfspaces" and point.shape[-1] != 2:
        raise ValueError(f"form: 'halfspaces' is for the plane, got {point.shape[-1]} coordinates; use 'vertices'")
    count = CHUNK if chunk_size is None else check_count("chunk_size", chunk_size, 1)
    layer = require_qpth()
    chosen = VertexForm(layer, regularisation) if form == "vertices" else HalfspaceForm(layer)
    return solve_hulls(point, vertices, partial(_solve, chosen, gradient == "kkt"), count)


def require_qpth() -> Layer:
    """qpth's layer, or the reason why there is none, as a ValueError."""
    try:
        from qpth.qp import QPFunction
    except ImportError as error:
        raise ValueError(
            "distance: 'qpth' needs the package qpth, which has no release for Python 3.13 and later; use 'closed_form'"
        ) from error
    # Without its check that Q is positive definite, one bad element does not stop a whole batch at once.
    return QPFunction(verbose=-1, check_Q_spd=False)


@dataclass(frozen=True)
class VertexForm:
    """The programme over convex weights of the vertices.

    Attributes:
        layer: qpth.
        regularisation: ε.
    """

    layer: Layer
    regularisation: float

    def solvable(self, offsets: Tensor) -> Tensor:
        """Which problems (B) qpth may be given: not those with all vertices at the point."""
        return (offsets != 0).flatten(1).any(-1)

    def solve(self, offsets: Tensor) -> tuple[Tensor, Tensor]:
        """Weights (B, V), NaN where qpth fails, and their slack (B): none."""
        weights = self._weights(_gram(offsets), self.regularisation, None)
        return weights, torch.zeros_like(offsets[:, 0, 0])

    def answered(self, offsets: Tensor, weights: Tensor) -> Tensor:
        """Whether weights (B, V) solve the programme with ε, however far that is from the one without."""
        slope = (offsets * mix(weights, offsets).unsqueeze(-2)).sum(-1) + self.regularisation * weights
        return (weights * slope).sum(-1) - slope.amin(-1) <= ANSWERED * self.regularisation

    def length(self, offsets: Tensor, weights: Tensor) -> Tensor:
        """Distances (B) whose gradient is qpth's."""
        moved = self._weights(_gram(offsets), PROXIMITY, weights)
        return torch.linalg.vector_norm(mix(moved, offsets), dim=-1)

    def _weights(self, gram: Tensor, proximity: float, centre: Tensor | None) -> Tensor:
        """`min_s ½ sᵀ(Q + ρ I)s - ρ sᵀc` over the simplex.

        Nothing is shared over the batch: qpth would average the gradients of what is.
        """
        batch, count, _ = gram.shape
        unit = torch.eye(count, dtype=gram.dtype, device=gram.device).expand_as(gram)
        zero = gram.new_zeros(batch, count)
        linear = zero if centre is None else -proximity * centre
        ones = gram.new_ones(batch, 1, count)
        found = _call(self.layer, zero, gram + proximity * unit, linear, -unit, zero, ones, ones[..., 0])
        found = found.clamp(min=0)  # within rounding they are
        return found / found.sum(-1, keepdim=True)


def _gram(offsets: Tensor) -> Tensor:
    return offsets @ offsets.mT


def _call(layer: Layer, like: Tensor, *terms: Tensor) -> Tensor:
    """qpth's answer; NaN where it raises or has none."""
    try:
        found = layer(*terms)
    except RuntimeError:
        found = None
    return torch.full_like(like, float("nan")) if found is None else found


@dataclass(frozen=True)
class HalfspaceForm:
    """The programme over the points left of every edge, in the plane.

    Attributes:
        layer: qpth.
    """

    layer: Layer

    def solvable(self, offsets: Tensor) -> Tensor:
        """Which problems (B) qpth may be given: hulls with an inside."""
        return PlanarEdges.of(offsets).usable

    def solve(self, offsets: Tensor) -> tuple[Tensor, Tensor]:
        """Weights (B, V), NaN where qpth fails, and how far (B) its point is from where they mix to."""
        edges = PlanarEdges.of(offsets)
        found = self._nearest(offsets, edges)
        weights = edges.weights(offsets, found)
        return weights, torch.linalg.vector_norm(found - mix(weights, offsets), dim=-1)

    def answered(self, offsets: Tensor, weights: Tensor) -> Tensor:
        """Whether the programme's answer is another than the distance's (B): never."""
        return torch.zeros_like(weights[:, 0], dtype=torch.bool)

    def length(self, offsets: Tensor, weights: Tensor) -> Tensor:
        """Distances (B) whose gradient is qpth's."""
        with torch.no_grad():
            edges = PlanarEdges.of(offsets)
        return torch.linalg.vector_norm(self._nearest(offsets, edges), dim=-1)

    def _nearest(self, offsets: Tensor, edges: "PlanarEdges") -> Tensor:
        normal, bound = edges.halfspaces(offsets)
        zero = torch.zeros_like(offsets[:, 0])
        unit = torch.eye(2, dtype=zero.dtype, device=zero.device).expand(len(zero), 2, 2)
        none = zero.new_empty(0)
        return _call(self.layer, zero, unit, zero, normal, bound, none, none)


# --- solving and checking ---


def _solve(form: VertexForm | HalfspaceForm, kkt: bool, problem: HullProblem) -> HullAnswer:
    with torch.no_grad():
        offsets = problem.offsets.detach()
        weights, slack = _solve_apart(form, offsets)
        found = offset_residuals(offsets, weights)
        sound = _sound(offsets, weights, slack)
        outside = sound & (found.gap <= SHARPNESS**2 * found.length**2) & (found.length > FAR * problem.blur)
        touching, resolved = torch.zeros_like(sound), torch.zeros_like(sound)
        rest = (~outside).nonzero().squeeze(-1)
        if len(rest):
            exact, touching[rest] = _exact(problem, rest)
            kept = sound[rest] & touching[rest]
            resolved[rest] = ~kept
            weights[rest] = torch.where(kept.unsqueeze(-1), weights[rest], exact)
            slack = torch.where(resolved, torch.zeros_like(slack), slack)
    length = problem.length(weights, touching)
    if kkt and length.requires_grad:
        length = _with_solver_gradient(form, problem, weights, length, outside.nonzero().squeeze(-1))
    return HullAnswer(weights, touching, resolved, length, slack)


def _solve_apart(form: VertexForm | HalfspaceForm, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Weights (B, V) and slacks (B), NaN where qpth fails.

    One element whose factorisation is singular ends the iterations of its whole batch, and nothing
    says which. So where many fail, they are tried again without the others, or in halves; not those whose ε was
    too large, for which qpth has done what it was asked.
    """
    weights, slack = torch.full_like(offsets[..., 0], float("nan")), torch.full_like(offsets[:, 0, 0], float("nan"))
    groups = [form.solvable(offsets).nonzero().squeeze(-1)]
    while groups:
        group = groups.pop()
        if not len(group):
            continue
        weights[group], slack[group] = form.solve(offsets[group])
        own, found = offsets[group], weights[group]
        failed = group[~_sound(own, found, slack[group]) & ~form.answered(own, found)]
        if len(group) > 1 and len(failed) > RETRY_SHARE * len(group):
            groups += failed.tensor_split(2) if len(failed) == len(group) else [failed]
    return weights, slack


def _sound(offsets: Tensor, weights: Tensor, slack: Tensor) -> Tensor:
    """Whether weights pass their check; never those with NaN."""
    found = offset_residuals(offsets, weights)
    return (torch.maximum(found.primal, slack) <= TOLERANCE) & (found.error <= TOLERANCE)


def _exact(problem: HullProblem, index: Tensor) -> tuple[Tensor, Tensor]:
    """Weights (b, V) by a method that does not fail, and whether (b) the points touch, of some problems."""
    if problem.offsets.shape[-1] == 2:
        return planar_weights(problem, index)
    offsets = problem.offsets.detach()[index]
    weights = nnls_weights(offsets)
    return weights, torch.linalg.vector_norm(mix(weights, offsets), dim=-1) <= problem.blur[index]


def _with_solver_gradient(
    form: VertexForm | HalfspaceForm, problem: HullProblem, weights: Tensor, length: Tensor, index: Tensor
) -> Tensor:
    """The same lengths, of which those in `index` have the gradient of qpth's backward pass."""
    if not len(index):
        return length
    offsets = problem.offsets[index]
    found = form.length(offsets, weights[index])
    agrees = (found - length[index]).detach().abs() <= TOLERANCE
    # Whatever the backward pass makes of an element that went wrong stays out of the sum.
    offsets.register_hook(partial(_kept, agrees))
    envelope = length[index]
    own = torch.where(agrees, envelope.detach() + (found - found.detach()), envelope)
    return length.index_copy(0, index, own)


def _kept(chosen: Tensor, gradient: Tensor) -> Tensor:
    mask = chosen.view(-1, *[1] * (gradient.dim() - 1))
    return torch.where(mask, gradient, torch.zeros_like(gradient))
