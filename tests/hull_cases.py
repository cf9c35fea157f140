"""What tests of distances share: sets of vertices of every kind, and the paper's arms on its shapes."""

from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from jaxtyping import config

import torcharm as ta

RNG = np.random.default_rng(11)
LINE = np.array([0.6, -0.8])

VERTEX_SETS = {
    "random": RNG.normal(size=(10, 2)),
    "many": RNG.normal(size=(200, 2)),
    "far from the origin": RNG.normal(size=(10, 2)) + 50.0,
    "flat": RNG.normal(size=(10, 2)) * [1.0, 1e-6],
    "triangle": RNG.normal(size=(3, 2)),
    "duplicates": np.repeat(RNG.normal(size=(6, 2)), 4, axis=0),
    "near duplicates": np.repeat(RNG.normal(size=(6, 2)), 4, axis=0) + RNG.uniform(-1e-14, 1e-14, size=(24, 2)),
    "two points": RNG.normal(size=(2, 2)),
    "near-duplicate pair": np.array([[0.3, 0.4], [0.3, 0.4 + 1e-14]]),
    "collinear": np.outer([0.0, 4.0, -2.0, 1.0, 8.0], [1.0, -0.5]),
    "nearly collinear": np.outer(RNG.normal(size=8), LINE) + RNG.uniform(-1e-14, 1e-14, size=(8, 2)),
    "vertical": np.array([[1.0, y] for y in (2.0, -1.0, 0.5, 2.0)]),
    "horizontal": np.array([[x, 1.0] for x in (2.0, -1.0, 0.5, 2.0)]),
    "one point": np.array([[0.7, -0.2]]),
    "the same point": np.full((4, 2), 0.25),
    "square with its edge points": np.array([[x, y] for x in (0, 1, 2) for y in (0, 1, 2.0)]),
}


def points_about(vertices, count=60):
    """Points far and near, and inside where there is an inside."""
    rng = np.random.default_rng(5)
    middle, spread = vertices.mean(0), np.ptp(vertices, axis=0).max() + 0.1
    mixtures = rng.dirichlet(np.ones(len(vertices)), size=count // 3) @ vertices
    around = middle + rng.normal(size=(count, 2)) * spread
    return np.concatenate((around, mixtures, vertices + rng.normal(size=vertices.shape) * 1e-3))


def size_of(points, vertices):
    return np.abs(points).max() + np.abs(vertices).max()


def double(values, *, grad=False):
    return torch.tensor(np.asarray(values, dtype=float), requires_grad=grad)


@contextmanager
def unchecked():
    """Without the run-time check of signatures, which takes most of the time of many small calls."""
    config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        config.update("jaxtyping_disable", False)


# --- the paper's arms on its shapes ---

PAPER_ARMS = {"antagonistic": ta.antagonistic_arm, "bellows": ta.bellows_arm, "muscles": ta.mckibben_arm}
PAPER_SHAPES = double([[-3.0, 3.0], [1.0, 1.5], [6.0, -1.5]])
SIZES = {"radii": 0.05, "length": 0.5, "max_pressure": 50.0, "twists": 1.0, "tip_load": 10.0}
"""What a large change of each input is, in its own unit: so much of each changes distances about alike."""


@dataclass(frozen=True)
class Scene:
    """An arm on shapes under loads, as a function of its leaves.

    Attributes:
        models: the actuators.
        members: for each actuator, its place in the leaves: actuators alike in all have one leaf together.
        leaves: radii, length and max_pressure (*designs, K), twists (..., N, 3) and tip_load (..., 3).
    """

    models: tuple
    members: tuple[int, ...]
    leaves: dict[str, torch.Tensor]

    def arm_and_task(self, **changed):
        values = self.leaves | changed
        designs = (values[name][..., self.members] for name in ("radii", "length", "max_pressure"))
        radii, length, limits = torch.broadcast_tensors(*designs)
        return ta.ArmDesign(radii, length, self.models, limits), ta.Task(values["twists"], values["tip_load"])

    def evaluate(self, changed=None, **options):
        return ta.evaluate(*self.arm_and_task(**(changed or {})), **{"metrics": ("absolute", "relative"), **options})

    def scale(self, metric, **options):
        """The largest coordinate of vertices minus required wrench, max|H - w|, (*designs, *tasks, N).

        Where it is 0 (node 1 differs by nothing from itself) it is 1 instead.
        """
        vertices, required = self.vertices_and_required(metric, **options)
        largest = (vertices - required.unsqueeze(-2)).abs().amax((-1, -2))
        return torch.where(largest > 0, largest, torch.ones_like(largest))

    def vertices_and_required(self, metric, **options):
        """(*designs, *tasks, N, V, 2) and (*tasks, N, 2), without gradients."""
        relative = metric == "relative"
        arm, task = self.arm_and_task(**{name: leaf.detach() for name, leaf in self.leaves.items()})
        twists = task.twists.expand(*task.batch_shape, *task.twists.shape[-2:])
        vertices = ta.wrench_hulls(arm, twists, relative=relative, **options).vertices
        required = ta.required_wrench(twists, task.tip_load)[..., [0, 2]]
        return vertices, required - required[..., :1, :] if relative else required


def paper_scene(name, *, loads=2, nodes=10, together=True, grad=False):
    """One of the paper's arms on its three shapes under loads: task batch (3, loads).

    Of the muscle-only arm two actuators each are alike in all. The hull has parallel faces there, and
    distances a kink where only one of two moves: unless asked otherwise, they move together.
    """
    arm = PAPER_ARMS[name]()
    twins = name == "muscles" and together
    members, own = ((0, 0, 1, 1), [0, 2]) if twins else ((0, 1, 2, 3), [0, 1, 2, 3])
    leaves = {
        "radii": arm.radii[own],
        "length": arm.length[own],
        "max_pressure": arm.max_pressure[own],
        "twists": ta.affine_curvature(*PAPER_SHAPES.T, nodes=nodes)[:, None],
        "tip_load": ta.sample_loads(loads, scale=(20.0, 20.0, 5.0)),
    }
    return Scene(arm.actuators, members, {key: leaf.clone().requires_grad_(grad) for key, leaf in leaves.items()})


def attainable_scene(loads=6, spread=1.0):
    """A bellows arm that holds two elements well inside its limits, by both metrics, under loads that are much alike.

    Args:
        loads: their number.
        spread: by how much each component may differ from those of one load [N, N·m].
    """
    arm, twists = PAPER_ARMS["bellows"](), double([[0.57, 0.0, 1.25], [0.58, 0.0, -1.2]])
    leaves = {name: getattr(arm, name).clone() for name in ("radii", "length", "max_pressure")}
    leaves["twists"] = twists
    leaves["tip_load"] = double([-11.0, 50.0, -1.0] + np.random.default_rng(0).uniform(-1, 1, (loads, 3)) * spread)
    return Scene(arm.actuators, (0, 1, 2, 3), {key: leaf.requires_grad_() for key, leaf in leaves.items()})


def random_scene(name, *, designs, tasks, nodes, seed=0, grad=False):
    """Designs about one of the paper's, each on every one of some random shapes with a load of its own.

    Bent and strained enough that no muscle stands at a kink of its model, at random about ±10 N and ±2.5 N·m.
    """
    rng = np.random.default_rng([seed, list(PAPER_ARMS).index(name)])
    arm = PAPER_ARMS[name]()
    count = arm.actuator_count
    leaves = {
        "radii": arm.radii + double(rng.normal(0.0, 0.006, (designs, count))),
        "length": arm.length * double(rng.uniform(0.95, 1.1, (designs, count))),
        "max_pressure": arm.max_pressure * double(rng.uniform(0.5, 1.0, (designs, count))),
        "twists": double(rng.uniform([0.45, -0.02, -3.0], [0.52, 0.02, 3.0], (tasks, nodes, 3))),
        "tip_load": double(rng.uniform(-0.5, 0.5, (tasks, 3)) * [20.0, 20.0, 5.0]),
    }
    members = tuple(range(count))
    return Scene(arm.actuators, members, {key: leaf.requires_grad_(grad) for key, leaf in leaves.items()})


def assert_slopes(total, at):
    """The gradient of a total at numbers (K,) that want one, against differences of fourth order."""
    (found,) = torch.autograd.grad(total(at), at)
    for index, step in enumerate(1e-5 * torch.eye(len(at), dtype=at.dtype)):
        with torch.no_grad():
            far = (total(at + 2 * step) - total(at - 2 * step)) / 4e-5
            near = (total(at + step) - total(at - step)) / 2e-5
        assert found[index].item() == pytest.approx(((4 * near - far) / 3).item(), rel=1e-6, abs=1e-5)
