"""The small polygons that polishing starts from: in the sets, in order, and nearest where the general ones say."""

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm import hulls
from torcharm.distance.closed_form import nearest_faces
from torcharm.distance.outside import _nearest, _polygons
from torcharm.distance.rings import rings
from torcharm.distance.touch import curve_sums
from torcharm.laws import section_laws
from torcharm.polygon import Polygons, minkowski_sum

SCALE = (1.0, 2.0)
ARMS = {
    "bellows": [ta.Bellows()] * 3,
    "muscles": [ta.McKibben()] * 4,
    "both": [ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows()],
    "lines": [ta.PolynomialActuator(((0, 0, 1.0), (1, 1, 3.0)), (-1.0, 1.0), (0.0, 50.0), 50.0)] * 2,
}


def sections_of(name, shape, nodes=12):
    models = ARMS[name]
    arm = ta.ArmDesign(torch.linspace(-0.07, 0.05, len(models), dtype=torch.float64), 0.5, models)
    return hulls.cross_sections(arm.flatten(), ta.affine_curvature(*shape, length=0.5, nodes=nodes)[None])


def case(name, shape, relative):
    sections = sections_of(name, shape)
    laws = section_laws(sections)
    laws = laws.minus_first(sections) if relative else laws
    return sections, laws, curve_sums(laws, sections, SCALE, relative=relative)[0]


CASES = [
    (name, shape, relative)
    for name in ARMS
    for shape in [(-3.0, 3.0), (6.0, -1.5), (5.0, 5.0)]
    for relative in (False, True)
]


@pytest.mark.parametrize(("name", "shape", "relative"), CASES)
def test_rings_go_round_inside_the_curves_hulls(name, shape, relative):
    _, laws, sums = case(name, shape, relative)
    u, force, turn = rings(sums)
    assert len(u) == (4 if name in ("muscles", "both") else 3)
    places = [row for law in laws.groups for row in range(len(ARMS[name]))[law.rows]]
    grid, dense = laws.samples(torch.empty(u.shape[1:], dtype=torch.float64), 2001, kinks=True)
    dense, grid = dense.numpy()[:, places], grid.expand_as(dense).numpy()[:, places]
    size = np.ptp(dense, axis=0) + 1e-9
    for angle in np.linspace(0, 2 * np.pi, 40):
        along = np.cos(angle) / size, np.sin(angle)
        reach = (along[0] * force + along[1] * u).max(0)
        assert (reach <= (along[0] * dense + along[1] * grid).max(0) + 1e-6).all()
    for row, fraction in ((0, 0.0), (-1, 1.0)):
        ends = (u == fraction).any(0)
        assert ends.all()
        np.testing.assert_allclose(
            np.where(u == fraction, force, -np.inf).max(0), dense[row], rtol=0, atol=1e-9 * (1 + size.max())
        )
    step, rise = np.roll(u, -1, 0) - u, np.roll(force, -1, 0) - force
    for first in range(len(u)):
        after = (first + 1) % len(u)
        assert (turn * (step[first] * rise[after] - step[after] * rise[first]) >= -1e-12 * size).all()


def test_rings_show_the_kinks_of_a_contracted_muscle():
    """Both of them, as samples at evenly spaced pressures do not."""
    _, laws, sums = case("muscles", (6.0, -1.5), False)
    u, _, _ = rings(sums)
    (law,) = laws.groups
    inner = ((law.kinks > 0) & (law.kinks < 1) & (law.slopes != 0)).all(0)
    assert inner.sum() > 5
    np.testing.assert_allclose(np.sort(u[:, inner], 0)[1:3], np.sort(law.kinks[:, inner], 0), rtol=0, atol=1e-14)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(("name", "shape", "relative"), CASES)
def test_polygons_are_the_rings_minkowski_sums_and_nearest_edges_those_of_the_closed_form(name, shape, relative, dtype):
    _, _, sums = case(name, shape, relative)
    rounding = 1e-11 if dtype is np.float64 else 3e-3
    u, force, _ = rings(sums)
    edges = _polygons(sums)
    moment = sums.bending * u - sums.radii * force
    size = 1 + np.abs(force).max() + np.abs(moment).max()
    for angle in np.linspace(0, 2 * np.pi, 40):
        nx, ny = np.cos(angle), np.sin(angle)
        reach = (nx * SCALE[0] * force + ny * moment).max(0).sum(0)
        np.testing.assert_allclose((nx * edges.x + ny * edges.y).max(0), reach, rtol=0, atol=1e-12 * size)
    held = [torch.from_numpy(value.astype(dtype)) for value in vars(edges).values()]
    again = minkowski_sum(held[0][0], held[1][0], held[2], held[3])
    np.testing.assert_allclose(again.x.numpy(), edges.x, rtol=0, atol=rounding * size)

    rng = np.random.default_rng(0)
    mixed = rng.dirichlet(np.ones(len(edges.x)), 100).T  # half of the points are mixes of the vertices
    x, y = (
        np.concatenate(
            (value.T @ mixed, value.mean(0)[:, None] + np.ptp(value, axis=0)[:, None] * rng.normal(size=(12, 100))), 1
        ).astype(dtype)
        for value in (edges.x, edges.y)
    )
    found = _nearest(type(edges)(*(value.numpy() for value in held)), x, y)
    wanted = nearest_faces(Polygons(*held), torch.from_numpy(x), torch.from_numpy(y), slots=True)
    assert found[0].dtype == found[3].dtype == dtype
    np.testing.assert_allclose(np.sqrt(found[0]), wanted.square.sqrt().numpy(), rtol=0, atol=rounding * size)
    assert (found[2] == wanted.inside.numpy()).all()
    if name != "lines" and dtype is np.float64 and not (relative and shape[0] == shape[1]):  # these have no area
        assert found[2].any()
    assert not found[2].all()
    np.testing.assert_allclose(found[3], wanted.blur.numpy(), rtol=1e-5)


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("name", ["muscles", "both"])
def test_polygons_sampled_at_kinks_lose_no_edge(name, relative):
    """Curves of fewer kinks than others repeat a sample."""
    sections = sections_of(name, (6.0, -1.5))
    laws = section_laws(sections)
    laws = laws.minus_first(sections) if relative else laws
    grid, force = laws.samples(sections.radii, 3, kinks=True)
    bending = sections.bending - sections.at_first_node(sections.bending) if relative else sections.bending
    polygons = hulls.build_hulls(hulls.Curves(grid, force, bending, sections.radii), "exact", SCALE).polygons
    moment = bending * grid - sections.radii * force
    size = 1 + force.abs().max().item()
    for angle in np.linspace(0, 2 * np.pi, 60):
        nx, ny = np.cos(angle), np.sin(angle)
        reach = (nx * SCALE[0] * force + ny * SCALE[1] * moment).amax(0).sum(0)
        torch.testing.assert_close((nx * polygons.x + ny * polygons.y).amax(0), reach, rtol=0, atol=1e-11 * size)


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("build", [ta.antagonistic_arm, ta.bellows_arm, ta.mckibben_arm])
def test_polished_float32_is_near_float64(build, relative):
    metric = "relative" if relative else "absolute"
    values = []
    for dtype in (torch.float64, torch.float32):
        arm = build()
        arm = ta.ArmDesign(arm.radii.to(dtype), arm.length.to(dtype), arm.actuators)
        task = ta.Task(ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=10).to(dtype), ta.sample_loads(8).to(dtype))
        found = ta.evaluate(arm, task, (metric,), polish=True)
        assert found.converged.all()
        values.append(getattr(found, f"{metric}_per_node"))
    assert values[1].dtype == torch.float32
    torch.testing.assert_close(values[1].double(), values[0], rtol=0, atol=5e-3)  # 64 roundings of 700 N
