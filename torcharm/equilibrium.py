"""Forward mechanics: the shape an arm takes at a pressure, under a tip load.

The balance `a_i + q_i = 0` at every node, solved for the twists: see `mechanics` for the equations and
`_continuation` for the method.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm import mechanics
from torcharm._continuation import LOOKS, SETTLING_STEPS, Problem, can_compile, loaded, settle, unloaded
from torcharm._inputs import (
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_above_zero,
    check_at_least,
    check_count,
    check_finite,
    check_flag,
    check_tensor,
    refuse_transforms,
)
from torcharm._response import DEFINITE, has_lengths, is_stable
from torcharm.actuators import want_gradients
from torcharm.arm import ArmDesign, check_planar
from torcharm.geometry import rod
from torcharm.geometry.rod import BASE_POSE
from torcharm.wrenches import along

BLOCK_ELEMENTS = 2_000_000
"""Entries of the stiffness matrices of one block (16 MB)."""
WARM_DAMPING = 1e-3
"""Of the first step from a warm start: next to Newton's."""
TOLERANCES = {torch.float64: 1e-10, torch.float32: 1e-4}
"""Of the load scale."""


class NotConvergedError(RuntimeError):
    """An equilibrium was not found, and `raise_on_failure` was set."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """What `solve_equilibrium` found; `batch` is that of arm, pressure and load, broadcast.

    Attributes:
        twists: (*batch, N, 3) `(l, γ, κ)` [m, m, rad]; of an element that did not converge, where it was left.
        base_pose: (*batch, 3).
        residual: (*batch) largest imbalance of a node: force over the load scale, or moment over the load scale
            times the arm's mean length. The load scale is the larger of the force and the moment over
            that length, and at least 1 N.
        converged: (*batch) whether the residual is within the tolerance, with every length above 0: the centreline's
            and the actuators'. A folded arm is no equilibrium.
        stable: (*batch) whether it converged and the arm stays there: whether all eigenvalues of `J = ∂R/∂z`, of the
            balance R by lengths and curvatures, have a negative real part. After a snap the arm may be left at an
            equilibrium that it would leave again.
        continued: (*batch) whether continuation from zero load reached it along one branch. False after a
            warm start, and where the branch ends before the full load and the arm snapped to another.
        strain_excess: (*batch) largest strain beyond its actuator's characterised range, 0 if none is.
        in_range: (*batch) whether every strain and pressure lies in the characterised range.
    """

    twists: Tensor
    base_pose: Tensor
    residual: Tensor
    converged: Tensor
    stable: Tensor
    continued: Tensor
    strain_excess: Tensor
    in_range: Tensor

    @property
    def poses(self) -> Tensor:
        """(*batch, N+1, 3) poses of the nodes and the tip [m, m, rad]."""
        return rod.poses(self.twists, self.base_pose)


def solve_equilibrium(
    arm: ArmDesign,
    pressure: TensorLike,
    tip_load: TensorLike,
    nodes: int = 10,
    *,
    base_pose: TensorLike = BASE_POSE,
    shear_stiffness: float | None = None,
    start: Float[Tensor, "*#batch N 3"] | None = None,
    tolerance: float | None = None,
    raise_on_failure: bool = False,
    chunk_size: int | None = None,
    compiled: bool = False,
) -> Equilibrium:
    """The arm's equilibrium at each pressure under each tip load.

    At every node the reaction balances the load: `Σ f_α + q_x = 0` and `Σ (-r_α f_α + τ_α) + q_m = 0`.
    Under compression several equilibria exist. **Returned is the branch that is continued from zero load**: the
    pressure rises first, then the load, in proportion. Where that branch ends (an arm about to snap), the arm is let
    go, and comes to rest on another: `continued` is then false. Such an equilibrium need not be stable: `stable` says.

    Differentiable once, with respect to pressures, loads, base poses, radii, lengths and whatever force models hold, by
    the implicit function theorem: one linear solve, whatever the number of iterations. (Plain autograd does it;
    transforms of torch.func are refused, with a RuntimeError.) Gradients of elements that did not converge are
    NaN, unless nothing depends on them.

    Args:
        arm: designs, of any batch shape; batch shapes of all arguments broadcast as in torch.
        pressure: (..., M) [kPa], not negative; limits of the arm are not enforced.
        tip_load: (..., 3) `(f_x, f_y, m)` in the world frame [N, N, N·m].
        nodes: N, the number of segments. The twists' error falls with 1/N.
        base_pose: (..., 3) pose of node 1 [m, m, rad].
        shear_stiffness: k [N/m] of each actuator, for `-k Σ_α γ_α + q_y = 0`: the arm shears with the load. None is
            rigid, γ = 0. The paper prints `+1e3`, by which an arm would shear against its load.
        start: (..., N, 3) twists of a warm start: Newton's method goes to the equilibrium near them, on whatever
            branch; what does not converge is continued from zero load.
        tolerance: of the residual; None takes 1e-10 in float64, 1e-4 in float32.
        raise_on_failure: makes it an error if any element does not converge.
        chunk_size: elements worked on at once; None chooses. Bounds memory.
        compiled: whether the work is done by machine code, as of `search_pressure`.

    Raises:
        ValueError: an argument is none of those allowed, or shapes do not fit.
        NotConvergedError: see `raise_on_failure`.
    """
    check_planar(arm)
    refuse_transforms("pressure, tip_load")
    check_count("nodes", nodes, 1)
    pressure, load, base, _ = as_floating(pressure=pressure, tip_load=tip_load, base_pose=base_pose, radii=arm.radii)
    _check_inputs(arm, pressure, load, base)
    shear_stiffness = check_above_zero("shear_stiffness", shear_stiffness)
    tolerance = check_above_zero("tolerance", tolerance)
    check_flag("raise_on_failure", raise_on_failure)
    check_flag("compiled", compiled)
    if start is not None:
        check_tensor("start", start, nodes, 3)
        check_finite("start", start)
    shapes = {"arm": arm.batch_shape, "pressure": pressure.shape[:-1], "tip_load": load.shape[:-1]}
    shapes |= {"base_pose": base.shape[:-1]} | ({} if start is None else {"start": start.shape[:-2]})
    batch = broadcast_shapes(**shapes)
    count = batch.numel()

    def flat(value: Tensor, data: int = 1) -> Tensor:
        shape = value.shape[value.ndim - data :]
        return value.to(pressure).expand(*batch, *shape).reshape(count, *shape)

    designs = arm._map(flat)
    inputs = (flat(pressure), flat(load), flat(base), None if start is None else flat(start, 2))
    found = _in_blocks(designs, *inputs, nodes, shear_stiffness, tolerance, chunk_size, compiled)
    result = Equilibrium(*(value.reshape((*batch, *value.shape[1:])) for value in found))
    failed = count - int(result.converged.sum())
    if raise_on_failure and failed:
        worst = float(result.residual[~result.converged].nan_to_num(nan=float("inf")).max())
        raise NotConvergedError(f"{failed} of {count} equilibria did not converge, the largest residual is {worst:.1e}")
    return result


def _check_inputs(arm: ArmDesign, pressure: Tensor, load: Tensor, base: Tensor) -> None:
    for name, value, size in (
        ("pressure", pressure, arm.actuator_count),
        ("tip_load", load, 3),
        ("base_pose", base, 3),
    ):
        check_tensor(name, value, size)
        check_finite(name, value)
    check_at_least("pressure", pressure, 0.0, unit="kPa")


def default_chunk(nodes: int, components: int) -> int:
    """Elements of a block."""
    return max(1, BLOCK_ELEMENTS // (nodes * components) ** 2)


def _in_blocks(
    arm: ArmDesign,
    pressure: Tensor,
    load: Tensor,
    base: Tensor,
    start: Tensor | None,
    nodes: int,
    shear_stiffness: float | None,
    tolerance: float | None,
    chunk_size: int | None,
    compiled: bool,
) -> list[Tensor]:
    components = 2 if shear_stiffness is None else 3
    chunk = default_chunk(nodes, components) if chunk_size is None else check_count("chunk_size", chunk_size, 1)
    tolerance = tolerance or TOLERANCES.get(pressure.dtype, 1e-2)
    count = len(pressure)
    blocks = []
    for first in range(0, max(1, count), chunk):
        here = slice(first, first + chunk)
        problem = Problem.of(
            arm[here],
            pressure[here],
            load[here],
            base[here],
            shear_stiffness,
            tolerance,
        )
        problem = replace(problem, compiled=compiled and can_compile(problem))
        blocks.append(
            _solve_block(problem, nodes, None if start is None else start[here].detach(), recompute=count > chunk)
        )
    return [torch.cat(column) for column in zip(*blocks, strict=True)]


def _solve_block(problem: Problem, nodes: int, start: Tensor | None, *, recompute: bool) -> tuple[Tensor, ...]:
    with torch.no_grad():
        found = solved(detached(problem), nodes, start)
    unknowns = with_gradients(problem, found.unknowns, found.converged, recompute=recompute)
    return mechanics.to_twists(unknowns), problem.base_pose, *found[1:]


class Solved(NamedTuple):
    """Equilibria (B, C, N), and the other fields of `Equilibrium`, (B,)."""

    unknowns: Tensor
    residual: Tensor
    converged: Tensor
    stable: Tensor
    continued: Tensor
    strain_excess: Tensor
    in_range: Tensor


def solved(
    problem: Problem, nodes: int, start: Tensor | None = None, looks: int = LOOKS, settling: int = SETTLING_STEPS
) -> Solved:
    """The equilibria of a problem without graph: a warm start, then continuation, then letting go.

    Args:
        problem: B of them.
        nodes: N.
        start: (B, N, 3) twists of a warm start.
        looks: evaluations of the balance along a path, at most.
        settling: steps of letting go, at most.
    """
    shape = (len(problem.pressure), problem.components, nodes)
    unknowns = problem.pressure.new_zeros(shape)
    continued = torch.ones(shape[0], dtype=torch.bool, device=unknowns.device)
    left = continued.nonzero().squeeze(-1)
    if start is not None:
        guess = mechanics.to_unknowns(start, shear=problem.components == 3)
        warm = settle(problem, guess, WARM_DAMPING)
        unknowns, continued = warm.unknowns, ~warm.arrived
        left = continued.nonzero().squeeze(-1)
    if len(left):
        part = problem if len(left) == shape[0] else problem[left]
        rest = unloaded(part, looks)
        path = loaded(part, rest.unknowns.expand(-1, -1, nodes).contiguous(), looks)
        unknowns[left], continued[left] = path.unknowns, rest.arrived & path.arrived
        snapped = left[~path.arrived]
        if len(snapped):
            unknowns[snapped] = settle(problem[snapped], unknowns[snapped], steps=settling).unknowns
    residual = problem.imbalance(problem.residual(unknowns))
    converged = (residual <= problem.tolerance) & has_lengths(problem.arm, unknowns)  # false for a NaN
    stable = converged & stays(problem, unknowns)
    return Solved(unknowns, residual, converged, stable, continued & converged, *strain_excess(problem, unknowns))


def stays(problem: Problem, unknowns: Tensor) -> Tensor:
    """(B,) whether arms at equilibria (B, C, N) stay there when they are disturbed: all eigenvalues of J have a real
    part below 0, by more than rounding. Where its symmetric part is negative definite, they have."""
    stiffness = problem.balance(unknowns).stiffness.flatten(3).flatten(1, 2)
    stable = is_stable(stiffness)
    rest = (~stable & stiffness.isfinite().flatten(1).all(-1)).nonzero().squeeze(-1)
    if len(rest):
        values = torch.linalg.eigvals(stiffness[rest])
        rounding = DEFINITE * torch.finfo(stiffness.dtype).eps * values.abs().amax(-1)
        stable[rest] = values.real.amax(-1) < -rounding
    return stable


def detached(problem: Problem) -> Problem:
    """The problem without its graph."""
    return replace(
        problem,
        arm=problem.arm._map(torch.Tensor.detach),
        pressure=problem.pressure.detach(),
        tip_load=problem.tip_load.detach(),
        base_pose=problem.base_pose.detach(),
    )


def strain_excess(problem: Problem, unknowns: Tensor) -> tuple[Tensor, Tensor]:
    """The largest strain beyond its range, and whether strains and pressures are within theirs."""
    models = problem.arm.actuators
    length, curvature = unknowns[:, :1], unknowns[:, -1:]
    radii, neutral = problem.arm.radii.unsqueeze(-1), problem.arm.length.unsqueeze(-1)
    strain = rod.strain(rod.offset_length(length, curvature, radii), neutral)
    low, high = (along([model.strain_range[end] for model in models], strain, -2) for end in (0, 1))
    excess = torch.maximum(low - strain, strain - high).clamp(min=0).amax((-1, -2))
    least, most = (along([model.pressure_range[end] for model in models], excess, -1) for end in (0, 1))
    within = ((problem.pressure >= least) & (problem.pressure <= most)).all(-1)
    return excess, (excess <= 16 * torch.finfo(excess.dtype).eps) & within


# Gradients


def with_gradients(problem: Problem, unknowns: Tensor, converged: Tensor, *, recompute: bool) -> Tensor:
    """The same equilibria, as functions of what the problem depends on: `dz = -J⁻¹ dR`.

    Args:
        problem: with the graphs of its tensors.
        unknowns: (B, C, N) that solve it.
        converged: (B,).
        recompute: works the residual out again for the backward pass, and keeps no graph until then.
    """
    inputs = (problem.arm.radii, problem.arm.length, problem.pressure, problem.tip_load, problem.base_pose)
    followed = torch.is_grad_enabled() and any(value.requires_grad for value in inputs)
    if not (followed or want_gradients(problem.arm.actuators, problem.arm.radii)):
        return unknowns

    def residual(*_: Tensor) -> Tensor:
        return problem.residual(unknowns)

    imbalance = checkpoint(residual, *inputs, use_reentrant=False) if recompute else residual()
    return _Implicit.apply(imbalance, unknowns, converged, detached(problem))


class _Implicit(torch.autograd.Function):
    """Unknowns that solve R = 0, with the gradient `-J⁻ᵀ g` for R."""

    @staticmethod
    def forward(ctx: Any, residual: Tensor, unknowns: Tensor, converged: Tensor, problem: Problem) -> Tensor:
        ctx.save_for_backward(unknowns, converged)
        ctx.problem = problem
        return unknowns.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None, None]:
        unknowns, converged = ctx.saved_tensors
        stiffness = ctx.problem.balance(unknowns).stiffness
        transposed = stiffness.movedim((-2, -1), (-4, -3))
        answer = -mechanics.solve(transposed, gradient.unsqueeze(-1)).squeeze(-1)
        wanted = (gradient != 0).flatten(1).any(-1)
        lost = torch.where(wanted & ~converged, float("nan"), 0.0).to(gradient)
        answer = torch.where(wanted[:, None, None], answer, torch.zeros_like(answer))
        return answer + lost[:, None, None], None, None, None
