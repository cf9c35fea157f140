"""Batches whose elements go at their own pace, and steps that run compiled."""

import subprocess
import sys
from dataclasses import replace
from typing import NamedTuple

import pytest
import torch
from hull_cases import unchecked
from torch import Tensor

import torcharm as ta
from torcharm._continuation import Problem, loaded, unloaded
from torcharm._underway import check_compiler, compiling, run

CPU = torch.device("cpu")


class Countdown(NamedTuple):
    element: Tensor
    left: Tensor
    over: Tensor


def countdown(own: Tensor, state: Countdown, by: float) -> Countdown:
    left = torch.where(state.over, state.left, state.left - by)
    return Countdown(state.element, left, state.over | (left <= own))


def test_all_go_to_their_end_at_their_own_pace():
    start = torch.tensor([3.0, 50.0, 2.0, 7.0, 20.0, 4.0, 2.0])
    for looks, wanted in ((100, torch.ones(7)), (5, start - 5)):
        out = torch.full_like(start, float("nan"))
        ended = torch.zeros(7, dtype=torch.bool)
        sizes = []

        def step(own, state, by, sizes=sizes):
            sizes.append(len(own))
            return countdown(own, state, by)

        def store(state, out=out, ended=ended):
            out[state.element], ended[state.element] = state.left, state.over

        state = Countdown(torch.arange(7), start, torch.zeros(7, dtype=torch.bool))
        run(step, torch.ones(7), state, looks, store, (1.0,), False)
        assert torch.equal(out, torch.maximum(torch.ones(7), wanted))
        assert torch.equal(ended, out == 1)
        assert sizes == sorted(sizes, reverse=True)
        assert sizes[-1] < 7


def has_compiler() -> bool:
    try:
        check_compiler()
    except ValueError:
        return False
    return True


TRACED_SEARCH = """
import torch
from torch._dynamo.testing import CompileCounterWithBackend
import torcharm as ta
from torcharm import _underway

torch.set_num_threads(1)
backend = CompileCounterWithBackend("aot_eager")  # graphs alone: what remains is the C++ compiler's, and takes minutes
steps = {}

def compiled(step):
    return steps.setdefault(step, torch.compile(step, dynamic=True, fullgraph=True, backend=backend))

_underway._compiled = compiled
_underway.check_compiler = lambda: None
shape, arm = ta.affine_curvature(-3.0, 3.0, nodes=3), ta.antagonistic_arm()
options = {"starts": 2, "hops": 1, "shear_stiffness": 1e5}
for loads in (ta.sample_loads(9), ta.sample_loads(1, seed=1)):
    plain = ta.search_pressure(arm, ta.Task(shape, loads), **options)
    found = ta.search_pressure(arm, ta.Task(shape, loads), compiled=True, **options)
    torch.testing.assert_close(found.cost, plain.cost, rtol=1e-9, atol=1e-12)
    assert torch.equal(found.converged, plain.converged)
    assert found.residual.max() <= 1e-10
print(backend.frame_count)
"""


def test_a_search_by_compiled_steps_is_the_same():
    # by itself: the check of signatures cannot be compiled
    done = subprocess.run([sys.executable, "-c", TRACED_SEARCH], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    # along the filling, along the loading, down the cost, and to the boundary: batches of all sizes share them
    assert done.stdout.strip() == "4"


@pytest.mark.skipif(not has_compiler(), reason="compiling needs a C++ compiler")
def test_compiled_code_finds_the_same_equilibria():
    torch._dynamo.reset()
    arm, count = ta.antagonistic_arm(), 40
    pressure = arm.max_pressure * torch.rand(count, 4, generator=torch.Generator().manual_seed(0)).double()
    designs = ta.ArmDesign(arm.radii.expand(count, 4), arm.length.expand(count, 4), arm.actuators)
    problem = Problem.of(designs, pressure, ta.sample_loads(count), torch.zeros(count, 3).double(), None, 1e-10)
    with torch.no_grad(), compiling(CPU), unchecked():
        for work in (unloaded, lambda problem: loaded(problem, unloaded(problem).unknowns.expand(-1, -1, 2))):
            plain, found = work(problem), work(replace(problem, compiled=True))
            assert plain.arrived.all()
            assert found.arrived.all()
            torch.testing.assert_close(found.unknowns, plain.unknowns, rtol=0, atol=1e-10)


def test_what_it_cannot_compile_for_is_said(monkeypatch):
    task = ta.Task(ta.affine_curvature(-1.0, 1.0, nodes=3), [0.0] * 3)
    monkeypatch.setattr(torch._inductor.config.cpp, "cxx", ("no-such-compiler",))
    torch._inductor.cpp_builder.cpp_compiler_search.cache_clear()
    with pytest.raises(ValueError, match=r"compiled: must be False without a C\+\+ compiler"):
        ta.search_pressure(ta.bellows_arm(), task, compiled=True)
    with pytest.raises(ValueError, match="compiled: must be False for tensors that are not on the CPU"):
        compiling(torch.device("cuda")).__enter__()
