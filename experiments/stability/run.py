"""Run stiff and extreme scenes through every backend, and measure errors against the reference.

Prints tables; writes results.csv, one row a scene, metric, backend and dtype, and stability.png, beside this file.
"""

import argparse
import importlib.util
import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torch import Tensor

import torcharm as ta
from experiments.paper import paper_task
from experiments.rows import write_rows
from experiments.stability import reference
from experiments.stability.reference import Array, Derivative, Distances, Real
from experiments.stability.rows import Row
from experiments.stability.scenes import ArmScene, HullScene, Scene, all_scenes

HERE = Path(__file__).parent
SAMPLES = 5
METRICS = ("absolute", "relative")
DISTANCES_GAP = 1e-10
"""Of the reference where no derivatives are asked for: answers are compared with it to 1e-7 of the same."""
TURN = 0.7
"""By so much [rad] scenes are turned out of the plane: no axis of space is left in it."""
WHOLE_CURVES, WHOLE_DERIVATIVES, DERIVATIVES = 100, 24, 1000
"""Above so many actuators × nodes the reference leaves out whole curves, their derivatives, and derivatives of samples:
they would take minutes."""


@dataclass(frozen=True)
class Backend:
    """A way to answer.

    Attributes:
        name: as in the tables.
        distance: as for `evaluate`.
        samples: points on each curve; None for the sets themselves, against whole curves.
        dtype: of the inputs.
        in_space: whether the scene is turned out of the plane, by `TURN` about the base's axis; distances stay.
    """

    name: str
    distance: str
    samples: int | None = None
    dtype: torch.dtype = torch.float64
    in_space: bool = False

    @property
    def key(self) -> tuple[int | None, torch.dtype]:
        """What its reference depends on."""
        return self.samples, self.dtype


def backends() -> list[Backend]:
    """Those that can be had; qpth has no release for Python 3.13 and later."""
    found = [
        Backend("exact", "gjk"),
        Backend("exact, in space", "gjk", in_space=True),
        Backend("exact, float32", "gjk", dtype=torch.float32),
        Backend("scipy", "scipy", SAMPLES),
    ]
    if importlib.util.find_spec("qpth") is not None:
        found.append(Backend("qpth", "qpth", SAMPLES))
    return found


@dataclass(frozen=True)
class Answer:
    """What a backend says of one metric.

    Attributes:
        value: (N,) distances.
        slopes: derivatives of their sum along the scene's two directions.
        in_range, converged: flags.
    """

    value: Tensor
    slopes: tuple[float, float]
    in_range: bool | None
    converged: bool


@dataclass(frozen=True)
class Truth:
    """The same from the reference; derivatives only if asked for. Distances of impossible shapes are infinite."""

    distances: Distances
    slopes: tuple[Derivative, Derivative] | None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: every fortieth scene, no file written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", module="qpth")
    console = Console(width=170)
    scenes = all_scenes()[:: 40 if options.quick else 1]
    rows = [row for scene in track(scenes, "scenes", console=console, transient=True) for row in scene_rows(scene)]
    for table in (success_table(rows), error_table(rows), gradient_table(rows)):
        console.print(table)
    for line in float32_lines():
        console.print(line)
    if options.quick:
        return
    write_rows(HERE / "results.csv", rows)
    from experiments.stability.figure import draw

    draw(rows, HERE / "stability.png")
    console.print(f"wrote {len(rows)} rows to results.csv, and stability.png")


def scene_rows(scene: Scene, chosen: Iterable[Backend] | None = None, *, derivatives: bool = True) -> Iterator[Row]:
    """The rows of one scene; the reference is worked out once for all backends that share it.

    Args:
        scene: which.
        chosen: backends; None for all.
        derivatives: whether the reference gives them too (for float64), which takes most of its time.
    """
    known: dict[tuple[int | None, torch.dtype], dict[str, Truth]] = {}
    for backend in backends() if chosen is None else chosen:
        if not applies(scene, backend):
            continue
        if backend.key not in known:
            known[backend.key] = truths(scene, backend, derivatives and backend.dtype == torch.float64)
        answers = arm_answers(scene, backend) if isinstance(scene, ArmScene) else hull_answers(scene, backend)
        for metric, answer in answers.items():
            yield as_row(scene, backend, metric, answer, known[backend.key][metric])


def applies(scene: Scene, backend: Backend) -> bool:
    return isinstance(scene, HullScene) or backend.samples is not None or section_count(scene) <= WHOLE_CURVES


def section_count(scene: ArmScene) -> int:
    """Actuators × nodes."""
    arm, task = scene.build()
    return arm.actuator_count * task.nodes


def as_row(scene: Scene, backend: Backend, metric: str, answer: Answer, truth: Truth) -> Row:
    value = answer.value.detach().double().numpy()
    finite = bool(np.isfinite(value).all())
    if np.isinf(truth.distances.value).all():
        return _impossible_row(scene, backend, metric, answer)
    scale, off = truth.distances.scale, abs(value - truth.distances.value)
    error = float(np.where(off == 0, 0, off / np.where(scale > 0, scale, 1)).max())
    largest = float(scale.max())
    gradient_error: float | None = None
    slopes = truth.slopes or ()
    if slopes and all(slope.settled for slope in slopes):
        gaps = [max(slope.low - own, own - slope.high, 0.0) for own, slope in zip(answer.slopes, slopes, strict=True)]
        gradient_error = min(max(gaps) / (largest or 1.0), 1.0) if all(map(math.isfinite, answer.slopes)) else 1.0
    return Row(
        group=scene.group,
        scene=scene.name,
        backend=backend.name,
        dtype=str(backend.dtype).removeprefix("torch."),
        metric=metric,
        value=float(value.sum()),
        reference=truth.distances.total,
        error=min(error, 1.0) if finite and answer.converged else 1.0,
        gradient_error=gradient_error,
        finite=finite,
        in_range=answer.in_range,
        converged=answer.converged,
        smooth=None if truth.slopes is None else all(slope.smooth and slope.settled for slope in slopes),
    )


def _impossible_row(scene: Scene, backend: Backend, metric: str, answer: Answer) -> Row:
    """Of a shape that leaves an actuator no length: right is an infinite distance everywhere that is not converged."""
    right = bool(answer.value.isinf().all()) and not answer.converged
    return Row(
        group=scene.group,
        scene=scene.name,
        backend=backend.name,
        dtype=str(backend.dtype).removeprefix("torch."),
        metric=metric,
        value=float(answer.value.detach().sum()),
        reference=math.inf,
        error=0.0 if right else 1.0,
        gradient_error=None,
        finite=bool(answer.value.isfinite().all()),
        in_range=answer.in_range,
        converged=answer.converged,
        smooth=None,
    )


# ---- arms ---------------------------------------------------------------------------------


def arm_inputs(scene: ArmScene, dtype: torch.dtype) -> tuple[ta.ArmDesign, ta.Task]:
    """The scene as a user of that dtype has it."""
    arm, task = scene.build()
    design = ta.ArmDesign(arm.radii.to(dtype), arm.length.to(dtype), arm.actuators, arm.max_pressure.to(dtype))
    return design, task.to(dtype)


def arm_answers(scene: ArmScene, backend: Backend) -> dict[str, Answer]:
    """Distances, and their derivatives by a factor on all radii and one on all neutral lengths."""
    arm, task = arm_inputs(scene, backend.dtype)
    factors = torch.ones(2, dtype=backend.dtype, requires_grad=True)
    scaled = ta.ArmDesign(arm.radii * factors[0], arm.length * factors[1], arm.actuators, arm.max_pressure)
    if backend.in_space:
        scaled, task = turned_out_of_plane(scaled, task)
    found = ta.evaluate(scaled, task, ("absolute", "relative"), samples=backend.samples, distance=backend.distance)
    answers = {}
    for metric in METRICS:
        total, per_node = getattr(found, metric), getattr(found, f"{metric}_per_node")
        (gradient,) = torch.autograd.grad(total, factors, retain_graph=True)
        slopes = (gradient[0].item(), gradient[1].item())
        answers[metric] = Answer(per_node, slopes, bool(found.in_range), bool(found.converged))
    return answers


def turned_out_of_plane(arm: ta.ArmDesign, task: ta.Task) -> tuple[ta.ArmDesign, ta.Task]:
    """The same arm and shape in space, the arm's own axes turned by `TURN` against the plane in which it bends."""
    c, s = math.cos(TURN), math.sin(TURN)
    offsets = torch.stack((c * arm.radii, s * arm.radii), -1)
    length, shear, bend = task.twists.unbind(-1)
    twists = torch.stack((length, c * shear, s * shear, torch.zeros_like(bend), -s * bend, c * bend), -1)
    force_x, force_y, moment = task.tip_load.unbind(-1)
    nothing = torch.zeros_like(moment)
    load = torch.stack((force_x, force_y, nothing, nothing, nothing, moment), -1)
    x, y, heading = task.base_pose.tolist()
    ahead, aside = math.cos(heading), math.sin(heading)
    base = [
        [ahead, -c * aside, -s * aside, x],
        [aside, c * ahead, s * ahead, y],
        [0.0, -s, c, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
    spatial = ta.ArmDesign(offsets=offsets, length=arm.length, actuators=arm.actuators, max_pressure=arm.max_pressure)
    return spatial, ta.Task(twists, load, twists.new_tensor(base), wrench_at=task.wrench_at)


def truths(scene: Scene, backend: Backend, derivatives: bool) -> dict[str, Truth]:
    if isinstance(scene, HullScene):
        return {"distance": hull_truth(*hull_inputs(scene, backend.dtype), derivatives)}
    arm, task = arm_inputs(scene, backend.dtype)
    if any((reference.sections(arm, task, False).strain <= -1).ravel()):
        never = Distances(np.full(task.nodes, np.inf, Real), np.ones(task.nodes, Real))
        return {metric: Truth(never, None) for metric in METRICS}
    derivatives = derivatives and section_count(scene) <= (
        WHOLE_DERIVATIVES if backend.samples is None else DERIVATIVES
    )
    return {metric: arm_truth(arm, task, metric, backend.samples, derivatives) for metric in METRICS}


def arm_truth(arm: ta.ArmDesign, task: ta.Task, metric: str, samples: int | None, derivatives: bool) -> Truth:
    find = partial(reference.node_distances, arm, task, metric, samples)
    if not derivatives:
        return Truth(find(gap=DISTANCES_GAP), None)
    distances = find()
    scale = float(distances.scale.max())

    def by_radius(t: Real) -> Array:
        return find(radius=1 + t).value

    def by_length(t: Real) -> Array:
        return find(length=1 + t).value

    return Truth(distances, (reference.derivative(by_radius, scale), reference.derivative(by_length, scale)))


# ---- hulls --------------------------------------------------------------------------------


def hull_inputs(scene: HullScene, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Points (P, 2) and, for each, all vertices (P, V, 2)."""
    point, vertices = (value.to(dtype) for value in scene.build())
    return point, vertices.expand(len(point), -1, -1).contiguous()


def hull_answers(scene: HullScene, backend: Backend) -> dict[str, Answer]:
    """Distances, and their derivatives by moving all points and by swelling the hull about the origin."""
    point, vertices = hull_inputs(scene, backend.dtype)
    move = torch.zeros(2, dtype=backend.dtype, requires_grad=True)
    where = point + move[0] * moving(vertices)
    hull = vertices * (1 + move[1])
    if backend.in_space:
        where, hull = (
            torch.stack((x, math.cos(TURN) * y, math.sin(TURN) * y), -1) for x, y in (where.unbind(-1), hull.unbind(-1))
        )
    if backend.distance == "gjk":
        value = ta.distance_to_hull(where, hull)
        converged = bool(value.isfinite().all())
    else:
        found = {"qpth": ta.qp_distance, "scipy": ta.nnls_distance}[backend.distance](where, hull)
        value, converged = found.value, bool(found.converged.all())
    (gradient,) = torch.autograd.grad(value.sum(), move)
    return {"distance": Answer(value, (gradient[0].item(), gradient[1].item()), None, converged)}


def moving(vertices: Tensor) -> Tensor:
    """(P, 2) a direction along which to move points, as long as the numbers are large."""
    return vertices.abs().amax() * vertices.new_tensor([0.6, 0.8])


def hull_truth(point: Tensor, vertices: Tensor, derivatives: bool) -> Truth:
    own, hull, step = reference.real(point), reference.real(vertices), reference.real(moving(vertices))
    distances = reference.polygon_distance(own, hull)
    if not derivatives:
        return Truth(distances, None)
    scale = float(distances.scale.max())
    by_point = reference.derivative(lambda t: reference.polygon_distance(own + t * step, hull).value, scale)
    by_size = reference.derivative(lambda t: reference.polygon_distance(own, hull * (1 + t)).value, scale)
    return Truth(distances, (by_point, by_size))


# ---- float32 ---------------------------------------------------------------------------------


def float32_errors() -> dict[str, dict[str, float]]:
    """Largest absolute error [N] of float32 against float64 on the paper's validation study.

    Both are given the same study; the rounding of the inputs counts. Keyed by arm, then by metric: of a
    task's sum over nodes, and of one node.
    """
    shape, study = ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=10), ta.sample_loads(100)
    task = paper_task(shape, study)
    found = {}
    for name, arm in {"antagonistic": ta.antagonistic_arm(), "bellows-only": ta.bellows_arm()}.items():
        single = ta.ArmDesign(arm.radii.float(), arm.length.float(), arm.actuators, arm.max_pressure.float())
        wide, narrow = (
            ta.evaluate(arm, task, ("absolute", "relative")),
            ta.evaluate(single, task.to(torch.float32), ("absolute", "relative")),
        )
        found[name] = {
            column: (getattr(narrow, column).double() - getattr(wide, column)).abs().max().item()
            for column in ("absolute", "relative", "absolute_per_node", "relative_per_node")
        }
    return found


def float32_lines() -> Iterator[str]:
    for arm, columns in float32_errors().items():
        figures = ", ".join(f"{name} {value:.2g}" for name, value in columns.items())
        yield f"float32 on the validation study, {arm}: largest absolute error [N] {figures}"


# ---- tables ----------------------------------------------------------------------------------


def success_table(rows: list[Row]) -> Table:
    """Shares of rows with errors within 1e-6 and 1e-9."""

    def cell(own: list[Row]) -> str:
        shares = (np.mean([row.error <= bound for row in own]) for bound in (1e-6, 1e-9))
        return " / ".join(f"{100 * share:.0f}" for share in shares)

    return table_of(rows, "Success [%] at 1e-6 / at 1e-9; a failure counts as an error of 1", cell)


def error_table(rows: list[Row]) -> Table:
    return table_of(rows, "Largest error / max|H - w|", lambda own: f"{max(row.error for row in own):.0e}")


def gradient_table(rows: list[Row]) -> Table:
    def cell(own: list[Row]) -> str:
        known = [row.gradient_error for row in own if row.gradient_error is not None]
        return f"{np.median(known):.0e} / {max(known):.0e}" if known else ""

    return table_of(rows, "Error of the derivatives / max|H - w|, median / largest", cell)


def table_of(rows: list[Row], title: str, cell: Callable[[list[Row]], str]) -> Table:
    names = list(dict.fromkeys(row.backend for row in rows))
    table = Table(title=title, title_justify="left")
    table.add_column("class of scenes")
    table.add_column("scenes", justify="right")
    for name in names:
        table.add_column(name, justify="right")
    for group in [*dict.fromkeys(row.group for row in rows), "all"]:
        own = [row for row in rows if group in (row.group, "all")]
        cells = [[row for row in own if row.backend == name] for name in names]
        count = len({(row.group, row.scene) for row in own})
        table.add_row(group, str(count), *(cell(part) if part else "" for part in cells))
    return table
