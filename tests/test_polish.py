"""Polished distances against converged ones that are found without polygons, and against certificates."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hull_cases import assert_slopes

import torcharm as ta
from experiments.reference import converged_distance
from torcharm import hulls
from torcharm.actuators import pressure_law
from torcharm.distance.outside import nearest_outside
from torcharm.distance.shapes import Cubics
from torcharm.distance.touch import curve_sums
from torcharm.laws import section_laws
from torcharm.pieces import fit_pieces

ARMS = {"antagonistic": ta.antagonistic_arm, "bellows": ta.bellows_arm, "McKibben": ta.mckibben_arm}
SHAPES = [(-3.0, 3.0), (1.0, 1.5), (6.0, -1.5)]


def affine(start, end, nodes=10):
    return ta.affine_curvature(start, end, length=0.5, nodes=nodes)


def polished(arm, twists, loads, *, relative, signed=False, compiled=False):
    metric = "relative" if relative else "absolute"
    task = ta.Task(twists, loads)
    found = ta.evaluate(arm, task, (metric,), samples=3, polish=True, compiled=compiled, signed=signed)
    return getattr(found, f"{metric}_per_node"), found.converged


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("signed", [False, True])
def test_paper_scenes_are_exact(name, shape, relative, signed, compiled):
    arm, twists, load = ARMS[name](), affine(*shape), ta.sample_loads(4)[3]
    value, converged = polished(arm, twists, load, relative=relative, signed=signed, compiled=compiled)
    wanted = converged_distance(arm, twists, load, relative=relative, signed=signed)
    assert converged.all()
    np.testing.assert_allclose(value.numpy(), wanted, rtol=0, atol=1e-8)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("relative", [False, True])
def test_random_designs_within_the_characterised_range_are_exact_or_flagged(seed, relative, compiled):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 7))
    models = tuple(ta.Bellows() if rng.random() < 0.5 else ta.McKibben() for _ in range(count))
    arm = ta.ArmDesign(torch.tensor(rng.uniform(-0.03, 0.03, count)), 0.5, models)
    twists = affine(*rng.uniform(-1.2, 1.2, 2), nodes=5)
    load = torch.tensor(rng.normal(0, (5, 5, 0.5)))
    value, converged = polished(arm, twists, load, relative=relative, compiled=compiled)
    wanted = converged_distance(arm, twists, load, relative=relative)
    assert converged.all()
    np.testing.assert_allclose(value.numpy(), wanted, rtol=0, atol=1e-8)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("signed", [False, True])
def test_a_muscle_of_its_neutral_length_pulls_in_a_straight_line(signed, compiled):
    # Unstrained, a muscle's power of pressure is a line; node 1's, extended, is not, and the difference bends by it.
    arm = ta.ArmDesign([0.0, 0.05], 0.5, [ta.McKibben()] * 2)
    twists, load = affine(3.0, -3.0), ta.sample_loads(4)[3]
    twists[:, 0] = torch.tensor([0.53, 0.5, 0.51, 0.5, 0.5, 0.49, 0.5, 0.52, 0.5, 0.5])
    value, converged = polished(arm, twists, load, relative=True, signed=signed, compiled=compiled)
    assert converged.all()
    wanted = converged_distance(arm, twists, load, relative=True, signed=signed)
    np.testing.assert_allclose(value.numpy(), wanted, rtol=0, atol=1e-8)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_what_is_not_a_number_does_not_converge(metric, compiled):
    @dataclass(frozen=True)
    class Broken(ta.PolynomialActuator):
        """Without a force where it is squeezed."""

        def pressure_law(self, strain):
            law = super().pressure_law(strain)
            return replace(law, coefficients=tuple(c + 0 * (strain + 0.01).sqrt() for c in law.coefficients))

    model = Broken(((1, 0, -40.0), (0, 1, 0.8), (0, 2, -0.002)), (-0.5, 0.5), (0.0, 60.0), 60.0)
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [model] * 2)
    loads, straight = ta.sample_loads(3), affine(0.0, 0.0, nodes=3)
    for twists, right in ((straight, True), (affine(0.0, 8.0, nodes=3), False)):
        found = ta.evaluate(arm, ta.Task(twists, loads), (metric,), samples=3, polish=True, compiled=compiled)
        assert (found.converged == right).all()
        assert getattr(found, metric).isfinite().all() == right
    x = np.array([[np.nan]])
    sections = hulls.cross_sections(ta.bellows_arm().flatten(), affine(1.0, 1.0, nodes=1)[None])
    sums, _ = curve_sums(section_laws(sections), sections, (1.0, 1.0), relative=False)
    assert not nearest_outside(sums, x, x, fractions=False).converged


@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_a_block_whose_search_from_outside_fails_is_searched_for_from_its_polygons(monkeypatch, metric):
    arm, task = ta.antagonistic_arm(), ta.Task(affine(1.0, 1.5), ta.sample_loads(3))
    wanted = ta.evaluate(arm, task, (metric,), polish=True)
    answered = []

    def failing(*arguments, **options):
        found = nearest_outside(*arguments, **options)
        found.square[4], found.converged[4] = 0.0, False
        answered.append(found)
        return found

    monkeypatch.setattr("torcharm.distance.outside.nearest_outside", failing)
    again = ta.evaluate(arm, task, (metric,), polish=True)
    assert len(answered) == 1
    assert again.converged.all()
    value, other = getattr(again, f"{metric}_per_node"), getattr(wanted, f"{metric}_per_node")
    assert float(other[:, 4].max()) > 0.1
    torch.testing.assert_close(value, other, rtol=0, atol=1e-9)


def test_no_search_leaves_a_trace_in_the_curves():
    arm = ta.ArmDesign([0.03, 0.06, 0.05], 0.5, [ta.McKibben()] * 3)
    sections = hulls.cross_sections(arm.flatten(), affine(6.0, -6.0)[None])
    sums, _ = curve_sums(section_laws(sections).minus_first(sections), sections, (1.0, 1.0), relative=True)
    (kept,) = (group.twins.latest for group, _ in sums.groups)
    for angle in np.linspace(0, 6, 20):  # one point a set: its curves are not copied
        x, y = (np.full((10, 1), 1e3 * part) for part in (np.cos(angle), np.sin(angle)))
        nearest_outside(sums, x, y, fractions=False)
        assert (kept == 1).all()


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("relative", [False, True])
def test_polishing_never_lengthens_a_distance_and_is_near_it(relative, compiled):
    arm = ta.antagonistic_arm(torch.linspace(0.04, 0.09, 20, dtype=torch.float64), 0.015, 0.5)
    loads = ta.sample_loads(10)
    value, _ = polished(arm, affine(-3.0, 3.0), loads, relative=relative, compiled=compiled)
    metric = "relative" if relative else "absolute"
    task = ta.Task(affine(-3.0, 3.0), loads)
    sampled = getattr(ta.evaluate(arm, task, (metric,), samples=33), f"{metric}_per_node")
    assert (value <= sampled + 1e-9).all()
    assert (sampled - value).max() < 0.02


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_gradients_are_those_of_the_exact_sets(name, metric, compiled):
    twists, loads = affine(-3.0, 3.0), ta.sample_loads(3)

    def total(scale):
        arm = ARMS[name]()
        arm = ta.ArmDesign(arm.radii * scale[0], arm.length * scale[1], arm.actuators)
        found = ta.evaluate(arm, ta.Task(twists, loads), (metric,), samples=3, polish=True, compiled=compiled)
        return getattr(found, metric).sum()

    at = torch.tensor([1.01, 1.002], dtype=torch.float64, requires_grad=True)
    assert_slopes(total, at)


def test_pieces_of_cubic_forces_are_the_forces():
    arm = ta.bellows_arm()
    sections = hulls.cross_sections(arm.flatten(), affine(6.0, -1.5)[None])
    pieces = fit_pieces(sections, torch.arange(10), relative=True)
    assert len(pieces.start) == 1
    assert not pieces.rough.any()
    fraction = torch.tensor([0.0, 0.3, 1.0], dtype=torch.float64).view(3, 1, 1)
    wanted = hulls.relative_curves(
        sections,
        hulls.Curves(
            fraction,
            arm.actuators[0].force(sections.strain, fraction * sections.limit),
            sections.bending,
            sections.radii,
        ),
    ).force
    c0, c1, c2, c3 = pieces.coefficients[:, 0]
    torch.testing.assert_close(((c3 * fraction + c2) * fraction + c1) * fraction + c0, wanted, rtol=0, atol=1e-11)


@pytest.mark.parametrize("compiled", [False, True])
def test_a_model_that_says_nothing_of_itself_is_polished_too(compiled):
    class Saturating:
        max_pressure, bending_stiffness = 50.0, -0.28
        strain_range, pressure_range = (-1.0, 1.0), (0.0, 50.0)

        def force(self, strain, pressure):
            return 40 * torch.tanh(pressure / 25) * (1 - 0.5 * strain) - 20 * strain

    arm = ta.ArmDesign(torch.tensor([0.06, -0.05, 0.02], dtype=torch.float64), 0.5, (Saturating(),) * 3)
    twists, load = affine(-2.0, 2.5), torch.tensor([4.0, -6.0, 0.4], dtype=torch.float64)
    for relative in (False, True):
        value, converged = polished(arm, twists, load, relative=relative, compiled=compiled)
        assert converged.all()
        np.testing.assert_allclose(
            value.numpy(), converged_distance(arm, twists, load, relative=relative), rtol=0, atol=1e-8
        )


def test_polish_is_refused_where_it_means_nothing():
    task = ta.Task(affine(1.0, 1.0), torch.zeros(3, dtype=torch.float64))
    for settings in ({"hull": "edges"}, {"distance": "scipy"}):
        with pytest.raises(ValueError, match=r"^polish: "):
            ta.evaluate(ta.bellows_arm(), task, **{"polish": True, **settings})


LAWFUL = {
    "bellows": ta.Bellows(),
    "McKibben": ta.McKibben(),
    "two McKibbens": ta.McKibben(force_scale=2.0),
    "line": ta.PolynomialActuator(((0, 0, 1.0), (1, 1, 3.0)), (-1.0, 1.0), (0.0, 50.0), 50.0),
    "constant": ta.PolynomialActuator(((0, 0, 1.0),), (-1.0, 1.0), (0.0, 50.0), 50.0),
}


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("name", LAWFUL)
def test_laws_are_the_forces(name, relative):
    arm = ta.ArmDesign(torch.tensor([-0.08, -0.02, 0.03, 0.06], dtype=torch.float64), 0.5, (LAWFUL[name],) * 4)
    sections = hulls.cross_sections(arm.flatten(), affine(3.0, -2.0)[None])
    laws = section_laws(sections)
    laws = laws.minus_first(sections) if relative else laws
    u = torch.tensor([0.0, 0.03, 0.4, 0.93, 1.0], dtype=torch.float64).view(-1, 1, 1)
    force = LAWFUL[name].force(sections.strain, u * sections.limit)
    if relative:
        force = force - LAWFUL[name].force(sections.at_first_node(sections.strain), u * sections.limit)
    (law,) = laws.groups
    np.testing.assert_allclose(law.force(u.numpy()), force.numpy(), rtol=0, atol=1e-11)


@pytest.mark.parametrize("shape", [*SHAPES, (4.0, 0.0)])
@pytest.mark.parametrize("relative", [False, True])
def test_sets_are_touched_where_a_fine_scan_of_pressures_finds_them(shape, relative):
    """And as the normal turns a little, by the radius of curvature the place moves; by symmetric differences."""
    arm = ta.ArmDesign([-0.08, -0.02, 0.03, 0.06, 0.05], 0.5, [*[ta.Bellows()] * 2, *[ta.McKibben()] * 3])
    sections = hulls.cross_sections(arm.flatten(), affine(*shape)[None])
    laws = section_laws(sections)
    laws = laws.minus_first(sections) if relative else laws
    bending = sections.bending - sections.at_first_node(sections.bending) if relative else sections.bending
    sums, holds = curve_sums(laws, sections, (1.0, 2.0), relative=relative)
    assert holds.all()
    grid, force = laws.samples(sections.radii, 20_001, kinks=False)
    moment = bending * grid - sections.radii * force
    compared = 0
    for angle in np.linspace(0.1, 6.2, 12):
        turned = angle + np.array([0.0, -1e-6, 1e-6])
        with np.errstate(all="ignore"):
            first, before, after = (sums.touch(np.full(10, np.cos(a)), np.full(10, np.sin(a))) for a in turned)
        nx, ny = np.cos(angle), np.sin(angle)
        reach = nx * first.x + ny * first.y
        rest = np.zeros_like(reach) if first.rest is None else first.rest
        reaches = (nx * force + 2 * ny * moment).numpy()
        scanned, between = reaches.max(0).sum(0), np.abs(np.diff(reaches, axis=0)).max(0).sum(0)
        assert (rest < 1e-5).all()
        assert (reach + 2 * rest >= scanned - 1e-10).all()
        assert (reach <= scanned + between).all()
        moved = nx * (after.y - before.y) - ny * (after.x - before.x)
        smooth = np.abs(after.u - before.u).max(0) < 1e-3
        smooth &= (np.abs(after.radius - before.radius) < 1e-3 * first.radius) | (first.radius == 0)
        np.testing.assert_allclose(moved[smooth] / 2e-6, first.radius[smooth], rtol=1e-3, atol=1e-6)
        compared += int((smooth & (first.radius > 0)).sum())
    assert compared > 10 or not relative


def longest_face(force):
    """The ends of the longest face of the lower hull of evenly spaced values."""
    hull = [0]
    for i in range(1, len(force)):
        while len(hull) > 1 and (force[hull[-1]] - force[hull[-2]]) * (i - hull[-1]) >= (force[i] - force[hull[-1]]) * (
            hull[-1] - hull[-2]
        ):
            hull.pop()
        hull.append(i)
    longest = int(np.diff(hull).argmax())
    return hull[longest], hull[longest + 1]


@pytest.mark.parametrize("compiled", [False, True])
def test_straight_faces_between_two_moving_maxima_of_one_curve(compiled):
    """A contracted muscle against one in extension: between arcs, on either side of a kink, the hull is straight."""
    arm, twists = ta.ArmDesign([-0.04, 0.03], 0.5, [ta.McKibben(), ta.McKibben()]), affine(6.0, -1.0, nodes=8)
    sections = hulls.cross_sections(arm.flatten(), twists[None])
    (law,) = section_laws(sections).minus_first(sections).groups
    force = law.force(np.linspace(0, 1, 1001).reshape(-1, 1, 1))
    mixed = (law.slopes != 0).any(0) & (law.gain != 0).any(0)
    ends = [
        longest_face((force[:, row, node] * np.sign(law.gain.sum(0)[row, node])).tolist())
        for row, node in np.argwhere(mixed)
    ]
    assert sum(0 < first < last - 100 and last < 1000 for first, last in ends) >= 3
    for seed in range(30):
        load = torch.tensor(np.random.default_rng(seed).normal(0, (6, 6, 0.3)))
        value, converged = polished(arm, twists, load, relative=True, compiled=compiled)
        assert converged.all()
        wanted = converged_distance(arm, twists, load, relative=True)
        np.testing.assert_allclose(value.numpy(), wanted, rtol=0, atol=1e-8)


def test_lines_from_an_end_touch_a_winding_cubic_where_the_steepest_chord_does():
    rng = np.random.default_rng(0)
    rate, bend, twist = rng.normal(size=(3, 400))
    end = rng.integers(0, 2, 400).astype(float)
    u = np.linspace(1e-4, 1 - 1e-4, 20001)[:, None]
    chord = rate + bend * (u + end) + twist * (u * u + u * end + end * end)  # (f(u) - f(end)) / (u - end)
    extreme = np.where(twist > 0, chord.argmin(0), chord.argmax(0))
    inner = (extreme > 0) & (extreme < len(u) - 1)
    ends = np.stack((end, np.where(end == 0, 1 - 1e-4, 1e-4)))[:, None]
    slope, there = Cubics(bend[None], twist[None], True).tangent(rate[None], *ends)
    assert 0.1 < inner.mean() < 0.9
    np.testing.assert_array_equal(there[0], inner)
    best = chord[extreme, np.arange(400)]
    np.testing.assert_allclose(slope[0][inner], best[inner], rtol=0, atol=1e-7)


def test_a_law_ends_where_the_model_jumps():
    strain = torch.tensor([-0.3, -0.2, 0.1], dtype=torch.float64)
    until = pressure_law(ta.McKibben(), strain).until
    assert until[0] == ta.McKibben().pressure_knots(strain)[1, 0] > 100
    assert (until[1:] > 1e9).all()


def test_a_model_without_a_law_agrees_with_one_that_has_it():
    class Lawless(ta.Bellows):
        pressure_law = None

    Lawless.pressure_law = lambda self, strain: None
    twists, loads = affine(6.0, -1.5), ta.sample_loads(5)
    for metric in ("absolute", "relative"):
        values = [
            ta.evaluate(
                ta.ArmDesign(ta.bellows_arm().radii, 0.5, (model,) * 4), ta.Task(twists, loads), (metric,), polish=True
            )
            for model in (ta.Bellows(), Lawless())
        ]
        both = values[0].converged & values[1].converged
        assert both.sum() >= 3
        torch.testing.assert_close(*(getattr(one, metric)[both] for one in values), rtol=0, atol=1e-8)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("relative", [False, True])
def test_beyond_the_characterised_range_answers_are_right_or_flagged(relative, signed, compiled):
    """Differences of two powers of pressure have maxima that samples do not show; forces are thousands of newtons."""
    right = 0
    for seed in range(8):
        rng = np.random.default_rng(100 + seed)
        arm = ta.antagonistic_arm(*rng.uniform((0.04, 0.01, 0.45), (0.09, 0.03, 0.55)))
        twists, load = affine(*rng.uniform(-6, 6, 2), nodes=5), ta.sample_loads(4)[3]
        value, converged = polished(arm, twists, load, relative=relative, signed=signed, compiled=compiled)
        if converged:
            wanted = converged_distance(arm, twists, load, relative=relative, signed=signed)
            np.testing.assert_allclose(value.numpy(), wanted, rtol=1e-9, atol=1e-8)
            right += 1
    assert right >= 6
