"""Chambers and elastic cores: a soft body against its closed forms."""

import math

import pytest
import torch

import torcharm as ta
from torcharm.actuators import model_name

AREA, STRETCH, BEND = 2e-5, 40.0, 1.2e-3  # m², EA [N], EI [N·m²]


def body(count=3, radius=0.008, length=0.05):
    offsets = torch.cat((ta.ring(radius, count), torch.zeros(1, 2, dtype=torch.float64)))
    return ta.ArmDesign(
        offsets=offsets, length=length, actuators=[ta.chamber(AREA)] * count + [ta.elastic_core(STRETCH, BEND)]
    )


def test_a_chamber_pushes_with_its_area_and_the_core_resists():
    strain, pressure = torch.tensor([-0.1, 0.3], dtype=torch.float64), torch.tensor([0.0, 70.0], dtype=torch.float64)
    assert torch.allclose(ta.chamber(AREA).force(strain, pressure), pressure * 1e3 * AREA)
    assert torch.allclose(ta.elastic_core(STRETCH, BEND).force(strain, pressure), -STRETCH * strain)


def test_models_have_names():
    """Of one's own: what its class or the object says, else the class; what a parent says is the parent's name."""

    class Own(ta.Bellows):
        pass

    class Named(ta.Bellows):
        name = "long bellows"

    names = [model_name(model) for model in (*body(1).actuators, ta.Bellows(), ta.McKibben(), Own(), Named())]
    assert names == ["chamber", "elastic core", "bellows", "mckibben", "Own", "long bellows"]
    assert repr(body()).startswith("ArmDesign(spatial, 3 chamber, 1 elastic core, ")
    figure = ta.plot.arm_shape(body(), ta.Task([[0.05, 0, 0, 0, 0, 0.1]] * 2, [0.0] * 6))
    labels = [text.get_text() for text in figure.get_legend().get_texts()]
    assert {"chamber (3)", "elastic core (1)"} <= set(labels)


def test_a_core_is_passive_and_chambers_are_not():
    assert body().max_pressure.tolist() == [100.0, 100.0, 100.0, 0.0]


def test_one_number_for_all_drives_the_chambers_alone():
    given = {"offsets": body().offsets, "length": 0.05, "actuators": body().actuators}
    assert ta.ArmDesign(**given, max_pressure=40.0).max_pressure.tolist() == [40.0, 40.0, 40.0, 0.0]
    assert bool(ta.solve_equilibrium(body(), 20.0, [0.0] * 6).in_range)


def test_a_body_stretches_and_bends_as_its_closed_form():
    """Without load: `EA ε = Σ p A`, and `EI κ/l = Σ p A r` of an arc."""
    arm, pressure = body(), torch.tensor([30.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    held = ta.solve_equilibrium(arm, pressure, torch.zeros(6, dtype=torch.float64), nodes=4)
    force = 30.0e3 * AREA
    length = 0.05 * (1 + force / STRETCH)
    assert torch.allclose(held.twists[:, 0], torch.full((4,), length, dtype=torch.float64), rtol=1e-9)
    bend = held.twists[:, 4:].norm(dim=-1)
    assert torch.allclose(bend, torch.full((4,), length * force * 0.008 / BEND, dtype=torch.float64), rtol=1e-8)


def test_results_are_differentiable_in_area_and_stiffness():
    area = torch.tensor(AREA, dtype=torch.float64, requires_grad=True)
    bend = torch.tensor(BEND, dtype=torch.float64, requires_grad=True)
    offsets = torch.tensor([[0.008, 0.0], [0.0, 0.0]], dtype=torch.float64)
    arm = ta.ArmDesign(offsets=offsets, length=0.05, actuators=[ta.chamber(area), ta.elastic_core(STRETCH, bend)])
    held = ta.solve_equilibrium(
        arm, torch.tensor([30.0, 0.0], dtype=torch.float64), torch.zeros(6, dtype=torch.float64)
    )
    turn = held.twists[0, 5]
    by_area, by_bend = torch.autograd.grad(turn, (area, bend))
    turn, force = float(turn.detach()), 30.0e3 * AREA
    assert math.isclose(by_bend, -turn / BEND, rel_tol=1e-8)
    assert math.isclose(by_area, turn / AREA * (1 + force / (STRETCH + force)), rel_tol=1e-8)


def test_searches_leave_the_core_alone():
    arm = body()
    task = ta.Task(ta.constant_curvature(0.5, 0.055, 6, direction=0.3), [0.0] * 6)
    found = ta.search_pressure(arm, task)
    assert bool(found.converged)
    assert float(found.pressure[3]) == 0.0
    assert float(ta.predict_error(arm, task).cost) == pytest.approx(float(found.cost), rel=1e-4, abs=1e-10)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: ta.chamber(-1.0), "area"),
        (lambda: ta.chamber(200.0), "area"),
        (lambda: ta.chamber(AREA, max_pressure=-1.0), "max_pressure"),
        (lambda: ta.elastic_core(0.0, BEND), "axial_stiffness"),
        (lambda: ta.elastic_core(STRETCH, math.nan), "bending_stiffness"),
    ],
)
def test_bad_input_names_the_field(call, field):
    with pytest.raises(ValueError, match=f"^{field}:"):
        call()
