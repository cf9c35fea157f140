"""Names are drawn as they are: what stands between dollar signs is no formula."""

import io

import pytest
import torch

import torcharm as ta
from torcharm import plot

NAME = r"$\frac{$ $x_1$ <b>&"


@pytest.fixture(scope="module")
def case():
    arm = ta.antagonistic_arm(outer_radius=0.05, inner_radius=0.015, length=0.5)
    return arm, ta.Task(ta.affine_curvature(0.0, 1.0, length=0.5, nodes=2))


def written(figure):
    """The texts of a figure that can be drawn."""
    figure.savefig(io.BytesIO(), format="svg")
    return [text.get_text() for text in figure.findobj(lambda artist: hasattr(artist, "get_text"))]


def test_of_studies(case):
    arm, task = case
    words = written(plot.study_figure([(NAME, arm)], NAME, task, [ta.evaluate(arm, task)]))
    assert words.count(NAME) >= 2
    assert f"{NAME}: 1 held\ndrawn: load 1 of 1" in words


def test_of_searches(case):
    arm, task = case
    words = written(plot.search_figure([(NAME, arm, ta.search_pressure(arm, task, starts=1))], NAME, task))
    assert f"{NAME}: how near the best pressures bring the tip" in words


def test_of_plans(case):
    arm, task = case
    pose = ta.poses(task.twists)[-1]
    words = written(plot.plan_figure([(NAME, arm, ta.plan_shape(arm, pose, [0.0, 0.0, 0.0], nodes=2))], NAME, pose))
    assert f"{NAME}: shapes through the tip pose" in words


def test_of_histograms():
    axes = plot.unattainability_histogram({NAME: torch.tensor([0.0, 1.0])})
    assert any(word.startswith(f"{NAME}: median 0.5 N") for word in written(axes.figure))
