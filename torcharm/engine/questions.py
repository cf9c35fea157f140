"""Questions about the equilibria of B arms, answered by one kernel: machine code of what they share is made once.

Each by itself would bring balance, Newton's step and continuation with it once more, and its first call would wait for
that. Searches stand apart: their code is as long as that of all of these, and most people first ask without.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from torcharm.engine.arms import sizes_of
from torcharm.engine.arrays import Array, make
from torcharm.engine.compilation import kernel
from torcharm.engine.continuation import find_equilibria
from torcharm.engine.implicit import solve_rows
from torcharm.engine.path import Found
from torcharm.engine.predictions import Predictions, predict_all
from torcharm.engine.pressure_model import SLOTS, Problem, Work
from torcharm.engine.references import by_reference
from torcharm.engine.threads import spread
from torcharm.engine.wrench_fit import Fit, FitAnswers, fit_all

EQUILIBRIA, SOLUTIONS, FITS, PREDICTIONS = range(4)
"""At pressures; of linear equations with J; pressures by wrenches alone; and pressures for a shape. See the modules."""


@by_reference
class Given(NamedTuple):
    """What is given beside the arms; a question takes some of it."""

    twists: Float64[Array, "B N K"] = np.zeros((0, 0, 0))  # shapes
    starts: Float64[Array, "S M"] = np.zeros((0, 0))  # normalised pressures to begin with
    start: Float64[Array, "B N K"] = np.zeros((0, 0, 0))  # twists of warm starts, or of none (0, N, K)
    rows: Int64[Array, "b"] = np.zeros(0, dtype=np.int64)  # which arms
    right: Float64[Array, "b X N C"] = np.zeros((0, 0, 0, 0))  # right-hand sides for each, which solutions replace
    weight: Float64[Array, "C"] = np.zeros(0)  # roots of the weights of wrenches


@by_reference
class Answers(NamedTuple):
    """Of equilibria, predictions and fits: one of them is written."""

    found: Found
    predictions: Predictions
    fits: FitAnswers


def answer(
    question: int, problem: Problem, tolerance: float, given: Given, **written: Found | Predictions | FitAnswers
) -> None:
    """Answer a question for all arms, in as many threads as PyTorch takes.

    Args:
        question: one of those above.
        problem: the arms; equilibria and solutions are at its limits of pressure, and need no goal.
        tolerance: of equilibria, of the load scale.
        given: what the question takes.
        written: that of `Answers` which it writes.
    """
    pressure, slots = np.zeros_like(problem.limit), SLOTS if question in (FITS, PREDICTIONS) else 0
    answers, sizes = make(Answers, {}, **written), sizes_of(problem.arms, slots=slots)

    def work(first: int, last: int) -> None:
        work, fit = make(Work, sizes, pressure=pressure), make(Fit, sizes, weight=given.weight)
        _answer(question, problem, tolerance, given, first, last, work, fit, answers)

    spread(len(given.rows) if question == SOLUTIONS else len(problem.limit), work)


def find(problem: Problem, start: Array, tolerance: float) -> Found:
    """The equilibria at the limits of pressure.

    Args:
        start: (B, N, K) twists of warm starts, or of none (0, N, K).
        tolerance: of the load scale.
    """
    found = make(Found, sizes_of(problem.arms, B=len(problem.limit)))
    answer(EQUILIBRIA, problem, tolerance, Given(start=start), found=found)
    return found


def solve(problem: Problem, twists: Array, index: Array, right: Array) -> None:
    """Replace right-hand sides (b, X, N, C) by J⁻¹ times them, of arms at an index (b,), at all twists (B, N, K)."""
    answer(SOLUTIONS, problem, 0.0, Given(twists=twists, rows=index, right=right))


def inverse(problem: Problem, twists: Array, index: Array) -> Array:
    """J⁻¹ (b, N·C, N·C) of the arms at an index (b,), at all twists (B, N, K)."""
    nodes, columns = twists.shape[1], len(problem.arms.unknown)
    size = nodes * columns
    right = np.broadcast_to(np.eye(size), (len(index), size, size)).copy()
    solve(problem, twists, index, right.reshape(len(index), size, nodes, columns))
    return right.transpose(0, 2, 1)


@kernel
def _answer(question, problem, tolerance, given, first, last, work, fit, answers):  # type: ignore[no-untyped-def]
    """Answer a question for the arms from one to another, without the last."""
    arms, loads, scale, limit = problem.arms, problem.loads, problem.scale, problem.limit
    if question == EQUILIBRIA:
        balance, path = work.balance, work.path
        find_equilibria(arms, loads, scale, limit, given.start, tolerance, first, last, balance, path, answers.found)
    elif question == SOLUTIONS:
        solve_rows(arms, loads, limit, given.twists, given.rows, first, last, work.balance, given.right)
    elif question == FITS:
        fit_all(problem, given.twists, given.starts, first, last, work, fit, answers.fits)
    else:
        starts, start = given.starts, given.start
        predict_all(problem, given.twists, starts, start, tolerance, first, last, work, fit, answers.predictions)
