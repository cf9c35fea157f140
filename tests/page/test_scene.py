"""Scenes and words of a page: what is seen is where the arm is, and no name of a study does anything."""

from dataclasses import replace

import numpy as np
import pytest
from page_cases import HOSTILE, plane, space

import torcharm as ta
from torcharm.page import state as page, words
from torcharm.page.answers import NodeSet, answer, settled
from torcharm.page.charts import axis_ends, margins, outline
from torcharm.page.scene import BLACK, GREY, VERMILLION, colour_of, draw, handles
from torcharm.page.state import BY_HAND
from torcharm.wrench_sets.node_distances import lack_in_words


def volume(mesh):
    """Of a closed mesh whose faces are seen from outside."""
    return np.linalg.det(mesh.points[mesh.properties["faces"]]).sum() / 6


@pytest.mark.parametrize("make", [plane, space])
def test_each_actuator_is_a_tube_of_its_length_and_all_is_seen_from_outside(make):
    found = answer(replace(make(), node=3))
    scene = draw(found)
    tubes = [element for name, element in scene.items() if name.startswith("actuator_")]
    assert len(tubes) == found.arm.actuator_count
    closed = [element for element in scene.values() if element.adder == "add_mesh_simple"]
    assert all(volume(mesh) > 0 for mesh in closed)
    again = draw(answer(page.with_value(replace(make(), node=3), 0, "distance", 0.04)))
    assert scene.keys() - {"tip", "error", "error_words"} == again.keys() - {"tip", "error", "error_words"}


def test_the_tip_s_error_is_drawn_as_long_as_it_is():
    found = answer(replace(plane(), mode=BY_HAND))
    error = draw(found)["error"]
    assert error.adder == "add_line_segments"
    assert np.linalg.norm(np.diff(error.points, axis=0)) == pytest.approx(found.found.tip_error.item(), rel=1e-6)
    wanted = ta.poses(found.task.twists, found.task.base_pose)[-1].numpy()
    np.testing.assert_allclose(handles(found).tip[:2, 3], wanted[:2], atol=1e-12)


def test_the_load_s_arrow_has_its_direction_and_its_handle_gives_it_back():
    found = answer(page.with_tip(page.with_tip(plane(), 0, 1.5), 1, -0.5))
    arrow = draw(found)["load_0"]
    assert arrow.adder == "add_arrows"
    way = arrow.points[1] - arrow.points[0]
    np.testing.assert_allclose(way / np.linalg.norm(way), np.array([1.5, -0.5, 0]) / np.hypot(1.5, 0.5), atol=1e-9)
    at = handles(found)
    np.testing.assert_allclose((at.load - at.load_start) * at.newtons, [1.5, -0.5, 0.0], atol=1e-12)


def test_colours_go_with_pressure_and_passive_actuators_are_grey():
    shades = [sum(colour_of(pressure, 50.0, passive=False)) for pressure in (0.0, 25.0, 50.0)]
    assert shades == sorted(shades)
    assert colour_of(10.0, 0.0, passive=False) == colour_of(10.0, 50.0, passive=True) == GREY
    assert colour_of(float("nan"), 50.0, passive=False) == GREY
    assert colour_of(90.0, 50.0, passive=False) == colour_of(50.0, 50.0, passive=False)


def test_a_set_in_space_holds_its_requirement_where_the_words_say_so():
    scene = draw(answer(space()))
    assert scene["required"].properties["color"] == BLACK
    assert "inside" in scene["required_words"].properties["text"]
    heavy = page.with_tip(page.with_tip(space(), 0, 0.5), 2, 0.5)
    loaded = draw(answer(heavy))
    assert (loaded["required"].properties["color"] == VERMILLION) == (
        "outside" in loaded["required_words"].properties["text"]
    )


def test_a_set_in_the_plane_is_its_outline():
    square = NodeSet(0, np.array([[-1.0, -2.0], [3.0, -1.0], [3.0, 1.0], [-1.0, 2.0]]), np.array([1.0, 0.5]), True)
    force, least, largest, required = outline(square)
    assert force.tolist() == [-1.0, 1.0, 3.0]
    assert least.tolist() == [-2.0, -1.5, -1.0]
    assert largest.tolist() == [2.0, 1.5, 1.0]
    assert np.isnan(required[[0, 2]]).all()
    assert required[1] == 0.5
    outside = NodeSet(0, square.corners, np.array([9.0, 0.5]), False)
    force, least, _, required = outline(outside)
    assert (force[-1], required[-1]) == (9.0, 0.5)
    assert np.isnan(least[-1])
    upright = NodeSet(0, np.array([[0.5, -2.0], [0.5, 3.0]]), np.array([1.0, 0.0]), False)
    force, least, largest, _ = outline(upright)  # pressures change the moment alone
    assert (force.tolist(), least[0], largest[0]) == ([0.5, 1.0], -2.0, 3.0)
    assert np.isnan(largest[1])


def test_axes_hold_all_and_hardly_move():
    corners = np.array([[-1.03, -2.0], [3.0, 0.01]])
    shown = [NodeSet(0, corners, np.array([force, 0.0]), True) for force in (0.0, 3.04, 3.06, 9.0)]
    ends = [axis_ends(one, 0) for one in shown]
    assert ends[1] == ends[2]
    assert all(low < -1.03 and high > max(3.0, one.required[0]) for (low, high), one in zip(ends, shown, strict=True))
    flat = NodeSet(0, np.zeros((4, 2)), np.zeros(2), True)
    assert axis_ends(flat, 0) == (-0.05, 0.05)


def test_words_give_the_verdict_and_numbers_with_units_and_escape_all_else():
    found = answer(plane())
    text = words.results(found)
    assert ">held<" in text
    assert f"{1e3 * found.found.tip_error.item():.3g}</td>" in text
    assert ">mm<" in text
    assert words.note(HOSTILE).count("<") == 2  # its own alone
    hand = answer(replace(settled(found), mode=BY_HAND))
    assert all("<img" not in element.properties.get("text", "") for element in draw(hand).values())
    assert "<img" not in words.results(hand)


def test_words_say_what_else_would_puzzle():
    found = answer(plane())
    margins = np.where(np.arange(6) == 2, -0.1, 0.2)
    assert "margin below 0" not in words.results(replace(found, margins=np.abs(margins)))
    assert "margin below 0: the margin is that of the exact shape" in words.results(replace(found, margins=margins))
    reason = f"no pressure serves all nodes: {lack_in_words(2, 0.1, (1.0, 1.0), relative=True)}"
    missed = replace(found, verdict="missed", reason=reason, margins=margins)
    assert "Change from the base: a segment" in words.results(missed)
    assert "margin below 0" not in words.results(missed)
    settings = found.state.study.settings
    assert "N·m counted as N" in words.explanation(settings)
    assert "1 f² + 400 m²" in words.explanation(replace(settings, weights=(1.0, 400.0)))


def test_of_margins_what_is_not_finite_is_left_out():
    found = answer(plane())
    nodes, values, zero = margins(found)
    assert nodes.tolist() == list(range(1, 7))
    assert values == pytest.approx(found.margins)
    assert not zero.any()
