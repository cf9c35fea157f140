"""Is a gain in the metric a gain in shape? Every task, before and after: predicted, and searched."""

from collections.abc import Callable, Iterator, Sequence
from functools import cache

import numpy as np

import torcharm as ta
from experiments.design_optimisation.rows import Row, TaskRow
from experiments.design_optimisation.scenes import ARMS, FEW, LOADS, SHAPES, chosen_arms, joint, single

GIVEN, NEAREST, OWN, JOINT = "given", "nearest in range", "for the shape", "for all shapes"
PART = "verification"
Save = Callable[[list[TaskRow]], None]


@cache
def optimised(arm: str, goal: str, quick: bool) -> ta.OptimisedDesign:
    """The best design for a shape, or for all."""
    loads, iterations = (FEW, 4) if quick else (LOADS, None)
    task = joint(loads) if goal == JOINT else single(goal, loads)
    return ta.optimise_design(ARMS[arm], task, starts=1 if quick else 16, iterations=iterations)


def measure(quick: bool, known: Sequence[TaskRow], save: Save) -> list[TaskRow]:
    """Every design on every shape it was made for; what is known already is not measured again."""
    rows = list(known)
    have = {(row.arm, row.design, row.shape) for row in rows}
    for arm, given in chosen_arms(quick).items():
        for shape in SHAPES:
            for name in (GIVEN, NEAREST, OWN, JOINT):
                if (arm, name, shape) in have:
                    continue
                design = given if name == GIVEN else optimised(arm, shape if name == OWN else JOINT, quick).best
                if name == NEAREST:  # to the given one, for all shapes: where descent began
                    design = optimised(arm, JOINT, quick).starts[0]
                rows += one_shape(arm, name, shape, design, 1 if quick else LOADS)
                save(rows)
    return rows


def one_shape(arm: str, name: str, shape: str, design: ta.ArmDesign, loads: int) -> Iterator[TaskRow]:
    """A design on one shape under all loads."""
    task = single(shape, loads)
    found = ta.evaluate(design, task, ("absolute", "predicted_error"))
    searched = ta.search_pressure(design, task, progress=False)
    assert found.absolute is not None
    assert found.prediction is not None
    predicted = found.prediction
    sound = predicted.converged & predicted.stable
    columns = (
        found.absolute,
        predicted.shape_error,
        sound,
        searched.cost.clamp(min=0).sqrt(),
        searched.converged,
    )
    for load, values in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
        yield TaskRow(arm, name, shape, load, *values)


def summary(rows: Sequence[TaskRow]) -> Iterator[Row]:
    """Per shape, by designs made for it, and over all shapes, by the design made for all."""
    for arm in dict.fromkeys(row.arm for row in rows):
        own = [row for row in rows if row.arm == arm]
        shapes = list(dict.fromkeys(row.shape for row in own))
        cases = [(shape, GIVEN, OWN, [shape]) for shape in shapes]
        cases += [("jointly", GIVEN, JOINT, shapes), ("jointly, from nearest in range", NEAREST, JOINT, shapes)]
        for case, before, after, within in cases:
            pair = [[row for row in own if row.design == name and row.shape in within] for name in (before, after)]
            yield from compared(arm, case, *pair)


def compared(arm: str, case: str, before: Sequence[TaskRow], after: Sequence[TaskRow]) -> Iterator[Row]:
    """Statistics of the same tasks, before and after."""

    def column(rows: Sequence[TaskRow], name: str) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
        return np.array([float(getattr(row, name)) for row in rows])

    yield Row(PART, arm, case, "tasks", len(after), "tasks")
    for name, flag, unit in (
        ("absolute", None, "N"),
        ("predicted", "predicted_converged", "m"),
        ("searched", "searched_converged", "m"),
    ):
        was, now = column(before, name), column(after, name)
        both = np.isfinite(was) & np.isfinite(now)
        if flag is not None:
            sound = [column(rows, flag) > 0 for rows in (before, after)]
            for moment, own in zip(("before", "after"), sound, strict=True):
                yield Row(PART, arm, case, f"{name}, converged {moment}", own.mean(), "share")
            both &= sound[0] & sound[1]
            yield Row(PART, arm, case, f"{name}, converged before and after", both.mean(), "share")
            late = now[sound[1]]
            yield Row(PART, arm, case, f"{name} after, median of all that converged", _of(np.median, late), unit)
        for moment, values in (("before", was[both]), ("after", now[both])):
            yield Row(PART, arm, case, f"{name} {moment}, mean", _of(np.mean, values), unit)
            yield Row(PART, arm, case, f"{name} {moment}, median", _of(np.median, values), unit)
        yield Row(PART, arm, case, f"{name}, smaller after", _of(np.mean, now[both] < was[both]), "share")


def _of(statistic: Callable[..., float], values: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> float:
    return float(statistic(values)) if len(values) else float("nan")
