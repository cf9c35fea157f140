"""A scene in one browser: what it shows is changed into what it is to show, part by part."""

from typing import Any

import numpy as np

from torcharm.page.scene import Arrow, Ball, Element, Label, Line, Mesh, Scene

HEAD = 2.5
"""The radius of an arrow's head over that of its shaft; the head is twice as long as it is wide."""
SHADOWLESS = {"cast_shadow": False, "receive_shadow": False}


class Canvas:
    """The parts of one client's scene, which is viser's, by name."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._parts: dict[str, tuple[type, Any]] = {}

    def show(self, scene: Scene) -> None:
        """Add what is new, change what is other than before, remove the rest."""
        for name in [name for name, (kind, _) in self._parts.items() if not isinstance(scene.get(name), kind)]:
            self._parts.pop(name)[1].remove()
        for name, element in scene.items():
            adder, properties, fixed = _drawn(element)
            place = properties.pop("position", None)
            if name in self._parts:
                handle = self._parts[name][1]
                for key, value in properties.items():
                    setattr(handle, key, value)  # sends nothing where the value is as before
            else:
                handle = getattr(self._scene, adder)(f"/{name}", **properties, **fixed)
                self._parts[name] = type(element), handle
            if place is not None:
                handle.position = place


def _drawn(element: Element) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """By which of viser's functions an element is added, its properties, and those that no element changes."""
    match element:
        case Mesh():
            points, faces = np.asarray(element.points, np.float32), np.asarray(element.faces, np.uint32)
            look = {"color": element.colour, "opacity": element.opacity, "flat_shading": element.flat}
            return "add_mesh_simple", {"vertices": points, "faces": faces} | look, {"side": "front"} | SHADOWLESS
        case Line():
            points = np.asarray(element.points, np.float32)
            pairs = np.stack((points[:-1], points[1:]), 1)
            properties = {"points": pairs, "colors": np.asarray(element.colour, np.uint8), "thickness": element.width}
            return "add_line_segments", properties, {"thickness_units": "screen"}
        case Arrow():
            length, head = float(np.linalg.norm(element.ends[1] - element.ends[0])), HEAD * element.radius
            sizes = {"shaft_radius": element.radius, "head_radius": head, "head_length": min(4 * head, 0.5 * length)}
            points, colour = np.asarray(element.ends[None], np.float32), np.asarray(element.colour, np.uint8)
            return "add_arrows", {"points": points, "colors": colour} | sizes, {}
        case Ball():
            properties = {"radius": element.radius, "color": element.colour, "position": element.place}
            return "add_icosphere", properties, SHADOWLESS
        case Label():
            where = {"anchor": "center-center", "font_screen_scale": 1.0}
            return "add_label", {"text": element.text, "position": element.place}, where
