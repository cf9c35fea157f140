import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

import torcharm as ta
from torcharm.plot.histograms import LEAST, NEAR, draw_tip_errors, tip_error_edges


@pytest.fixture(scope="module", params=[ta.bellows_arm, ta.antagonistic_arm])
def found(request):
    arm = request.param(outer_radius=0.05, inner_radius=0.015, length=0.5)
    loads = ta.sample_loads(20, (4, 4, 0.4))
    return ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 1.0, length=0.5, nodes=4), loads), ("predicted_error",))


def test_bars_by_verdict_count_every_load_once(found):
    axes, edges = Figure().add_subplot(), tip_error_edges([found])
    lost = draw_tip_errors(axes, found, edges)
    bars = {bar.get_label(): sum(patch.get_height() for patch in bar) for bar in axes.containers}
    errors = 1e3 * found.tip_error.numpy()
    near = (errors <= 10) & (found.verdict == "missed")  # 2 % of 500 mm; it is their turn that is off
    words, counts = np.unique(np.where(near, NEAR, found.verdict)[np.isfinite(errors)], return_counts=True)
    assert bars == dict(zip(words.tolist(), counts.tolist(), strict=True))
    assert (NEAR in bars) == (found.verdict == "held").any()
    assert sum(bars.values()) + lost == 20
    tops = [patch.get_y() + patch.get_height() for bar in axes.containers for patch in bar]
    assert max(tops) == np.histogram(errors[np.isfinite(errors)], edges)[0].max()


def test_lines_are_the_median_and_the_tolerance(found):
    axes = Figure().add_subplot()
    draw_tip_errors(axes, found, tip_error_edges([found]))
    median, tolerance = (line.get_xdata()[0] for line in axes.lines)
    assert median == pytest.approx(1e3 * float(np.median(found.tip_error.numpy())))
    assert tolerance == pytest.approx(10)


def test_edges_hold_all_errors_and_the_tolerance(found):
    edges = tip_error_edges([found])
    errors = 1e3 * found.tip_error[found.tip_error.isfinite()]
    assert edges[0] < max(LEAST, float(errors.min())) < float(errors.max()) < edges[-1]
    assert edges[0] < 10 < edges[-1]


def test_sets_alone_have_no_errors():
    arm = ta.antagonistic_arm(outer_radius=0.05, inner_radius=0.015, length=0.5)
    found = ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 1.0, length=0.5, nodes=2)), ("absolute",))
    with pytest.raises(ValueError, match="found: must hold predicted errors"):
        tip_error_edges([found])


def test_a_map_has_the_scale_that_is_asked_for():
    from torcharm.plot import load_grid, load_map

    grid = load_grid(1.0, 3)
    axes = load_map(grid, torch.arange(9.0).reshape(3, 3) + 1, unit="", lowest=0.0, highest=4.0, contour=None)
    bar = axes.figure.axes[1]
    assert bar.get_ylim()[0] == 0
    assert bar.get_ylabel() == "signed unattainability"
    assert axes.collections[0].get_clim() == (0, 4)
