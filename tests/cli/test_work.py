"""What all commands that work through arms share: mistakes and Ctrl-C cost nothing that is finished."""

import sys
from io import StringIO
from types import SimpleNamespace
from typing import Any

import pytest

from torcharm.cli.work import Work

PAIRS: Any = [(SimpleNamespace(name=name), number) for number, name in enumerate("abcab")]


def halves(arm, number, told):
    """Two results of each pair, with a step of the bar after each; arms called b make a mistake after the first."""
    yield number, 1
    told(1, arm.name)
    if arm.name == "b":
        raise ValueError("arm: is refused")
    yield number, 2


def test_a_mistake_costs_the_rest_of_its_pair_alone_and_is_told_once(capsys):
    work = Work()
    assert work.each("halving", PAIRS, halves, 2) == [(0, 1), (0, 2), (1, 1), (2, 1), (2, 2), (3, 1), (3, 2), (4, 1)]
    assert work.refused == {"arm: is refused": ["b", "b"]}
    assert not work.interrupted
    with pytest.raises(SystemExit) as ended:
        work.finish(PAIRS)
    assert ended.value.code == 2
    assert capsys.readouterr().err == "torcharm: b: arm: is refused\n"


@pytest.mark.parametrize("finished", [[1], []])
def test_ctrl_c_ends_all_work_and_keeps_what_is_finished(finished):
    def interrupted(arm, number, told):
        yield from halves(arm, number, told)
        if number == 2:
            raise KeyboardInterrupt

    work = Work()
    assert work.each("halving", PAIRS, interrupted)[-1] == (2, 2)
    assert work.interrupted
    with pytest.raises(KeyboardInterrupt) as ended:
        work.finish(finished)
    assert ended.value.args == (() if finished else ("nothing was finished",))


def test_the_bar_of_a_terminal_tells_how_far_it_is_and_ends_at_100_percent(monkeypatch):
    class Terminal(StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    Work().each("halving", PAIRS, halves, 2)
    shown = [line for line in terminal.getvalue().splitlines() if "halving" in line]
    assert "100%" in shown[-1]
    assert "100%" not in shown[0]
