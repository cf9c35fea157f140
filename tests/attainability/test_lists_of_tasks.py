"""Lists of tasks, which may differ in nodes and loads: a result for each, in order."""

import math

import pytest
import torch

import torcharm as ta

ARM = ta.antagonistic_arm(0.05, 0.015, 0.5)
TASKS = [
    ta.Task(ta.affine_curvature(0.0, 1.0, nodes=4), ta.sample_loads(3, (4.0, 4.0, 0.4))),
    ta.Task(ta.affine_curvature(-0.5, 0.8, nodes=7), [0.0, -1.0, 0.0], wrench_at="start"),
    ta.Task(ta.affine_curvature(0.2, [[0.1], [0.5]], nodes=4), load=ta.ExternalLoad([1.0, 0.0, 0.0], gravity=True)),
]
SHAPES = [(3,), (), (2, 1)]
CALLS = {
    "evaluate": lambda task: ta.evaluate(ARM, task, signed=True),
    "sets alone": lambda task: ta.evaluate(ARM, task, ("relative",), weights=(1.0, 4.0)),
    "predict_error": lambda task: ta.predict_error(ARM, task),
    "search_pressure": lambda task: ta.search_pressure(ARM, task, starts=1),
}


def numbers(found):
    """All tensors of a result, by name."""
    return {name: value for name, value in vars(found).items() if isinstance(value, torch.Tensor)}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("kind", [list, tuple])
def test_each_task_has_the_result_that_it_has_alone(call, kind):
    found = CALLS[call](kind(TASKS))
    assert isinstance(found, tuple)
    for one, task, shape in zip(found, TASKS, SHAPES, strict=True):
        alone = CALLS[call](task)
        assert type(one) is type(alone)
        assert one.in_range.shape == shape
        assert numbers(one).keys() == numbers(alone).keys()
        for name, value in numbers(alone).items():
            torch.testing.assert_close(numbers(one)[name], value, rtol=0, atol=0, equal_nan=True)
    if call == "evaluate":
        assert [one.task for one in found] == TASKS
        assert found[1].verdict == ta.evaluate(ARM, TASKS[1]).verdict


def test_a_list_of_one_is_a_list():
    (found,) = ta.evaluate(ARM, [TASKS[0]], "absolute")
    assert found.absolute.shape == (3,)


def test_gradients_come_through_all_of_a_list():
    radius = torch.tensor(0.05, dtype=torch.float64, requires_grad=True)
    tasks = [ta.Task(task.twists, 20.0 * task.tip_load) for task in TASKS]
    arm = ta.antagonistic_arm(radius, 0.015, 0.5)
    total = sum(one.absolute.sum() for one in ta.evaluate(arm, tasks, "absolute"))
    alone = sum(ta.evaluate(arm, task, "absolute").absolute.sum() for task in tasks)
    (slope,), (expected,) = torch.autograd.grad(total, radius), torch.autograd.grad(alone, radius)
    assert slope.isclose(expected)
    assert expected != 0


@pytest.mark.parametrize("call", CALLS)
def test_errors_say_which_task(call):
    spatial = ta.Task(torch.ones(4, 6, dtype=torch.float64), torch.zeros(6, dtype=torch.float64))
    for given, said in (
        ([], r"^task: must hold at least one task, got none$"),
        ([TASKS[0], spatial], r"^task\[1\]: must be of the arm's dimension, 2, got 3$"),
    ):
        with pytest.raises(ValueError, match=said):
            CALLS[call](given)
    with pytest.raises(ValueError, match=r"^weights: must be finite and above 0"):
        ta.evaluate(ARM, TASKS, weights=(math.nan, 1.0))
