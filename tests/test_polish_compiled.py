"""Polishing by machine code: against NumPy's answers, against scans of normals, and where it is not to be had."""

import math

import numpy as np
import pytest
import torch
from hull_cases import assert_slopes
from hypothesis import given, settings
from hypothesis import strategies as st

import torcharm as ta
from experiments.reference import converged_distance
from torcharm import _compiled, hulls
from torcharm._face_squares import Faces, _replayed, face_squares
from torcharm.actuators import PressureLaw
from torcharm.distance.compiled import compiled_faces, law_table
from torcharm.laws import section_laws

ARMS = {"antagonistic": ta.antagonistic_arm, "bellows": ta.bellows_arm, "McKibben": ta.mckibben_arm}
SHAPES = [(-3.0, 3.0), (1.0, 1.5), (6.0, -1.5)]
METRICS = ["absolute", "relative"]
MODELS = (ta.Bellows(), ta.McKibben(), ta.McKibben(force_scale=2.0), ta.Bellows(force_scale=0.5))


def affine(start, end, nodes=10):
    return ta.affine_curvature(start, end, length=0.5, nodes=nodes)


def both(arm, task, metric, **options):
    """What NumPy finds, and what machine code does."""
    found = [ta.evaluate(arm, task, (metric,), polish=True, compiled=one, **options) for one in (False, True)]
    return [(getattr(one, f"{metric}_per_node"), one.converged) for one in found]


def forces_of(sections, relative, count=4001):
    """Fractions (S, M, B) and forces there, kinks among them."""
    laws = section_laws(sections)
    laws = laws.minus_first(sections) if relative else laws
    grid, force = laws.samples(sections.radii, count, kinks=True)
    return grid.expand_as(force).numpy(), force.numpy()


def faces_of(sections, x, y, *, relative=False, signed=False, scale=(1.0, 1.0)):
    point = torch.as_tensor(x), torch.as_tensor(y)
    laws = law_table(sections)
    return compiled_faces(sections, laws, point, scale, relative=relative, signed=signed, fractions=True)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("name", ARMS)
def test_batches_are_numpys(name, signed, metric):
    rng = np.random.default_rng(1)
    arm = ARMS[name](torch.tensor(rng.uniform(0.03, 0.1, 4)), torch.tensor(rng.uniform(0.01, 0.03, 4)), 0.5)
    twists = torch.stack([affine(*shape) for shape in SHAPES])
    for loads in (ta.sample_loads(3), ta.sample_loads(12).view(4, 3, 3)):  # one or more loads on a shape
        for options in ({}, {"weights": (4.0, 0.3)}):
            (value, _), (own, converged) = both(arm, ta.Task(twists, loads), metric, signed=signed, **options)
            assert converged.all()
            torch.testing.assert_close(own, value, rtol=1e-11, atol=1e-8)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    kinds=st.lists(st.integers(0, 3), min_size=1, max_size=6),
    nodes=st.integers(1, 6),
    bend=st.sampled_from([0.0, 1.0, 3.0, 8.0]),
    limits=st.sampled_from([(1.0,), (1.0, 0.5), (1.0, 0.0)]),
    alike=st.booleans(),
    signed=st.booleans(),
    metric=st.sampled_from(METRICS),
)
def test_any_scene_is_right(seed, kinds, nodes, bend, limits, alike, signed, metric):
    """Also arms of one actuator, of identical ones, of muscles neither stretched nor contracted, without pressure."""
    rng = np.random.default_rng(seed)
    models = tuple(MODELS[kind] for kind in kinds)
    radii = np.full(len(kinds), 0.03) if alike else rng.uniform(-0.1, 0.1, len(kinds))
    arm = ta.ArmDesign(radii, 0.5, models, [model.max_pressure * rng.choice(limits) for model in models])
    twists, loads = affine(*rng.uniform(-bend, bend, 2), nodes=nodes), torch.tensor(rng.normal(0, (5, 5, 0.5), (3, 3)))
    (value, numpys), (own, converged) = both(arm, ta.Task(twists, loads), metric, signed=signed)
    close = np.isclose(own.numpy(), value.numpy(), rtol=1e-10, atol=1e-8)
    for load in (~close).any(-1).nonzero()[0]:  # one of both is wrong
        wanted = converged_distance(arm, twists, loads[load], relative=metric == "relative", signed=signed)
        np.testing.assert_allclose(own[load].numpy(), wanted, rtol=1e-10, atol=1e-8)
    assert (converged | ~numpys).all()


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("name", ARMS)
def test_points_of_the_boundary_touch_it_and_points_beside_it_are_as_far(name, relative):
    """At its corners and between: points that lines touch, as seen in fine samples."""
    sections = hulls.cross_sections(ARMS[name]().flatten(), affine(6.0, -1.5, 5)[None])
    grid, force = forces_of(sections, relative)
    bending = sections.bending.numpy()
    if relative:
        bending = bending - sections.at_first_node(sections.bending).numpy()
    radii = sections.radii.numpy()
    compared = 0
    for angle in np.linspace(0.05, 6.2, 16):
        nx, ny = np.cos(angle), np.sin(angle)
        reach = (nx - ny * radii) * force + ny * bending * grid
        best = reach.argmax(0)[None]
        u, pull = np.take_along_axis(grid, best, 0)[0], np.take_along_axis(force, best, 0)[0]
        inward = np.where(u == 0, [reach[0], reach[1], reach[2]], [reach[-1], reach[-2], reach[-3]])
        steep = inward[0] - inward[1] > 0.5 * (inward[1] - inward[2])  # there is no maximum between the samples
        at_end = (((u == 0) | (u == 1)) & steep).all(0)
        x, y = pull.sum(0), (bending * u - radii * pull).sum(0)
        for away in (0.0, 1e-3, 2.0):
            found = faces_of(sections, (x + away * nx)[:, None], (y + away * ny)[:, None], relative=relative)
            distance = np.sqrt(found.faces.square.numpy())[:, 0] * ~found.faces.inside.numpy()[:, 0]
            assert found.converged.all()
            assert (np.abs(distance - away)[at_end] < 1e-9 * (1 + np.abs(x) + np.abs(y))[at_end]).all()
            assert (np.abs(distance - away) < 1e-4).all()
            compared += int(at_end.sum())
    assert compared > 20


def test_sets_without_area_have_no_inside():
    """Of one straight actuator, of unpressed ones, and of node 1 against itself."""
    line = ta.PolynomialActuator(((0, 0, 1.0), (1, 1, 3.0), (0, 1, 0.4)), (-1.0, 1.0), (0.0, 50.0), 50.0)
    arm = ta.ArmDesign([0.03], 0.5, (line,))
    loads = torch.tensor([[1.0, 2.0, 0.1], [0.0, 0.0, 0.0]], dtype=torch.float64)
    task = ta.Task(affine(0.0, 0.0, 3), loads)
    for metric in METRICS:
        (value, _), (own, converged) = both(arm, task, metric, signed=True)
        assert converged.all()
        assert (own >= 0).all()
        torch.testing.assert_close(own, value, rtol=0, atol=1e-12)
    idle = ta.ArmDesign([-0.05, 0.05], 0.5, [ta.Bellows(), ta.McKibben()], [0.0])
    (value, _), (own, converged) = both(idle, ta.Task(affine(1.0, 2.0), loads), "absolute", signed=True)
    assert converged.all()
    torch.testing.assert_close(own, value, rtol=0, atol=1e-11)
    _, (own, _) = both(ta.antagonistic_arm(), ta.Task(affine(1.0, 2.0), loads), "relative", signed=True)
    assert (own[..., 0] == 0).all()


def test_powers_that_hardly_bend_have_their_maxima_too():
    """A muscle barely stretched, against one stretched barely less: exponents are 1 and a hundred thousandth."""
    arm = ta.ArmDesign([-0.05, 0.02], 0.5, [ta.McKibben()] * 2)
    twists = affine(0.0, 0.0, 6)
    twists[:, 0] = 0.5 * (1 + torch.tensor([1e-5, 2e-5, 1e-4, 1e-3, 1e-6, 1e-5], dtype=torch.float64))
    for load in torch.tensor(np.random.default_rng(0).normal(0, (1e-3, 1e-3, 1e-4), (8, 3))):
        _, (own, converged) = both(arm, ta.Task(twists, load), "relative", signed=True)
        assert converged.all()
        wanted = converged_distance(arm, twists, load, relative=True, signed=True)
        np.testing.assert_allclose(own.numpy(), wanted, rtol=0, atol=1e-10)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("name", ARMS)
def test_gradients_are_those_of_differences(name, signed, metric):
    twists, loads = torch.stack([affine(*shape, nodes=4) for shape in SHAPES]), ta.sample_loads(3)
    design = ARMS[name]()

    def total(scale):
        """Of radii, lengths, limits, shapes and loads that are scaled, and a base that moves."""
        arm = ta.ArmDesign(
            design.radii * scale[0], design.length * scale[1], design.actuators, design.max_pressure * scale[2]
        )
        task = ta.Task(twists * scale[3], loads * scale[4], torch.stack((scale[4], scale[3], scale[4] - 2.5)))
        found = ta.evaluate(arm, task, (metric,), polish=True, compiled=True, signed=signed)
        assert found.converged.all()
        value = getattr(found, f"{metric}_per_node")
        return (value * torch.linspace(0.3, 1.0, value.numel(), dtype=value.dtype).view_as(value)).sum()

    at = torch.tensor([1.01, 1.002, 0.97, 1.003, 1.1], dtype=torch.float64, requires_grad=True)
    assert_slopes(total, at)


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("name", ARMS)
def test_slopes_in_closed_form_are_autograds(name, relative):
    """Of the same faces, every input by itself; kinks are followed."""
    arm, kinks = ARMS[name](0.06, 0.02), 0
    for shape in SHAPES:
        sections = hulls.cross_sections(arm.flatten(), affine(*shape)[None])
        leaves = [
            value.clone().requires_grad_()
            for value in (sections.strain, sections.bending, sections.radii, sections.limit)
        ]
        own = hulls.Sections(sections.actuators, sections.shape, *leaves)
        x, y = (torch.tensor(np.random.default_rng(0).normal(0, 300, (10, 7))).requires_grad_() for _ in range(2))
        found = faces_of(own, x, y, relative=relative)
        faces = Faces(found.fraction, found.kinked, (1.0, 1.0), relative)
        kinks += 0 if found.kinked is None else int(found.kinked.sum())
        value, wanted = face_squares(own, (x, y), faces), _replayed(own, (x, y), faces, None)
        torch.testing.assert_close(value, wanted, rtol=1e-9, atol=1e-6)
        first, again = (torch.autograd.grad(one.sum(), (*leaves, x, y)) for one in (value, wanted))
        for mine, theirs in zip(first, again, strict=True):
            torch.testing.assert_close(mine, theirs, rtol=1e-6, atol=1e-7 * float(theirs.abs().max()) + 1e-12)
        weight = torch.linspace(0.5, 1.0, 10, dtype=torch.float64)
        second = []
        for one in (face_squares(own, (x, y), faces), _replayed(own, (x, y), faces, None)):
            (slope,) = torch.autograd.grad(one.sum(), own.strain, create_graph=True)
            second.append(torch.autograd.grad((slope * weight).sum(), own.radii)[0])
        torch.testing.assert_close(second[0], second[1])
    assert kinks > 0 or relative or name == "bellows"


def test_blocks_are_the_whole_and_replays_are_graphs():
    arm = ta.antagonistic_arm(torch.linspace(0.05, 0.09, 5, dtype=torch.float64))
    found = []
    for size in (None, 2):
        radii, loads = arm.radii.clone().requires_grad_(), ta.sample_loads(3).requires_grad_()
        design = ta.ArmDesign(radii, 0.5, arm.actuators)
        task = ta.Task(torch.stack([affine(*shape) for shape in SHAPES]), loads)
        value = ta.evaluate(design, task, polish=True, compiled=True, chunk_size=size)
        slopes = torch.autograd.grad((value.absolute + 0.5 * value.relative).sum(), (radii, loads))
        found.append((value.absolute, value.relative, *slopes))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-9)


def test_what_machine_code_does_not_know_is_answered_all_the_same(monkeypatch):
    arm, twists, loads = ta.antagonistic_arm(), affine(1.0, 1.5), ta.sample_loads(3)
    asked = []

    def counting(*arguments, **options):
        asked.append(arguments)
        return compiled_faces(*arguments, **options)

    monkeypatch.setattr("torcharm.distance.compiled.compiled_faces", counting)

    def agree(arm, task, times, **options):
        asked.clear()
        (value, _), (own, _) = both(arm, task, "absolute", **options)
        assert len(asked) == times
        torch.testing.assert_close(own, value, rtol=0, atol=1e-8)

    agree(arm, ta.Task(twists, loads), 1)
    agree(arm, ta.Task(twists, loads), 0, residuals=True)
    single = ta.ArmDesign(arm.radii.float(), 0.5, arm.actuators)
    agree(single, ta.Task(twists.float(), loads.float()), 0)

    class Lawless(ta.Bellows):
        pressure_law = None

    Lawless.pressure_law = lambda self, strain: None
    agree(ta.ArmDesign(arm.radii, 0.5, [Lawless()] * 4), ta.Task(twists, loads), 0)

    class Bent(ta.Bellows):
        """A law of a cubic and a power."""

        def pressure_law(self, strain):
            law = super().pressure_law(strain)
            return PressureLaw(law.coefficients, gain=0 * strain, exponent=2 + 0 * strain)

    agree(ta.ArmDesign(arm.radii, 0.5, [Bent()] * 4), ta.Task(twists, loads), 0)
    short = ta.Task(affine(7.5, 7.5), loads)  # muscles so short that their law ends below this limit
    agree(ta.ArmDesign([0.02, 0.015], 0.5, [ta.McKibben()] * 2, [300.0]), short, 0)
    asked.clear()
    for options in ({}, {"hull": "edges"}, {"distance": "scipy"}):  # nothing to polish
        assert not ta.evaluate(arm, ta.Task(twists, loads), compiled=True, **options).absolute.isnan().any()
    assert not asked


def test_what_wants_a_gradient_inside_a_force_model_gets_it():
    class Soft(ta.PolynomialActuator):
        def force(self, strain, pressure):
            return super().force(strain, pressure) * factor

        def pressure_law(self, strain):
            return PressureLaw(tuple(factor * one for one in super().pressure_law(strain).coefficients))

    model = Soft(ta.Bellows().coefficients, (-0.5, 0.7), (0.0, 92.0), 50.0)
    found = []
    for compiled in (False, True):
        factor = torch.tensor(0.9, dtype=torch.float64, requires_grad=True)
        arm = ta.ArmDesign([-0.08, 0.08], 0.5, [model] * 2)
        value = ta.evaluate(arm, ta.Task(affine(1.0, 2.0), ta.sample_loads(2)), polish=True, compiled=compiled)
        found.append(torch.autograd.grad(value.absolute.sum(), factor)[0])
    torch.testing.assert_close(*found)


def test_where_machine_code_fails_numpy_answers(monkeypatch):
    arm, task = ta.antagonistic_arm(), ta.Task(affine(1.0, 1.5), ta.sample_loads(3))
    wanted = ta.evaluate(arm, task, polish=True)

    def failing(*arguments, **options):
        found = compiled_faces(*arguments, **options)
        found.faces.square[4], found.converged[4] = 7.0, False
        return found

    monkeypatch.setattr("torcharm.distance.compiled.compiled_faces", failing)
    found = ta.evaluate(arm, task, polish=True, compiled=True)
    assert found.converged.all()
    torch.testing.assert_close(found.absolute_per_node, wanted.absolute_per_node, rtol=0, atol=0)


def test_a_bending_moment_that_no_pressure_changes_is_taken_along():
    bend = ta.ConstantBending(-0.3)
    models = [ta.Bellows(bending_stiffness=bend), ta.McKibben(), ta.McKibben(), ta.Bellows(bending_stiffness=bend)]
    twists, loads, found = affine(-3.0, 3.0), ta.sample_loads(4), []
    for compiled in (False, True):
        radii = ta.antagonistic_arm().radii.clone().requires_grad_()
        task = ta.Task(twists, loads)
        value = ta.evaluate(ta.ArmDesign(radii, 0.5, models), task, polish=True, compiled=compiled)
        total = value.absolute.sum() + value.relative.sum()
        found.append((total.detach(), torch.autograd.grad(total, radii)[0]))
    torch.testing.assert_close(found[0][0], found[1][0], rtol=0, atol=1e-8)
    torch.testing.assert_close(found[0][1], found[1][1], rtol=1e-6, atol=1e-5)


def test_the_kernel_is_compiled_once():
    from torcharm.distance.kernel import nearest

    for arm in (ta.bellows_arm(), ta.antagonistic_arm(torch.linspace(0.05, 0.09, 3, dtype=torch.float64))):
        for nodes in (1, 4):
            for loads in (ta.sample_loads(1)[0], ta.sample_loads(4)):
                for signed in (False, True):
                    task = ta.Task(affine(1.0, 2.0, nodes), loads)
                    ta.evaluate(arm, task, polish=True, compiled=True, signed=signed)
    assert len(nearest.signatures) == 1


def test_without_numba_there_is_no_machine_code(monkeypatch):
    task = ta.Task(affine(1.0, 1.0), torch.zeros(3, dtype=torch.float64))
    monkeypatch.setattr(_compiled, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"^compiled: must be False without numba, which torcharm\[compiled\] brings"):
        ta.evaluate(ta.bellows_arm(), task, polish=True, compiled=True)
    assert math.isfinite(ta.evaluate(ta.bellows_arm(), task, polish=True).absolute.item())


class Both(ta.Bellows):
    """A bellows of one's own, whose slopes are not written out anew."""

    def force(self, strain, pressure):
        return 1.3 * super().force(strain, pressure)

    def pressure_law(self, strain):
        return PressureLaw(tuple(1.3 * part for part in super().pressure_law(strain).coefficients))


def test_slopes_that_are_not_those_of_the_law_are_not_taken():
    radii = torch.tensor([-0.05, 0.05], dtype=torch.float64, requires_grad=True)
    task = ta.Task(ta.affine_curvature(1.0, 1.5, length=0.5, nodes=5), ta.sample_loads(2))
    slopes = []
    for compiled in (False, True):
        found = ta.evaluate(ta.ArmDesign(radii, 0.5, [Both()] * 2), task, polish=True, compiled=compiled)
        assert found.converged.all()
        slopes.append(torch.autograd.grad(found.absolute.sum() + found.relative.sum(), radii)[0])
    torch.testing.assert_close(slopes[1], slopes[0], rtol=1e-5, atol=1e-5)
