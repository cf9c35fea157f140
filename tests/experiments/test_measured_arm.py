"""Fits find what made-up states were made with, and are judged on states that they have not seen."""

from dataclasses import replace

import pytest
import torch

import torcharm as ta
from experiments.measured_arm.limits import limits
from experiments.measured_arm.module import END_LENGTH, LENGTH, Hypothesis, States, module, read_states, tips
from experiments.measured_arm.run import HYPOTHESES, compared, fitted

NOWHERE = torch.zeros(6, 3, dtype=torch.float64)


def made_up(how):
    """Six states of a module that is as a hypothesis says; two are pulled."""
    pairs = torch.tensor([[90.0, 0, 0], [0, 90, 0], [0, 0, 60], [80, 60, 0], [0, 70, 70], [30, 0, 0]])
    chambers = pairs.double().repeat_interleave(2, -1)
    wrench = torch.zeros(6, 6, dtype=torch.float64)
    wrench[1, 0], wrench[4, 2] = 0.3, -0.4
    pressure = torch.cat((chambers, torch.zeros(6, 1, dtype=torch.float64)), -1)
    states = States(("made up",) * 6, tuple(range(1, 7)), pressure, wrench, NOWHERE)
    return replace(states, tip=tips(how, states))


@pytest.mark.parametrize(
    ("field", "value"), [("young", 1.3), ("thinning", -0.8), ("twisting", 1.1), ("short_of_tip", 0.6)]
)
def test_a_fit_finds_what_states_were_made_with(field, value):
    states = made_up(replace(Hypothesis(), **{field: value}))
    ends = next(ends for name, ends, _ in HYPOTHESES.values() if name == field)
    found = fitted(states, field, ends, [0, 1, 2, 4], Hypothesis())
    assert found == pytest.approx(value, abs=0.02)


def test_every_state_is_judged_once_by_a_value_that_was_fitted_on_the_others():
    states = made_up(Hypothesis(young=1.2))
    spoilt = replace(states, tip=states.tip.clone())
    spoilt.tip[::2] = made_up(Hypothesis(young=0.8)).tip[::2]  # odd numbers are of a softer module
    name = "Young's modulus"
    rows = [row for row in compared(spoilt, {name: HYPOTHESES[name]}) if row.hypothesis == name]
    assert sorted(row.state for row in rows) == [1, 2, 3, 4, 5, 6]
    for row in rows:
        assert row.value == pytest.approx(1.2 if row.state % 2 else 0.8, abs=0.02)
        assert row.tip_error_mm > 1
        assert row.pulled == (row.state in (2, 5))


def test_short_of_the_tip_the_force_acts_at_the_body_s_end():
    states = made_up(Hypothesis())
    load = ta.ExternalLoad(gravity=True, points=[ta.PointLoad(states.wrench, at=1.0)])
    held = ta.solve_equilibrium(module(Hypothesis()), states.pressure, load, nodes=10)
    place = tips(Hypothesis(short_of_tip=1.0), states)
    torch.testing.assert_close(place, held.poses[:, -1, :3, 3], rtol=0, atol=1e-9)
    assert (place - tips(Hypothesis(), states))[1].norm() > 1e-3


def test_recordings_point_down_and_the_world_up(tmp_path):
    path = tmp_path / "states.csv"
    names = [f"pressure_{k}_kPa" for k in (1, 2, 3)] + [f"force_{c}_N" for c in "xyz"]
    names += [f"moment_{c}_Nm" for c in "xyz"] + [f"tip_{c}_m" for c in "xyz"]
    values = [10, -0.5, 20, 1, 2, 3, 4, 5, 6, 0.01, 0.02, 0.06]
    path.write_text(f"case,state,{','.join(names)}\nload1,7,{','.join(map(str, values))}\n")
    states = read_states(path)
    assert states.pressure.tolist() == [[10, 10, 0, 0, 20, 20, 0]]
    assert states.wrench.tolist() == [[1, -3, 2, 4, -6, 5]]
    assert states.tip.tolist() == [[0.01, -0.06, 0.02]]
    assert bool(states.pulled)


def test_without_pressure_and_load_it_hangs_straight_and_a_little_longer():
    states = made_up(Hypothesis())
    still = replace(states, pressure=0 * states.pressure, wrench=0 * states.wrench)
    place = tips(Hypothesis(), still)
    assert place[:, [0, 2]].abs().max() < 1e-9
    assert bool((-place[:, 1] > LENGTH + END_LENGTH).all())
    assert bool((-place[:, 1] < LENGTH + END_LENGTH + 5e-4).all())


def test_the_rod_comes_to_its_closed_forms_as_nodes_grow():
    found = list(limits())
    by_name = {name: {one.nodes: one.off for one in found if one.name == name} for name in {one.name for one in found}}
    assert len(by_name) == 5
    for off in by_name.values():
        assert off[40] < 2e-4
        assert off[10] < 1e-11 or off[40] < off[10] / 12  # second order: a sixteenth
