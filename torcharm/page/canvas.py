"""A scene in one browser: what it shows is changed into what it is to show, part by part."""

from collections.abc import Callable
from typing import Any

import numpy as np

from torcharm.page.scene import Arrow, Ball, Element, Label, Line, Mesh, Scene

HEAD = 2.5
"""The radius of an arrow's head over that of its shaft; the head is twice as long as it is wide."""


class Canvas:
    """The parts of one client's scene, by name.

    Args:
        scene: viser's, of one client.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._parts: dict[str, tuple[type, Any]] = {}

    def show(self, scene: Scene) -> None:
        """Add what is new, change what is other than before, remove the rest."""
        for name in [name for name, (kind, _) in self._parts.items() if not isinstance(scene.get(name), kind)]:
            self._parts.pop(name)[1].remove()
        for name, element in scene.items():
            properties = _PROPERTIES[type(element)](element)
            place = properties.pop("position", None)
            if name in self._parts:
                handle = self._parts[name][1]
                for key, value in properties.items():
                    setattr(handle, key, value)  # sends nothing where the value is as before
            else:
                add = getattr(self._scene, _ADDERS[type(element)])
                handle = add(f"/{name}", **properties, **_FIXED.get(type(element), {}))
                self._parts[name] = type(element), handle
            if place is not None:
                handle.position = place


def _mesh(mesh: Mesh) -> dict[str, Any]:
    points, faces = np.asarray(mesh.points, np.float32), np.asarray(mesh.faces, np.uint32)
    return {
        "vertices": points,
        "faces": faces,
        "color": mesh.colour,
        "opacity": mesh.opacity,
        "flat_shading": mesh.flat,
    }


def _line(line: Line) -> dict[str, Any]:
    points = np.asarray(line.points, np.float32)
    colours = np.asarray(line.colour, np.uint8)
    return {"points": np.stack((points[:-1], points[1:]), 1), "colors": colours, "thickness": line.width}


def _arrow(arrow: Arrow) -> dict[str, Any]:
    length = float(np.linalg.norm(arrow.ends[1] - arrow.ends[0]))
    head = HEAD * arrow.radius
    sizes = {"shaft_radius": arrow.radius, "head_radius": head, "head_length": min(4 * head, 0.5 * length)}
    return {"points": np.asarray(arrow.ends[None], np.float32), "colors": np.asarray(arrow.colour, np.uint8)} | sizes


def _ball(ball: Ball) -> dict[str, Any]:
    return {"radius": ball.radius, "color": ball.colour, "position": ball.place}


def _label(label: Label) -> dict[str, Any]:
    return {"text": label.text, "position": label.place}


_PROPERTIES: dict[type, Callable[[Any], dict[str, Any]]] = {
    Mesh: _mesh,
    Line: _line,
    Arrow: _arrow,
    Ball: _ball,
    Label: _label,
}
_ADDERS: dict[type[Element], str] = {
    Mesh: "add_mesh_simple",
    Line: "add_line_segments",
    Arrow: "add_arrows",
    Ball: "add_icosphere",
    Label: "add_label",
}
_FIXED: dict[type, dict[str, Any]] = {
    Mesh: {"side": "front", "cast_shadow": False, "receive_shadow": False},
    Line: {"thickness_units": "screen"},
    Ball: {"cast_shadow": False, "receive_shadow": False},
    Label: {"anchor": "center-center", "font_screen_scale": 1.0},
}
"""What no element changes."""
