"""What there is to move on a page, in the units in which designers think: mm, kPa, N, N·m, g."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from torcharm.page.state import (
    BEST,
    BY_HAND,
    State,
    groups,
    limits,
    payload_range,
    tip_range,
    value_range,
    with_arm,
    with_gravity,
    with_load,
    with_mode,
    with_node,
    with_payload,
    with_pressure,
    with_task,
    with_tip,
    with_value,
    within,
)

UNITS = {"distance": ("mm", 1e3), "length": ("mm", 1e3), "limit": ("kPa", 1.0)}
"""Of a group's values, what sliders show and how many of it a unit of the state is."""
HINTS = {
    "distance": "From the centreline of the arm.",
    "length": "Neutral length.",
    "limit": "Highest pressure.",
}
COMPONENTS = {
    3: (("force x", "N"), ("force y", "N"), ("moment", "N·m")),
    6: tuple((f"{what} {axis}", unit) for what, unit in (("force", "N"), ("moment", "N·m")) for axis in "xyz"),
}
"""Of tip loads in the plane and in space."""
DIGITS_BEYOND = 1
"""Of a slider's value, the digits beyond those of its step."""
STEPS = 400
"""Places of a slider."""


@dataclass(frozen=True)
class Control:
    """One thing to move.

    Attributes:
        key: that tells it from the others.
        folders: in which it lies, from the outermost on.
        label: what it is called, with its unit.
        read: its value in a state.
        write: the state after it was moved.
        options: the words to choose from; of a slider and a tick none.
        ends: from where to where a slider goes; None of others.
        step: of the slider.
        hint: a sentence.
        enabled: whether it can be moved now.
    """

    key: str
    folders: tuple[str, ...]
    label: str
    read: Callable[[State], Any]
    write: Callable[[State, Any], State]
    options: tuple[str, ...] = ()
    ends: tuple[float, float] | None = None
    step: float = 1.0
    hint: str = ""
    enabled: Callable[[State], bool] = lambda _: True

    def value(self, state: State) -> Any:
        """What it shows: of a slider to a tenth of its step, as more digits tell nothing."""
        found = self.read(state)
        return found if self.ends is None else round(found, DIGITS_BEYOND - math.floor(math.log10(self.step)))

    def moved(self, state: State, value: Any) -> State:
        """The state after it was moved: no slider by what is no number."""
        number = self.ends is None or within(value, *self.ends) is not None
        return self.write(state, value) if number else state

    def beyond(self, value: Any) -> str:
        """A sentence on a value that was typed and is beyond a slider's ends, at which it stays; else nothing."""
        kept = None if self.ends is None else within(value, *self.ends)
        if self.ends is None or kept is None or abs(kept - value) < self.step:
            return ""
        return f"{self.label}: goes from {self.ends[0]:g} to {self.ends[1]:g} on this page."


def same_controls(one: State, other: State) -> bool:
    """Whether two states have the same controls, so that one's may move the other."""
    return one.study is other.study and (one.arm, one.task) == (other.arm, other.task)


def controls(state: State) -> tuple[Control, ...]:
    """All there is to move in a state."""
    return (*_design(state), *_task(state), *_pressures(state), *_node(state))


def _design(state: State) -> Iterator[Control]:
    names = tuple(arm.name for arm in state.study.arms)
    yield _choice("arm", ("Design",), "arm", names, lambda one: one.arm, with_arm)
    for number, group in enumerate(groups(state.named_arm.design)):
        members = ", ".join(str(group.first + member + 1) for member in group.members)
        folders = ("Design", f"{group.kind} {members}")
        for name in UNITS:
            low, high = value_range(group, name)
            if low < high:
                yield _of_group(number, folders, name, (low, high))


def _of_group(number: int, folders: tuple[str, ...], name: str, ends: tuple[float, float]) -> Control:
    """A value of a group, from one end to the other."""
    unit, factor = UNITS[name]
    low, high = (factor * end for end in ends)
    return Control(
        f"{name} {number}",
        folders,
        f"{name} [{unit}]",
        lambda one: factor * float(getattr(one.designs[one.arm][number], name)),
        lambda one, value: with_value(one, number, name, value / factor),
        ends=(low, high),
        step=_step(high - low),
        hint=HINTS[name],
    )


def _task(state: State) -> Iterator[Control]:
    tasks = tuple(task.name for task in state.study.tasks_of(state.named_arm))
    yield _choice("task", ("Task",), "task", tasks, lambda one: one.task, with_task)
    loads = state.named_task.task.batch_shape.numel()
    if loads > 1:
        yield Control(
            "load",
            ("Task",),
            f"load, of {loads}",
            lambda one: one.load + 1,
            lambda one, value: with_load(one, value - 1),
            ends=(1, loads),
            hint="Which of the task's loads.",
        )
    for component, ((name, unit), most) in enumerate(zip(COMPONENTS[len(state.tip)], tip_range(state), strict=True)):
        yield _of_tip(component, f"{name} [{unit}]", most)
    yield Control("gravity", ("Task",), "gravity", lambda one: one.gravity, with_gravity, hint="Whether masses weigh.")
    heaviest = 1e3 * payload_range(state)
    yield Control(
        "payload",
        ("Task",),
        "payload [g]",
        lambda one: 1e3 * one.payload,
        lambda one, value: with_payload(one, value / 1e3),
        ends=(0.0, heaviest),
        step=_step(heaviest),
        hint="A further mass at the tip, which weighs under gravity.",
        enabled=lambda one: one.gravity,
    )


def _of_tip(component: int, label: str, most: float) -> Control:
    """A component of the tip load, up to its most either way."""
    return Control(
        f"tip {component}",
        ("Task",),
        label,
        lambda one: one.tip[component],
        lambda one, value: with_tip(one, component, value),
        ends=(-most, most),
        step=_step(2 * most),
        hint="At the tip, in the world: x right, y up, z to the viewer.",
    )


def _pressures(state: State) -> Iterator[Control]:
    modes = (BEST, BY_HAND)
    yield Control("mode", ("Pressures",), "pressures", lambda one: one.mode, with_mode, options=modes)
    highest = [value_range(group, "limit")[1] for group in groups(state.named_arm.design) for _ in group.members]
    places = [group.first + member for group in groups(state.named_arm.design) for member in group.members]
    for actuator, most in sorted(zip(places, highest, strict=True)):
        if most > 0:
            yield _of_pressure(actuator, most)


def _of_pressure(actuator: int, most: float) -> Control:
    """The pressure of an actuator, up to its most."""
    return Control(
        f"pressure {actuator}",
        ("Pressures",),
        f"{actuator + 1} [kPa]",
        lambda one: min(one.pressure[actuator], limits(one)[actuator]),
        lambda one, value: with_pressure(one, actuator, value),
        ends=(0.0, most),
        step=_step(most),
        hint="By hand; it ends at the actuator's limit.",
        enabled=lambda one: one.mode == BY_HAND,
    )


def _node(state: State) -> Iterator[Control]:
    yield Control(
        "node",
        ("Node",),
        "node",
        lambda one: one.node + 1,
        lambda one, value: with_node(one, value - 1),
        ends=(1, state.given.nodes),
        hint="Whose attainable set is shown; 1 is at the base.",
    )


def _choice(
    key: str,
    folders: tuple[str, ...],
    label: str,
    names: tuple[str, ...],
    read: Callable[[State], int],
    write: Callable[[State, int], State],
) -> Control:
    """One of some names, of which a state has the number."""

    def write_name(state: State, name: str) -> State:
        return write(state, names.index(name)) if name in names else state

    return Control(key, folders, label, lambda state: names[read(state)], write_name, options=names)


def _step(span: float) -> float:
    """A round step of a slider's range."""
    return float(f"{span / STEPS:.1g}")
