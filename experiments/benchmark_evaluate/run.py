"""Time the evaluator: the validation study against scipy, a design sweep, and growth.

Prints tables and writes results.csv beside this file: one row a measurement.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from scipy.optimize import minimize, nnls

import torcharm as ta
from experiments.rows import Measurement, measurements_table, write_rows
from torcharm import hulls
from torcharm.distance.closed_form import nearest_faces

Array = np.ndarray[Any, np.dtype[np.float64]]
HERE = Path(__file__).parent
NODES = 10
SHAPE = ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=NODES)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no file written")
    parser.add_argument("--compile", action="store_true", help="also torch.compile (several minutes)")
    parser.add_argument("--threads", type=int, default=2, help="threads for torch (default 2)")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    console = Console()
    rows: list[Measurement] = []
    for part in (machine, validation, sweep, stages, memory, compiled, growth):
        if part is compiled and not options.compile:
            continue
        found = list(part(options.quick))
        console.print(measurements_table(found, 4))
        rows += found
    if not options.quick:
        write_rows(HERE / "results.csv", rows)
        console.print(f"wrote {len(rows)} rows to results.csv")


def seconds(work: Callable[[], object], repeats: int = 9) -> float:
    """Median time of a warm call."""
    work()
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


# ---- the machine -------------------------------------------------------------------------


def machine(quick: bool) -> Iterator[Measurement]:
    """What the machine does at present: other times mean little without it on a shared one."""
    a, b = torch.rand(2, 100_000, dtype=torch.float64)
    out = torch.empty_like(a)
    big = seconds(lambda: torch.mul(a, b, out=out), 201) / len(a)
    small = seconds(lambda: a[:4] * 2.0, 2001)
    part = f"this machine, {torch.get_num_threads()} thread(s)"
    yield Measurement(part, "product of 100,000 doubles", "time", big * 1e9, "ns an element")
    yield Measurement(part, "slice and product of 4", "time", small * 1e6, "µs")


# ---- the validation study -------------------------------------------------------------


def validation(quick: bool) -> Iterator[Measurement]:
    """Absolute unattainability of 2 arms × 100 loads × 10 nodes, against a QP a node with SLSQP."""
    part = "validation study: 2 arms × 100 loads × 10 nodes, absolute"
    arms = (ta.antagonistic_arm(), ta.bellows_arm())
    task = ta.Task(SHAPE, ta.sample_loads(100))
    for case, settings in {"exact": {}, "edges, 3 points": {"hull": "edges", "samples": 3}}.items():

        def ours(settings: dict[str, object] = settings) -> list[torch.Tensor | None]:
            return [ta.evaluate(arm, task, ("absolute",), **settings).absolute_per_node for arm in arms]  # type: ignore[arg-type]

        spent = seconds(ours, 3 if quick else 51)
        yield Measurement(part, f"torcharm, {case}", "time", spent * 1e3, "ms")
    answers = ours()  # of the edges, which is what the baseline solves

    loads = slice(0, 2 if quick else 100)
    shorter = ta.Task(SHAPE, task.tip_load[loads])
    elapsed, worst, worst_exact, solved = 0.0, 0.0, 0.0, 0
    for arm, answer in zip(arms, answers, strict=True):
        assert answer is not None
        vertices = all_edge_samples(arm)
        wanted = ta.required_wrench(SHAPE, shorter.tip_load)[..., (0, 2)].numpy()
        for load, wrenches in enumerate(track(wanted, "SLSQP", transient=True)):
            for node, wrench in enumerate(wrenches):
                start = time.perf_counter()
                distance = slsqp_distance(vertices[node], wrench)
                elapsed += time.perf_counter() - start
                worst = max(worst, abs(distance - answer[load, node].item()))
                accurate = nnls_distance(vertices[node], wrench)
                worst_exact = max(worst_exact, abs(accurate - answer[load, node].item()))
                solved += 1
    baseline = elapsed * 2000 / solved
    yield Measurement(part, f"scipy SLSQP, {solved} QPs of 48 weights", "time", baseline * 1e3, "ms")
    yield Measurement(part, "scipy SLSQP / torcharm, the same hulls", "ratio", baseline / spent, "times")
    yield Measurement(part, "scipy SLSQP - torcharm, the same hulls", "largest difference", worst, "N")
    yield Measurement(part, "scipy nnls - torcharm, the same hulls", "largest difference", worst_exact, "N")


def all_edge_samples(arm: ta.ArmDesign) -> Array:
    """Reactions (N, 48, 2) to the paper's pressures: three on every edge of the pressure box."""
    table = torch.tensor(hulls.edge_table(arm.actuator_count, 3)) / 2 * arm.max_pressure
    return ta.reaction_wrench(arm, SHAPE, table).movedim(0, 1).numpy()


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


# ---- a sweep over designs -------------------------------------------------------------


def sweep(quick: bool) -> Iterator[Measurement]:
    """Time a design: 4 actuators × 10 nodes × 1 load × 3 samples a curve."""
    for count in (1, 1000) if quick else (1, 1000, 10_000, 100_000):
        parameters = random_parameters(count)
        repeats = 3 if quick or count > 1000 else 21
        forward = seconds(lambda p=parameters: sweep_total(p), repeats)  # type: ignore[misc]
        both = seconds(lambda p=parameters: sweep_gradient(p), repeats)  # type: ignore[misc]
        part = "design sweep: 4 actuators × 10 nodes × 1 load × 3 samples"
        yield Measurement(part, f"{count:,} designs", "forward", forward / count * 1e6, "µs a design")
        yield Measurement(part, f"{count:,} designs", "forward + backward", both / count * 1e6, "µs a design")


def random_parameters(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Outer radii and lengths [m] around the paper's."""
    generator = torch.Generator().manual_seed(0)
    radius, length = torch.rand(2, count, generator=generator, dtype=torch.float64)
    return 0.04 + 0.05 * radius, 0.45 + 0.1 * length


def sweep_total(parameters: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
    radius, length = parameters
    arm = ta.antagonistic_arm(radius, 0.015, length)
    found = ta.evaluate(arm, ta.Task(SHAPE, [3.0, -2.0, 0.5]), ("absolute",), samples=3).absolute
    assert found is not None
    return found


def sweep_gradient(
    parameters: tuple[torch.Tensor, torch.Tensor],
    total: Callable[[tuple[torch.Tensor, torch.Tensor]], torch.Tensor] = sweep_total,
) -> tuple[torch.Tensor, ...]:
    leaves = tuple(parameter.requires_grad_() for parameter in map(torch.clone, parameters))
    return torch.autograd.grad(total(leaves).sum(), leaves)  # type: ignore[arg-type]


def stages(quick: bool) -> Iterator[Measurement]:
    """Where the time of a forward pass goes, in one block of designs."""
    count = 500 if quick else 2500
    radius, length = random_parameters(count)
    arm = ta.antagonistic_arm(radius, 0.015, length)
    wanted = ta.required_wrench(SHAPE, torch.tensor([3.0, -2.0, 0.5], dtype=torch.float64))
    x, y = (wanted[:, axis].repeat_interleave(count).unsqueeze(-1) for axis in (0, 2))
    torch.empty(30_000_000, dtype=torch.uint8)
    with torch.no_grad():
        sections = hulls.cross_sections(arm, SHAPE[None])
        curves = hulls.sample_curves(sections, 3)
        polygons = hulls.build_hulls(curves, "exact", (1.0, 1.0)).polygons
        steps: dict[str, Callable[[], object]] = {
            "strains": lambda: hulls.cross_sections(arm, SHAPE[None]),
            "forces along the curves": lambda: hulls.sample_curves(sections, 3),
            "Minkowski sums": lambda: hulls.build_hulls(curves, "exact", (1.0, 1.0)),
            "distances": lambda: nearest_faces(polygons, x, y, slots=False),
        }
        spent = {name: seconds(step, 21) / count * 1e6 for name, step in steps.items()}
    part = f"where a forward pass spends its time: one block of {count:,} designs"
    for name, value in spent.items():
        yield Measurement(part, name, "time", value, "µs a design")


def memory(quick: bool) -> Iterator[Measurement]:
    """Peak memory of a process that evaluates many designs × 10 nodes × 1 load, torch included."""
    for count in (10_000,) if quick else (1, 1_000_000):
        code = f"from experiments.benchmark_evaluate import run; run.print_peak({count}, {torch.get_num_threads()})"
        root = HERE.parents[1]
        printed = subprocess.run([sys.executable, "-c", code], cwd=root, check=True, capture_output=True, text=True)
        peak, elapsed = map(float, printed.stdout.split())
        part = "memory: absolute and relative, exact hulls, default samples"
        yield Measurement(part, f"{count:,} designs", "peak of the process", peak / 1024, "MiB")
        yield Measurement(part, f"{count:,} designs", "time", elapsed, "s")


def print_peak(count: int, threads: int) -> None:
    torch.set_num_threads(threads)
    radius, length = random_parameters(count)
    start = time.perf_counter()
    ta.evaluate(ta.antagonistic_arm(radius, 0.015, length), ta.Task(SHAPE, [3.0, -2.0, 0.5]))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter() - start)


def compiled(quick: bool) -> Iterator[Measurement]:
    """The sweep through torch.compile, checked for equal results."""
    count = 20_000
    parameters = random_parameters(count)
    fast = torch.compile(sweep_total)
    part = f"torch.compile: the sweep at {count:,} designs"
    start = time.perf_counter()
    difference = (fast(parameters) - sweep_total(parameters)).abs().max().item()
    yield Measurement(part, "forward", "compilation", time.perf_counter() - start, "s")
    yield Measurement(part, "forward", "largest difference", difference, "N")
    for name, total in (("eager", sweep_total), ("compiled", fast)):
        spent = seconds(lambda t=total: t(parameters), 5)  # type: ignore[misc]
        yield Measurement(part, f"forward, {name}", "time", spent / count * 1e6, "µs a design")
    start = time.perf_counter()
    pairs = zip(sweep_gradient(parameters, fast), sweep_gradient(parameters), strict=True)
    difference = max((ours - theirs).abs().max().item() for ours, theirs in pairs)
    yield Measurement(part, "forward + backward", "compilation", time.perf_counter() - start, "s")
    yield Measurement(part, "forward + backward", "largest difference", difference, "N/m")
    for name, total in (("eager", sweep_total), ("compiled", fast)):
        spent = seconds(lambda t=total: sweep_gradient(parameters, t), 5)  # type: ignore[misc]
        yield Measurement(part, f"forward + backward, {name}", "time", spent / count * 1e6, "µs a design")


# ---- growth ---------------------------------------------------------------------------


def growth(quick: bool) -> Iterator[Measurement]:
    """Time against designs, loads, nodes and actuators, one at a time, and the power it grows with."""
    top = 2 if quick else 5
    ladders: dict[str, tuple[list[int], Callable[[int], tuple[ta.ArmDesign, ta.Task]]]] = {
        "designs": ([1000 * 2**k for k in range(top)], lambda n: scene(designs=n)),
        "loads": ([10_000 * 2**k for k in range(top)], lambda n: scene(loads=n)),
        "nodes": ([1000 * 2**k for k in range(top)], lambda n: scene(nodes=n)),
        "actuators": ([4 * 2**k for k in range(top)], lambda n: scene(designs=500, actuators=n)),
    }
    part = "growth: absolute, exact hulls of 3 samples"
    for name, (sizes, build) in ladders.items():
        spent = []
        for size in sizes:
            arm, task = build(size)
            spent.append(seconds(lambda a=arm, t=task: ta.evaluate(a, t, ("absolute",), samples=3), 5))  # type: ignore[misc]
            yield Measurement(part, f"{size:,} {name}", "time", spent[-1] * 1e3, "ms")
        power = np.polyfit(np.log(sizes), np.log(spent), 1)[0]
        yield Measurement(part, name, "power of growth (1 is linear)", float(power), "")


def scene(designs: int = 1, loads: int = 1, nodes: int = NODES, actuators: int = 4) -> tuple[ta.ArmDesign, ta.Task]:
    generator = torch.Generator().manual_seed(0)
    radii = 0.16 * torch.rand(designs, actuators, generator=generator, dtype=torch.float64) - 0.08
    kinds = [ta.Bellows() if index % 2 == 0 else ta.McKibben() for index in range(actuators)]
    shape = ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=nodes)
    return ta.ArmDesign(radii, 0.5, kinds), ta.Task(shape, ta.sample_loads(loads))
