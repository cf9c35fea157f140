"""Following an equilibrium as the load, or the pressure, rises from nothing.

A predictor-corrector method, the whole batch at once and each element at its own pace: a step along the
tangent, then Newton's method, accepted only where Newton contracts at once (Deuflhard, *Newton Methods for
Nonlinear Problems*, 2004, ch. 5) and the determinant of the stiffness keeps its sign. Both guard against
landing on another branch: under compression an arm has several equilibria.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._response import DEFINITE, has_lengths, is_stable
from torcharm._tracing import FIRST_SHARE, Course, Scale, trace
from torcharm.arm import ArmDesign
from torcharm.geometry import rod
from torcharm.wrenches import along

if TYPE_CHECKING:
    from torcharm.kernels.fleet import Fleet

LOOKS = 200
"""Evaluations of the balance along a path, at most."""
FIRST_FILLING = 0.3
"""Of the pressure, taken by the first step."""
SETTLING_STEPS = 60
"""To rest, at most: of 450 arms that came to rest one took more than 40, and none more than 50."""
BLOCK_ELEMENTS = 2_000_000
"""Entries of the stiffness matrices of one block (16 MB)."""
WARM_DAMPING = 1e-3
"""Of the first step from a warm start: next to Newton's."""
TOLERANCES = {torch.float64: 1e-10, torch.float32: 1e-4}
"""Of the load scale."""


@dataclass(frozen=True)
class Problem:
    """B problems of equilibrium, flattened.

    Attributes:
        arm: B designs.
        pressure: (B, M) [kPa].
        tip_load: (B, 3).
        base_pose: (B, 3).
        shear_stiffness: k [N/m] of each actuator, or None.
        length: (B,) the designs' mean neutral length [m].
        reach: (B,) their largest offset [m].
        tolerance: of the load scale.
        compiled: whether steps run compiled: for arms that the kernels know.
    """

    arm: ArmDesign
    pressure: Tensor
    tip_load: Tensor
    base_pose: Tensor
    shear_stiffness: float | None
    length: Tensor
    reach: Tensor
    tolerance: float
    compiled: bool = False

    @staticmethod
    def of(
        arm: ArmDesign,
        pressure: Tensor,
        tip_load: Tensor,
        base_pose: Tensor,
        shear_stiffness: float | None,
        tolerance: float,
    ) -> "Problem":
        """The problem of flattened tensors."""
        length, reach = arm.length.detach().mean(-1), arm.radii.detach().abs().amax(-1)
        return Problem(arm, pressure, tip_load, base_pose, shear_stiffness, length, reach, tolerance)

    @property
    def components(self) -> int:
        """C, unknowns a segment."""
        return 2 if self.shear_stiffness is None else 3

    @property
    def load_scale(self) -> Tensor:
        """(B,) [N]: the larger of the force and the moment over the arm's length, and 1 N at least."""
        force, moment = self.tip_load[:, :2].norm(dim=-1), self.tip_load[:, 2].abs() / self.length
        return torch.maximum(force, moment).clamp(min=1.0)

    def __getitem__(self, index: Tensor | slice) -> "Problem":
        return replace(
            self,
            arm=self.arm[index],
            pressure=self.pressure[index],
            tip_load=self.tip_load[index],
            base_pose=self.base_pose[index],
            length=self.length[index],
            reach=self.reach[index],
        )

    def balance(self, unknowns: Tensor) -> mechanics.Balance:
        """R and its derivatives, detached."""
        return mechanics.balance(self.arm, unknowns, self.pressure, self.tip_load, self.base_pose, self.shear_stiffness)

    def residual(self, unknowns: Tensor) -> Tensor:
        """R (B, C, N), with its graph."""
        return mechanics.balance_residual(
            self.arm, unknowns, self.pressure, self.tip_load, self.base_pose, self.shear_stiffness
        )

    def imbalance(self, residual: Tensor) -> Tensor:
        """(B,) the largest entry of R, forces over the load scale and moments over that times the length."""
        force, moment = residual[:, :-1].abs().flatten(1).amax(-1), residual[:, -1].abs().amax(-1)
        return torch.maximum(force, moment / self.length) / self.load_scale

    @property
    def arms(self) -> mechanics.Arms:
        """The same, as `mechanics.march` takes them."""
        return mechanics.Arms.of(self.arm, self.tip_load, self.base_pose, self.shear_stiffness)

    @property
    def scale(self) -> Scale:
        """What imbalances and moves are measured by."""
        return Scale(self.load_scale, self.length, self.reach)

    @property
    def fleet(self) -> "Fleet | None":
        """The same for compiled steps, if they are to run compiled."""
        if not self.compiled:
            return None
        from torcharm.kernels.fleet import Fleet

        return Fleet.of(self.arms, self.scale, self.pressure.mT, self.tolerance)

    def course(self, *, loading: bool) -> Course:
        """The path on which the load grows from nothing, or the pressure."""
        return Course(self.arms, self.pressure.mT.contiguous(), loading, self.scale, self.tolerance, self.fleet)

    def straight(self) -> Tensor:
        """One segment (B, C, 1) of the mean neutral length, straight."""
        start = self.pressure.new_zeros(len(self.pressure), self.components, 1)
        start[:, 0, 0] = self.length
        return start


def can_compile(problem: Problem) -> bool:
    """Whether the kernels know its arms."""
    from torcharm.kernels.arms import known

    return known(problem.arm.actuators, problem.pressure, problem.shear_stiffness)


class Settled(NamedTuple):
    """Where the arms came to rest: (B, C, N), and whether they did (B,)."""

    unknowns: Tensor
    arrived: Tensor


def resting(problem: Problem) -> Settled:
    """The arm without load or pressure, one segment for all: straight if that is at rest, else settled from there."""
    none = torch.zeros_like(problem.pressure), torch.zeros_like(problem.tip_load)
    idle = replace(problem, pressure=none[0], tip_load=none[1])
    unknowns = problem.straight()
    arrived = idle.imbalance(idle.residual(unknowns)) <= problem.tolerance
    left = ~arrived
    if bool(left.any()):
        unknowns[left], arrived[left] = settle(idle[left], unknowns[left])
    return Settled(unknowns, arrived)


def unloaded(problem: Problem, looks: int = LOOKS) -> Settled:
    """The arm without load, one segment for all, continued from zero pressure; there, settled from straight."""
    rest = resting(problem)
    filled = replace(problem, tip_load=torch.zeros_like(problem.tip_load))
    path = trace(filled.course(loading=False), rest.unknowns.movedim(0, -1).contiguous(), FIRST_FILLING, looks)
    found = Settled(path.unknowns.movedim(-1, 0).contiguous(), path.arrived & rest.arrived)
    left = ~found.arrived
    if bool(left.any()):  # where a force model jumps, say
        found.unknowns[left], found.arrived[left] = settle(filled[left], found.unknowns[left])
    return found


def loaded(problem: Problem, start: Tensor, looks: int = LOOKS) -> Settled:
    """The equilibrium of `start` (B, C, N), which bears no load, continued to the full load."""
    path = trace(problem.course(loading=True), start.movedim(0, -1).contiguous(), FIRST_SHARE, looks)
    return Settled(path.unknowns.movedim(-1, 0).contiguous(), path.arrived)


def _move(problem: Problem, step: Tensor) -> Tensor:
    """(B,) the size of a change of z: headings along the arm [rad], and three times the strains."""
    heading = step[:, -1].cumsum(-1).abs().amax(-1) / step.shape[-1]
    stretch = step[:, :-1].abs().flatten(1).amax(-1) + problem.reach * step[:, -1].abs().amax(-1)
    return torch.maximum(heading, 3 * stretch / problem.length)


def settle(problem: Problem, start: Tensor, damping: float = 0.4, steps: int = SETTLING_STEPS) -> Settled:
    """Let the arms go, and follow them to rest: what follows where a branch ends is a snap.

    Overdamped motion `D ż = R` by implicit Euler steps `(J - D/h) δ = -R` that grow as the motion slows down
    (pseudo-transient continuation; Kelley and Keyes 1998) and become Newton's.

    Args:
        problem, start: (B, C, N) where they are let go.
        damping: of the first step, D/h over the sections' own stiffness; little of it makes Newton steps at once.
        steps: at most.
    """
    fleet = problem.fleet
    if fleet is not None:
        return Settled(*fleet.settle(start, damping, steps))
    here, arrived = start.clone(), torch.zeros(len(start), dtype=torch.bool, device=start.device)
    active = torch.arange(len(start), device=start.device)
    amount = start.new_full((len(start),), 2.5 * damping)
    last = start.new_full((len(start),), float("inf"))
    for _ in range(steps):
        part, z = problem[active], here[active]
        found = part.balance(z)
        miss = part.imbalance(found.residual)
        done = miss <= problem.tolerance
        arrived[active[done]] = True
        keep = ~done & miss.isfinite()
        if not bool(keep.any()):
            break
        unit = _mobility(part, found)
        # A step that led uphill was too long; those that lead down become Newton's
        amount = torch.where(miss > 1.5 * last, amount * 4, amount * 0.4).clamp(1e-12, 1e6)
        matrix = found.stiffness
        matrix.diagonal(dim1=-3, dim2=-1).diagonal(dim1=-3, dim2=-2).sub_((amount[:, None] * unit)[:, None, :])
        step = -mechanics.solve(matrix, found.residual.unsqueeze(-1)).squeeze(-1)
        size = _move(part, step)
        short = (0.5 / size.clamp(min=1e-12)).clamp(max=1.0)
        amount = torch.where(size > 0.5, amount * 2, amount)
        z = z + short[:, None, None] * step
        keep &= size.isfinite()
        here[active[keep]] = z[keep]
        active, amount, last = active[keep], amount[keep], miss[keep]
    return Settled(here, arrived)


def _mobility(problem: Problem, found: mechanics.Balance) -> Tensor:
    """(B, C): a stiffness to measure damping by, the largest of the sections' own in each component."""
    own = found.stiffness.diagonal(dim1=-3, dim2=-1).diagonal(dim1=-3, dim2=-2)  # (B, N, C)
    return own.abs().amax(-2).clamp(min=1e-9)


def default_chunk(nodes: int, components: int) -> int:
    """Elements of a block."""
    return max(1, BLOCK_ELEMENTS // (nodes * components) ** 2)


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
