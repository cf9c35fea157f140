"""Questions about the equilibria of B arms, answered by one kernel: machine code of what they share is made once.

Each by itself would bring balance, Newton's step and continuation with it once more, and its first call would wait for
that. Searches stand apart: their code is as long as that of all of these, and most people first ask without.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torcharm.engine.compilation import kernel
from torcharm.engine.continuation import find_equilibria
from torcharm.engine.implicit import solve_rows
from torcharm.engine.path import Found
from torcharm.engine.predictions import Predictions, predict_all
from torcharm.engine.pressure_model import SLOTS, Problem, make_work
from torcharm.engine.references import by_reference
from torcharm.engine.threads import spread
from torcharm.engine.wrench_fit import FitAnswers, fit_all, make_fit

Array = NDArray[Any]

EQUILIBRIA, SOLUTIONS, FITS, PREDICTIONS = range(4)
"""At pressures; of linear equations with J; pressures by wrenches alone; and pressures for a shape. See the modules."""


@by_reference
class Given(NamedTuple):
    """What is given beside the arms; a question takes some of it.

    Attributes:
        twists: (B, N, K) shapes.
        places: (S, M) normalised pressures to begin with.
        start: (B, N, K) twists of warm starts, or of none (0, N, K).
        rows, right: (b,), (b, X, N, C) which arms, and right-hand sides for each, which solutions replace.
        weight: (C,) roots of the weights of wrenches.
    """

    twists: Array = np.zeros((0, 0, 0))
    places: Array = np.zeros((0, 0))
    start: Array = np.zeros((0, 0, 0))
    rows: Array = np.zeros(0, dtype=np.int64)
    right: Array = np.zeros((0, 0, 0, 0))
    weight: Array = np.zeros(0)


@by_reference
class Answers(NamedTuple):
    """Of equilibria, predictions and fits: one of them is written."""

    found: Found
    predictions: Predictions
    fits: FitAnswers


def make_found(count: int, nodes: int, size: int) -> Found:
    """Room for so many equilibria."""
    whole = np.zeros((count, 2), dtype=np.int64)
    return Found(
        np.zeros((count, nodes, size)), np.zeros(count), np.zeros(count, dtype=np.int64), whole, np.zeros((count, 2))
    )


def make_predictions(count: int, nodes: int, size: int, actuators: int) -> Predictions:
    """Room for so many predictions."""
    half_cost, slope = np.zeros((2, count))
    stable, reached = np.zeros((2, count), dtype=np.bool_)
    place, twists = np.zeros((count, actuators)), np.zeros((count, nodes, size))
    return Predictions(place, twists, half_cost, slope, np.zeros(count, dtype=np.int64), stable, reached)


def make_fits(count: int, nodes: int, columns: int, actuators: int) -> FitAnswers:
    """Room for so many fits."""
    place, miss, done = np.zeros((count, actuators)), np.zeros((count, nodes, columns)), np.zeros(count, dtype=np.bool_)
    return FitAnswers(place, np.zeros(count), miss, np.zeros(count), done)


def answer(
    question: int,
    problem: Problem,
    tolerance: float,
    given: Given,
    found: Found | None = None,
    predictions: Predictions | None = None,
    fits: FitAnswers | None = None,
) -> None:
    """Answer a question for all arms, in as many threads as PyTorch takes.

    Args:
        question: one of those above.
        problem: the arms; equilibria and solutions are at its limits of pressure, and need no goal.
        tolerance: of equilibria, of the load scale.
        given: what the question takes.
        found, predictions, fits: that which it writes.
    """
    pressure, slots = np.zeros_like(problem.limit), SLOTS if question in (FITS, PREDICTIONS) else 0
    answers = Answers(
        make_found(0, 0, 0) if found is None else found,
        make_predictions(0, 0, 0, 0) if predictions is None else predictions,
        make_fits(0, 0, 0, 0) if fits is None else fits,
    )

    def work(first: int, last: int) -> None:
        room = make_work(problem.arms, pressure, slots)
        fit = make_fit(problem.arms, given.weight)
        _answer(question, problem, tolerance, given, first, last, room, fit, answers)

    spread(len(given.rows) if question == SOLUTIONS else len(problem.limit), work)


@kernel
def _answer(question, problem, tolerance, given, first, last, work, fit, answers):  # type: ignore[no-untyped-def]
    """Answer a question for the arms from one to another, without the last."""
    arms, loads, scale, limit = problem.arms, problem.loads, problem.scale, problem.limit
    if question == EQUILIBRIA:
        room, path = work.room, work.path
        find_equilibria(arms, loads, scale, limit, given.start, tolerance, first, last, room, path, answers.found)
    elif question == SOLUTIONS:
        solve_rows(arms, loads, limit, given.twists, given.rows, first, last, work.room, given.right)
    elif question == FITS:
        fit_all(problem, given.twists, given.places, first, last, work, fit, answers.fits)
    else:
        places, start = given.places, given.start
        predict_all(problem, given.twists, places, start, tolerance, first, last, work, fit, answers.predictions)
