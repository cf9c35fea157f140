"""The handle in a scene by which a person drags the tip or the load."""

from threading import Lock
from typing import Any

import numpy as np

from torcharm.page.answers import Answer
from torcharm.page.scene import Handles, handles
from torcharm.page.session import Session

NOTHING, TIP, LOAD = "nothing", "the tip", "the load"
"""What it drags."""
SIZE = 0.28
"""Of it, as a share of the arm's length."""


class Gizmo:
    """The handle of one browser, which is there if something is to be dragged, and `dragging` while it is.

    The scene and its rotations are viser's; the session hears where the handle was dragged.
    """

    def __init__(self, scene: Any, transforms: Any, session: Session) -> None:
        self._scene, self._rotation, self._session = scene, transforms.SO3, session
        self._what, self.dragging = NOTHING, False
        self._handle: Any = None
        self._at: Handles | None = None
        self._changing = Lock()  # the session's thread shows it, and the server's takes another

    def take(self, what: str) -> None:
        """Drag something else from now on."""
        with self._changing:
            self._what, self.dragging = what, False
            if self._handle is not None:
                self._handle.remove()
                self._handle = None
        self._session.refresh()

    def show(self, found: Answer) -> None:
        """Put it where what it drags is, unless it is being dragged."""
        with self._changing:
            if self._what == NOTHING or self.dragging:
                return
            self._at = at = handles(found)
            if self._handle is None:
                self._handle = self._scene.add_transform_controls(
                    "/handle",
                    scale=SIZE * float(found.arm.neutral_length),
                    active_axes=(True, True, found.arm.dimension == 3),
                    disable_rotations=self._what == LOAD,
                    depth_test=False,
                )
                self._handle.on_update(self._dragged)
            tip = self._what == TIP
            self._handle.position = at.tip[:3, 3] if tip else at.load
            self._handle.wxyz = self._rotation.from_matrix(at.tip[:3, :3] if tip else np.eye(3)).wxyz

    async def _dragged(self, event: Any) -> None:
        """Where the load's arrow starts is held while its head is dragged, though the arm moves meanwhile."""
        if self._at is None or event.target is not self._handle:
            return
        if event.phase == "end":
            self.dragging = False
            self._session.refresh()
            return
        self.dragging = self.dragging or event.phase == "start"
        place = np.asarray(event.target.position, np.float64)
        if not np.isfinite(place).all():
            return
        if self._what == LOAD:
            self._session.drag_load((place - self._at.load_start) * self._at.newtons)
            return
        pose = np.eye(4)
        pose[:3, :3] = self._rotation(np.asarray(event.target.wxyz, np.float64)).normalize().as_matrix()
        pose[:3, 3] = place
        self._session.drag_tip(pose)
