"""The search for violations, against sets whose violations are known or found by brute force."""

import numpy as np
import pytest

from experiments.hull_gallery import scenes, search
from experiments.hull_gallery.rows import Row
from experiments.rows import read_rows, write_rows

U = np.linspace(0.0, 1.0, search.FINE)


def sums_of(*curves):
    return search.CurveSum(np.stack([np.stack(curve, -1) for curve in curves]), True, True)


def parabola(bend, width=10.0):
    """Points `(width u, bend u (1 - u))`: a chord along x, with a bulge of bend / 4."""
    return width * U, bend * U * (1 - U)


def brute_distance(sums, point, count=400):
    """The least distance from a point to a sum of two curves, by trying all pressures of a grid."""
    grid = np.linspace(0, 1, count)
    pressures = np.stack(np.meshgrid(grid, grid, indexing="ij"), -1).reshape(-1, 2)
    return np.linalg.norm(sums.at(pressures) - point, axis=-1).min()


def test_straight_curves_violate_nothing():
    found = search.examine(sums_of((4.0 * U, 1.0 * U), (3.0 * U, -2.0 * U), (1.0 * U, 5.0 * U)))
    assert max(found.convex.size, found.boundary.size, found.edges.size) < 1e-9
    assert found.free <= 1


def test_one_curve_is_off_its_chord_by_its_bulge_and_has_a_boundary_of_two_points():
    found = search.examine(sums_of(parabola(4.0)))
    # The chord's middle is as near to the flanks as to the top: the nearest point of the arc, by a fine scan.
    x, y = parabola(4.0)
    gap = np.hypot(x[:, None] - np.linspace(0, 10, 2001), y[:, None]).min(0).max()
    assert found.convex.size == pytest.approx(gap, rel=2e-2)
    assert found.boundary.size == pytest.approx(np.hypot(5.0, 1.0), rel=1e-2)


def test_twins_have_a_boundary_from_inside_the_box():
    """Of `c + c` the upper boundary is `2 c`, which one pressure at an end misses: in the middle by half a bulge."""
    sums = sums_of(parabola(4.0), parabola(4.0))
    found = search.examine(sums)
    assert found.free == 2
    # The middle of the upper boundary is (10, 2); pressures (0 or 1, any) reach (10, 0) and arcs of height 1 beside it.
    box = np.concatenate([np.stack(np.broadcast_arrays(fixed, U), -1) for fixed in (0.0, 1.0)])
    image = sums.at(np.concatenate((box, box[:, ::-1])))
    middle = np.linalg.norm(image - [10.0, 2.0], axis=-1).min()
    assert found.boundary.size >= middle * (1 - 1e-3)
    # The edges' hull has the two arcs' tops (5, 1) and (15, 1), and the chord between them: 1 below the middle.
    assert found.edges.size == pytest.approx(1.0, rel=1e-2)
    assert brute_distance(sums, found.convex.point) == pytest.approx(found.convex.size, rel=2e-2)


@pytest.mark.parametrize("name", ["M = 2: bellows, muscle", "M = 2: slowing, side by side"])
def test_distances_against_trying_all_pressures(name):
    case = next(case for case in scenes.CASES if case.name == name)
    sums = search.curve_sums(case.build(), scenes.twists(scenes.SHAPES[2]).numpy(), relative=False)[4]
    found = search.examine(sums)
    assert found.convex.size > 0.1
    assert brute_distance(sums, found.convex.point, 1500) == pytest.approx(found.convex.size, abs=2e-2)


@pytest.mark.parametrize(("name", "shape", "node"), [("muscle-only", 2, 2), ("antagonistic", 0, 2)])
def test_no_reaction_of_many_is_nearer_than_the_search_says(name, shape, node):
    """Descents alone end in the muscles' kinks, and take a point in the midst of the set for one far from it."""
    case = next(case for case in scenes.CASES if case.name == f"M = 4: {name} (paper)")
    sums = search.curve_sums(case.build(), scenes.twists(scenes.SHAPES[shape]).numpy(), relative=False)[node - 1]
    found = search.convexity(sums, search.hull_ring(search.extreme_points(sums)[0]))
    drawn = np.random.default_rng(2).beta(0.3, 0.3, (300_000, 4))
    nearest = np.linalg.norm(sums.at(drawn) - found.point, axis=-1).min()
    assert 0 < found.size <= nearest
    assert nearest < found.size + 0.2


def test_curve_sums_are_the_reactions():
    import torch

    import torcharm as ta

    arm, twists = ta.antagonistic_arm(), scenes.twists(scenes.SHAPES[0])
    share = np.random.default_rng(0).uniform(size=(20, 4))
    reaction = ta.reaction_wrench(arm, twists, torch.from_numpy(share) * arm.max_pressure).numpy()
    for relative in (False, True):
        own = reaction - reaction[:, :1] if relative else reaction
        for node, sums in enumerate(search.curve_sums(arm, twists.numpy(), relative=relative)):
            np.testing.assert_allclose(sums.at(share), own[:, node], atol=1e-2)


def test_rows_survive_the_file(tmp_path):
    rows = [Row("a", -2.0, 3.0, "absolute", 1, 0.1, 0.0, 0.2, 2, 50.0, True, False)]
    write_rows(tmp_path / "rows.csv", rows)
    assert read_rows(tmp_path / "rows.csv", Row) == rows
