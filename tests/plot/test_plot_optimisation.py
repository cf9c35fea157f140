"""The picture of an optimisation: errors of few and of many tasks, and sections with the numbers of actuators."""

import dataclasses
import io
from functools import cache

import matplotlib
import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm import plot
from torcharm.design.task_errors import TaskErrors
from torcharm.inputs import three_digits

matplotlib.use("Agg")


def errors(count: int, seed: int) -> TaskErrors:
    found = 0.01 * torch.rand(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    yes = torch.ones(count, dtype=torch.bool)
    stable = yes.clone()
    stable[count // 2 + 1 :] = False  # of one or two tasks none
    return TaskErrors(found, 2 * found, torch.zeros(count, 4), yes, stable, yes, -torch.ones(count))


@cache
def optimised() -> ta.OptimisedDesign:
    arm = ta.ArmDesign([-0.03, 0.03], 0.5, "bellows")
    task = ta.Task(ta.affine_curvature(0.5, 0.5, length=0.5, nodes=3), [0.0, 0.0, 0.0])
    return ta.optimise_design(arm, task, objective=ta.Objective("unattainability"), starts=1, iterations=1)


def result(count: int, **arms: ta.ArmSeries) -> ta.OptimisedDesign:
    return dataclasses.replace(optimised(), **arms, before=errors(count, 0), after=errors(count, 1))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_tasks_are_pairs_of_marks(count):
    found = result(count)
    figure = plot.optimisation_figure(found, "few")
    axes = figure.axes[0]
    given, best = (np.asarray(mark.get_offsets()) for mark in axes.collections[:2])
    for marks, side in ((given, found.before), (best, found.after)):
        stable = side.stable.numpy()
        np.testing.assert_allclose(marks[:, 0], np.flatnonzero(stable) + 1)
        np.testing.assert_allclose(marks[:, 1], 1e3 * side.tip_error.numpy()[stable])
    assert axes.get_xticks().tolist() == list(range(1, count + 1))
    low, high = axes.get_ylim()
    assert low == 0.0 < max(given[:, 1].max(), best[:, 1].max()) < high
    figure.savefig(io.BytesIO())


def test_errors_are_of_the_shape_where_these_were_minimised():
    found = dataclasses.replace(result(3), objective=ta.Objective())
    axes = plot.optimisation_figure(found).axes[0]
    for mark, side in zip(axes.collections[:2], (found.before, found.after), strict=True):
        np.testing.assert_allclose(mark.get_offsets()[:, 1], 1e3 * side.shape_error.numpy()[side.stable.numpy()])
    assert axes.get_ylabel() == "predicted shape error [mm]"
    assert f"mean {three_digits(found.after.shape_mm())} mm" in axes.get_legend_handles_labels()[1][1]


def test_many_tasks_are_two_lines_in_ascending_order():
    axes = plot.optimisation_figure(result(30)).axes[0]
    assert not axes.collections
    for line in axes.lines:
        assert (np.diff(line.get_ydata()) >= 0).all()
        assert "14 without a stable equilibrium" in line.get_label()


@pytest.mark.parametrize("space", [False, True])
def test_sections_have_the_colours_and_numbers_of_other_pictures(space):
    """A passive core counts as in tables; in series numbers go on."""
    core = ta.elastic_core(45.0, 3.6e-3)
    across = {"offsets": [[0.0, 0.0], [0.03, 0.02], [-0.03, 0.0]]} if space else {"radii": [0.0, -0.03, 0.03]}
    one = ta.ArmDesign(**across, length=0.4, actuators=[core, ta.McKibben(), ta.Bellows()])
    arm = ta.series([one, one])
    section = plot.optimisation_figure(result(2, given=arm, best=arm)).axes[1]
    assert [text.get_text() for text in section.texts] == list("123456")
    filled = {mark.get_label(): mark.get_facecolor()[0] for mark in section.collections if mark.get_label()[0] != "_"}
    assert set(filled) == {"elastic core", "mckibben", "bellows"}
    for kind, colour in filled.items():
        np.testing.assert_allclose(colour, matplotlib.colors.to_rgba(plot.KIND_STYLES[kind][0]))
