"""Time the evaluator: the validation study against scipy, sweeps in the plane and in space, growth and memory.

Times are CPU times of one thread. Prints tables and writes results.csv beside this file: one row a measurement.
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from scipy.optimize import minimize, nnls
from torch import Tensor

import torcharm as ta
from experiments.paper import paper_task, paper_wrench
from experiments.rows import Measurement, measurements_table, write_rows

Array = np.ndarray[Any, np.dtype[np.float64]]
HERE = Path(__file__).parent
NODES = 10
SHAPE = ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=NODES)
PLANE, SPACE = "plane", "space"
METRICS = ("absolute", "relative")
TIP_LOADS = {PLANE: [3.0, -2.0, 0.5], SPACE: [3.0, -2.0, 1.0, 0.2, -0.1, 0.5]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no file written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console()
    rows: list[Measurement] = []
    for part in (machine, compilation, memory, validation, sweep, own_model, growth):
        found = list(part(options.quick))
        console.print(measurements_table(found, 4))
        rows += found
    if not options.quick:
        write_rows(HERE / "results.csv", rows)
        console.print(f"wrote {len(rows)} rows to results.csv")


def seconds(work: Callable[[], object], repeats: int = 9) -> float:
    """Median CPU time of a warm call."""
    work()
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)


# ---- the machine -------------------------------------------------------------------------


def machine(quick: bool) -> Iterator[Measurement]:
    """What the machine does at present: other times mean little without it on a shared one."""
    a, b = torch.rand(2, 100_000, dtype=torch.float64)
    out = torch.empty_like(a)
    big = seconds(lambda: torch.mul(a, b, out=out), 201) / len(a)
    small = seconds(lambda: a[:4] * 2.0, 2001)
    part = "this machine, one thread"
    yield Measurement(part, "product of 100,000 doubles", "time", big * 1e9, "ns an element")
    yield Measurement(part, "slice and product of 4", "time", small * 1e6, "µs")


def compilation(quick: bool) -> Iterator[Measurement]:
    """The first call of a process, torch already imported, with no compiled code on disk and with it."""
    part = "first call: absolute and relative, one design, one load"
    if quick:  # with what is compiled already, as compiling takes its time
        (spent,) = in_a_process(f"print_first_calls({PLANE!r})")
        yield Measurement(part, "plane, compiled by an earlier process", "time", spent, "s")
        return
    for dimensions in ((PLANE,), (SPACE,), (PLANE, SPACE)):
        with tempfile.TemporaryDirectory() as folder:
            for case in ("nothing compiled yet", "compiled by an earlier process"):
                (spent,) = in_a_process(f"print_first_calls(*{dimensions})", NUMBA_CACHE_DIR=folder)
                yield Measurement(part, f"{' and '.join(dimensions)}, {case}", "time", spent, "s")


def in_a_process(call: str, **environment: str) -> list[float]:
    """The numbers that a function of this module prints in a process of its own."""
    code = "import torch; torch.set_num_threads(1)\n"
    code += f"from experiments.benchmark_evaluate import run; run.{call}"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=HERE.parents[1],
        env=os.environ | environment,
        check=True,
        capture_output=True,
        text=True,
    )
    return [float(word) for word in done.stdout.split()]


def print_first_calls(*dimensions: str) -> None:
    scenes = [scene(dimension) for dimension in dimensions]
    start = time.process_time()
    for arm, task in scenes:
        ta.evaluate(arm, task, ("absolute", "relative"))
    print(time.process_time() - start)


# ---- the validation study -------------------------------------------------------------


def validation(quick: bool) -> Iterator[Measurement]:
    """Absolute unattainability of 2 arms × 100 loads × 10 nodes, against a QP a node with SLSQP."""
    part = "validation study: 2 arms × 100 loads × 10 nodes, absolute"
    arms = (ta.antagonistic_arm(), ta.bellows_arm())
    task = paper_task(SHAPE, ta.sample_loads(100))
    for case, settings in {"exact": {}, "edges, 3 points": {"hull": "edges", "samples": 3}}.items():

        def ours(settings: dict[str, Any] = settings) -> list[Tensor | None]:
            return [ta.evaluate(arm, task, ("absolute",), **settings).absolute_per_node for arm in arms]

        spent = seconds(ours, 3 if quick else 51)
        yield Measurement(part, f"torcharm, {case}", "time", spent * 1e3, "ms")
    answers = ours()  # of the edges, which is what the baseline solves

    loads = slice(0, 2 if quick else 100)
    shorter = paper_task(SHAPE, task.tip_load[loads])
    elapsed, worst, worst_exact, solved = 0.0, 0.0, 0.0, 0
    for arm, answer in zip(arms, answers, strict=True):
        assert answer is not None
        vertices = ta.wrench_hulls(arm, SHAPE, hull="edges", samples=3).vertices.numpy()
        wanted = paper_wrench(SHAPE, shorter.tip_load)[..., (0, 2)].numpy()
        for load, wrenches in enumerate(track(wanted, "SLSQP", transient=True)):
            for node, wrench in enumerate(wrenches):
                start = time.process_time()
                distance = slsqp_distance(vertices[node], wrench)
                elapsed += time.process_time() - start
                worst = max(worst, abs(distance - answer[load, node].item()))
                accurate = nnls_distance(vertices[node], wrench)
                worst_exact = max(worst_exact, abs(accurate - answer[load, node].item()))
                solved += 1
    baseline = elapsed * 2000 / solved
    yield Measurement(part, f"scipy SLSQP, {solved} QPs", "time", baseline * 1e3, "ms")
    yield Measurement(part, "scipy SLSQP / torcharm, the same hulls", "ratio", baseline / spent, "times")
    yield Measurement(part, "scipy SLSQP - torcharm, the same hulls", "largest difference", worst, "N")
    yield Measurement(part, "scipy nnls - torcharm, the same hulls", "largest difference", worst_exact, "N")


def slsqp_distance(vertices: Array, wrench: Array) -> float:
    """The paper's QP, `min ½‖Hᵀs - w‖²` over the simplex, with gradients, as for MATLAB's fmincon."""
    gap = vertices - wrench
    scale = np.abs(gap).max()
    gap = gap / scale
    count = len(vertices)
    found = minimize(
        lambda s: 0.5 * ((s @ gap) ** 2).sum(),
        np.full(count, 1 / count),
        jac=lambda s: gap @ (s @ gap),
        bounds=[(0, None)] * count,
        constraints={"type": "eq", "fun": lambda s: s.sum() - 1, "jac": lambda s: np.ones(count)},
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 200},
    )
    return float(np.linalg.norm(found.x @ gap) * scale)


def nnls_distance(vertices: Array, wrench: Array) -> float:
    """The same QP by Lawson and Hanson: the point nearest to the origin of the shifted hull."""
    gap = vertices - wrench
    scale = np.abs(gap).max()
    system = np.vstack((gap.T / scale, np.ones(len(gap))))
    weights, _ = nnls(system, np.array([0.0, 0.0, 1.0]))
    return float(np.linalg.norm(weights @ gap) / weights.sum())


# ---- sweeps over designs ----------------------------------------------------------------


def scene(
    dimension: str,
    designs: int = 1,
    loads: int = 1,
    nodes: int = NODES,
    actuators: int = 4,
    models: Sequence[ta.Actuator] | None = None,
) -> tuple[ta.ArmDesign, ta.Task]:
    """Random designs of bellows and muscles in turn, on a curved shape.

    In the plane offsets are drawn from ±80 mm; in space actuators stand on a ring of a drawn radius.
    """
    generator = torch.Generator().manual_seed(0)
    kinds = models or (ta.Bellows(), ta.McKibben())
    own = [kinds[index % 2] for index in range(actuators)]
    slope, start = (-3.0, 3.0) if dimension == PLANE else (-1.0, 1.5)
    shape = ta.affine_curvature(slope, start, length=0.5, nodes=nodes)
    load = torch.tensor(TIP_LOADS[dimension], dtype=torch.float64)
    if loads > 1:
        load = load * (0.5 + torch.rand(loads, 1, generator=generator, dtype=torch.float64))
    if dimension == PLANE:
        radii = 0.16 * torch.rand(designs, actuators, generator=generator, dtype=torch.float64) - 0.08
        return ta.ArmDesign(radii, 0.5, own), paper_task(shape, load)
    radius = 0.03 + 0.03 * torch.rand(designs, 1, 1, generator=generator, dtype=torch.float64)
    twists = torch.zeros(nodes, 6, dtype=torch.float64)
    twists[:, 0], twists[:, 4], twists[:, 5] = shape[:, 0], 0.6 * shape[:, 2].flip(0), 0.8 * shape[:, 2]
    offsets = radius * ta.ring(radius=1.0, count=actuators)
    return ta.ArmDesign(offsets=offsets, length=0.5, actuators=own), paper_task(twists, load)


def total(arm: ta.ArmDesign, task: ta.Task, metric: str) -> Tensor:
    found: Tensor | None = getattr(ta.evaluate(arm, task, (metric,)), metric)
    assert found is not None
    return found


@dataclass(frozen=True)
class Timed:
    """Seconds of one evaluation."""

    forward: float
    both: float


def timed(arm: ta.ArmDesign, task: ta.Task, metric: str, repeats: int) -> Timed:
    """Forward, and forward with gradients in all radii (in space: offsets) and lengths."""

    def with_gradients() -> object:
        leaves = [
            None if value is None else value.detach().clone().requires_grad_()
            for value in (arm.radii, arm.length, arm.out_of_plane)
        ]
        tracked = ta.ArmDesign(leaves[0], leaves[1], arm.actuators, arm.max_pressure, out_of_plane=leaves[2])
        return torch.autograd.grad(total(tracked, task, metric).sum(), [leaf for leaf in leaves if leaf is not None])

    return Timed(seconds(lambda: total(arm, task, metric), repeats), seconds(with_gradients, repeats))


def sweep(quick: bool) -> Iterator[Measurement]:
    """Time a design: 4 actuators × 10 nodes × 1 load, exact sets; of one design that is the time of a small call."""
    part = "design sweep: exact sets, 4 actuators × 10 nodes × 1 load"
    for dimension in (PLANE, SPACE):
        for metric in METRICS:
            for count in (1, 200) if quick else (1, 1000, 100_000):
                arm, task = scene(dimension, designs=count)
                spent = timed(arm, task, metric, 3 if quick or count > 1 else 21)
                case = f"{dimension}, {metric}, {count:,} design(s)"
                yield Measurement(part, case, "forward", spent.forward / count * 1e6, "µs a design")
                yield Measurement(part, case, "forward + backward", spent.both / count * 1e6, "µs a design")


# ---- a user's model -----------------------------------------------------------------------


@dataclass(frozen=True)
class OwnBellows:
    """The bellows' force as a user would write it, unknown to the engine."""

    bending_stiffness: float = ta.Bellows().bending_stiffness  # type: ignore[assignment]
    max_pressure: float = 50.0
    strain_range: tuple[float, float] = ta.Bellows().strain_range
    pressure_range: tuple[float, float] = ta.Bellows().pressure_range

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        return ta.Bellows().force(strain, pressure)


@dataclass(frozen=True)
class Saturating(OwnBellows):
    """A user's force that no polynomial in pressure is."""

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        return 40 * torch.tanh(pressure / 40) * (1 - 0.8 * strain) - 60 * strain


def own_model(quick: bool) -> Iterator[Measurement]:
    """A user's force model beside the shipped one that it copies, and one that has no shipped counterpart."""
    count = 200 if quick else 10_000
    part = f"a user's torch model: {count:,} designs × 10 nodes × 1 load, absolute"
    for dimension in (PLANE, SPACE):
        spent, answers = {}, {}
        known: dict[str, ta.Actuator] = {"shipped": ta.Bellows(), "user's": OwnBellows(), "saturating": Saturating()}
        for name, model in known.items():
            arm, task = scene(dimension, designs=count, models=(model, model))
            spent[name], answers[name] = timed(arm, task, "absolute", 3), total(arm, task, "absolute")
            yield Measurement(part, f"{dimension}, {name}", "forward", spent[name].forward / count * 1e6, "µs a design")
            both = spent[name].both / count * 1e6
            yield Measurement(part, f"{dimension}, {name}", "forward + backward", both, "µs a design")
        ratio = spent["user's"].forward / spent["shipped"].forward
        yield Measurement(part, f"{dimension}, user's / shipped", "forward", ratio, "times")
        difference = (answers["user's"] - answers["shipped"]).abs().max().item()
        yield Measurement(part, f"{dimension}, user's - shipped", "largest difference", difference, "N")


# ---- memory ---------------------------------------------------------------------------


def memory(quick: bool) -> Iterator[Measurement]:
    """Peak memory of a process that evaluates many designs × 10 nodes × 1 load, torch included."""
    part = "memory: absolute and relative, exact sets"
    sizes = {PLANE: (2000,)} if quick else {PLANE: (1, 100_000, 1_000_000), SPACE: (1, 100_000)}
    for dimension, counts in sizes.items():
        for count in counts:
            for gradient in (True,) if quick else (False, True):
                peak, elapsed = in_a_process(f"print_peak('{dimension}', {count}, {gradient})")
                case = f"{dimension}, {count:,} design(s){', with gradients' if gradient else ''}"
                yield Measurement(part, case, "peak of the process", peak / 1024, "MiB")
                yield Measurement(part, case, "time", elapsed, "s")


def print_peak(dimension: str, count: int, gradient: bool) -> None:
    arm, task = scene(dimension, designs=count)
    length = arm.length.clone().requires_grad_(gradient)
    design = ta.ArmDesign(arm.radii, length, arm.actuators, arm.max_pressure, out_of_plane=arm.out_of_plane)
    start = time.process_time()
    found = ta.evaluate(design, task, ("absolute", "relative"))
    if gradient:
        assert found.absolute is not None
        assert found.relative is not None
        (found.absolute.sum() + found.relative.sum()).backward()
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time() - start)


# ---- growth ---------------------------------------------------------------------------


def growth(quick: bool) -> Iterator[Measurement]:
    """Time against designs, loads, nodes and actuators, one at a time, and the power it grows with."""
    top, scale = (2, 10) if quick else (5, 1)
    ladders: dict[str, list[dict[str, int]]] = {
        "designs": [{"designs": 1000 * 2**k // scale} for k in range(top)],
        "loads": [{"loads": 1000 * 2**k // scale} for k in range(top)],
        "nodes": [{"nodes": 1000 * 2**k // scale} for k in range(top)],
        "actuators": [{"actuators": 4 * 2**k, "designs": 500 // scale} for k in range(top)],
    }
    for dimension in (PLANE, SPACE):
        part = f"growth: absolute, exact sets, {dimension}"
        for name, sizes in ladders.items():
            spent = []
            for size in sizes:
                arm, task = scene(dimension, **size)  # type: ignore[arg-type]
                spent.append(seconds(lambda a=arm, t=task: total(a, t, "absolute"), 5))  # type: ignore[misc]
                yield Measurement(part, f"{size[name]:,} {name}", "time", spent[-1] * 1e3, "ms")
            power = np.polyfit(np.log([size[name] for size in sizes]), np.log(spent), 1)[0]
            yield Measurement(part, name, "power of growth (1 is linear)", float(power), "")
