"""Eight spatial scenes and their statics, written down once more in plain numpy and scipy.

The scenes and the oracle share nothing with torcharm: matrix exponentials, sums over pieces, loops. Only
`arm_and_task` builds torcharm's own objects from a scene.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm

GRAVITY = np.array([0.0, -9.81, 0.0])
STIFFNESS = -1 / 3.5
"""K [N·m²] of bellows and muscles alike, at their highest pressures, 50 and 100 kPa."""


@dataclass(frozen=True)
class Load:
    """A wrench (force, then moment) at a fraction of a segment's arc, of the world or following the body."""

    wrench: tuple[float, ...]
    segment: int = 0
    at: float = 1.0
    frame: str = "world"


@dataclass(frozen=True)
class Segment:
    """Actuators by one letter each (b bellows, m McKibben) at offsets (y, z), and the shape to hold."""

    kinds: str
    offsets: np.ndarray
    length: float
    twists: np.ndarray
    mass: float = 0.0
    torsion_stiffness: float | None = None
    link: np.ndarray | None = None


@dataclass(frozen=True)
class Scene:
    name: str
    segments: tuple[Segment, ...]
    loads: tuple[Load, ...]
    base: np.ndarray = field(default_factory=lambda: hanging())
    gravity: bool = False


def hat(twist):
    x, y, z = twist[3:]
    return np.array([[0, -z, y, twist[0]], [z, 0, -x, twist[1]], [-y, x, 0, twist[2]], [0, 0, 0, 0]])


def hanging(lean=0.0, pitch=0.0, roll=0.0):
    """The hanging base, turned by `lean` about world z, then about its own y and x."""
    pose = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    for angle, axis in ((lean, 5), (pitch, 4), (roll, 3)):
        pose = pose @ expm(hat(angle * np.eye(6)[axis]))
    return pose


def ring(radii, phase=0.0):
    angle = phase + 2 * np.pi * np.arange(len(radii)) / len(radii)
    return np.stack((np.multiply(radii, np.cos(angle)), np.multiply(radii, np.sin(angle))), -1)


def shape(length, nodes, kx=(0, 0), ky=(0, 0), kz=(0, 0)):
    """Twists (nodes, 6) of one length whose curvatures go evenly from one value to another."""
    turns = [np.linspace(*ends, nodes) for ends in (kx, ky, kz)]
    return np.stack((np.full(nodes, length), np.zeros(nodes), np.zeros(nodes), *turns), -1)


BOTH = (0.05, 0.03, 0.05, 0.03)
SIX = (0.05, 0.025, 0.05, 0.025, 0.05, 0.025)
FLAT = np.outer((-0.08, -0.015, 0.015, 0.08), (math.cos(0.7), math.sin(0.7)))
LINK = expm(hat((0.02, 0.002, -0.003, 0.4, 0.05, -0.03)))


def tip(*wrench, segment=0, frame="world"):
    return Load((*wrench, *(0.0,) * (6 - len(wrench))), segment, 1.0, frame)


SCENES = (
    Scene(
        "three bellows, dead tip force and moment",
        (Segment("bbb", ring((0.04,) * 3), 0.3, shape(0.31, 8, ky=(0.5, 0.2), kz=(0.8, 1.0))),),
        (tip(1.5, 2.0, -1.0, 0.05, -0.1, 0.08),),
    ),
    Scene(
        "bellows and muscles, dead tip force",
        (Segment("bmbm", ring(BOTH, 0.3), 0.4, shape(0.39, 8, ky=(-0.6, -0.1), kz=(0.4, 0.7))),),
        (tip(4.0, 3.0, -2.0),),
    ),
    Scene(
        "three bellows hanging in gravity, payload at the tip",
        (Segment("bbb", ring((0.04,) * 3), 0.3, shape(0.315, 8, ky=(0.3, 0.3), kz=(-0.6, -0.3)), mass=0.4),),
        (tip(0.0, -0.981, 0.0),),
        gravity=True,
    ),
    Scene(
        "bellows and muscles in gravity, leaning base, payload at mid-arm",
        (Segment("bmbm", ring(BOTH), 0.4, shape(0.395, 8, ky=(0.5, 0.1), kz=(-0.3, 0.5)), mass=0.5),),
        (Load((0.0, -1.962, 0.0, 0.0, 0.0, 0.0), 0, 0.5), tip(1.0, 0.0, 2.0)),
        hanging(0.6, 0.4),
        gravity=True,
    ),
    Scene(
        "bellows and muscles with torsion, dead tip force and moment",
        (
            Segment(
                "bmbm",
                ring(BOTH, 0.1),
                0.4,
                shape(0.392, 8, kx=(0.15, 0.25), ky=(0.3, 0.6), kz=(-0.4, -0.2)),
                torsion_stiffness=0.3,
            ),
        ),
        (tip(2.0, 1.0, 3.0, 0.1, 0.15, -0.05),),
    ),
    Scene(
        "two segments in gravity, dead tip force",
        (
            Segment("bmbmbm", ring(SIX), 0.3, shape(0.297, 6, ky=(0.3, 0.7), kz=(-0.4, -0.2)), mass=0.35),
            Segment(
                "bbb", ring((0.035,) * 3, math.pi / 3), 0.2, shape(0.205, 6, ky=(-0.5, -0.3), kz=(0.3, 0.6)), mass=0.12
            ),
        ),
        (tip(1.0, 1.5, -0.8, segment=1), tip(0.0, -0.4905, 0.0, segment=1)),
        gravity=True,
    ),
    Scene(
        "two segments, a link, torsion, a following wrench inside of an element, a dead moment",
        (
            Segment(
                "bmbmbm",
                ring(SIX),
                0.3,
                shape(0.297, 5, kx=(0.05, 0.15), ky=(0.3, 0.5), kz=(-0.2, 0.3)),
                mass=0.3,
                torsion_stiffness=0.5,
                link=LINK,
            ),
            Segment(
                "bmbm",
                ring((0.04, 0.025, 0.04, 0.025)),
                0.22,
                shape(0.218, 6, kx=(-0.1, 0.0), ky=(0.4, 0.1), kz=(0.3, 0.5)),
                mass=0.12,
                torsion_stiffness=0.2,
            ),
        ),
        (
            Load((0.0, 2.0, 1.0, 0.02, 0.05, 0.0), 0, 0.37, "body"),
            tip(0.0, 0.0, 0.0, 0.05, 0.1, -0.08, segment=1),
            tip(0.0, 0.5, 0.0, segment=1, frame="body"),
        ),
        hanging(pitch=0.2),
        gravity=True,
    ),
    Scene(
        "the planar antagonistic arm in a turned plane, a load a little out of it",
        (
            Segment(
                "bmmb",
                FLAT,
                0.5,
                shape(
                    0.49,
                    10,
                    ky=(-1.2 * math.sin(0.7), -0.2 * math.sin(0.7)),
                    kz=(1.2 * math.cos(0.7), 0.2 * math.cos(0.7)),
                ),
            ),
        ),
        (tip(3.0, -2.0, 0.2, 0.0, 0.0, 0.3),),
        hanging(roll=-0.7),
    ),
)


def elements(scene):
    """One (segment, local index, twist over the element, link after it or None) for each element, from the base."""
    found = []
    for index, segment in enumerate(scene.segments):
        count = len(segment.twists)
        for local, twist in enumerate(segment.twists):
            last = local == count - 1
            found.append((index, local, twist / count, segment.link if last else None))
    return found


def node_poses(scene):
    """Poses of the starts of all elements, and the tip's."""
    found = [scene.base]
    for _, _, step, link in elements(scene):
        found.append(found[-1] @ expm(hat(step)) @ (np.eye(4) if link is None else link))
    return found


def pieces(scene, parts=12):
    """All that loads the arm: (element, fraction of it, position, force, moment about that position), world frame.

    An element's weight is spread over it by Gauss-Legendre points, each a piece of its own.
    """
    poses, found, every = node_poses(scene), [], elements(scene)
    for load in scene.loads:
        local = max(math.ceil(load.at * len(scene.segments[load.segment].twists) - 1e-9) - 1, 0)
        element = sum(len(segment.twists) for segment in scene.segments[: load.segment]) + local
        fraction = load.at * len(scene.segments[load.segment].twists) - local
        pose = poses[element] @ expm(fraction * hat(every[element][2]))
        turn = pose[:3, :3] if load.frame == "body" else np.eye(3)
        wrench = np.array(load.wrench)
        found.append((element, fraction, pose[:3, 3], turn @ wrench[:3], turn @ wrench[3:]))
    points, weights = np.polynomial.legendre.leggauss(parts)
    for element, (index, _, step, _) in enumerate(every):
        mass = scene.gravity * scene.segments[index].mass / len(scene.segments[index].twists)
        for point, weight in zip((points + 1) / 2, weights / 2, strict=True):
            place = (poses[element] @ expm(point * hat(step)))[:3, 3]
            found.append((element, point, place, mass * weight * GRAVITY, np.zeros(3)))
    return found


def required_wrench(scene):
    """Wrenches (N, 6) at the starts of the elements: a piece anywhere on element j loads all nodes up to j in full."""
    found, loading = [], pieces(scene)
    for node, pose in enumerate(node_poses(scene)[:-1]):
        total = np.zeros(6)
        for element, _, place, force, moment in loading:
            if element >= node:
                total[:3] += pose[:3, :3].T @ force
                total[3:] += pose[:3, :3].T @ (moment + np.cross(place - pose[:3, 3], force))
        found.append(-total)
    return np.array(found)


def node_sets(scene, metric):
    """For each segment its nodes' attainable sets and required wrenches, for `experiments.exactness.reference`."""
    from experiments.exactness import models
    from experiments.exactness.reference import Sets

    kinds = {"b": (models.polynomial(models.BELLOWS), 50.0), "m": (models.mckibben(), 100.0)}
    required, start, found = required_wrench(scene)[:, [0, 4, 5]], 0, []
    for segment in scene.segments:
        twists, (y, z) = segment.twists, segment.offsets.T
        nodes, count = len(twists), len(y)
        length = twists[:, :1] - y * twists[:, 5:] + z * twists[:, 4:5]
        strain = (length - segment.length) / segment.length
        limit = np.array([kinds[kind][1] for kind in segment.kinds])
        lever = np.broadcast_to(np.stack((np.ones_like(y), z, -y), -1), (nodes, count, 3))
        rate = STIFFNESS / (length * limit)
        bending = np.stack((0 * rate, rate * twists[:, 4:5], rate * twists[:, 5:]), -1)
        target, first = required[start : start + nodes], None
        start += nodes
        if metric == "relative":
            first, bending, target = (
                np.broadcast_to(strain[:1], strain.shape),
                bending - bending[:1],
                target - target[:1],
            )
        own = tuple(kinds[kind][0] for kind in segment.kinds)
        found.append(Sets(own, strain, first, lever, bending, np.broadcast_to(limit, strain.shape), target))
    return found


def potential_energy(scene):
    """Energy [J] of dead forces and weights: minus force times position, summed over the pieces."""
    assert all(load.frame == "world" and not any(load.wrench[3:]) for load in scene.loads)
    return -sum(force @ place for _, _, place, force, _ in pieces(scene))


def arm_and_task(scene, wrench_at="start"):
    """The scene as torcharm's arm (a series if it has several segments) and task, in float64."""
    import torch

    import torcharm as ta

    models = {"b": ta.Bellows(), "m": ta.McKibben()}
    parts = []
    for segment in scene.segments:
        parts.append(
            ta.ArmDesign(
                offsets=torch.from_numpy(segment.offsets),
                length=segment.length,
                actuators=[models[kind] for kind in segment.kinds],
                mass=segment.mass,
                torsion_stiffness=segment.torsion_stiffness,
            )
        )
        if segment.link is not None:
            parts.append(ta.RigidLink(pose=torch.from_numpy(segment.link)))
    points = [ta.PointLoad(load.wrench, load.segment, load.at, load.frame) for load in scene.loads]
    task = ta.Task(
        torch.from_numpy(np.concatenate([segment.twists for segment in scene.segments])),
        base_pose=torch.from_numpy(scene.base),
        load=ta.ExternalLoad(gravity=scene.gravity, points=points),
        wrench_at=wrench_at,
        segment_nodes=[len(segment.twists) for segment in scene.segments],
    )
    return (parts[0] if len(parts) == 1 else ta.series(parts)), task
