"""What there is to move on a page, in the units in which designers think: mm, kPa, N, N·m, g."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from torcharm.page.state import (
    BEST,
    BY_HAND,
    State,
    groups,
    payload_range,
    pressure_of,
    put,
    tip_range,
    value_range,
    with_arm,
    with_load,
    with_payload,
    with_task,
    with_tip,
    with_value,
)

VALUES = {
    "distance": ("mm", 1e3, "From the centreline of the arm."),
    "length": ("mm", 1e3, "Neutral length."),
    "limit": ("kPa", 1.0, "Highest pressure."),
}
"""Of a group's values the unit that sliders show, how many of it a unit of the state is, and what it is."""
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
        write: the state after it was moved to a value that it can have.
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
        """The state after it was moved: a slider ends at its ends, and what it cannot have changes nothing.

        A page's messages may hold anything.
        """
        if self.ends is not None:
            value = within(value, *self.ends)
        elif self.options:
            value = value if value in self.options else None
        else:
            value = bool(value)
        return state if value is None or not self.enabled(state) else self.write(state, value)

    def beyond(self, value: Any) -> str:
        """A sentence on a value that was typed and is beyond a slider's ends, at which it stays; else nothing."""
        kept = None if self.ends is None else within(value, *self.ends)
        if self.ends is None or kept is None or abs(kept - value) < self.step:
            return ""
        return f"{self.label}: goes from {self.ends[0]:g} to {self.ends[1]:g} on this page."


def within(value: Any, low: float, high: float) -> float | None:
    """A number brought into a range; None of what is none."""
    return min(max(float(value), low), high) if isinstance(value, int | float) and math.isfinite(value) else None


def same_controls(one: State, other: State) -> bool:
    """Whether two states have the same controls, so that one's may move the other."""
    return one.study is other.study and (one.arm, one.task) == (other.arm, other.task)


def controls(state: State) -> tuple[Control, ...]:
    """All there is to move in a state."""
    return (*_design(state), *_task(state), *_pressures(state), *_node(state))


def _design(state: State) -> Iterator[Control]:
    names = tuple(arm.name for arm in state.study.arms)
    yield _choice("arm", "Design", names, lambda one: one.arm, with_arm)
    for number, group in enumerate(groups(state.named_arm.design)):
        members = ", ".join(str(group.first + member + 1) for member in group.members)
        for name in VALUES:
            low, high = value_range(group, name)
            if low < high:
                yield _of_group(number, f"{group.kind} {members}", name, (low, high))


def _of_group(number: int, folder: str, name: str, ends: tuple[float, float]) -> Control:
    """A value of a group, from one end to the other."""
    unit, factor, hint = VALUES[name]
    return _slider(
        f"{name} {number}",
        ("Design", folder),
        f"{name} [{unit}]",
        lambda one: factor * float(getattr(one.designs[one.arm][number], name)),
        lambda one, value: with_value(one, number, name, value / factor),
        (factor * ends[0], factor * ends[1]),
        hint,
    )


def _task(state: State) -> Iterator[Control]:
    tasks = tuple(task.name for task in state.study.tasks_of(state.named_arm))
    yield _choice("task", "Task", tasks, lambda one: one.task, with_task)
    loads = state.named_task.task.batch_shape.numel()
    if loads > 1:
        yield _number("load", "Task", f"load, of {loads}", loads, "Which of the task's loads.", with_load)
    for component, ((name, unit), most) in enumerate(zip(COMPONENTS[len(state.tip)], tip_range(state), strict=True)):
        yield _of_tip(component, f"{name} [{unit}]", most)
    yield Control(
        "gravity",
        ("Task",),
        "gravity",
        read=lambda one: one.gravity,
        write=lambda one, value: replace(one, gravity=value),
        hint="Whether masses weigh.",
    )
    yield _slider(
        "payload",
        ("Task",),
        "payload [g]",
        lambda one: 1e3 * one.payload,
        lambda one, value: with_payload(one, value / 1e3),
        (0.0, 1e3 * payload_range(state)),
        "A further mass at the tip, which weighs under gravity.",
        lambda one: one.gravity,
    )


def _of_tip(component: int, label: str, most: float) -> Control:
    """A component of the tip load, up to its most either way."""
    return _slider(
        f"tip {component}",
        ("Task",),
        label,
        lambda one: one.tip[component],
        lambda one, value: with_tip(one, component, value),
        (-most, most),
        "At the tip, in the world: x right, y up, z to the viewer.",
    )


def _pressures(state: State) -> Iterator[Control]:
    yield Control(
        "mode",
        ("Pressures",),
        "pressures",
        read=lambda one: one.mode,
        write=lambda one, mode: replace(one, mode=mode),
        options=(BEST, BY_HAND),
    )
    own = groups(state.named_arm.design)
    highest = {group.first + member: value_range(group, "limit")[1] for group in own for member in group.members}
    for actuator, most in sorted(highest.items()):
        if most > 0:
            yield _of_pressure(actuator, most)


def _of_pressure(actuator: int, most: float) -> Control:
    """The pressure of an actuator, up to its most."""
    return _slider(
        f"pressure {actuator}",
        ("Pressures",),
        f"{actuator + 1} [kPa]",
        lambda one: pressure_of(one)[actuator],
        lambda one, value: replace(one, pressure=put(one.pressure, actuator, value)),
        (0.0, most),
        "By hand; it ends at the actuator's limit.",
        lambda one: one.mode == BY_HAND,
    )


def _node(state: State) -> Iterator[Control]:
    hint = "Whose attainable set is shown; 1 is at the base."
    yield _number("node", "Node", "node", state.given.nodes, hint, lambda one, node: replace(one, node=node))


def _slider(
    key: str,
    folders: tuple[str, ...],
    label: str,
    read: Callable[[State], float],
    write: Callable[[State, float], State],
    ends: tuple[float, float],
    hint: str,
    enabled: Callable[[State], bool] = lambda _: True,
) -> Control:
    """A number between two ends, by round steps."""
    step = float(f"{(ends[1] - ends[0]) / STEPS:.1g}")
    return Control(key, folders, label, read, write, ends=ends, step=step, hint=hint, enabled=enabled)


def _number(key: str, folder: str, label: str, count: int, hint: str, write: Callable[[State, int], State]) -> Control:
    """One of so many, shown from 1, which a state has from 0 in a field of the key's name."""
    return Control(
        key,
        (folder,),
        label,
        read=lambda one: int(getattr(one, key)) + 1,
        write=lambda one, number: write(one, round(number) - 1),
        ends=(1, count),
        hint=hint,
    )


def _choice(
    key: str,
    folder: str,
    names: tuple[str, ...],
    read: Callable[[State], int],
    write: Callable[[State, int], State],
) -> Control:
    """One of some names, of which a state has the number."""
    return Control(
        key,
        (folder,),
        key,
        read=lambda one: names[read(one)],
        write=lambda one, name: write(one, names.index(name)),
        options=names,
    )
