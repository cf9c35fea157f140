"""Workspaces against what is known without them: a formula, and brute force."""

import numpy as np
import pytest
import torch
from hull_cases import unchecked
from scipy.spatial import cKDTree

import torcharm as ta
from experiments.workspace.run import beyond, brute_force, hanging, random_places
from torcharm.workspaces import STATES

REACH, SLENDER = 0.3, 0.05


def spring(limit=10.0, pressures=(0.0, 50.0)):
    return ta.PolynomialActuator(((0, 1, 2.0), (1, 0, -100.0)), (-0.3, 0.3), pressures, limit, 0.0)


def spring_arm(**options):
    return ta.ArmDesign([-SLENDER, SLENDER], REACH, [spring(**options)] * 2)


def spring_tips(pressure):
    """Where the tips (..., 2) of a `spring_arm` are without load: each spring is as long as its pressure says."""
    left, right = (REACH * (1 + torch.as_tensor(pressure) / 50)).unbind(-1)  # at radii -r and r
    twists = torch.stack((0.5 * (left + right), 0 * left, (left - right) / (2 * SLENDER)), -1)
    return ta.poses(twists.unsqueeze(-2))[..., -1, :2]


def edges_of_box(count, highest):
    """Pressures (4 count, 2) around the box of two."""
    way = torch.linspace(0, highest, count, dtype=torch.float64)
    low, high = torch.zeros_like(way), torch.full_like(way, highest)
    sides = ((way, low), (high, way), (way.flip(0), high), (low, way.flip(0)))
    return torch.cat([torch.stack(side, -1) for side in sides])


class TestFormula:
    """Two springs without load: pressures are as many as coordinates, and the boundary is the image of the box's."""

    found = staticmethod(lambda **options: ta.workspace(spring_arm(**options), states=2000, nodes=3))

    def test_states_are_where_the_formula_says(self):
        found = self.found()
        assert (found.status == "reached").all()
        torch.testing.assert_close(found.position, spring_tips(found.pressure), rtol=0, atol=1e-9)

    def test_area_and_boundary(self):
        found = self.found()
        x, y = spring_tips(edges_of_box(400, 10.0)).T
        area = float((x * y.roll(-1) - y * x.roll(-1)).sum().abs()) / 2
        assert found.size == pytest.approx(area, rel=0.01)
        rim = cKDTree(np.stack((x, y), -1))
        assert rim.query(found.region.points[np.unique(found.region.facets)])[0].max() < 1e-3

    def test_pressures_out_of_range_are_told_apart(self):
        found = self.found(pressures=(0.0, 5.0))
        assert ((found.status == "reached") == (found.pressure <= 5.0 + 1e-5).all(-1).numpy()).all()
        x, y = spring_tips(edges_of_box(400, 5.0)).T
        area = float((x * y.roll(-1) - y * x.roll(-1)).sum().abs()) / 2
        assert found.size == pytest.approx(area, rel=0.015)
        assert found.extrapolated_region.size == pytest.approx(self.found().size, rel=0.01)


@pytest.mark.parametrize(
    ("arm", "weight"), [(ta.antagonistic_arm(), 2.0), (ta.bellows_arm(), 2.0), (ta.mckibben_arm(), 1.0)]
)
def test_brute_force_finds_nothing_beyond(arm, weight):
    found = ta.workspace(arm, hanging(arm, weight), states=10_000, nodes=6)
    tips, codes, _ = brute_force(arm, hanging(arm, weight), random_places(arm, 20_000), nodes=6)
    assert beyond(tips[codes == 0], found.region).max() < 2e-3
    assert beyond(tips, found.extrapolated_region).max() < found.resolution


def test_states_are_equilibria_with_their_words():
    arm = ta.mckibben_arm(length=0.4)
    load = ta.ExternalLoad([0.0, 1.0, 0.0], gravity=True)  # upward: it compresses the arm
    found = ta.workspace(arm, load, states=600, nodes=4)
    again = ta.solve_equilibrium(arm, found.pressure, load, 4)
    torch.testing.assert_close(found.twists, again.twists)
    words = np.where(again.in_range, "reached", "excluded by range")
    for flag, word in ((again.continued, "snapped"), (again.stable, "unstable"), (again.converged, "not converged")):
        words = np.where(flag, words, word)
    words = np.where(again.possible, words, "impossible")
    assert (found.status == words).all()
    assert {"reached", "snapped", "unstable"} <= set(words)
    assert sum(found.shares.values()) == pytest.approx(1)
    assert set(found.shares) == set(STATES)


@pytest.mark.parametrize(
    "arm", [ta.antagonistic_arm(), ta.antagonistic_ring(), ta.silicone_arm()], ids=["plane", "space", "series"]
)
def test_payload_factors_are_load_capacities(arm):
    found = ta.workspace(arm, 0.02, states=400, nodes=4)
    some = torch.nonzero(found.extrapolated).flatten()[::20]
    nodes = found.segment_nodes if len(found.segment_nodes) > 1 else None
    capacity = ta.load_capacity(arm, ta.Task(found.twists[some], load=found.load, segment_nodes=nodes))
    expected = capacity.factor.nan_to_num(nan=1.0, posinf=torch.inf).clamp(min=1)
    torch.testing.assert_close(found.payload_factor[some], expected, rtol=1e-6, atol=1e-6)
    assert found.payload_factor[found.status == "unstable"].isnan().all()


def test_an_arm_in_space_and_its_size():
    arm = ta.antagonistic_ring()
    found = ta.workspace(arm, hanging(arm, 1.0), states=3000, nodes=5)
    assert found.position.shape == (3000, 3)
    assert 5e-3 < found.size < 12e-3
    tips, codes, _ = brute_force(arm, hanging(arm, 1.0), random_places(arm, 3000), nodes=5)
    tips = tips[codes == 0]
    assert len(tips) > 500
    away = beyond(tips, found.region)
    assert np.quantile(away, 0.9) < 3e-3
    assert away.max() < 0.5 * found.resolution


def test_straight_arms_reach_a_line():
    found = ta.workspace(ta.ArmDesign([0.0], 0.3, ["bellows"]), states=200)
    assert found.size == 0
    assert not found.contains([0.0, -0.32]).item()
    assert found.reach > 0.3
    assert bool((found.position[:, 0].abs() < 1e-9).all())


class TestInterruptions:
    def test_a_callback_stops(self):
        told = []
        found = ta.workspace(
            spring_arm(), states=8000, nodes=2, callback=lambda *now: told.append(now) or len(told) == 2
        )
        assert found.stopped == "callback"
        assert [of for _, of in told] == [8000, 8000]
        assert len(found.code) == told[-1][0] < 8000

    def test_ctrl_c_leaves_what_is_known(self):
        def interrupt(done, _):
            raise KeyboardInterrupt

        found = ta.workspace(spring_arm(), states=3000, nodes=2, callback=interrupt)
        assert found.stopped == "interrupted"
        assert 0 < len(found.code) < 3000
        assert found.size > 0


def test_what_is_no_arm():
    with unchecked(), pytest.raises(ValueError, match="arm: must be an ArmDesign or an ArmSeries, got 1"):
        ta.workspace(1)


@pytest.mark.parametrize(
    ("arm", "options", "message"),
    [
        (ta.antagonistic_arm(torch.tensor([0.07, 0.08])), {}, r"arm: must be one design, .* got batch shape \(2,\)"),
        (ta.ArmDesign([0.0], 0.3, ["bellows"], max_pressure=0.0), {}, "arm: must have an actuator that is driven"),
        (spring_arm(), {"payload": -0.1}, "payload: must be at least 0 kg"),
        (spring_arm(), {"payload": [1.0, 2.0]}, r"payload: must have shape"),
        (spring_arm(), {"payload": torch.zeros(2, 3)}, r"payload: must be a mass \[kg\] or a wrench"),
        (spring_arm(), {"payload": 0.1, "gravity": False}, "payload: a mass has no weight with gravity=False"),
        (spring_arm(), {"payload": [0.0] * 6}, "load: must"),
        (spring_arm(), {"states": 10}, "states: must be an integer of at least 100, got 10"),
        (spring_arm(), {"resolution": 0.0}, "resolution: must be a finite number above 0"),
        (spring_arm(), {"seed": -1}, "seed: must be an integer of at least 0"),
        (spring_arm(), {"base_pose": "sideways"}, "base_pose: must be one of"),
    ],
)
def test_mistakes(arm, options, message):
    with pytest.raises(ValueError, match=message):
        ta.workspace(arm, **options)


@pytest.mark.parametrize(("stop", "rtol"), [(1200, 0.05), (3000, 0.0)])
def test_a_stopped_workspace_has_no_gaps_between_states_that_are_yet_to_come(stop, rtol):
    options = {"payload": 0.1, "states": 3000, "nodes": 4}
    arm = ta.antagonistic_arm()
    whole = ta.workspace(arm, **options)
    part = ta.workspace(arm, **options, callback=lambda done, _: done >= stop)
    assert part.stopped == "callback"
    assert part.interruption == f"interrupted: {len(part.code)} of 3000 states"
    assert part.size == pytest.approx(whole.size, rel=rtol, abs=0)
    assert whole.interruption == ""
