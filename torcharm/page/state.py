"""What a page shows, as numbers, and what each event makes of it.

Every function here takes a state and returns another; nothing is computed but what the numbers stand for: a design and
a task. That numbers are some, and within their range, `controls` see to.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor

from torcharm.actuators import model_name
from torcharm.arm import ArmDesign
from torcharm.arm_series import rebuilt, segments_of, with_slices
from torcharm.design.space import Arm
from torcharm.load import GRAVITY, ExternalLoad, PointLoad
from torcharm.study import NamedArm, NamedTask, Study
from torcharm.task import Task

T = TypeVar("T")

BEST, BY_HAND = "best for the task", "by hand"
"""Where pressures come from: a prediction for the task, or sliders."""
SHARES = {"distance": (0.2, 2.0), "length": (0.5, 1.5), "limit": (0.1, 1.5)}
"""Of a study's value, from where to where a slider goes."""
BEYOND = 2.0
"""By how much the range of a load exceeds the study's largest."""
LEAST_FORCE = 0.5
"""Half the range of a force [N] of tasks without any."""
LEAST_MOMENT = 0.05
"""Half the range of a moment [N·m] of tasks without any."""


@dataclass(frozen=True)
class Values:
    """Of actuators that are changed together: their distance from the centreline [m], length [m] and limit [kPa]."""

    distance: float
    length: float
    limit: float


@dataclass(frozen=True)
class Group:
    """Actuators of one segment of a study's arm that are alike, and are changed together.

    Attributes:
        segment: its number, from 0.
        members: their places in the segment, from 0.
        first: the number of the segment's first actuator in the arm, from 0.
        kind: of their force model.
        values: as the study has them.
    """

    segment: int
    members: tuple[int, ...]
    first: int
    kind: str
    values: Values


@dataclass(frozen=True)
class State:
    """What one page shows. Numbers are in metres, newtons, kilograms and kilopascals.

    Attributes:
        study: whose arms and tasks these are.
        source: its file, from whose folder on force models' files are named; None of a study that is from none.
        arm: the number of the arm, and
        task: that of the task among the arm's, and
        load: that of one of its loads, all from 0.
        designs: of every arm the values of its groups.
        mode: BEST or BY_HAND.
        pressure: of each actuator; in the mode BEST what was found last.
        tip: the tip load, 3 or 6 numbers in the world frame.
        payload: a further mass at the tip, which counts under gravity.
        gravity: whether masses weigh.
        twists: rows of a shape in place of the task's, or None.
        node: whose set is shown, from 0.
    """

    study: Study
    source: Path | None
    arm: int
    task: int
    load: int
    designs: tuple[tuple[Values, ...], ...]
    mode: str
    pressure: tuple[float, ...]
    tip: tuple[float, ...]
    payload: float
    gravity: bool
    twists: tuple[tuple[float, ...], ...] | None
    node: int

    @property
    def named_arm(self) -> NamedArm:
        """The arm as the study has it."""
        return self.study.arms[self.arm]

    @property
    def named_task(self) -> NamedTask:
        """The task as the study has it."""
        return self.study.tasks_of(self.named_arm)[self.task]

    @property
    def given(self) -> Task:
        """The task of one load, as the study has it."""
        return self.named_task.task.part(self.load)


def groups(arm: Arm) -> tuple[Group, ...]:
    """Alike are actuators of one model, distance, length and limit."""
    found: dict[tuple[int, int, str, Values], list[int]] = {}
    for number, (segment, own) in enumerate(with_slices(segments_of(arm)[0])):
        columns = (segment.offsets.norm(dim=-1), segment.length, segment.max_pressure)
        rows = torch.stack(columns, -1).tolist()
        for place, (model, row) in enumerate(zip(segment.actuators, rows, strict=True)):
            values = Values(*(float(f"{value:.9g}") for value in row))
            found.setdefault((number, own.start, model_name(model), values), []).append(place)
    return tuple(
        Group(number, tuple(members), first, kind, values) for (number, first, kind, values), members in found.items()
    )


def opened(study: Study, source: Path | None = None) -> State:
    """The page of a study: its first arm on the first of its tasks."""
    designs = tuple(tuple(group.values for group in groups(arm.design)) for arm in study.arms)
    blank = State(study, source, 0, 0, 0, designs, BEST, (), (), 0.0, False, None, 0)
    return with_arm(blank, 0)


def with_arm(state: State, arm: int) -> State:
    """Another arm of the study, on the same task if it has it; what was changed of the design before stays."""
    count = state.study.arms[arm].design.actuator_count
    tasks = [task.name for task in state.study.tasks_of(state.study.arms[arm])]
    task = tasks.index(state.named_task.name) if state.named_task.name in tasks else 0
    moved = with_task(replace(state, arm=arm, mode=BEST, pressure=(0.0,) * count), task)
    return with_load(moved, state.load) if moved.named_task is state.named_task else moved


def with_task(state: State, task: int) -> State:
    """Another task of the arm, under the first of its loads."""
    return with_load(replace(state, task=task, twists=None, payload=0.0), 0)


def with_load(state: State, load: int) -> State:
    """Another of the task's loads."""
    changed = replace(state, load=load)
    given = changed.given
    node = min(state.node, given.nodes - 1)
    return replace(changed, tip=tuple(given.tip_load.tolist()), gravity=given.load.gravity, node=node)


def value_range(group: Group, name: str) -> tuple[float, float]:
    """From where to where a value of a group may go; the same twice if it cannot change."""
    low, high = SHARES[name]
    value = getattr(group.values, name)
    return low * value, high * value


def with_value(state: State, group: int, name: str, value: float) -> State:
    """A value of one group of the arm's actuators."""
    own = list(state.designs[state.arm])
    own[group] = replace(own[group], **{name: value})
    return replace(state, designs=put(state.designs, state.arm, tuple(own)))


def tip_range(state: State) -> tuple[float, ...]:
    """By how much each component of the tip load may be above or below 0."""
    forces = state.named_arm.design.dimension
    most = state.named_task.task.tip_load.detach().abs().reshape(-1, len(state.tip)).amax(0).tolist()
    force = max(BEYOND * max(most[:forces]), LEAST_FORCE)
    moment = max(BEYOND * max(most[forces:]), LEAST_MOMENT)
    return (round_up(force),) * forces + (round_up(moment),) * (len(most) - forces)


def payload_range(state: State) -> float:
    """The heaviest payload: what weighs as much as the largest force."""
    return round_up(tip_range(state)[0] / GRAVITY)


def with_tip(state: State, component: int, value: float) -> State:
    """A component of the tip load."""
    return replace(state, tip=put(state.tip, component, value))


def with_force(state: State, force: Sequence[float]) -> State:
    """The force of the tip load (x, y, z) within its range, of which the plane takes two; moments stay."""
    most = tip_range(state)
    for component, value in enumerate(force[: state.named_arm.design.dimension]):
        if math.isfinite(value):
            state = with_tip(state, component, min(max(value, -most[component]), most[component]))
    return state


def with_payload(state: State, mass: float) -> State:
    """A further mass at the tip; one that is there weighs."""
    return replace(state, payload=mass, gravity=state.gravity or mass > 0)


def with_shape(state: State, twists: Tensor | None) -> State:
    """A shape in place of the task's, or the task's."""
    return replace(state, twists=None if twists is None else tuple(map(tuple, twists.tolist())))


def as_given(state: State) -> State:
    """The same arm, task and load, all as the study has them; other arms stay as they are."""
    given = opened(state.study, state.source).designs[state.arm]
    kept = replace(state, designs=put(state.designs, state.arm, given))
    return with_load(with_task(with_arm(kept, state.arm), state.task), state.load)


def design_of(state: State, arm: int | None = None) -> Arm:
    """The design that the page shows, or another arm's as it was changed."""
    number = state.arm if arm is None else arm
    given = state.study.arms[number].design
    parts = list(segments_of(given)[0])
    for group, values in zip(groups(given), state.designs[number], strict=True):
        if values != group.values:
            parts[group.segment] = _changed(parts[group.segment], group, values)
    return rebuilt(given, parts)


def _changed(segment: ArmDesign, group: Group, values: Values) -> ArmDesign:
    members = list(group.members)
    radii, length, limit = segment.radii.clone(), segment.length.clone(), segment.max_pressure.clone()
    across = None if segment.out_of_plane is None else segment.out_of_plane.clone()
    scale = values.distance / group.values.distance if group.values.distance else 1.0
    for offset in (radii, across):
        if offset is not None:
            offset[members] *= scale
    length[members], limit[members] = values.length, values.limit
    return segment.with_values(radii, length, limit, across)


def task_of(state: State) -> Task:
    """The task that the page shows: one shape under one load."""
    given = state.given
    points = list(given.load.points)
    if not state.gravity:  # masses do not weigh then, and only wrenches are left
        points = [PointLoad(one.wrench, one.segment, one.at, one.frame) for one in points if one.wrench is not None]
    elif state.payload:
        points.append(PointLoad(mass=state.payload))
    load = ExternalLoad(list(state.tip), state.gravity, points)
    twists = given.twists if state.twists is None else torch.tensor(state.twists, dtype=torch.float64)
    return replace(given, twists=twists, load=load)


def pressure_of(state: State) -> list[float]:
    """Pressures by hand, none above its limit."""
    return list(map(min, state.pressure, design_of(state).max_pressure.tolist()))


def changed_task(state: State) -> bool:
    """Whether the task is another than the study's."""
    given = state.given
    as_it_was = (tuple(given.tip_load.tolist()), 0.0, given.load.gravity, None)
    return (state.tip, state.payload, state.gravity, state.twists) != as_it_was


def put(values: tuple[T, ...], place: int, value: T) -> tuple[T, ...]:
    """The same values, but for one."""
    return (*values[:place], value, *values[place + 1 :])


def round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, ..."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9))
