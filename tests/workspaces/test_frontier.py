"""Which ways lead out of a region: from its facets, and from what is too thin to have any."""

import numpy as np

import torcharm as ta
from torcharm.geometry.alpha_shape import alpha_shape
from torcharm.workspaces.frontier import Frontier, ways_out_of_spikes
from torcharm.workspaces.states import EXCLUDED, REACHED, KnownSlopes, joined, solve_states


def strip(height):
    """Points of a strip (0 to 1, 0 to `height`) a tenth apart, and a spike to the right of it: on one line."""
    across = np.linspace(0, 1, 11)
    rows = [np.stack((across, np.full(11, y)), 1) for y in np.arange(0, height + 1e-9, 0.1)]
    spike = [[1.12, 0.0], [1.25, 0.001]]
    return np.concatenate((*rows, spike))


def test_the_end_of_a_spike_leads_along_it():
    points = strip(0.3)
    shape = alpha_shape(points, 0.08)
    found, way = ways_out_of_spikes(shape)
    ends = way[np.isin(found, [len(points) - 1])]
    assert len(ends) == 1
    np.testing.assert_allclose(ends[0], [1, 0], atol=0.02)


def test_the_corner_of_a_square_leads_along_its_diagonal_and_its_sides_do_not():
    points = strip(1.0)[:-2]
    found, way = ways_out_of_spikes(alpha_shape(points, 0.08))
    corners = {tuple(points[one].round(1)): each for one, each in zip(found, way, strict=True)}
    assert set(corners) <= {(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)}
    for (x, y), each in corners.items():
        np.testing.assert_allclose(each, (np.array([x, y]) - 0.5) * np.sqrt(2), atol=1e-12)


def test_no_region_has_no_way_out():
    found, way = ways_out_of_spikes(alpha_shape(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), 0.1))
    assert len(found) == len(way) == 0


def test_attempts_that_left_the_range_are_corrected_from_where_they_landed():
    arm = ta.antagonistic_arm()
    scene = ta.solve_equilibrium(arm, 0.0, ta.ExternalLoad(gravity=True), 5)._problem
    places = np.random.default_rng(0).random((150, arm.actuator_count))
    states = solve_states(scene, places)
    one = np.ones(arm.actuator_count)
    frontier = Frontier(KnownSlopes(scene, 10_000), 0.02, 0.01, 1e-4, (REACHED,), 0 * one, one, True)
    push = frontier.push(states, 100)
    tried = solve_states(scene, push.normalised)
    missed = tried.code.numpy() == EXCLUDED
    states = joined((states, tried))
    again = frontier.push_on(states, push, 100)
    corrected = [any((goal == own).all() for own in push.goal[missed]) for goal in again.goal]
    landed = solve_states(scene, again.normalised[corrected])
    gained = (landed.position * again.normal[corrected]).sum(1) > again.height[corrected]
    assert missed.sum() > 5
    assert sum(corrected) > 5
    assert ((landed.code.numpy() == REACHED) & gained).mean() > 0.5
