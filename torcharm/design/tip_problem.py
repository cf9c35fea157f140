"""Shapes through a tip pose: their unknowns, what binds these, and the shape that comes nearest."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torcharm.arm_series import segments_of
from torcharm.design.space import Arm, Array
from torcharm.geometry import rod, se3
from torcharm.load import ExternalLoad
from torcharm.statics.balance import link_ends
from torcharm.statics.external_load import HULL
from torcharm.task import Task

STRAIN_SLACK = 1e-7
"""By how much of a length [m] strains stay off the ends of their range."""
LENGTH_UNIT = 0.1
"""In which lengths are counted [m], so that they vary as much as curvatures do."""
ANGLE = 0.1
"""Which miss of the tip's place [m] counts as much as one of its heading by 1 rad."""
ACTIVE = 1e-4
"""How near to its end [m] a strain is that holds a shape back, by the length of its actuator."""

Cost = Callable[[Tensor], Tensor]


@dataclass(frozen=True, eq=False)
class TipProblem:
    """Unknowns z of a shape of N elements, lengths (N, in units of 0.1 m) and then curvatures (N, or 2 N).

    Attributes:
        arm: one design.
        goal, base: poses.
        nodes: elements of each segment, N in all.
        strains: rows A and bounds b of `A z ≤ b`; None without.
    """

    arm: Arm
    goal: Tensor
    base: Tensor
    nodes: tuple[int, ...]
    strains: tuple[Array, Array] | None

    @property
    def count(self) -> int:
        """N."""
        return sum(self.nodes)

    @property
    def bends(self) -> slice:
        """Of the unknowns, the curvatures."""
        return slice(self.count, None)

    @property
    def links(self) -> list[Tensor | None]:
        """Poses of the links behind the segments."""
        shape = self.base.shape
        return [None if end is None else end.detach().reshape(shape).to(self.base) for end in link_ends(self.arm)]

    @property
    def neutral(self) -> Array:
        """(S,) mean neutral length of each segment's actuators [m]."""
        return np.array([float(one.length.detach().mean()) for one in segments_of(self.arm)[0]])

    def curvatures(self, unknowns: Tensor) -> list[Tensor]:
        """(1 or 2, N) by segments."""
        return list(unknowns[self.bends].unflatten(0, (-1, self.count)).split(self.nodes, -1))

    def twists(self, unknowns: Tensor) -> Tensor:
        """(N, 3 or 6), without shear and torsion."""
        values = unknowns.unflatten(0, (-1, self.count)).T
        whole = values.new_zeros(self.count, 3 * self.arm.dimension - 3)
        whole[:, HULL[whole.shape[-1]]] = values * values.new_tensor((LENGTH_UNIT, *[1.0] * (self.arm.dimension - 1)))
        return whole

    def unknowns(self, twists: Tensor) -> Array:
        """Those of twists (N, 3 or 6), whose shear and torsion are passed over."""
        scale = twists.new_tensor((LENGTH_UNIT, *[1.0] * (self.arm.dimension - 1)))
        return np.asarray((twists.detach()[:, HULL[twists.shape[-1]]] / scale).double().cpu().T.reshape(-1))

    def task(self, twists: Tensor, load: ExternalLoad) -> Task:
        """A shape (N, 3 or 6) as the task to hold it under loads."""
        nodes = self.nodes if len(self.nodes) > 1 else None
        return Task(twists, base_pose=self.base.to(twists), load=load, segment_nodes=nodes)

    def _miss(self, unknowns: Tensor) -> Tensor:
        poses = rod.poses(self.twists(unknowns), self.base, segment_nodes=self.nodes, links=self.links)
        if self.arm.dimension == 2:
            return poses[-1] - self.goal
        gap = se3.compose(se3.inverse(self.goal), poses[-1])
        return torch.cat((se3.position(gap), se3.log(gap)[3:]))

    def tip_miss(self, unknowns: Array) -> Array:
        """(3,) or (6,) [m, rad], the place first."""
        return self._miss(torch.from_numpy(unknowns)).numpy()

    def tip_jacobian(self, unknowns: Array) -> Array:
        """(3, 2N) or (6, 3N)."""
        return np.asarray(torch.autograd.functional.jacobian(self._miss, torch.from_numpy(unknowns), vectorize=True))

    def violation(self, unknowns: Array) -> float:
        """Of the tip pose, and of strains."""
        over = 0.0 if self.strains is None else float((self.strains[0] @ unknowns - self.strains[1]).max())
        return max(float(np.abs(self.tip_miss(unknowns)).max()), over)

    def arc(self, lengths: Array) -> Array:
        """Unknowns of arcs of constant curvature, by segments of lengths (S,) [m] that each turn by their share: in the
        plane of the right turn, in space of that by which the base's heading becomes the tip's."""
        if self.arm.dimension == 2:
            kinks = sum(float(link[2]) for link in self.links if link is not None)
            turns = [float(self.goal[2] - self.base[2]) - kinks]
        else:
            x, y, z = (self.base[:3, :3].T @ self.goal[:3, 0]).tolist()
            aside = math.hypot(y, z)
            turn = math.atan2(aside, x) / aside if aside > 1e-9 else 0.0
            turns = [-turn * z, turn * y]
        rows = [lengths / LENGTH_UNIT, *(turn * lengths / lengths.sum() for turn in turns)]
        return np.concatenate([np.repeat(row, self.nodes) for row in rows])

    def onto_tip(self, unknowns: Array, free: slice = slice(None), accuracy: float = 1e-14) -> Array:
        """The nearest unknowns, by Newton's method, whose tip is where it should be [m, rad]; some may be held."""
        z = unknowns.copy()
        for _ in range(20):
            miss = self.tip_miss(z)
            if np.abs(miss).max() < accuracy or not np.isfinite(miss).all():
                break
            z[free] -= np.linalg.pinv(self.tip_jacobian(z)[:, free]) @ miss
        return z

    def minimise(
        self, cost: Cost, start: Array, iterations: int, free: slice = slice(None), tolerance: float = 1e-15
    ) -> Array:
        """The unknowns of least cost that SLSQP reaches, those not free held, and put onto the tip pose."""
        return self.onto_tip(self._descend(cost, start, iterations, free, tolerance, tip=True), free)

    def nearest(self) -> Array:
        """Unknowns whose tip comes nearest, by a descent from one arc."""
        start = self.arc(self.neutral)
        if self.strains is not None:
            rows, bound = self.strains
            for _ in range(40):  # an arc that strains allow, if there is one
                if (rows @ start <= bound).all():
                    break
                start[self.bends] *= 0.8
        scale = torch.full_like(self._miss(torch.from_numpy(start)), ANGLE)
        scale[: self.arm.dimension] = 1.0
        return self._descend(
            lambda z: (scale * self._miss(z)).square().sum(), start, 200, slice(None), 1e-12, tip=False
        )

    def _descend(self, cost: Cost, start: Array, iterations: int, free: slice, tolerance: float, *, tip: bool) -> Array:
        from scipy.optimize import minimize

        scale = abs(float(cost(torch.from_numpy(start)))) or 1.0

        def whole(part: Array) -> Array:
            z = start.copy()
            z[free] = part
            return z

        def value(part: Array) -> tuple[float, Array]:
            found, slope = value_and_slope(cost, whole(part))
            sound = math.isfinite(found) and np.isfinite(slope).all()
            return (found / scale, slope[free] / scale) if sound else (1e30, np.zeros_like(part))

        pose = {
            "type": "eq",
            "fun": lambda part: self.tip_miss(whole(part)),
            "jac": lambda part: self.tip_jacobian(whole(part))[:, free],
        }
        limits = [pose] if tip else []
        if self.strains is not None:
            rows, bound = self.strains
            limits.append(
                {"type": "ineq", "fun": lambda part: bound - rows @ whole(part), "jac": lambda part: -rows[:, free]}
            )
        options = {"maxiter": iterations, "ftol": tolerance}
        answer = minimize(value, start[free], jac=True, method="SLSQP", constraints=limits, options=options)
        return whole(answer.x)


def value_and_slope(cost: Cost, unknowns: Array) -> tuple[float, Array]:
    """A cost and its gradient."""
    z = torch.from_numpy(unknowns).requires_grad_()
    found = cost(z)
    (slope,) = torch.autograd.grad(found, z)
    return float(found.detach()), slope.numpy()


def strain_rows(arm: Arm, nodes: tuple[int, ...]) -> tuple[Array, Array]:
    """`(1 + ε₋) l̂ ≤ l + z κ_y - y κ_z ≤ (1 + ε₊) l̂` for every actuator at every node, over the unknowns."""
    rows, bounds = [np.zeros((1, arm.dimension * sum(nodes)))], [np.ones(1)]
    for segment, unit in zip(segments_of(arm)[0], np.split(np.eye(sum(nodes)), np.cumsum(nodes)[:-1]), strict=True):
        places, neutral = segment.offsets.detach().tolist(), segment.length.detach().tolist()
        for (y, z), length, model in zip(places, neutral, segment.actuators, strict=True):
            own = np.hstack((LENGTH_UNIT * unit, *((z * unit,) if arm.dimension == 3 else ()), -y * unit))
            for sign, edge in zip((-1.0, 1.0), (float(end) for end in model.strain_range), strict=True):
                if math.isfinite(edge):
                    rows.append(sign * own)
                    bounds.append(np.full(len(unit), sign * (1 + edge) * length - STRAIN_SLACK))
    return np.concatenate(rows), np.concatenate(bounds)


def why_no_shape(problem: TipProblem) -> str:
    """That none was found, how near the nearest comes, and what to try."""
    near = problem.nearest()
    ranges = "" if problem.strains is None else " with all strains in the actuators' characterised range"
    length = sum(part.mean() for part in np.split(LENGTH_UNIT * near[: problem.count], np.cumsum(problem.nodes)[:-1]))
    return (
        f"no shape: none of {problem.count} elements was found that meets the tip pose{ranges}; the nearest, of length "
        f"{length:.3g} m (actuators: {problem.neutral.sum():.3g} m), misses it by "
        f"{_miss_in_words(problem.tip_miss(near))}: {_advice(problem, near)}"
    )


def _advice(problem: TipProblem, near: Array) -> str:
    """What holds the nearest shape back says what to change."""
    if problem.strains is None:
        return "try a tip nearer to the base, more nodes or more starts"
    group = rod.group_of(3 * problem.arm.dimension - 3)
    away, reach = float((group.position(problem.goal) - group.position(problem.base)).norm()), 0.0
    for segment, link in zip(segments_of(problem.arm)[0], problem.links, strict=True):
        ends = zip(segment.length.tolist(), segment.actuators, strict=True)
        reach += min((1 + float(model.strain_range[1])) * length for length, model in ends)
        reach += 0.0 if link is None else float(group.position(link).norm())
    if away > reach:
        return f"the tip is {away:.3g} m from the base, and the arm at most {reach:.3g} m long: try a longer one"
    rows, bound = problem.strains
    held = rows[bound - rows @ near < ACTIVE, : problem.count].sum(-1)  # above 0 where one is as long as it may be
    if not len(held):
        return "try another heading, more nodes or more starts"
    if (held > 0).all():
        return "try a longer arm, or a tip nearer to the base"
    if (held < 0).all():
        return "try a shorter arm, or a tip further from the base"
    return "try less bend, actuators nearer to the centreline, or an arm of another length"


def _miss_in_words(off: Array) -> str:
    """How far a tip is off, by the misses of its place and its heading."""
    places = 2 if len(off) == 3 else 3
    place, turn = 1e3 * float(np.linalg.norm(off[:places])), math.degrees(float(np.linalg.norm(off[places:])))
    return f"{place:.0f} mm and {turn:.0f}°" if place >= 10 else f"{place:.2g} mm and {turn:.2g}°"
