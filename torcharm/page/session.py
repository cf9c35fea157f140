"""One page at work: changes come in, and the newest state is evaluated and shown.

One thread does it. While it evaluates, changes gather; then all are applied, which takes no time, and only the last
state is evaluated. So a burst of moves drops the states between, and none is ever waited for.

A process waits for its threads before it ends: one that Python cuts off amid compiled code aborts the process. They say
so themselves, as a thread is else what the one that starts it is, and viser's do not hold up the end.
"""

import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from torch import Tensor

from torcharm.geometry.alpha_shape import AlphaShape
from torcharm.page.answers import Answer, answer, followed, planned, same_reach, settled, swept
from torcharm.page.state import State, as_given, with_force, with_shape
from torcharm.plot._common import Array

Change = Callable[[State], State]
SAID = ("", "plan", "save", "load study", "drag tip")
"""Changes that say themselves what came of them, and those without a control."""
STEPS_BACK = 200
"""States that can be undone."""


class Session:
    """The history of one page, and the thread that evaluates it.

    Args:
        state: with which it begins.
        show: is called in the thread with each answer, and again with the last where a change made no difference.
        tell: is called with a sentence for the person.

    Attributes:
        state: after all changes that were applied.
        failures: changes that were given up for an error that no person can cause.
    """

    def __init__(self, state: State, show: Callable[[Answer], None], tell: Callable[[str], None]) -> None:
        self.state = state
        self._past, self._moved_last = deque[State](maxlen=STEPS_BACK), ""
        self._show, self._tell = show, tell
        self._waiting: list[tuple[str, Callable[[], None]]] = [("", lambda: None)]
        self._ready = threading.Condition()
        self._busy, self._closed = False, False
        self.failures = 0
        self._beside = {"plan": threading.Lock(), "workspace": threading.Lock()}
        self._reach: tuple[State, AlphaShape] | None = None
        self._last: Answer | None = None

    def start(self) -> None:
        """Evaluate and show the first state, and go on from there."""
        threading.Thread(target=self._run, name="torcharm page", daemon=False).start()

    def move(self, control: str, change: Change) -> None:
        """Change the state; a newer change of the same control takes the place of one that still waits."""
        self._post(control, partial(self._move, control, change))

    def undo(self) -> None:
        """Go back to before the last change; changes of one control in a row are one."""
        self._post("", self._undo)

    def refresh(self) -> None:
        """Show the last answer again."""
        self._post("", lambda: None)

    def reset(self) -> None:
        """Arm, task and load as the study has them."""
        self.move("reset", as_given)

    def drag_tip(self, pose: Array) -> None:
        """The tip was dragged to a pose (4, 4): the task's shape follows it."""

        def follow(state: State) -> State:
            twists = followed(state, pose)
            if twists is None:
                self._tell("No shape has its tip there.")
                return state
            self._tell("")
            return with_shape(state, twists)

        self.move("drag tip", follow)

    def drag_load(self, force: Array) -> None:
        """The load's arrow was dragged to a force (3,)."""
        self.move("drag load", lambda state: with_force(state, force.tolist()))

    def plan(self) -> None:
        """Look for a shape through the tip that the arm can hold, beside all else; one at a time."""
        words = "Planning a shape through this tip that the arm can hold, for some seconds."
        self._start_beside("plan", words, planned, self._take_plan)

    def sweep(self) -> None:
        """Find where the tip can be under the load, beside all else; it is shown until arm or load change."""
        words = "Looking for where the tip can be under this load, for some seconds."
        self._start_beside("workspace", words, swept, self._take_workspace)

    def wait(self, seconds: float) -> bool:
        """Until all changes are shown, or for so long; whether they are."""
        with self._ready:
            return self._ready.wait_for(lambda: not self._waiting and not self._busy, seconds)

    def close(self) -> None:
        """End the thread after what it is at."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    def _post(self, control: str, work: Callable[[], None]) -> None:
        with self._ready:
            if control and self._waiting and self._waiting[-1][0] == control:
                self._waiting.pop()
            self._waiting.append((control, work))
            self._ready.notify_all()

    def _run(self) -> None:
        while True:
            with self._ready:
                self._busy = False
                self._ready.notify_all()
                self._ready.wait_for(lambda: bool(self._waiting) or self._closed)
                if self._closed:
                    return
                waited, self._waiting, self._busy = self._waiting, [], True
            if any(control not in SAID for control, _ in waited):
                self._tell("")  # what was said was said of the state before
            for _, work in waited:
                self._safely(work)
            self._safely(self._evaluate)

    def _safely(self, work: Callable[[], None]) -> None:
        """Do it; whatever goes wrong costs this change alone, and the page goes on."""
        try:
            work()
        except ValueError as error:  # what a person can cause
            self._tell(str(error))
        except Exception:
            if not self._closed:  # else the browser has left
                self.failures += 1
                traceback.print_exc(file=sys.stderr)
                self._tell("Something went wrong; the terminal says what.")

    def _move(self, control: str, change: Change) -> None:
        moved = change(self.state)
        if moved != self.state:
            if control != self._moved_last:
                self._past.append(self.state)
            self.state, self._moved_last = moved, control

    def _undo(self) -> None:
        if self._past:
            self.state, self._moved_last = self._past.pop(), ""

    def _evaluate(self) -> None:
        if self._last is None or self._last.state != self.state:
            found = answer(self.state)
            self.state = settled(found)
            self._last = replace(found, state=self.state)
        known = self._reach is not None and same_reach(self._reach[0], self.state)
        if not self._closed:
            self._show(replace(self._last, region=self._reach[1] if known and self._reach else None))

    def _start_beside(
        self, name: str, begun: str, work: Callable[[State], tuple[Any, str]], take: Callable[..., None]
    ) -> None:
        """Do some work on the state as it is, and take what it finds, or None, and says; of a name one at a time."""
        asked = self.state

        def run() -> None:
            try:
                found, words = work(asked)
            except ValueError as error:
                found, words = None, f"No {name}: {error}"
            finally:
                self._beside[name].release()
            take(asked, found, words)

        if self._beside[name].acquire(blocking=False):
            self._tell(begun)
            threading.Thread(target=run, name=f"torcharm {name}", daemon=False).start()

    def _take_plan(self, asked: State, twists: Tensor | None, words: str) -> None:
        def take(state: State) -> State:
            moved = (state.arm, state.task, state.twists) != (asked.arm, asked.task, asked.twists)
            self._tell("The plan was dropped, as another shape is asked for now." if moved else words)
            return state if moved or twists is None else with_shape(state, twists)

        self.move("plan", take)

    def _take_workspace(self, asked: State, region: AlphaShape | None, words: str) -> None:
        self._reach = self._reach if region is None else (asked, region)
        current = same_reach(asked, self.state)
        self._tell(words if current else "The workspace was dropped, as arm or load are others now.")
        self.refresh()
