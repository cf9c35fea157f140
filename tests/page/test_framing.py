"""The view holds all there is to see, as near as can be, until a person turns it."""

import asyncio
from dataclasses import dataclass, field

import numpy as np
import pytest
from page_cases import plane, space

from torcharm.page.answers import answer
from torcharm.page.framing import FIELD_OF_VIEW, NARROW, SHEET, Framing, view_axes, view_of
from torcharm.page.scene import draw, label

DIRECTIONS = ((0.0, 0.0, 1.0), (0.35, 0.3, 1.0), (-2.0, 1.0, 0.5))


def picture(points, place, aspect):
    """Where points are seen from a place ahead of them, from -1 to 1, to the right and up."""
    across, up, ahead = (points - place).T
    return np.stack((across / aspect, up), -1) / ahead[:, None] / np.tan(FIELD_OF_VIEW / 2)


@pytest.mark.parametrize("aspect", [0.3, 0.8, 1.8])
def test_all_is_in_view_and_no_nearer_place_would_do(aspect):
    corners = np.array([3.0, -1.0, 0.5]) + (0.1, 0.5, 0.2) * (2.0 * np.argwhere(np.ones((2, 2, 2))) - 1)
    place, target = view_of(np.stack((corners.min(0), corners.max(0))), aspect)
    assert (target - place)[:2].tolist() == [0.0, 0.0]
    seen = picture(corners, place, aspect)
    low = 2 * SHEET - 1 if aspect < NARROW else -1.0
    assert abs(seen).max() <= 1 + 1e-9
    front = seen[[0, 2, 4, 6]]
    assert max(np.ptp(front[:, 0]) / 2, np.ptp(front[:, 1]) / (1 - low)) == pytest.approx(1.0)


def test_the_axes_are_a_camera_s_with_y_upwards_in_its_picture():
    for towards in DIRECTIONS:
        axes = view_axes(towards)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(np.stack((axes[0], axes[1], -axes[2]))) == pytest.approx(1)
        assert axes[1, 1] > 0
        assert axes[0, 1] == pytest.approx(0)


def test_on_a_telephone_the_arm_lies_above_the_sheet_of_controls():
    points = np.concatenate([element.points for element in draw(answer(plane())).values()]) @ view_axes(DIRECTIONS[0]).T
    aspect = 0.9 * NARROW
    seen = picture(points, view_of(np.stack((points.min(0), points.max(0))), aspect)[0], aspect)
    assert seen[:, 1].min() > 0.15  # the picture goes from -1 to 1, and the sheet up to 0.2
    assert abs(seen).max() < 1 + 1e-9


def cube(side):
    return {str(place): label("", side * np.array(place)) for place in np.ndindex(2, 2, 2)}


@dataclass
class Camera:
    """As viser's: what is set here, the browser says back."""

    image_width: int = 600
    image_height: int = 600
    position: np.ndarray = field(default_factory=lambda: np.array([3.0, 3.0, 3.0]))
    look_at: np.ndarray = field(default_factory=lambda: np.zeros(3))
    up_direction: tuple = (0.0, 1.0, 0.0)
    fov: float = 1.0
    heard: list = field(default_factory=list)

    def on_update(self, callback):
        self.heard.append(callback)

    def say(self):
        for callback in self.heard:
            asyncio.run(callback(self))

    def sees(self, scene, aspect=1.0, towards=DIRECTIONS[0]):
        axes = view_axes(towards)
        points = np.concatenate([element.points for element in scene.values()])
        return abs(picture(points @ axes.T, axes @ self.position, aspect)).max() <= 1


def test_the_view_follows_what_leaves_it_until_a_person_turns_it():
    camera, changed = Camera(), []
    framing = Framing(camera, lambda: changed.append(1))
    camera.say()  # from where it looked before anything was set
    small, large = cube(0.5), cube(0.75)
    framing.show(small, 2, False)
    assert camera.sees(small)
    assert not camera.sees(large)
    first = camera.position
    framing.show(small, 2, False)
    assert camera.position is first
    framing.show(large, 2, True)  # while something is dragged
    assert camera.position is first
    framing.show(large, 2, False)
    assert camera.sees(large)

    camera.image_width = 300
    camera.say()
    assert len(changed) == 1
    framing.show(small, 2, False)
    assert camera.sees(small, 0.5)

    camera.position = camera.position + 0.1  # a person's
    camera.image_width = 900
    camera.say()
    assert len(changed) == 1
    framing.show(large, 2, False)
    assert not camera.sees(large)
    framing.begin()
    framing.show(large, 2, False)
    assert camera.sees(large)


def test_a_window_without_height_has_a_view_too():
    camera, scene = Camera(image_height=0), draw(answer(space()))
    Framing(camera, lambda: None).show(scene, 3, False)
    assert np.isfinite(camera.position).all()
    assert camera.sees(scene, 5.0, DIRECTIONS[1])
