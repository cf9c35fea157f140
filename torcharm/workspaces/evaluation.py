"""Where an arm can reach: the states of its whole box of pressures, more of them where the boundary lies."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.equilibrium import solve_equilibrium
from torcharm.equilibrium.problem import Problem
from torcharm.inputs import (
    TensorLike,
    as_floating,
    check_above_zero,
    check_at_least,
    check_count,
    check_finite,
    check_flag,
    plain_number,
    shown,
)
from torcharm.load import ExternalLoad, PointLoad, check_tip
from torcharm.pressure.starts import spread_points
from torcharm.task import WRENCH_AT
from torcharm.workspaces.frontier import Frontier
from torcharm.workspaces.result import Workspace
from torcharm.workspaces.states import EXCLUDED, REACHED, Batch, KnownSlopes, joined, payload_factors, solve_states

Array = NDArray[np.float64]

Callback = Callable[[int, int], object]
"""Is told how many states are known, and of how many; returns True to stop."""


@dataclass(frozen=True)
class _Schedule:
    """How states are shared out, in the plane or in space.

    Attributes:
        spread: of the states, over the whole box of pressures.
        stages: in which boundaries are followed: how many of the states are known by its end, and how close together
            attempts are that promise little, in parts of the resolution.
        inside: of the states, among those reached after the first stage: what a region lacks inside is no boundary.
        rounds: in which a region grows at most, of a stage.
        least: of a region's points: with fewer attempts a round is not worth its triangulation, but in the last stage.
        finer: times the distance within which states have their neighbours is the resolution: so much denser states
            become. In space most go to the boundary.
        unseen: of the arm's length: no resolution is finer, and no gain looked for smaller.
    """

    spread: float
    stages: tuple[tuple[float, float], ...]
    inside: float
    rounds: int
    least: float
    finer: float
    unseen: float


SCHEDULES = {
    2: _Schedule(spread=0.2, stages=((0.6, 1.0), (1.0, 0.2)), inside=0.1, rounds=6, least=0.0, finer=0.4, unseen=5e-4),
    3: _Schedule(
        spread=0.12,
        stages=((0.65, 1.0), (0.85, 0.3), (1.0, 0.1)),
        inside=0.05,
        rounds=12,
        least=0.025,
        finer=0.9,
        unseen=1e-3,
    ),
}
"""By an arm's dimension."""
MIXED = 0.07
"""Of the states, between those of them that are reached, of which the box may hold few."""
REPEATS, AGAIN = 2, (0.1, 0.2)
"""How often, while states are left, boundaries are followed again from states spread inside: how many of all; and how
close together, as in a stage. A region that range limits grows from them where no state of its boundary leads on."""
IN_RANGE = 0.6
"""Of the states that follow boundaries, for that of the region in range; the others follow that of the extrapolated."""
OVERHANG = 0.25
"""By which random pressures overshoot each end of their range, where they are held: a third lie on the box's faces, by
which most of a workspace is bounded."""
AT_ONCE = 2000
"""States solved between two looks at the clock: at most a second's work in space."""
FURTHER = 3
"""Pushes of a round, one from where the other got to: as many resolutions at most."""
FEW = 1e-2
"""Of the states: a region does not grow by fewer, they are left to the next stage."""
TYPICAL = 0.99
"""Of the states have as many neighbours as a simplex has corners within the resolution."""
SMALL = 4e-3
"""Of the arm's length: a round whose largest gain is smaller is a region's last of its stage."""


class _Stopped(Exception):
    """The callback wants no more."""


def workspace(
    arm: ArmDesign | ArmSeries,
    payload: TensorLike | ExternalLoad | None = None,
    *,
    gravity: bool = True,
    states: int = 20_000,
    nodes: int = 10,
    base_pose: TensorLike | str | None = None,
    wrench_at: str = WRENCH_AT,
    resolution: float | None = None,
    seed: int = 0,
    callback: Callback | None = None,
) -> Workspace:
    """Where an arm's tip can be with a payload, over all pressures of its box.

    A workspace is the set of the tip's poses at stable equilibria that loading from rest leads to: first the pressures
    rise, each up to its limit, then weight and payload, as for `solve_equilibrium`. Equilibria that the arm gets to by
    a snap, those where it would not stay, and those whose strains or pressures leave the characterised range are told
    apart, and are no part of it.

    A fifth of the states (in space an eighth) is spread over the box, its corners, edges and faces, and some among
    those that are reached. Others follow the boundary: where a first-order model promises that pressures take the tip
    beyond the region reached, that is tried; as pressures mostly outnumber coordinates, the boundary is not the image
    of the box's. What is left is spread among those reached.

    Each state knows the largest factor by which its payload could grow if its shape were kept and every node had
    pressures of its own: see `load_capacity`. It is at least 1, as the state itself shows.

    Args:
        arm: one design, or segments in series, in the plane or in space.
        payload: at the tip: a mass [kg]; a wrench in the world frame (3,) or (6,) [N, N·m]; or an ExternalLoad, which
            is all that loads the arm. None is none.
        gravity: whether the arm and a payload's mass weigh; an ExternalLoad says so itself.
        states: how many equilibria are solved.
        nodes: elements of the arm, or of each segment.
        base_pose: (3,) or (4, 4) pose of node 1 [m, rad], or "hanging" (None), "upright" or "horizontal".
        wrench_at: where an element's wrench is taken, as of `Task`.
        resolution: α of the regions' alpha shapes [m]: gaps between states narrower than twice that belong to them.
            None chooses one for each by its states and how far they lie apart.
        seed: of the random pressures.
        callback: is told how many states are known and how many are wanted, from time to time; returning True stops.

    After Ctrl-C, or where the callback stops it, the result is of the states known by then.

    Raises:
        ValueError: an argument is none of those allowed, the arm is a batch, has no driven actuator, or does not fit
            the payload.

    Example:
        >>> found = ta.workspace(ta.bellows_arm(), payload=0.1, states=200, nodes=3)
        >>> round(found.reach, 1)  # how far from its base the tip comes with 100 g [m]
        0.8
    """
    scene = _checked(arm, payload, gravity, nodes, base_pose, wrench_at)
    check_count("states", states, 100)
    check_count("seed", seed, 0)
    run = _Run(scene, states, check_above_zero("resolution", resolution), callback)
    stopped, schedule = "finished", run.schedule
    try:
        run.spread(int(schedule.spread * states), seed)
        run.resolve(EXCLUDED)
        run.mix(int((schedule.spread + MIXED) * states), seed)
        for stage, (share, spacing) in enumerate(schedule.stages):
            if stage == 1:
                run.mix(run.count + int(schedule.inside * states), seed + 1)
                if scene.arm.dimension == 3:  # in the plane the first resolution is fine enough
                    run.resolve(REACHED)
            run.follow_boundaries(spacing, int(share * states))
        for more in range(REPEATS):
            run.mix(min(run.count + int(AGAIN[0] * states), states), seed + 2 + more)
            run.follow_boundaries(AGAIN[1], states)
        run.mix(states, seed + 2 + REPEATS)
    except KeyboardInterrupt:
        stopped = "interrupted"
    except _Stopped:
        stopped = "callback"
    return run.result(stopped)


@dataclass
class _Run:
    """States that become more; the resolutions are those of the region in range, and of where models extrapolate."""

    scene: Problem
    wanted: int
    given: float | None
    callback: Callback | None
    batches: list[Batch] = field(default_factory=list)
    resolutions: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        self.slopes = KnownSlopes(self.scene, self.wanted)
        self.schedule = SCHEDULES[self.scene.arm.dimension]

    @property
    def count(self) -> int:
        return sum(map(len, self.batches))

    def add(self, normalised: Array) -> None:
        """Solve the states at normalised pressures."""
        for part in np.split(normalised, range(AT_ONCE, len(normalised), AT_ONCE)):
            if len(part):
                self.batches.append(solve_states(self.scene, part))
            if self.callback is not None and self.callback(self.count, self.wanted) is True:
                raise _Stopped

    def spread(self, until: int, seed: int) -> None:
        """Solve states all over the box, up to so many in all."""
        driven = self.scene.arm.max_pressure.numpy() > 0
        count, size = until - self.count, int(driven.sum())
        if count <= 0:
            return
        corners = np.array(list(product((0.0, 1.0), repeat=size))) if 2**size <= count // 4 else np.zeros((0, size))
        inside = spread_points(count - len(corners), size, seed) * (1 + 2 * OVERHANG) - OVERHANG
        first = np.zeros((count, len(driven)))
        first[:, driven] = np.concatenate((corners, inside.clip(0, 1)))
        self.add(first)

    def resolve(self, worst: int) -> None:
        """Choose the resolutions, unless one is given; again the finer, of states no worse than a code."""
        found = self.given or _resolution(joined(self.batches), self.scene, worst)
        self.resolutions = (
            (found, found) if self.resolutions is None else (min(found, self.resolutions[0]), self.resolutions[1])
        )

    def mix(self, until: int, seed: int) -> None:
        """Solve states between pairs of those reached, or if none is, all over the box; up to so many in all."""
        states = joined(self.batches)
        own = states.normalised[states.code == REACHED].numpy()
        if not len(own):
            self.spread(until, seed + 1)
            return
        draw = np.random.default_rng(seed)
        one, other = own[draw.integers(len(own), size=(2, max(until - self.count, 0)))]
        self.add(one + draw.random((len(one), 1)) * (other - one))

    def follow_boundaries(self, spacing: float, end: int) -> None:
        """Solve states beyond the boundaries while there are any, first of the region in range; so many in all."""
        assert self.resolutions is not None
        one, length = np.ones(self.scene.arm.actuator_count), float(self.scene.arm.neutral_length)
        for share, resolution, region in (
            (IN_RANGE, self.resolutions[0], ((REACHED,), *_range_of_pressures(self.scene), True)),
            (1.0, self.resolutions[1], ((REACHED, EXCLUDED), 0 * one, one, False)),
        ):
            least = self.schedule.unseen * length
            frontier = Frontier(self.slopes, resolution, spacing * resolution, least, *region)
            self._push(frontier, self.count + int(share * (end - self.count)), SMALL * length, end < self.wanted)

    def _push(self, frontier: Frontier, end: int, small: float, hasty: bool) -> None:
        """Solve states beyond one boundary, up to so many in all, while gains are not small [m] and, where a stage is
        yet to come, attempts not few."""
        states = joined(self.batches)
        for _ in range(self.schedule.rounds):
            if end - self.count < FEW * self.wanted:
                break
            push = frontier.push(states, (end - self.count) // 2)
            most = push.gain.max(initial=0.0)
            few = len(push) < self.schedule.least * len(frontier.own(states))
            for further in range(FURTHER):
                if further:
                    push = frontier.push_on(states, push, (end - self.count) // 2)
                self.add(push.normalised)
                states = joined(self.batches)
            if most < small or (hasty and few):
                break

    def result(self, stopped: str) -> Workspace:
        """What is known."""
        if not self.batches:
            self.batches.append(solve_states(self.scene, np.zeros((0, self.scene.arm.actuator_count))))
        states, resolutions = joined(self.batches), self.resolutions or (0.0, 0.0)
        if stopped != "finished":  # those chosen were for more states than there are
            spread = int(self.schedule.spread * self.wanted)
            near, far = (self.given or _resolution(states, self.scene, worst, spread) for worst in (REACHED, EXCLUDED))
            resolutions = max(near, resolutions[0]), max(far, resolutions[1])
        scene = self.scene
        return Workspace(
            states.tip_pose,
            states.normalised * scene.arm.max_pressure,
            states.twists,
            states.code,
            states.strain_excess,
            payload_factors(scene, states),
            *resolutions,
            scene.arm,
            scene.load,
            scene.base_pose,
            scene.nodes,
            scene.wrench_at,
            stopped,
            self.wanted,
        )


def _resolution(states: Batch, scene: Problem, worst: int, spread: int | None = None) -> float:
    """At which hardly any state of a code no worse lies alone, once as many as are wanted are known.

    Where the first so many, `spread` over the box, are told, none come any more: those must not lie alone among all
    there are. The others are too close together where the boundary was followed to tell how far apart states lie.
    """
    from scipy.spatial import cKDTree

    schedule, position = SCHEDULES[scene.arm.dimension], states.position
    least = schedule.unseen * float(scene.arm.neutral_length)
    counted = states.code.numpy() <= worst
    asked = position[:spread][counted[:spread]]
    position = np.unique(position[counted], axis=0)
    corners = position.shape[1] + 1
    if len(position) <= corners or not len(asked):
        return least
    away = cKDTree(position).query(np.unique(asked, axis=0), corners + 1)[0][:, -1]
    denser = schedule.finer if spread is None else 1.0
    return float(max(denser * np.quantile(away, TYPICAL), least))


def _range_of_pressures(scene: Problem) -> tuple[Array, Array]:
    """(M,) the lowest and the highest normalised pressure in range."""
    limit = scene.arm.max_pressure
    ranges = limit.new_tensor([[plain_number(end) for end in model.pressure_range] for model in scene.arm.actuators])
    within = torch.where(limit[:, None] > 0, ranges / limit[:, None], 0.0).clamp(0.0, 1.0)
    return within[:, 0].numpy(), within[:, 1].numpy()


def _checked(arm: Any, payload: Any, gravity: Any, nodes: Any, base_pose: Any, wrench_at: Any) -> Problem:
    """The arm under its load, without pressure, once everything is known to make sense."""
    if not isinstance(arm, (ArmDesign, ArmSeries)):
        raise ValueError(f"arm: must be an ArmDesign or an ArmSeries, got {shown(arm)}")
    if arm.batch_shape:
        raise ValueError(f"arm: must be one design, as arm[0] of a batch, got batch shape {tuple(arm.batch_shape)}")
    if not bool((arm.max_pressure > 0).any()):
        raise ValueError("arm: must have an actuator that is driven, got pressure limits of 0 alone")
    load = _load(payload, gravity)
    if load.batch_shape:
        raise ValueError(f"payload: must be one, got batch shape {tuple(load.batch_shape)}")
    with torch.no_grad():
        rest = solve_equilibrium(arm, 0.0, load, nodes, base_pose=base_pose, wrench_at=wrench_at)
    scene = rest._problem
    if scene.batch:
        raise ValueError(f"base_pose: must be one pose, got batch shape {tuple(scene.batch)}")
    return scene


def _load(payload: Any, gravity: Any) -> ExternalLoad:
    """All that loads the arm."""
    if isinstance(payload, ExternalLoad):
        return payload
    check_flag("gravity", gravity)
    if payload is None:
        return ExternalLoad(gravity=gravity)
    (given,) = as_floating(payload=payload)
    if given.ndim == 1:
        check_tip("payload", given)
        return ExternalLoad(given, gravity)
    if given.ndim:
        raise ValueError(f"payload: must be a mass [kg] or a wrench (3,) or (6,), got shape {tuple(given.shape)}")
    check_finite("payload", given)
    check_at_least("payload", given, 0.0, unit="kg")
    if not gravity and bool(given > 0):
        raise ValueError("payload: a mass has no weight with gravity=False, which must be True; or give a wrench")
    return ExternalLoad(gravity=gravity, points=[PointLoad(mass=given)])
