"""A session evaluates the newest state, and nothing that goes wrong ends it."""

import threading
import time
from dataclasses import replace

import numpy as np
from page_cases import plane

from torcharm.geometry.alpha_shape import alpha_shape
from torcharm.page import state as page
from torcharm.page.session import Session

LONG = 120
"""Seconds that nothing takes, not even on a busy machine that compiles the engine first."""


class Watched:
    """A session whose pictures can be held back."""

    def __init__(self):
        self.shown, self.told = [], []
        self.free = threading.Event()
        self.free.set()
        self.session = Session(plane(), self._show, self.told.append)
        self.session.start()

    def _show(self, found):
        self.free.wait(LONG)
        self.shown.append(found.state)

    def __enter__(self):
        assert self.session.wait(LONG)
        return self

    def __exit__(self, *_):
        self.free.set()
        self.session.close()


def longer(value):
    return lambda state: page.with_value(state, 0, "length", value)


def test_a_burst_drops_what_is_stale_and_keeps_the_last():
    with Watched() as watched:
        watched.free.clear()
        watched.session.move("a", longer(0.51))
        for step in range(100):
            watched.session.move("a", longer(0.52 + step / 1000))
            watched.session.move("b", lambda state: page.with_tip(state, 0, 0.3))
        before = len(watched.shown)
        watched.free.set()
        assert watched.session.wait(LONG)
        assert len(watched.shown) - before <= 2
        assert watched.shown[-1].designs[0][0].length == 0.52 + 99 / 1000
        assert watched.shown[-1].tip[0] == 0.3
        assert watched.session.state == watched.shown[-1]


def test_undo_goes_back_and_a_change_without_effect_is_shown_again():
    with Watched() as watched:
        start = watched.session.state
        watched.session.move("a", longer(0.6))
        assert watched.session.wait(LONG)
        watched.session.undo()
        assert watched.session.wait(LONG)
        assert watched.session.state == start
        before = len(watched.shown)
        watched.session.move("a", lambda state: state)
        assert watched.session.wait(LONG)
        assert len(watched.shown) == before + 1


def test_moves_of_one_control_are_undone_at_once():
    with Watched() as watched:
        start = watched.session.state
        for value in (0.51, 0.52, 0.53):
            watched.session.move("length", longer(value))
            assert watched.session.wait(LONG)
        watched.session.move("tip", lambda state: page.with_tip(state, 0, 1.0))
        watched.session.undo()
        assert watched.session.wait(LONG)
        assert watched.session.state.designs[0][0].length == 0.53
        watched.session.undo()
        watched.session.undo()
        assert watched.session.wait(LONG)
        assert watched.session.state == start


def test_what_goes_wrong_costs_one_change(capsys):
    def mistake(state):
        raise ValueError("that is not allowed")

    def fault(state):
        raise RuntimeError("a fault")

    with Watched() as watched:
        watched.session.move("a", mistake)
        watched.session.move("b", fault)
        watched.session.move("c", longer(0.6))
        assert watched.session.wait(LONG)
        assert watched.session.state.designs[0][0].length == 0.6
        said = [text for text in watched.told if text]
        assert said[0] == "that is not allowed"
        assert "terminal" in said[1]
        watched.session.move("c", longer(0.61))
        assert watched.session.wait(LONG)
        assert watched.told[-1] == ""  # what was said was of the state before
        assert watched.session.failures == 1
        assert "a fault" in capsys.readouterr().err


def test_a_plan_for_a_shape_that_is_gone_is_dropped(monkeypatch):
    asked, go = threading.Event(), threading.Event()

    def plan(state):
        asked.set()
        go.wait(LONG)
        return page.task_of(state).twists * 1.01, "Planned."

    monkeypatch.setattr("torcharm.page.session.planned", plan)
    with Watched() as watched:
        watched.session.plan()
        assert asked.wait(LONG)
        watched.session.move("task", lambda state: page.with_shape(state, page.task_of(state).twists * 0.99))
        assert watched.session.wait(LONG)
        moved = watched.session.state.twists
        go.set()
        while not any("dropped" in words for words in watched.told):
            watched.session.wait(LONG)
        assert watched.session.state.twists == moved
        watched.session.plan()
        while watched.told[-1] != "Planned.":
            watched.session.wait(LONG)
        assert np.asarray(watched.session.state.twists)[0, 0] > np.asarray(moved)[0, 0]


def test_a_workspace_is_shown_until_the_load_changes(monkeypatch):
    region = alpha_shape(np.array([[0.0, -0.4], [0.1, -0.5], [-0.1, -0.5]]), 1.0)
    monkeypatch.setattr("torcharm.page.session.swept", lambda state: (region, "reached"))
    with Watched() as watched:
        regions = []
        watched.session._show = lambda found: regions.append(found.region)
        watched.session.sweep()
        until = time.monotonic() + 30
        while "reached" not in watched.told and time.monotonic() < until:
            time.sleep(0.01)
        assert watched.session.wait(LONG)
        watched.session.move("node", lambda state: replace(state, node=1))
        assert watched.session.wait(LONG)
        assert regions[-1] is region
        watched.session.move("tip", lambda state: page.with_tip(state, 0, 0.77))
        assert watched.session.wait(LONG)
        assert regions[-1] is None
