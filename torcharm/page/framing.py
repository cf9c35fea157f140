"""Where a browser looks from: all there is to see fills its window, until the person turns the view."""

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from torcharm.page.scene import Scene
from torcharm.plot._common import Array

FIELD_OF_VIEW = 0.65
"""Of the camera, from top to bottom [rad]: narrow, so that what is near does not look much larger."""
TOWARDS = {2: (0.0, 0.0, 1.0), 3: (0.35, 0.3, 1.0)}
"""By an arm's dimension, the direction from it to the eye: an arm in space is seen a little from its side."""
MARGIN = 0.1
"""Of the largest side of the box around a scene, what is left free around it, for words and for what moves next."""
NARROW, SHEET = 0.62, 0.6
"""Up to which width over height a window is a telephone's, whose controls lie over so much of its lower part."""
ASPECTS = (0.2, 5.0)
"""Of windows that there are: a browser may say that its has no height."""
KEPT = 16
"""Places of the camera that were set last: a browser says where it looked from when newer ones are on the way."""
ALIKE = 1e-3
"""Of the distance to the arm, by how much a camera's place may differ from one that was set and still be that one."""


class Framing:
    """The camera of one browser, which is viser's.

    `changed` is called when the window has another shape, which needs another view.
    """

    def __init__(self, camera: Any, changed: Callable[[], None]) -> None:
        self._camera, self._changed = camera, changed
        self._known = deque([np.asarray(camera.position)], KEPT)
        self._box = np.zeros((2, 3))
        self._aspect, self._wanted, self._own = 0.0, True, True
        camera.fov = FIELD_OF_VIEW
        camera.on_update(self._moved)

    def begin(self) -> None:
        """Set the view anew with the next scene."""
        self._wanted = True

    def show(self, scene: Scene, dimension: int, hold: bool) -> None:
        """Set the view of a scene where that is asked for, or where the scene leaves a view that was set here.

        On hold it must not move, as something is being dragged in it.
        """
        axes = view_axes(TOWARDS[dimension])
        seen = np.concatenate([element.points for element in scene.values()]) @ axes.T
        box = np.stack((seen.min(0), seen.max(0)))
        within = bool((self._box[0] <= box[0]).all() and (box[1] <= self._box[1]).all())
        if not self._wanted and (hold or not self._own or within):
            return
        room = MARGIN * float(np.ptp(box, 0).max())
        self._box, self._aspect = box + np.array([[-room], [room]]), shape_of(self._camera)
        self._wanted, self._own = False, True
        place, target = view_of(self._box, self._aspect) @ axes
        self._known.append(place)
        self._camera.position, self._camera.look_at, self._camera.up_direction = place, target, (0.0, 1.0, 0.0)

    async def _moved(self, camera: Any) -> None:
        """The browser says where it looks from: elsewhere than was set, a person has turned the view, which stays."""
        place = np.asarray(camera.position)
        near = ALIKE * float(np.linalg.norm(camera.look_at - place))
        if not any(np.linalg.norm(place - known) <= near for known in tuple(self._known)):
            self._own = False
        elif self._own and self._aspect and abs(shape_of(camera) / self._aspect - 1) > ALIKE:
            self._wanted = True
            self._changed()


def shape_of(camera: Any) -> float:
    """The width of a window over its height."""
    return min(max(camera.image_width / max(camera.image_height, 1), ASPECTS[0]), ASPECTS[1])


def view_axes(towards: tuple[float, float, float]) -> Array:
    """(3, 3) right, up and ahead, in rows, of a camera that looks from there, with y upwards in its picture."""
    ahead = -np.asarray(towards) / float(np.linalg.norm(towards))
    right = np.cross(ahead, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(right, ahead), ahead))


def view_of(box: Array, aspect: float) -> Array:
    """Of a camera from which a box (2, 3) is seen whole, the place and a point ahead, by the axes of its picture.

    What lies over the lower part of a narrow window has nothing behind it.
    """
    middle, half = box.mean(0), np.ptp(box, 0) / 2
    covered = SHEET if aspect < NARROW else 0.0
    high = math.tan(FIELD_OF_VIEW / 2)
    away = max(half[0] / (aspect * high), half[1] / ((1 - covered) * high))
    target = middle - (0.0, covered * high * away, 0.0)
    return np.stack((target - (0.0, 0.0, away + half[2]), target))
