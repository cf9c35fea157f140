"""Measure forward mechanics and pressure search, against scipy in the same run.

Prints tables, writes results.csv (one row a measurement) and two figures beside this file.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from scipy.stats import spearmanr
from torch import Tensor

import torcharm as ta
from experiments.benchmark_search import figures, reference
from experiments.benchmark_search.figures import DEFAULT
from experiments.paper import paper_equilibrium, paper_task
from experiments.rows import Measurement as Row, measurements_table, read_rows, write_rows

HERE = Path(__file__).parent
ARMS = {"antagonistic": ta.antagonistic_arm(), "bellows-only": ta.bellows_arm()}
OTHERS = {"antagonistic": reference.ANTAGONISTIC, "bellows-only": reference.BELLOWS}
SHAPE = ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=10)
PLANS = ((1, 0), (DEFAULT[0], 0), DEFAULT)
"""Starts and rounds of searches, the defaults the last."""
PLANS_OF_SCIPY = (
    ("L-BFGS-B", 1, 100),
    ("SLSQP", 1, 100),
    ("SLSQP", 8, 20),
)
"""Methods, starts and tasks."""
SAME_COST = 1e-6
"""Difference of two costs [m²] of one equilibrium at most: those of two equilibria differ by more."""
TURN = 10
"""Tasks of scipy's between two searches of all by ours: a machine that does other work is slower for minutes."""
HARD = ((50.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0, 1.0), (1.3, 2.65, 1.59, 4.59), (20.0, 50.0, 10.0, 5.0), (0.0,) * 4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no file written")
    parser.add_argument("--threads", type=int, default=1, help="threads for torch (default 1)")
    names = [part.__name__ for part in PARTS]
    parser.add_argument("--only", nargs="+", choices=names, help="measure these parts alone, and keep the other rows")
    parser.add_argument("--figure", action="store_true", help="only draw: times of results.csv, and ranks anew")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    console = Console()
    rows: list[Row] = []
    for part in PARTS:
        if options.figure or (options.only and part.__name__ not in options.only):
            continue
        found = list(part(options.quick))
        console.print(measurements_table(found))
        rows += found
    if options.quick:
        return
    known = {row.part for row in rows}
    kept = [row for row in read_rows(HERE / "results.csv", Row) if row.part not in known]
    rows = kept + rows if options.only or options.figure else rows
    if not options.figure:
        write_rows(HERE / "results.csv", rows)
    figures.draw_starts(rows, HERE / "starts.png")
    figures.draw_ranks({name: ranked(name, 100) for name in ARMS}, HERE / "ranks.png")
    console.print(f"{len(rows)} rows in results.csv; drew starts.png and ranks.png")


# ---- forward mechanics ------------------------------------------------------------------


def hard_pressures(arm: ta.ArmDesign) -> Tensor:
    """Every order of the hard pressures, and the limits (P, 4)."""
    orders = [order for base in HARD for order in sorted(set(permutations(base)))]
    given = torch.tensor(orders, dtype=torch.float64)
    return torch.cat((torch.minimum(given, arm.max_pressure), arm.max_pressure[None]))


def hard_points(quick: bool) -> Iterator[Row]:
    """Convergence at hard pressures under the published loads, and agreement with scipy."""
    part = "hard points: every order of (50,0,0,0), (1,1,1,1), (1.3,2.65,1.59,4.59), (20,50,10,5); zero; limits"
    for name, arm in ARMS.items():
        for moment in (2.0, 5.0):
            pressure, loads = hard_pressures(arm), ta.sample_loads(100, (20, 20, moment))
            if quick:
                pressure, loads = pressure[::9], loads[::20]
            found = paper_equilibrium(arm, pressure[:, None], loads)
            case = f"{name}, M0 = {moment:g}"
            yield Row(part, case, "equilibria", found.converged.numel())
            yield Row(
                part, case, "converged to 1e-10 of the load scale", 100 * float(found.converged.double().mean()), "%"
            )
            yield Row(
                part,
                case,
                "of these along the branch from zero load",
                100 * float(found.continued.double().mean()),
                "%",
            )
            yield Row(part, case, "flagged", float((~found.converged).sum()))
            yield Row(part, case, "largest residual of the converged", float(found.residual[found.converged].max()))
            picks = np.random.default_rng(0).permutation(found.converged.numel())[: 5 if quick else 60]
            yield from against_scipy(part, case, OTHERS[name], found, pressure, loads, picks)


def against_scipy(
    part: str,
    case: str,
    other: reference.Arm,
    found: ta.Equilibrium,
    pressure: Tensor,
    loads: Tensor,
    picks: np.ndarray[Any, np.dtype[np.int64]],
) -> Iterator[Row]:
    gaps, shots, elsewhere, failed = [], [], 0, 0
    for pick in track(picks, f"scipy, {case}", transient=True):
        i, j = divmod(int(pick), len(loads))
        if not found.converged[i, j]:
            continue
        ours = np.concatenate(found.twists[i, j, :, ::2].numpy().T)
        near = ours * (1 + 1e-4 * np.sin(np.arange(len(ours))))
        theirs = reference.solve_all(other, pressure[i].numpy(), loads[j].numpy(), near)
        if theirs is None:
            failed += 1
        elif np.abs(theirs - ours).max() > 0.01:
            elsewhere += 1
        else:
            gaps.append(np.abs(theirs - ours).max())
        shot = reference.shoot(other, pressure[i].numpy(), loads[j].numpy(), near)
        if shot is not None:
            shots.append(np.abs(shot - ours).max())
    yield Row(
        part,
        case,
        f"scipy root, {len(gaps)} compared ({failed} failed, {elsewhere} left): largest difference",
        max(gaps),
        "m, rad",
    )
    yield Row(
        part,
        case,
        f"scalar shooting, {len(shots)} compared: largest difference",
        max(shots, default=float("nan")),
        "m, rad",
    )


def speed(quick: bool) -> Iterator[Row]:
    """Equilibria a second by batch, random pressures and published loads; scipy in the same run."""
    part = f"speed: N = 10, random pressures, loads of the validation, {torch.get_num_threads()} thread(s)"
    for name, arm in ARMS.items():
        for batch in (1, 10, 100) if quick else (1, 10, 100, 1000, 5000):
            generator = torch.Generator().manual_seed(0)
            pressure = torch.rand(batch, 4, generator=generator, dtype=torch.float64) * arm.max_pressure
            loads = ta.sample_loads(batch)
            times = []
            for _repeat in range(2 if quick else 6):
                begun = time.perf_counter()
                found = paper_equilibrium(arm, pressure, loads)
                times.append(time.perf_counter() - begun)
            rate = batch / float(np.median(times[1:]))  # the first may compile
            case = f"{name}, batch {batch:,}"
            yield Row(part, case, "equilibria", rate, "1/s")
            yield Row(part, case, "converged", 100 * float(found.converged.double().mean()), "%")
        other, solved, begun = OTHERS[name], 0, time.perf_counter()
        tries = 2 if quick else 20
        for k in range(tries):
            start = reference.continue_all(other, pressure[k].numpy(), loads[k].numpy(), 10, steps=4)
            solved += start is not None
        rate = tries / (time.perf_counter() - begun)
        yield Row(part, f"{name}, scipy root, 4 load steps", "equilibria", rate, "1/s")
        yield Row(part, f"{name}, scipy root, 4 load steps", "converged", 100 * solved / tries, "%")
        begun = time.perf_counter()
        solved = 0
        straight = np.concatenate((np.full(10, 0.5), np.zeros(10)))
        for k in range(tries):
            solved += reference.solve_all(other, pressure[k].numpy(), loads[k].numpy(), straight) is not None
        rate = tries / (time.perf_counter() - begun)
        yield Row(part, f"{name}, scipy root, from straight", "equilibria", rate, "1/s")
        yield Row(part, f"{name}, scipy root, from straight", "converged", 100 * solved / tries, "%")


def extremes(quick: bool) -> Iterator[Row]:
    """Stiff and extreme scenes: converged, along the branch, flagged."""
    part = "stiff and extreme: 50 random pressures and loads each (antagonistic unless said)"
    count = 6 if quick else 50
    generator = torch.Generator().manual_seed(1)
    share = torch.rand(count, 4, generator=generator, dtype=torch.float64)
    arm = ARMS["antagonistic"]
    usual, loads = share * arm.max_pressure, ta.sample_loads(count)
    scenes: dict[str, tuple[ta.ArmDesign, Tensor, Tensor, dict[str, float]]] = {}
    for level in (0.0, 1e-6, 1e-3, 1e-1):
        scenes[f"pressures to {level:g} kPa"] = (arm, share * level, loads, {})
    for level in (10.0, 30.0, 100.0):
        scenes[f"loads to {level:g} N"] = (arm, usual, loads * level / 10, {})
    for factor in (1e-3, 1e-1, 10.0, 1e3):
        models = [replace(model, bending_stiffness=factor * float(model.bending_stiffness)) for model in arm.actuators]  # type: ignore[type-var, arg-type]
        scenes[f"bending stiffness × {factor:g}"] = (ta.ArmDesign(arm.radii, arm.length, models), usual, loads, {})
    for stiffness in (1e3, 1e5, 1e7, 1e9):
        scenes[f"finite shear {stiffness:g} N/m"] = (arm, usual, loads, {"shear_stiffness": stiffness})
    for nodes in (1, 2, 5, 20, 50, 100):
        scenes[f"N = {nodes}"] = (arm, usual, loads, {"nodes": nodes})
    scenes["muscles only"] = (ta.mckibben_arm(), share * 100, loads, {})
    scenes["muscles only, to 5 kPa: kinks"] = (ta.mckibben_arm(), share * 5, loads, {})
    for name, (design, pressure, load, options) in scenes.items():
        found = paper_equilibrium(design, pressure, load, **options)  # type: ignore[arg-type]
        good, size = found.converged, len(pressure)
        assert bool((found.residual[good] <= 1e-10).all())
        yield Row(part, name, "converged", 100 * float(good.double().mean()), "%")
        yield Row(part, name, "along the branch from zero load", 100 * float(found.continued.double().mean()), "%")
        yield Row(part, name, "flagged", size - float(good.sum()))
        yield Row(part, name, "out of the characterised range", 100 * float((~found.in_range).double().mean()), "%")


# ---- pressure search --------------------------------------------------------------------


def validation(name: str, count: int) -> tuple[ta.ArmDesign, ta.Task]:
    return ARMS[name], paper_task(SHAPE, ta.sample_loads(100)[:count])


def searches(quick: bool) -> Iterator[Row]:
    """The validation's 200 searches against the scipy baseline on some of them."""
    part = "search: validation shape (-3, 3), M0 = 2, ω = linspace(0, 1, N)"
    count = 3 if quick else 100
    plans = (("SLSQP", 1, 1),) if quick else PLANS_OF_SCIPY
    methods = ("SLSQP",) if quick else ("SLSQP", "L-BFGS-B", "Nelder-Mead", "trust-constr")
    few = 1 if quick else 2
    spent_of: dict[tuple[str, int], list[float]] = {}
    for name in ARMS:
        arm, task = validation(name, count)
        load_code(arm)
        found, spent = timed_search(arm, task, 1 if quick else 5)
        yield Row(part, f"{name}, {count} tasks", "time a search", spent * 1e3, "ms")
        yield Row(part, name, "converged", float(found.converged.sum()), f"of {count}")
        yield Row(part, name, "continued from zero load", float(found.continued.sum()), f"of {count}")
        flat = float((found.optimality > 1e-4).sum())
        yield Row(part, name, "first-order optimality above 1e-4", flat, f"of {count}")
        yield Row(part, name, "median cost", float(found.cost.median()), "m²")
        for method in methods:
            sub = paper_task(SHAPE, task.tip_load[:few])
            begun = time.perf_counter()
            tried = ta.search_pressure(arm, sub, "scipy", scipy_method=method, progress=False)
            case = f"{name}, scipy {method}, {few} tasks"
            yield Row(part, case, "time a search", (time.perf_counter() - begun) / few, "s")
            yield Row(part, case, "mean excess cost", float((tried.cost - found.cost[:few]).mean()), "m²")
        for method, multi, some in plans:
            costs, slow, own = [], 0.0, []
            for loads in task.tip_load[:some].split(TURN):
                begun = time.perf_counter()
                theirs = ta.search_pressure(
                    arm, paper_task(SHAPE, loads), "scipy", scipy_method=method, starts=multi, progress=False
                )
                slow += (time.perf_counter() - begun) / some
                costs.append(theirs.cost)
                own.append(timed_search(arm, task, 1)[1])
            cost_of_scipy, quick_one = torch.cat(costs), float(np.median(own))
            case = f"{name}, scipy {method}, {multi} start(s), {some} tasks"
            yield Row(part, case, "time a search", slow, "s")
            yield Row(part, case, "time over ours, in turn", slow / quick_one, "times")
            ours = found.cost[:some]
            good, better = (ours <= cost_of_scipy + 1e-9).sum(), (ours < cost_of_scipy / 1.01).sum()
            yield Row(part, case, "no worse (+1e-9)", float(good), f"of {some}")
            yield Row(part, case, "better by over 1 %", float(better), f"of {some}")
            for index in (ours > cost_of_scipy + 1e-9).nonzero().squeeze(-1).tolist():
                worse = f"{case}, load {index + 1}, scipy found better"
                yield Row(part, worse, "cost", float(ours[index]), "m²")
                yield Row(part, worse, "cost, scipy", float(cost_of_scipy[index]), "m²")
            sums = spent_of.setdefault((method, multi), [0.0, 0.0])
            sums[0], sums[1] = sums[0] + slow, sums[1] + quick_one
    for (method, multi), (slow, quick_one) in spent_of.items():
        case = f"both arms, scipy {method}, {multi} start(s)"
        yield Row(part, case, "time over ours, in turn", slow / quick_one, "times")


def searches_of_scipy_alone(quick: bool) -> Iterator[Row]:
    """The paper's way, in which scipy finds each equilibrium, too, beside the validation's searches of ours."""
    part = "search with scipy alone: L-BFGS-B, one start, equilibria by root; the validation's tasks"
    few, count = (1, 3) if quick else (20, 100)
    for name in ARMS:
        arm, task = validation(name, count)
        load_code(arm)
        length, _, curvature = SHAPE.numpy().T
        wanted, limits = reference.march(length, curvature), np.asarray(arm.max_pressure)
        slow, quick_one, gaps = [], [], []
        for load in task.tip_load[:few]:
            begun = time.perf_counter()
            pressure, cost = reference.search(OTHERS[name], wanted, load.numpy(), limits, len(SHAPE))
            slow.append(time.perf_counter() - begun)
            quick_one.append(timed_search(arm, task, 1)[1])
            loaded = paper_equilibrium(arm, torch.from_numpy(pressure), load)
            gaps.append(abs(reference.pose_cost(loaded.twists[:, [0, 2]].T.flatten().numpy(), wanted) - cost))
        case, reached = f"{name}, {few} tasks", [gap for gap in gaps if gap <= SAME_COST]
        yield Row(part, case, "time a search", float(np.mean(slow)), "s")
        yield Row(part, case, "time over ours, in turn", float(np.mean(slow) / np.median(quick_one)), "times")
        yield Row(part, case, "ends that loading from rest reaches", len(reached), f"of {few}")
        yield Row(
            part, case, "of these, largest difference of its cost from ours", max(reached, default=math.nan), "m²"
        )


def load_code(arm: ta.ArmDesign) -> None:
    """Search once, so that what is timed next neither compiles nor loads machine code."""
    ta.search_pressure(arm, paper_task(SHAPE, ta.sample_loads(2)))


def timed_search(
    arm: ta.ArmDesign, task: ta.Task, repeats: int, starts: int = DEFAULT[0], rounds: int = DEFAULT[1]
) -> tuple[ta.PressureSearch, float]:
    """What a search finds, and the median of its seconds for each task."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        found = ta.search_pressure(arm, task, starts=starts, rounds=rounds)
        times.append((time.perf_counter() - begun) / len(found.cost))
    return found, float(np.median(times))


def large(quick: bool) -> Iterator[Row]:
    """Many searches at once: what a call costs whatever its size is shared."""
    count = 4 if quick else 1000
    part = f"search of {count:,} tasks at once, against scipy SLSQP in the same run"
    for name, arm in ARMS.items():
        task = paper_task(SHAPE, ta.sample_loads(count, seed=7))
        sub = paper_task(SHAPE, task.tip_load[: 1 if quick else 10])
        begun = time.perf_counter()
        theirs = ta.search_pressure(arm, sub, "scipy", scipy_method="SLSQP")
        slow = (time.perf_counter() - begun) / len(theirs.cost)
        yield Row(part, f"{name}, scipy SLSQP, 1 start", "time a search", slow * 1e3, "ms")
        load_code(arm)
        for first, rounds in PLANS:
            found, each = timed_search(arm, task, 1, first, rounds)
            ours = found.cost[: len(theirs.cost)]
            case = f"{name}, {first} start(s), {rounds} round(s)"
            yield Row(part, case, "time a search", each * 1e3, "ms")
            yield Row(part, case, "scipy's time over it", slow / each, "times")
            good = float((ours <= theirs.cost + 1e-9).sum())
            yield Row(part, case, "no worse than scipy (+1e-9)", good, f"of {len(ours)}")


def starts(quick: bool) -> Iterator[Row]:
    """Cost gap against time, by number of starts."""
    part = "error against time: search, 100 tasks an arm, gap to the best of all these runs"
    full = (*PLANS[:2], (4, 2), PLANS[2], (32, 6))
    plans = full[:2] if quick else full
    for name in ARMS:
        arm, task = validation(name, 2 if quick else 100)
        found = {}
        load_code(arm)
        for count, rounds in plans:
            answer, spent = timed_search(arm, task, 1 if quick else 3, count, rounds)
            found[count, rounds] = spent, answer.cost
        best = torch.stack([cost for _, cost in found.values()]).amin(0)
        for (count, rounds), (spent, cost) in found.items():
            case = f"{name}, {count} start(s), {rounds} round(s)"
            within = float((cost <= 1.01 * best + 1e-12).double().mean())
            yield Row(part, case, "time a search", spent * 1e3, "ms")
            yield Row(part, case, "within 1 % of the best", 100 * within, "%")
            yield Row(part, case, "mean gap", float((cost - best).mean()), "m²")


def correlations(quick: bool) -> Iterator[Row]:
    """The paper's claim: does unattainability rank tasks as the search does?"""
    part = "rank correlation (Spearman) of unattainability with the search's cost"
    for name in ARMS:
        cost, metrics = ranked(name, 3 if quick else 100)
        for metric, value in metrics.items():
            yield Row(part, name, metric, float(spearmanr(value, cost).statistic))


def ranked(name: str, count: int) -> tuple[reference.Array, dict[str, reference.Array]]:
    """The search's costs of an arm's tasks, and what the metrics say of these."""
    arm, task = validation(name, count)
    found = ta.evaluate(arm, task, ("absolute", "relative"))
    assert found.absolute is not None
    assert found.relative is not None
    return ta.search_pressure(arm, task).cost.numpy(), {
        "absolute": found.absolute.numpy(),
        "relative": found.relative.numpy(),
        "absolute + relative": (found.absolute + found.relative).numpy(),
        "wrench-space fit": ta.fit_pressure(arm, task).distance.numpy(),
    }


PARTS: tuple[Callable[[bool], Iterator[Row]], ...] = (
    hard_points,
    speed,
    extremes,
    searches,
    searches_of_scipy_alone,
    large,
    starts,
    correlations,
)
