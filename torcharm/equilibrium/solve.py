"""Forward mechanics: the shape that an arm takes at a pressure, under a load.

The balance of all elements, solved for the twists: see `statics.balance` for the equations, `engine.newton_step` and
`engine.continuation` for the method.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, segments_of
from torcharm.engine.arms import flat
from torcharm.engine.continuation import CONTINUED
from torcharm.engine.questions import find
from torcharm.equilibrium.correction import corrected
from torcharm.equilibrium.gradient import with_gradients
from torcharm.equilibrium.problem import Problem
from torcharm.equilibrium.stability import buckles_in_torsion, lengths_positive, stays, strain_excess
from torcharm.equilibrium.status import status_word
from torcharm.geometry import rod
from torcharm.geometry.rod import as_base, check_rigid, goes_by_name, group_of
from torcharm.inputs import (
    HoldsTensors,
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_above_zero,
    check_choice,
    check_count,
    check_finite,
    check_flag,
    check_pressure,
    check_tensor,
    one_for_all,
    refuse_transforms,
    shown,
)
from torcharm.load import ExternalLoad, check_tip
from torcharm.statics.balance import link_ends
from torcharm.statics.external_load import arm_wrench
from torcharm.task import WRENCH_AT, WRENCH_PLACES, check_segments

TOLERANCE = 1e-10
"""Of the load scale: the error of strains that it leaves is far below any that can be made or measured, and Newton's
method passes it with one more step than a thousandth takes."""

WORDS = ("converged", "snapped", "unstable", "not converged", "impossible")
"""What may be said of an equilibrium. Snapped: stable, but not on the branch continued from zero load. Impossible: a
length of the centreline or of an actuator is not above 0."""


class NotConvergedError(RuntimeError):
    """An equilibrium was not found, or a search did not converge, and `raise_on_failure` was set.

    Example:
        >>> ta.solve_equilibrium(ta.mckibben_arm(), 30.0, load=[0.0, 100.0, 0.0], raise_on_failure=True)
        Traceback (most recent call last):
        NotConvergedError: 1 of 1 equilibria did not converge, ...
    """


@dataclass(frozen=True, eq=False, repr=False)
class Equilibrium(HoldsTensors):
    """What `solve_equilibrium` found; `batch` is that of arm, pressure, load, base pose and start, broadcast.

    Attributes:
        twists: (*batch, N, 3) `(l, γ, κ)` or (*batch, N, 6) `(l, γ_y, γ_z, κ_x, κ_y, κ_z)` [m, rad]; of an element
            that did not converge, where it was left.
        base_pose: (*batch, 3) or (*batch, 4, 4).
        residual: (*batch) largest imbalance of an element: force over the load scale, or moment over the load scale
            times the arm's mean length. The load scale is the larger of all forces and of all moments over that
            length, at least 1 N; and what actuators answer to a strain of 1e-4, where that is more.
        converged: (*batch) whether the residual is within the tolerance, with every length above 0: the
            centreline's and the actuators'. A folded arm is no equilibrium.
        stable: (*batch) whether it converged and the arm stays there: whether all eigenvalues of `J = ∂R/∂z`, of the
            balance R by the unknowns, have a negative real part. After a snap the arm may be left at an
            equilibrium that it would leave again.
        continued: (*batch) whether continuation from zero load reached it along one branch. False after a
            warm start, and where the branch ends before the full load and the arm snapped to another.
        possible: (*batch) whether every length is above 0.
        strain_excess: (*batch) largest strain beyond its actuator's characterised range, 0 if none is.
        in_range: (*batch) whether every strain and pressure lies in the characterised range.

    Example:
        >>> found = ta.solve_equilibrium(ta.bellows_arm(), [[0.0] * 4, [20.0] * 4], load=[0.0, 0.0, 0.0])
        >>> found.poses[:, -1, 1].round(decimals=2).tolist(), found.in_range.tolist()  # it grows out of its range
        ([-0.5, -0.9], [True, False])
    """

    twists: Tensor
    base_pose: Tensor
    residual: Tensor
    converged: Tensor
    stable: Tensor
    continued: Tensor
    possible: Tensor
    strain_excess: Tensor
    in_range: Tensor
    _problem: Problem = field(repr=False)

    @property
    def status(self) -> str | NDArray[np.str_]:
        """What to think of it, in a word of `WORDS`: one, or an array (*batch) of them."""
        return status_word(WORDS, self.continued, self.stable, self.converged, self.possible)

    @property
    def load(self) -> ExternalLoad:
        """What loads the arm."""
        return self._problem.load

    @property
    def segment_nodes(self) -> tuple[int, ...]:
        """How many elements each segment has."""
        return self._problem.nodes

    @property
    def poses(self) -> Tensor:
        """(*batch, N+1, 3) or (*batch, N+1, 4, 4) poses of the nodes and the tip [m, m, rad]."""
        problem = self._problem
        links = [None if end is None else end.to(self.twists) for end in link_ends(problem.arm)]
        return rod.poses(self.twists, self.base_pose, segment_nodes=problem.nodes, links=links)

    @property
    def required_torsion(self) -> Tensor:
        """(*batch, N) the torque m_x that the loads require of each element [N·m]: its cross-section must bear it
        though no pressure does. Of an arm in space."""
        problem = self._problem
        if problem.arm.dimension == 2:
            raise ValueError("required_torsion: must be asked of an arm in space, got a planar one")
        place, twists = problem.base_pose, self.twists.to(problem.base_pose)
        required = arm_wrench(problem.arm, twists, problem.load, place, problem.wrench_at, problem.nodes)
        return required[..., 3].to(self.twists)

    @property
    def buckles_in_torsion(self) -> Tensor:
        """(*batch, N) where pushing actuators take all stiffness against torsion away: `Σ f_α ρ_α² l/l_α ≥ C`.
        False where the arm is rigid in torsion, as in the plane."""
        problem = self._problem
        if problem.arm.dimension == 2:
            return torch.zeros_like(self.twists[..., 0], dtype=torch.bool)
        with torch.no_grad():
            return buckles_in_torsion(problem, self.twists.to(problem.base_pose)).expand(self.twists.shape[:-1])


def solve_equilibrium(
    arm: ArmDesign | ArmSeries,
    pressure: TensorLike,
    load: TensorLike | ExternalLoad,
    nodes: int | Sequence[int] = 10,
    *,
    base_pose: TensorLike | str | None = None,
    wrench_at: str = WRENCH_AT,
    shear_stiffness: float | None = None,
    start: Float[Tensor, "*#batch N K"] | None = None,
    tolerance: float | None = None,
    raise_on_failure: bool = False,
) -> Equilibrium:
    """The arm's equilibrium at each pressure under each load.

    At every element the reaction balances the load: `Σ f_α + q_x = 0` and `Σ (-r_α f_α + τ_α) + q_m = 0` in the
    plane. Under compression several equilibria exist. **Returned is the branch that is continued from zero load**: the
    pressure rises first, then the load, in proportion. Where that branch ends (an arm about to snap), the arm is let
    go, and comes to rest on another: `continued` is then false. Such an equilibrium need not be stable: `stable` says.

    Differentiable once, with respect to pressures, loads, base poses, designs, links and whatever force models hold, by
    the implicit function theorem: one linear solve, whatever the number of iterations. (Plain autograd does it;
    transforms of torch.func are refused, with a RuntimeError.) Gradients of elements that did not converge are
    NaN, unless nothing depends on them.

    Args:
        arm: designs, of any batch shape; batch shapes of all arguments broadcast as in torch. In space κ_x is unknown
            where a `torsion_stiffness` is given.
        pressure: (..., M) or one for all [kPa], not negative, segment after segment; limits of the arm are not
            enforced.
        load: a tip load (..., 3) or (..., 6) in the world frame [N, N·m], or an ExternalLoad.
        nodes: N, the number of elements, or one number for each segment; an integer serves each.
        base_pose: (..., 3) or (..., 4, 4) pose of node 1 [m, rad], or "hanging" (None), "upright" or "horizontal".
        wrench_at: where an element's wrench is taken, "middle" (the twists' error falls with 1/N²) or "start" (with
            1/N; the paper's).
        shear_stiffness: k [N/m] of each actuator, for `-k Σ_α γ_α + q_y = 0`: the arm shears with the load. None is
            rigid, γ = 0. The paper prints `+1e3`, by which an arm would shear against its load.
        start: (..., N, K) twists of a warm start: Newton's method goes to the equilibrium near them, on whatever
            branch; what does not converge is continued from zero load.
        tolerance: of the residual; None takes 1e-10.
        raise_on_failure: makes it an error if any element does not converge.

    Raises:
        ValueError: an argument is none of those allowed, or shapes do not fit.
        NotConvergedError: see `raise_on_failure`.

    Example:
        >>> found = ta.solve_equilibrium(ta.antagonistic_arm(), pressure=[20.0, 30.0, 5.0, 10.0], load=[0.0, -1.0, 0.0])
        >>> found.status, found.poses[-1].round(decimals=2).tolist()  # the tip [m, m, rad]
        ('converged', [0.11, -0.5, -1.14])
    """
    refuse_transforms("pressure, load")
    problem, start = _checked(arm, pressure, load, nodes, base_pose, wrench_at, shear_stiffness, start)
    tolerance = check_above_zero("tolerance", tolerance) or TOLERANCE
    check_flag("raise_on_failure", raise_on_failure)
    result = solved(problem, start, tolerance)
    failed = problem.count - int(result.converged.sum())
    if raise_on_failure and failed:
        worst = float(result.residual[~result.converged].nan_to_num(nan=math.inf).max())
        raise NotConvergedError(
            f"{failed} of {problem.count} equilibria did not converge, the largest residual is {worst:.1e}"
        )
    return result


def solved(problem: Problem, start: Tensor | None = None, tolerance: float = TOLERANCE) -> Equilibrium:
    """The equilibria of a problem, in its dtype; arguments as of `solve_equilibrium`."""
    given, problem = problem.pressure, problem.double()
    size = (sum(problem.nodes), 3 if problem.arm.dimension == 2 else 6)
    warm = np.zeros((0, *size)) if start is None else flat(start, problem.batch, 2)
    packed = problem.packed
    found = find(packed, warm, tolerance)
    if not packed.arms.tables.is_empty:
        found = corrected(problem, found, tolerance)
    twists = torch.from_numpy(found.twists).reshape(*problem.batch, *size)
    with torch.no_grad():
        possible = lengths_positive(problem, twists).expand(problem.batch)
        excess, within = (value.expand(problem.batch) for value in strain_excess(problem, twists))
    residual = torch.from_numpy(found.residual).reshape(problem.batch)
    converged = (residual <= tolerance) & possible  # false for a NaN
    stable = converged & torch.from_numpy(stays(packed, found)).reshape(problem.batch)
    continued = converged & torch.from_numpy(found.reached == CONTINUED).reshape(problem.batch)
    twists = with_gradients(problem, twists, converged)
    group = group_of(size[1])
    base = problem.base_pose.expand(*problem.batch, *group.POSE_SHAPE)
    return Equilibrium(
        twists=twists.to(given),
        base_pose=base.to(given),
        residual=residual.to(given),
        converged=converged.to(given.device),
        stable=stable.to(given.device),
        continued=continued.to(given.device),
        possible=possible.to(given.device),
        strain_excess=excess.to(given),
        in_range=within.to(given.device),
        _problem=problem,
    )


def _checked(
    arm: Any, pressure: Any, load: Any, nodes: Any, base_pose: Any, wrench_at: Any, shear_stiffness: Any, start: Any
) -> tuple[Problem, Tensor | None]:
    """The problem, once everything is known to make sense."""
    if not isinstance(arm, (ArmDesign, ArmSeries)):
        raise ValueError(f"arm: must be an ArmDesign or an ArmSeries, got {shown(arm)}")
    check_choice("wrench_at", wrench_at, WRENCH_PLACES)
    segments, columns = segments_of(arm)[0], 3 if arm.dimension == 2 else 6
    counts = segment_counts(nodes, len(segments))
    group = group_of(columns)
    if pressure is None:
        raise ValueError("pressure: must be given, got None")
    fields = {"pressure": pressure, "radii": segments[0].radii}
    if not goes_by_name(base_pose):
        fields["base_pose"] = base_pose
    if not isinstance(load, ExternalLoad):
        fields["load"] = load
    given = {name: value for name, value in fields.items() if value is not None}
    values = dict(zip(given, as_floating(**given), strict=True))
    pressure = values["pressure"]
    pressure = one_for_all(pressure, arm.actuator_count)
    base = as_base(values.get("base_pose", base_pose), pressure, columns)
    whole = whole_load(load if isinstance(load, ExternalLoad) else values["load"], columns, pressure)
    check_segments(whole, len(segments))
    check_tensor("pressure", pressure, arm.actuator_count)
    check_finite("pressure", pressure)
    check_pressure("pressure", pressure)
    check_tensor("base_pose", base, *group.POSE_SHAPE)
    check_finite("base_pose", base)
    check_rigid("base_pose", base)
    if start is not None:
        check_tensor("start", start, sum(counts), columns)
        check_finite("start", start)
    batch = broadcast_shapes(
        arm=arm.batch_shape,
        pressure=pressure.shape[:-1],
        load=whole.batch_shape,
        base_pose=base.shape[: base.ndim - len(group.POSE_SHAPE)],
        **({} if start is None else {"start": start.shape[:-2]}),
    )
    stiffness = check_above_zero("shear_stiffness", shear_stiffness)
    return Problem(arm.to(pressure), pressure, whole, base, counts, wrench_at, stiffness, batch), start


def segment_counts(nodes: Any, segments: int) -> tuple[int, ...]:
    """The number of elements of each segment, from one number or one for each."""
    if not isinstance(nodes, Sequence) or isinstance(nodes, str):
        return (check_count("nodes", nodes, 1),) * segments
    if len(nodes) != segments:
        raise ValueError(f"nodes: must be one number, or one for each of {segments} segments, got {shown(list(nodes))}")
    return tuple(check_count("nodes", count, 1) for count in nodes)


def whole_load(load: ExternalLoad | Tensor, columns: int, like: Tensor) -> ExternalLoad:
    """All that loads the arm, in one dtype."""
    if not isinstance(load, ExternalLoad):
        check_tip("load", load, (columns,))
        return ExternalLoad().with_tip(load)
    if load.columns not in (None, columns):
        raise ValueError(f"load: must be of {columns} components as the arm is, got {load.columns}")
    return load.to(like)
