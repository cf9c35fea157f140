"""A browser without a window: viser's messages over its socket, and what they leave on the page.

Messages to a page are zstd-compressed msgpack, in which arrays are places in the bytes behind it, each at a multiple of
eight; messages from a page are msgpack. Only what a test needs is kept: controls with their values, and the scene.
"""

import time
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.sync.client import connect

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, 0.0, 1.0],
    "fov": 0.65,
    "near": 0.01,
    "far": 100.0,
    "image_height": 720,
    "image_width": 1280,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 1.0, 0.0],
}
"""A page says first where it looks from."""
MARGINS = 3
"""Columns of the chart of margins, which is drawn once for every answer."""


@dataclass
class Part:
    """Of a page: a control, or an element of its scene."""

    kind: str
    props: dict[str, Any]
    value: Any = None
    place: Any = None
    owner: str = ""


@dataclass
class Page:
    """One open page.

    Attributes:
        controls: by their ids.
        scene: elements by their names.
        pictures: how many answers were shown.
    """

    url: str
    origin: str | None = None
    controls: dict[str, Part] = field(default_factory=dict)
    scene: dict[str, Part] = field(default_factory=dict)
    pictures: int = 0

    def __post_init__(self) -> None:
        address = self.url.replace("http", "ws", 1)
        protocols: Any = [f"viser-v{viser.__version__}"]
        self._socket = connect(address, subprotocols=protocols, origin=self.origin, max_size=None)  # type: ignore[arg-type]
        self.send(CAMERA)

    def __enter__(self) -> "Page":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, message: dict[str, Any]) -> None:
        """A message to the server."""
        self._socket.send(msgspec.msgpack.encode(message))

    def receive(self, seconds: float) -> bool:
        """Take in what comes within a time; whether anything did."""
        try:
            data = self._socket.recv(timeout=seconds)
        except TimeoutError:
            return False
        assert isinstance(data, bytes)
        size = int.from_bytes(data[8:16], "little")
        whole = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(data[16 : 16 + size]))
        arrays, start = [], 16 + size
        for length in whole["binaryBufferLengths"]:
            start += -start % 8
            arrays.append(data[start : start + length])
            start += length
        for message in whole["messages"]:
            self._take(_with_arrays(message, arrays))
        return True

    def until(self, done: Any, seconds: float = 30.0) -> float:
        """Take in what comes until something holds; how long that took [s].

        Raises:
            TimeoutError: it did not in time.
        """
        start = time.perf_counter()
        while not done():
            if time.perf_counter() - start > seconds:
                raise TimeoutError(f"nothing came within {seconds} s")
            self.receive(0.2)
        return time.perf_counter() - start

    def find(self, label: str, kind: str = "") -> str:
        """The id of the first control of a label."""
        return next(
            uuid for uuid, part in self.controls.items() if part.props.get("label") == label and kind in part.kind
        )

    def move(self, uuid: str, value: Any) -> None:
        """Move a control as a person would."""
        self.controls[uuid].value = value
        self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def press(self, label: str) -> None:
        """Click a button."""
        self.send({"type": "GuiUpdateMessage", "uuid": self.find(label, "Button"), "updates": {"value": True}})

    def drag(self, name: str, place: Any, turn: Any = (1.0, 0.0, 0.0, 0.0)) -> None:
        """Move a handle of the scene."""
        message = {"type": "TransformControlsUpdateMessage", "name": name, "owner": self.scene[name].owner}
        self.send({**message, "wxyz": list(turn), "position": list(place)})

    @property
    def words(self) -> str:
        """All HTML of the page."""
        return "\n".join(str(part.props.get("content", "")) for part in self.controls.values())

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "GuiUpdateMessage" and message["uuid"] in self.controls:
            part, updates = self.controls[message["uuid"]], dict(message["updates"])
            part.value = updates.pop("value", part.value)
            part.props.update(updates)
            self.pictures += len(updates.get("data", ())) == MARGINS
        elif kind == "GuiRemoveMessage":
            self.controls.pop(message["uuid"], None)
        elif kind == "SceneNodeUpdateMessage" and message["name"] in self.scene:
            self.scene[message["name"]].props.update(message["updates"])
        elif kind == "SetPositionMessage" and message["name"] in self.scene:
            self.scene[message["name"]].place = message["position"]
        elif kind == "RemoveSceneNodeMessage":
            self.scene.pop(message["name"], None)
        elif "uuid" in message and isinstance(message.get("props"), dict):
            self.controls[message["uuid"]] = Part(kind, dict(message["props"]), message.get("value"))
        elif "name" in message and isinstance(message.get("props"), dict):
            self.scene[message["name"]] = Part(kind, dict(message["props"]), owner=message.get("owner", ""))


def _with_arrays(value: Any, arrays: list[bytes]) -> Any:
    """A message with its arrays in place."""
    if isinstance(value, dict):
        if "__binary_index" in value:
            return np.frombuffer(arrays[value["__binary_index"]], value["dtype"])
        return {key: _with_arrays(item, arrays) for key, item in value.items()}
    return [_with_arrays(item, arrays) for item in value] if isinstance(value, list | tuple) else value
