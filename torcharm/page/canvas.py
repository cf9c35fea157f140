"""A scene in one browser: what it shows is changed into what it is to show, part by part."""

from typing import Any

from torcharm.page.scene import Scene


class Canvas:
    """The parts of one client's scene, which is viser's, by name."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._parts: dict[str, tuple[str, Any]] = {}

    def show(self, scene: Scene) -> None:
        """Add what is new, change what is other than before, remove the rest."""
        for name, (adder, handle) in tuple(self._parts.items()):
            if name not in scene or scene[name].adder != adder:
                del self._parts[name]
                handle.remove()
        for name, element in scene.items():
            if name in self._parts:
                for key, value in element.properties.items():
                    setattr(self._parts[name][1], key, value)  # sends nothing where the value is as before
            else:
                handle = getattr(self._scene, element.adder)(f"/{name}", **element.properties, **element.fixed)
                self._parts[name] = element.adder, handle
