"""What there is to see of an answer: meshes, lines, arrows and words in the world, in metres, by names.

Names are the page's own, so that nothing of a study is ever one. What keeps its name from one answer to the next is
the same thing, moved.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from torcharm.actuators import is_passive
from torcharm.arm_series import segments_of
from torcharm.design.space import Arm
from torcharm.geometry.alpha_shape import AlphaShape
from torcharm.inputs import three_digits
from torcharm.page.answers import Answer, NodeSet, place_of_node
from torcharm.page.state import State, tip_range
from torcharm.plot._common import Array, array
from torcharm.plot._shapes import Centreline, centreline, skin_of, tubes
from torcharm.plot.arms import loads_on
from torcharm.wrench_sets.wrench_set import hull_faces

Colour = tuple[int, int, int]
BLACK, VERMILLION, BLUE, GREY, PLATE = (0, 0, 0), (213, 94, 0), (0, 114, 178), (153, 153, 153), (85, 85, 85)
"""As in the figures: what is attainable is black, the rest vermillion, and sets are blue."""
SAND, REACH = (224, 200, 114), 0.35
"""The colour of where the tip can be, as in the figures, and how opaque it is."""
COLOURS = colormaps["viridis"]
"""Of pressures, from none to the limit."""
ARROW = 0.35
"""Of the largest tip force that a slider gives, as a share of the arm's length."""
SHORTEST, LONGEST = 0.01, 0.6
"""Shares of the arm's length: an arrow that is not drawn, as it would be all head; and what no arrow exceeds, as a
weight may that is far above the largest tip force."""
SHADE = 0.15
"""How opaque the shade of the shape that is asked for is."""
VISIBLE = 0.006
"""An error of the tip that is drawn, as a share of the arm's length: below it is one place to the eye."""
BOX, BOX_PLACE = 0.22, (0.45, 0.8)
"""Half the width of the box that shows a set in space, and where its middle is: along the base's heading, and across.
Shares of the arm's length."""
HEAD = 2.5
"""The radius of an arrow's head over that of its shaft; the head is twice as long as it is wide."""
SHADOWLESS = {"cast_shadow": False, "receive_shadow": False}


@dataclass(frozen=True, eq=False)
class Element:
    """One thing to see, as viser takes it.

    Attributes:
        adder: the function of its scenes that adds one.
        points: (P, 3) where it is.
        properties: that may change from one answer to the next.
        fixed: those that no element of its kind changes.
    """

    adder: str
    points: Array
    properties: Mapping[str, Any]
    fixed: Mapping[str, Any]


Scene = Mapping[str, Element]
Named = Iterator[tuple[str, Element]]


def mesh(
    points: Array, faces: NDArray[np.intp], colour: Colour, opacity: float | None = None, *, flat: bool = False
) -> Element:
    """Triangles (F, 3) of points (V, 3), of which the outside is seen; flat ones have edges between them."""
    look = {"color": colour, "opacity": opacity, "flat_shading": flat}
    corners = {"vertices": np.asarray(points, np.float32), "faces": np.asarray(faces, np.uint32)}
    return Element("add_mesh_simple", points, corners | look, {"side": "front"} | SHADOWLESS)


def line(points: Array, colour: Colour, width: float = 2.0) -> Element:
    """Straight from point to point (P, 3), so many pixels wide."""
    pairs = np.stack((points[:-1], points[1:]), 1).astype(np.float32)
    properties = {"points": pairs, "colors": np.asarray(colour, np.uint8), "thickness": width}
    return Element("add_line_segments", points, properties, {"thickness_units": "screen"})


def arrow(ends: Array, colour: Colour, radius: float) -> Element:
    """From one point to another (2, 3), with a shaft of a radius."""
    length, head = float(np.linalg.norm(ends[1] - ends[0])), HEAD * radius
    sizes = {"shaft_radius": radius, "head_radius": head, "head_length": min(4 * head, 0.5 * length)}
    properties = {"points": ends[None].astype(np.float32), "colors": np.asarray(colour, np.uint8)} | sizes
    return Element("add_arrows", ends, properties, {})


def ball(place: Array, radius: float, colour: Colour) -> Element:
    """A sphere around a point (3,)."""
    properties = {"radius": radius, "color": colour, "position": place}
    return Element("add_icosphere", place[None], properties, SHADOWLESS)


def label(text: str, place: Array) -> Element:
    """Words at a point (3,)."""
    where = {"anchor": "center-center", "font_screen_scale": 1.0}
    return Element("add_label", place[None], {"text": text, "position": place}, where)


@dataclass(frozen=True, eq=False)
class Handles:
    """Where a person can take hold of a scene.

    Attributes:
        tip: (4, 4) where the task's shape ends.
        load: (3,) the head of the tip load's arrow, and
        load_start: (3,) its start.
        newtons: of the force for each metre of the arrow.
    """

    tip: Array
    load: Array
    load_start: Array
    newtons: float


def _centrelines(found: Answer) -> tuple[Centreline, Centreline]:
    """Of the shape that is asked for and of the one that the arm takes, if one was found."""
    wanted = centreline(found.arm, found.task.twists, found.task)
    if found.twists is None:
        return wanted, wanted
    return wanted, centreline(found.arm, found.twists.to(found.task.twists), found.task)


def draw(found: Answer) -> Scene:
    """All there is to see, by name."""
    wanted, at = _centrelines(found)
    length = float(found.arm.neutral_length)
    parts = (
        _base(found.arm, at),
        () if found.twists is None else _arm(found, at),
        _target(found, wanted, at, length),
        _loads(found, at, length),
        _node(found, at, length),
        _set_in_space(found.node_set, wanted, length) if found.arm.dimension == 3 else (),
        () if found.region is None else _reach(found.region, length),
    )
    return {name: element for part in parts for name, element in part}


def handles(found: Answer) -> Handles:
    """Where the tip and the load are, to be dragged."""
    wanted, at = _centrelines(found)
    newtons = newtons_per_metre(found.state)
    force = np.zeros(3)
    force[: found.arm.dimension] = found.state.tip[: found.arm.dimension]
    start = at.tip[:3, 3]
    return Handles(wanted.tip, start + force / newtons, start, newtons)


def newtons_per_metre(state: State) -> float:
    """Of the arrows of forces: the slider's largest is as long as `ARROW` says."""
    return tip_range(state)[0] / (ARROW * float(state.named_arm.design.neutral_length))


def colour_of(pressure: float, limit: float, *, passive: bool) -> Colour:
    """Of an actuator at its pressure; grey where there is none to have."""
    if passive or limit <= 0 or not math.isfinite(pressure):
        return GREY
    red, green, blue = COLOURS(min(max(pressure / limit, 0.0), 1.0))[:3]
    return round(255 * red), round(255 * green), round(255 * blue)


def _tube(skin: Array, colour: Colour, opacity: float | None = None) -> Element:
    """A tube (P, K, 3), closed at its ends; from base to tip, and around from y to z, its outside is seen."""
    count, around = skin.shape[:2]
    here = np.arange(count - 1)[:, None] * around + np.arange(around - 1)
    quads = np.stack((here, here + 1, here + around + 1, here + around), -1).reshape(-1, 4)
    fan = np.stack((np.zeros(around - 2, np.intp), *(np.arange(around - 2) + step for step in (1, 2))), -1)
    faces = np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], fan[:, ::-1], fan + (count - 1) * around))
    return mesh(skin.reshape(-1, 3), faces, colour, opacity)


def _seen(points: Array, faces: NDArray[np.intp], outward: Array) -> NDArray[np.intp]:
    """Faces (F, 3) of points in the order in which they are seen from where directions (F, 3) lead outwards."""
    first, second, third = np.moveaxis(points[faces], 1, 0)
    inside = (np.cross(second - first, third - first) * outward).sum(1) < 0
    return np.where(inside[:, None], faces[:, ::-1], faces)


def _base(arm: Arm, at: Centreline) -> Named:
    wide, pose = 1.4 * _width(arm), at.segments[0][0]
    back = pose.copy()
    back[:3, 3] -= 0.12 * wide * pose[:3, 0]
    yield "base", _tube(skin_of(np.stack((back, pose)), 0.0, 0.0, wide), PLATE)


def _width(arm: Arm) -> float:
    """The largest offset [m], and some."""
    return max(max(float(array(one.offsets).__abs__().max()) for one in segments_of(arm)[0]), 0.005)


def _arm(found: Answer, at: Centreline) -> Named:
    """Tubes, in the colours of their pressures, their numbers, and links."""
    number, limits = 0, found.arm.max_pressure.tolist()
    segments, links = segments_of(found.arm)
    following = [*(poses[0] for poses in at.segments[1:]), at.tip]
    for segment, poses, link, after in zip(segments, at.segments, links, following, strict=True):
        shares = np.linspace(0.3, 0.7, segment.actuator_count)
        for skin, model, share in zip(tubes(segment, poses), segment.actuators, shares, strict=True):
            passive = is_passive(model)
            yield f"actuator_{number}", _tube(skin, colour_of(found.pressure[number], limits[number], passive=passive))
            place = skin[round(share * (len(skin) - 1)), :-1].mean(0)
            yield f"number_{number}", label(str(number + 1), place)
            number += 1
        if link is not None:
            yield f"link_{number}", _tube(skin_of(np.stack((poses[-1], after)), 0.0, 0.0, 0.8 * _width(segment)), PLATE)


def _target(found: Answer, wanted: Centreline, at: Centreline, length: float) -> Named:
    """The shape of the task as a shade of the arm around its centreline, and how far off the tip is."""
    for number, (segment, poses) in enumerate(zip(segments_of(found.arm)[0], wanted.segments, strict=True)):
        yield f"task_{number}", _tube(skin_of(poses, 0.0, 0.0, _width(segment)), GREY, SHADE)
    yield "task_line", line(wanted.points, BLACK, 3.0)
    yield "task_tip", ball(wanted.tip[:3, 3], 0.016 * length, BLACK)
    off = float(np.linalg.norm((wanted.tip - at.tip)[:3, 3]))
    if found.twists is not None and off > VISIBLE * length:
        yield "tip", ball(at.tip[:3, 3], 0.016 * length, VERMILLION)
        ends = np.stack((wanted.tip[:3, 3], at.tip[:3, 3]))
        yield "error", line(ends, VERMILLION, 3.0)
        yield "error_words", label(f"{three_digits(1e3 * off)} mm off", ends.mean(0))


def _loads(found: Answer, at: Centreline, length: float) -> Named:
    """Forces as arrows, with their sizes."""
    newtons = newtons_per_metre(found.state)
    for number, (name, place, force, moment) in enumerate(loads_on(found.arm, found.task.load, at)):
        size, turn = (float(np.linalg.norm(value[0])) for value in (force, moment))
        end = place + force[0] / max(newtons, size / (LONGEST * length))
        if size / newtons > SHORTEST * length:
            yield f"load_{number}", arrow(np.stack((place, end)), BLACK, 0.006 * length)
        if size > 0 or turn > 0:
            words = [f"{three_digits(size)} N"] if size > 0 else []
            words += [f"{three_digits(turn)} N·m"] if turn > 0 else []
            yield f"load_words_{number}", label(f"{name} {', '.join(words)}", end)


def _node(found: Answer, at: Centreline, length: float) -> Named:
    """Where the node is whose set is shown: the start of its element."""
    number, node = place_of_node(found.task, found.node_set.node)
    segment, poses = segments_of(found.arm)[0][number], at.segments[number]
    pose = poses[round(node * (len(poses) - 1) / found.task.nodes_of_segments[number])]
    ahead, wide = pose.copy(), _width(segment)
    ahead[:3, 3] += 0.006 * length * pose[:3, 0]
    yield "node", _tube(skin_of(np.stack((pose, ahead)), 0.0, 0.0, 1.25 * wide), BLUE, 0.5)
    yield "node_words", label(f"node {found.node_set.node + 1}", pose[:3, 3] - 1.5 * wide * pose[:3, 1])


def _reach(region: AlphaShape, length: float) -> Named:
    """Where the tip can be: a sheet behind the arm with its outline, or in space a body."""
    if region.triangulation is None or not region.kept.any():
        return
    if region.points.shape[1] == 3:
        yield "reach", mesh(region.points, _seen(region.points, region.facets, region.normals), SAND, REACH)
        return
    behind = np.full((len(region.points), 1), -0.1 * length)
    faces = region.triangulation.simplices[region.kept].astype(np.intp)  # against the clock, as seen from before
    yield "reach", mesh(np.concatenate((region.points, behind), 1), faces, SAND, REACH)
    for number, loop in enumerate(region.loops()):
        depth = np.full((len(loop), 1), behind[0, 0])
        yield f"reach_line_{number}", line(np.concatenate((loop, depth), 1), BLACK, 1.5)


def _set_in_space(shown: NodeSet, wanted: Centreline, length: float) -> Named:
    """The set of a node in a box beside the arm: each axis is as long as the set is wide along it."""
    base = wanted.segments[0][0]
    along, across = BOX_PLACE
    aside = np.array([-base[1, 0], base[0, 0], 0.0])
    middle = base[:3, 3] + length * (along * base[:3, 0] + across * aside)
    whole = np.concatenate((shown.corners, shown.required[None]))
    low, high = whole.min(0), whole.max(0)
    span = np.where(high - low > 1e-9, high - low, 1.0)

    def placed(values: Array) -> Array:
        return middle + BOX * length * (2 * (values - low) / span - 1)

    corners, faces = placed(shown.corners), hull_faces(shown.corners).astype(np.intp)
    if len(faces):
        outward = corners[faces].mean(1) - corners.mean(0)
        yield "set", mesh(corners, _seen(corners, faces, outward), BLUE, 0.4, flat=True)
    else:  # a set without volume
        yield "set", line(corners, BLUE, 3.0)
    origin = placed(low)
    for axis, (name, unit) in enumerate((("f_x", "N"), ("m_y", "N·m"), ("m_z", "N·m"))):
        end = origin.copy()
        end[axis] += 2 * BOX * length
        yield f"axis_{axis}", line(np.stack((origin, end)), BLACK, 2.0)
        yield f"axis_words_{axis}", label(f"{name} {low[axis]:.3g} to {high[axis]:.3g} {unit}", end)
    inside = "inside" if shown.inside else "outside"
    yield "required", ball(placed(shown.required), 0.018 * length, BLACK if shown.inside else VERMILLION)
    yield "required_words", label(f"required, {inside}", placed(shown.required) + np.array((0.0, 0.05 * length, 0.0)))
