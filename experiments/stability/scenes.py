"""Stiff, degenerate and extreme scenes, as data."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import torcharm as ta
from experiments.paper import paper_task
from torcharm.actuators.polynomial import PAPER_BENDING_STIFFNESS

Array = NDArray[np.float64]
LOAD = (10.0, -90.0, 6.0)
"""Out of reach at every node, past corners and past edges of the hulls."""
LENGTH = 0.505
"""A centreline 1 % longer than the paper's actuators: no strain is zero by accident."""
MIXED = (ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows())
RADII = (-0.08, -0.015, 0.015, 0.08)


@dataclass(frozen=True)
class ArmScene:
    """One design on one task.

    Attributes:
        group: its class of scenes.
        name: which one it is.
        build: makes them, in float64.
    """

    group: str
    name: str
    build: Callable[[], tuple[ta.ArmDesign, ta.Task]]


@dataclass(frozen=True)
class HullScene:
    """Points (P, 2) and the vertices (V, 2) of one hull."""

    group: str
    name: str
    build: Callable[[], tuple[Tensor, Tensor]]


Scene = ArmScene | HullScene


def all_scenes() -> list[Scene]:
    """Every scene; a name is unique within its class."""
    parts = (
        curvatures,
        bends,
        vanishing_lengths,
        impossible,
        radii,
        actuator_counts,
        limits,
        stiffnesses,
        loads,
        node_counts,
        strains,
        force_scales,
        hull_scales,
        duplicates,
        collinear,
        boundaries,
    )
    return [scene for part in parts for scene in part()]


def arm_scene(
    group: str,
    name: str,
    *,
    radii: Sequence[float] = RADII,
    actuators: Sequence[ta.Actuator] = MIXED,
    length: float = 0.5,
    limit: Sequence[float] | None = None,
    slope: float = 0.4,
    start: float = 0.5,
    nodes: int = 6,
    along: float = LENGTH,
    load: Sequence[float] = LOAD,
) -> ArmScene:
    """The paper's antagonistic arm, gently bent so that all strains are in range, but for what is named."""

    def build() -> tuple[ta.ArmDesign, ta.Task]:
        arm = ta.ArmDesign(_double(radii), _double(length), actuators, None if limit is None else _double(limit))
        return arm, paper_task(ta.affine_curvature(slope, start, length=along, nodes=nodes), _double(load))

    return ArmScene(group, name, build)


def _double(values: object) -> Tensor:
    return torch.as_tensor(np.asarray(values, dtype=float))


# ---- shapes ---------------------------------------------------------------------------------


def curvatures() -> Iterator[Scene]:
    group = "constant curvature"
    for curvature in (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 1.0):
        yield arm_scene(group, f"κ = {curvature:g} rad", slope=0.0, start=curvature)
    slim = (-0.01, -0.004, 0.004, 0.01)
    yield arm_scene(group, "κ = 20 rad, slim arm", slope=0.0, start=20.0, radii=slim)
    yield arm_scene(group, "κ = 6 rad, the paper's arm", slope=0.0, start=6.0)


def bends() -> Iterator[Scene]:
    group = "nearly straight, rolled up"
    slim = (-0.01, -0.004, 0.004, 0.01)
    yield arm_scene(group, "κ from 0 to 1e-12", slope=1e-12, start=0.0)
    yield arm_scene(group, "κ from -1e-9 to 1e-9", slope=2e-9, start=-1e-9)
    yield arm_scene(group, "κ from -1e-6 to 1e-6", slope=2e-6, start=-1e-6)
    yield arm_scene(group, "κ from -1e-3 to 1e-3", slope=2e-3, start=-1e-3)
    yield arm_scene(group, "one full turn", slope=0.0, start=2 * math.pi, radii=slim)
    yield arm_scene(group, "a spiral of three turns", slope=12 * math.pi, start=0.0, radii=slim, nodes=12)
    yield arm_scene(group, "an S, 20 to -20 rad", slope=-40.0, start=20.0, radii=slim, nodes=12)
    yield arm_scene(group, "the paper's validation shape", slope=-3.0, start=3.0, along=0.5, nodes=10)


def vanishing_lengths() -> Iterator[Scene]:
    """Actuators squeezed to nearly nothing. Without a length they are impossible, and all distances infinite."""
    group = "actuator length near zero"
    radii = (-0.0625, -0.015625, 0.015625, 0.0625)
    for name, part in {"a length of 5e-6": 1e-5, "a length of 5e-4": 1e-3, "a length of 0.05": 0.1}.items():
        yield arm_scene(group, name, radii=radii, slope=0.0, start=8.0 * (1 - part), along=0.5)
    yield arm_scene(group, "5e-4 on the way", radii=radii, slope=3.992, start=4.0, along=0.5, nodes=5)


def impossible() -> Iterator[Scene]:
    for name, curvature in {"a length of 0": 8.0, "a length of -0.5 m": 16.0}.items():
        yield arm_scene(
            "no actuator length",
            name,
            radii=(-0.0625, -0.015625, 0.015625, 0.0625),
            slope=0.0,
            start=curvature,
            along=0.5,
        )


def strains() -> Iterator[Scene]:
    group = "strain beyond the range"
    for along in (0.55, 1.0, 2.0, 0.3, 0.1, 0.08):
        yield arm_scene(group, f"an arm of 0.5 m at {along:g} m", along=along)
    muscles = [ta.McKibben(force_scale=2.0)] * 4
    yield arm_scene(group, "p = 0, muscles in extension", actuators=muscles, limit=[0.0] * 4, along=0.52)
    yield arm_scene(group, "p = 0 at +9 %", actuators=muscles, limit=[0.0] * 4, along=0.545)
    yield arm_scene(group, "muscles in extension, pushed", actuators=muscles, along=0.52, load=(0.0, 60.0, 0.5))
    yield arm_scene(group, "muscles at the collapse", actuators=muscles, along=0.345, load=(0.0, 30.0, 0.5))


# ---- designs ----------------------------------------------------------------------------------


def radii() -> Iterator[Scene]:
    group = "radii"
    yield arm_scene(group, "all zero", radii=[0.0] * 4)
    yield arm_scene(group, "all zero, straight", radii=[0.0] * 4, slope=0.0, start=0.0)
    yield arm_scene(group, "all 5 cm to one side", radii=[0.05] * 4)
    yield arm_scene(group, "1e-9 m", radii=[-1e-9, -1e-10, 1e-10, 1e-9])
    yield arm_scene(group, "1 m, nearly straight", radii=[-1.0, -0.5, 0.5, 1.0], slope=0.0, start=0.01)


def actuator_counts() -> Iterator[Scene]:
    group = "number of actuators"
    yield arm_scene(group, "1 bellows", radii=[0.03], actuators=[ta.Bellows()])
    yield arm_scene(group, "1 muscle", radii=[0.03], actuators=[ta.McKibben()])
    yield arm_scene(group, "1 muscle in the middle", radii=[0.0], actuators=[ta.McKibben()])
    yield arm_scene(group, "8 identical bellows", radii=[0.03] * 8, actuators=[ta.Bellows()] * 8)
    yield arm_scene(group, "8 identical muscles", radii=[-0.03] * 8, actuators=[ta.McKibben()] * 8)
    for count in (8, 64):
        places = np.linspace(-0.08, 0.08, count)
        kinds = [ta.McKibben() if abs(place) < 0.03 else ta.Bellows() for place in places]
        yield arm_scene(group, f"{count} side by side", radii=places.tolist(), actuators=kinds, nodes=2)


def limits() -> Iterator[Scene]:
    group = "pressure limits"
    yield arm_scene(group, "all 0 kPa", limit=[0.0] * 4)
    yield arm_scene(group, "one 0 kPa", limit=[50.0, 0.0, 100.0, 50.0])
    yield arm_scene(group, "1e-9 kPa", limit=[1e-9] * 4)
    yield arm_scene(group, "from 1e-6 to 50 kPa", limit=[1e-6, 100.0, 1e-3, 50.0])
    yield arm_scene(group, "500 kPa, beyond the range", limit=[500.0] * 4)


def stiffnesses() -> Iterator[Scene]:
    group = "bending stiffness"
    for factor in (0.0, 1e-6, 1e-3, 1.0, 1e3, 1e6):
        stiffer = [replace(model, bending_stiffness=factor * PAPER_BENDING_STIFFNESS) for model in MIXED]
        yield arm_scene(group, f"× {factor:g}", actuators=stiffer)


def force_scales() -> Iterator[Scene]:
    group = "hulls of arms, scaled"
    for factor in (1e-6, 1e6):
        scaled = [
            replace(model, force_scale=factor, bending_stiffness=factor * PAPER_BENDING_STIFFNESS) for model in MIXED
        ]
        yield arm_scene(group, f"forces and loads × {factor:g}", actuators=scaled, load=[factor * q for q in LOAD])
        yield arm_scene(group, f"forces × {factor:g}, load as it was", actuators=scaled)


# ---- tasks --------------------------------------------------------------------------------------


def loads() -> Iterator[Scene]:
    group = "loads"
    for force in (0.0, 1e-9, 1.0, 100.0, 1e4):
        yield arm_scene(group, f"{force:g} N", load=(0.6 * force, -0.8 * force, 0.0))
    yield arm_scene(group, "1e4 N·m", load=(0.0, 0.0, 1e4))
    yield arm_scene(group, "1e-9 N·m", load=(0.0, 0.0, 1e-9))


def node_counts() -> Iterator[Scene]:
    group = "number of nodes"
    for count in (1, 2, 200, 2000):
        yield arm_scene(group, f"N = {count}", nodes=count, load=(0.0, -150.0, 4.0))


# ---- hulls as points ----------------------------------------------------------------------------


def hull_scene(group: str, name: str, points: object, vertices: object) -> HullScene:
    return HullScene(group, name, lambda: (_double(points), _double(vertices)))


def blob(seed: int = 3, count: int = 12) -> Array:
    """The vertices of a polygon of no particular shape, 100 N wide and 5 N·m high."""
    return np.random.default_rng(seed).normal(size=(count, 2)) * (50.0, 2.5)


def around(vertices: Array, seed: int = 4) -> Array:
    """Four points outside, near and far, and two inside."""
    rng = np.random.default_rng(seed)
    middle, spread = vertices.mean(0), np.ptp(vertices, axis=0).max()
    mixed = rng.dirichlet(np.ones(len(vertices)), size=2) @ vertices
    angles = np.array([0.3, 1.7, 3.9, 5.5])
    outside = middle + spread * np.stack((np.cos(angles), np.sin(angles)), -1) * [[1.0], [2.0], [10.0], [0.8]]
    return np.concatenate((outside, mixed))


def hull_scales() -> Iterator[Scene]:
    group = "hulls scaled"
    vertices, points = blob(), around(blob())
    for factor in (1e-6, 1.0, 1e6):
        yield hull_scene(group, f"× {factor:g}", factor * points, factor * vertices)
        far = 1e3 * factor * np.array([1.0, -1.0])
        yield hull_scene(group, f"× {factor:g}, far from the origin", factor * points + far, factor * vertices + far)
    yield hull_scene(group, "1e6 N by 1e-6 N·m", points * (1e4, 1e-6), vertices * (1e4, 1e-6))


def duplicates() -> Iterator[Scene]:
    group = "duplicates"
    vertices, points = blob(), around(blob())
    rng = np.random.default_rng(5)
    yield hull_scene(group, "every vertex four times", points, np.repeat(vertices, 4, 0))
    for gap in (1e-14, 1e-12, 1e-9):
        near = np.repeat(vertices, 4, 0) + gap * rng.uniform(-1, 1, (4 * len(vertices), 2))
        yield hull_scene(group, f"every vertex four times, to {gap:g}", points, near)
    yield hull_scene(group, "one point, eight times", points, np.tile(vertices[:1], (8, 1)))
    eight = [0.03 + 1e-14 * step for step in range(8)]
    yield arm_scene(group, "8 bellows, 1e-14 m apart", radii=eight, actuators=[ta.Bellows()] * 8)
    yield arm_scene(group, "8 muscles, 1e-14 m apart", radii=eight, actuators=[ta.McKibben()] * 8)


def collinear() -> Iterator[Scene]:
    group = "collinear hulls"
    share = np.array([[-1.0], [0.2], [0.4], [1.0], [3.0]])
    points = np.array([[0.5, 2.0], [9.0, -4.0], [-7.0, 1.0], [1.0, -0.5], [12.0, -6.0]])
    rng = np.random.default_rng(6)
    yield hull_scene(group, "a line through the origin", points, share * (2.0, -1.0))
    yield hull_scene(group, "horizontal", points, share * (2.0, 0.0))
    yield hull_scene(group, "vertical", points, share * (0.0, 2.0))
    yield hull_scene(group, "far from the origin", points + 1e3, share * (2.0, -1.0) + 1e3)
    for gap in (1e-14, 1e-9, 1e-6):
        bent = share * (2.0, -1.0) + gap * rng.uniform(-1, 1, (5, 2))
        yield hull_scene(group, f"but for {gap:g}", points, bent)
    yield hull_scene(group, "two points", points, share[:2] * (2.0, -1.0))
    yield hull_scene(group, "one point", points, share[:1] * (2.0, -1.0))
    plain = [replace(model, bending_stiffness=0.0) for model in MIXED]
    yield arm_scene(group, "arm without radii or stiffness", radii=[0.0] * 4, actuators=plain)
    yield arm_scene(group, "arm with one radius, no stiffness", radii=[0.03] * 4, actuators=plain)


def boundaries() -> Iterator[Scene]:
    group = "on the boundary"
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])
    turned = square @ np.array([[0.6, 0.8], [-0.8, 0.6]]) * 25.0
    for name, corners in {"square": square, "turned": turned}.items():
        middle = corners.mean(0)
        edges = (corners + np.roll(corners, -1, 0)) / 2
        thirds = (2 * corners + np.roll(corners, -1, 0)) / 3
        yield hull_scene(group, f"{name}: on a vertex", corners, corners)
        yield hull_scene(group, f"{name}: on an edge", np.concatenate((edges, thirds)), corners)
        size = np.abs(corners - middle).max()
        for gap in (1e-14, 1e-12, 1e-9, 1e-6):
            towards = (middle - edges) / np.linalg.norm(middle - edges, axis=1, keepdims=True) * gap * size
            yield hull_scene(group, f"{name}: inside by {gap:g}", edges + towards, corners)
            yield hull_scene(group, f"{name}: outside by {gap:g}", edges - towards, corners)
