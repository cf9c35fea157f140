"""One page at work: changes come in, and the newest state is evaluated and shown.

One thread does it. While it evaluates, changes gather; then all are applied, which takes no time, and only the last
state is evaluated. So a burst of moves drops the states between, and none is ever waited for.

A process waits for its threads before it ends: one that Python cuts off amid compiled code aborts the process. They say
so themselves, as a thread is else what the one that starts it is, and viser's do not hold up the end.
"""

import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from torcharm.geometry.alpha_shape import AlphaShape
from torcharm.page.answers import Answer, answer, followed, planned, same_reach, settled, swept
from torcharm.page.state import History, State, as_given, moved_on, same, undone, with_force, with_shape
from torcharm.plot._common import Array

Change = Callable[[State], State]
SAID = ("", "plan", "save", "load", "drag tip")
"""Changes that say themselves what came of them, and those without a control."""


class Session:
    """The history of one page, and the thread that evaluates it.

    Args:
        state: with which it begins.
        show: is called in the thread with each answer, and again with the last where a change made no difference.
        tell: is called with a sentence for the person.

    Attributes:
        failures: changes that were given up for an error that no person can cause.
    """

    def __init__(self, state: State, show: Callable[[Answer], None], tell: Callable[[str], None]) -> None:
        self._history = History(state)
        self._show, self._tell = show, tell
        self._changes: list[tuple[str, Callable[[History], History]]] = [("", lambda history: history)]
        self._ready = threading.Condition()
        self._busy, self._closed = False, False
        self.failures = 0
        self._planning, self._sweeping = threading.Lock(), threading.Lock()
        self._reach: tuple[State, AlphaShape] | None = None
        self._last: Answer | None = None

    def start(self) -> None:
        """Evaluate and show the first state, and go on from there."""
        threading.Thread(target=self._run, name="torcharm page", daemon=False).start()

    @property
    def state(self) -> State:
        """The state after all changes that were applied."""
        return self._history.now

    def move(self, control: str, change: Change) -> None:
        """Change the state; a newer change of the same control takes the place of one that still waits."""
        self._post(control, lambda history: moved_on(history, control, change(history.now)))

    def undo(self) -> None:
        """Go back to before the last change."""
        self._post("", undone)

    def refresh(self) -> None:
        """Show the last answer again."""
        self._post("", lambda history: history)

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
        if self._planning.acquire(blocking=False):
            self._tell("Planning a shape through this tip that the arm can hold, for some seconds.")
            threading.Thread(target=self._plan, args=(self.state,), name="torcharm plan", daemon=False).start()

    def sweep(self) -> None:
        """Find where the tip can be under the load, beside all else; it is shown until arm or load change."""
        if self._sweeping.acquire(blocking=False):
            self._tell("Looking for where the tip can be under this load, for some seconds.")
            threading.Thread(target=self._sweep, args=(self.state,), name="torcharm workspace", daemon=False).start()

    def wait(self, seconds: float) -> bool:
        """Until all changes are shown, or for so long; whether they are."""
        with self._ready:
            return self._ready.wait_for(lambda: not self._changes and not self._busy, seconds)

    def close(self) -> None:
        """End the thread after what it is at."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    def _post(self, control: str, change: Callable[[History], History]) -> None:
        with self._ready:
            if control and self._changes and self._changes[-1][0] == control:
                self._changes.pop()
            self._changes.append((control, change))
            self._ready.notify_all()

    def _run(self) -> None:
        while True:
            with self._ready:
                self._busy = False
                self._ready.notify_all()
                self._ready.wait_for(lambda: bool(self._changes) or self._closed)
                if self._closed:
                    return
                changes, self._changes, self._busy = self._changes, [], True
            if any(control not in SAID for control, _ in changes):
                self._tell("")  # what was said was said of the state before
            for _, change in changes:
                self._safely(partial(self._apply, change))
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

    def _apply(self, change: Callable[[History], History]) -> None:
        self._history = change(self._history)

    def _evaluate(self) -> None:
        state = self._history.now
        if self._last is None or not same(self._last.state, state):
            found = answer(state)
            self._history = replace(self._history, now=settled(found))
            self._last = replace(found, state=self._history.now)
        known = self._reach is not None and same_reach(self._reach[0], state)
        if not self._closed:
            self._show(replace(self._last, region=self._reach[1] if known and self._reach else None))

    def _plan(self, asked: State) -> None:
        try:
            twists, words = planned(asked)
        except ValueError as error:
            twists, words = None, f"Not planned: {error}"
        finally:
            self._planning.release()

        def take(state: State) -> State:
            moved = (state.arm, state.task, state.twists) != (asked.arm, asked.task, asked.twists)
            self._tell("The plan was dropped, as another shape is asked for now." if moved else words)
            return state if moved or twists is None else with_shape(state, twists)

        self.move("plan", take)

    def _sweep(self, asked: State) -> None:
        try:
            region, words = swept(asked)
            self._reach = asked, region
        except ValueError as error:
            words = f"No workspace: {error}"
        finally:
            self._sweeping.release()
        same = same_reach(asked, self.state)
        self._tell(words if same else "The workspace was dropped, as arm or load are others now.")
        self.refresh()
