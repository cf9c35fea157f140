"""Where a browser looks from: all there is to see fills its window, until the person turns the view."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from torcharm.page.scene import Arrow, Ball, Label, Scene
from torcharm.plot._common import Array

FIELD_OF_VIEW = 0.65
"""Of the camera, from top to bottom [rad]: narrow, so that what is near does not look much larger."""
TOWARDS = {2: (0.0, 0.0, 1.0), 3: (0.35, 0.3, 1.0)}
"""By an arm's dimension, the direction from it to the eye: an arm in space is seen a little from its side."""
MARGIN = 0.12
"""The part of the window at each side that is left free when a view is set, for words and for what moves next."""
NARROW, SHEET = 0.62, 0.6
"""Up to which width over height a window is a telephone's, whose controls lie over so much of its lower part."""
LETTER = 0.0045
"""Of a word in the picture, half the width of a letter over the window's height: letters keep their size."""
ROUNDS = 6
"""In which a place is found for words, too: one that takes a third of the window's width is then off by 1e-3 of it."""
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
        corners, axes = Corners.of(scene), view_axes(TOWARDS[dimension])
        aspect = shape_of(self._camera)
        if not self._wanted and (hold or not self._own or in_view(corners, axes, self._known[-1], sides(aspect))):
            return
        place = fitted(corners, axes, sides(aspect, MARGIN))
        ahead = axes[2] * float(axes[2] @ (corners.points.mean(0) - place))
        self._known.append(place)
        self._aspect, self._wanted, self._own = aspect, False, True
        self._camera.position, self._camera.look_at, self._camera.up_direction = place, place + ahead, (0.0, 1.0, 0.0)

    async def _moved(self, camera: Any) -> None:
        """The browser says where it looks from: elsewhere than was set, a person has turned the view, which stays."""
        place = np.asarray(camera.position)
        near = ALIKE * float(np.linalg.norm(camera.look_at - place))
        if not any(np.linalg.norm(place - known) <= near for known in tuple(self._known)):
            self._own = False
        elif self._own and self._aspect and abs(shape_of(camera) / self._aspect - 1) > ALIKE:
            self._wanted = True
            self._changed()


@dataclass(frozen=True, eq=False)
class Corners:
    """What is to be in view: points (P, 3), and to both sides of each the room (P,) of words, as a tangent."""

    points: Array
    room: Array

    @classmethod
    def of(cls, scene: Scene) -> "Corners":
        """All of a scene."""
        points, room = [], []
        for element in scene.values():
            if isinstance(element, Ball | Label):
                own = element.place[None]
            else:
                own = element.ends if isinstance(element, Arrow) else element.points
            letters = len(element.text) if isinstance(element, Label) else 0
            points.append(own)
            room.append(np.full(len(own), 2 * LETTER * letters * math.tan(FIELD_OF_VIEW / 2)))
        return cls(np.concatenate(points), np.concatenate(room))


def shape_of(camera: Any) -> float:
    """The width of a window over its height."""
    return min(max(camera.image_width / max(camera.image_height, 1), ASPECTS[0]), ASPECTS[1])


def view_axes(towards: tuple[float, float, float]) -> Array:
    """(3, 3) right, up and ahead, in rows, of a camera that looks from there, with y upwards in its picture."""
    ahead = -np.asarray(towards) / float(np.linalg.norm(towards))
    right = np.cross(ahead, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(right, ahead), ahead))


def sides(aspect: float, margin: float = 0.0) -> tuple[float, float, float, float]:
    """Tangents of the angles from straight ahead to the left, right, lower and upper end of what is to be filled."""
    high = math.tan(FIELD_OF_VIEW / 2)
    wide = (1 - margin) * aspect * high
    covered = SHEET * high if aspect < NARROW else 0.0
    half = (1 - margin) * (high - covered)
    return wide, wide, half - covered, half + covered


def fitted(corners: Corners, axes: Array, sides: tuple[float, float, float, float]) -> Array:
    """The nearest place (3,) from which all is seen between the sides.

    A point p is left of the right side if right·(p - c) ≤ tan · ahead·(p - c), which is linear in the camera's place c,
    and so are the others: each pair of sides bounds how far ahead c may be, and where it is across then. Words are as
    wide as they are far away, so that they are counted from the place found before.
    """
    across, up, ahead = axes @ corners.points.T
    left, right, below, above = sides
    depth, place = ahead, np.zeros(2)
    for _ in range(ROUNDS):
        wide = corners.room * (ahead - depth)
        low, high = np.array((left, below)), np.array((right, above))
        start = np.array(((across + wide - right * ahead).max(), (up - above * ahead).max()))
        end = np.array(((across - wide + left * ahead).min(), (up + below * ahead).min()))
        depth = ((end - start) / (low + high)).min()
        place = (start + end + (high - low) * depth) / 2
    found: Array = np.array((*place, depth)) @ axes
    return found


def in_view(corners: Corners, axes: Array, place: Array, sides: tuple[float, float, float, float]) -> bool:
    """Whether all is seen between the sides from a place."""
    across, up, ahead = axes @ (corners.points - place).T
    (left, right, below, above), room = sides, corners.room * ahead
    seen = (room - left * ahead <= across) & (across <= right * ahead - room)
    seen &= (-below * ahead <= up) & (up <= above * ahead)
    return bool((seen & (ahead > 0)).all())
