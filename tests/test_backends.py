"""`evaluate` through each of its distances: they agree, say what they are worth, and refuse what they cannot do."""

import csv
import importlib.util
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import oracle
import pytest
import torch
from hull_cases import PAPER_ARMS, SIZES, paper_scene, random_scene, unchecked
from typer.testing import CliRunner

import torcharm as ta
from torcharm import cli

METRICS = ("absolute", "relative")
SAMPLES = {"exact": 5, "edges": 3}
HALFSPACES = partial(ta.qp_distance, form="halfspaces")

needs_qpth = pytest.mark.skipif(importlib.util.find_spec("qpth") is None, reason="qpth is not installed")
QPTH = {
    "qpth": pytest.param("qpth", marks=needs_qpth),
    "half-spaces": pytest.param(HALFSPACES, marks=needs_qpth),
    "envelope": pytest.param(partial(ta.qp_distance, gradient="envelope"), marks=needs_qpth),
}
each_arm = pytest.mark.parametrize("name", PAPER_ARMS)
each_hull = pytest.mark.parametrize("hull", SAMPLES)
SOLVERS = {"scipy": "scipy", "qpth": QPTH["qpth"], "half-spaces": QPTH["half-spaces"]}
each_solver = pytest.mark.parametrize("distance", SOLVERS.values(), ids=SOLVERS)


def largest_error(scene, found, expected, **options):
    """Of the distances of all nodes, over the largest coordinate of hull minus required wrench."""
    errors = []
    for metric in METRICS:
        one, other = (getattr(result, metric + "_per_node").detach() for result in (found, expected))
        errors.append(((one - other).abs() / scene.scale(metric, **options)).max().item())
    return max(errors)


def gradients(scene, total):
    """Of a total, per large change of each input."""
    found = torch.autograd.grad(total, list(scene.leaves.values()), retain_graph=True)
    return {key: own * SIZES[key] for key, own in zip(scene.leaves, found, strict=True)}


def gradient_error(scene, found, expected):
    """The largest error of any input's gradient, over the gradient with respect to all inputs."""
    errors = []
    for metric in METRICS:
        exact, own = (gradients(scene, getattr(result, metric).sum()) for result in (expected, found))
        size = torch.stack([one.norm() for one in exact.values()]).norm()
        errors += [(own[key] - one).norm() / size for key, one in exact.items()]
    return torch.stack(errors).max().item()


# --- agreement on the paper's arms and shapes ---


@each_hull
@each_arm
@unchecked()
def test_scipy_agrees_with_the_closed_form(name, hull):
    scene, options = paper_scene(name, grad=True), {"hull": hull, "samples": SAMPLES[hull]}
    expected, found = (scene.evaluate(distance=distance, **options) for distance in ("closed_form", "scipy"))
    assert (expected.absolute_per_node > 0).any()
    assert found.converged.all()
    assert largest_error(scene, found, expected, **options) < 1e-12
    assert gradient_error(scene, found, expected) < 1e-9


# Measured, the largest of the three arms and both hulls: value, gradient.
#     qpth          2e-12  1.5e-5
#     half-spaces   8e-7   4.5e-6
#     envelope      2e-12  2.6e-8
# qpth's gradients are the worse the nearer the hull: 7e-5 of that of a single node out of reach by 0.8 % of max|H - w|.
QPTH_GRADIENTS = {"qpth": 4e-5, "half-spaces": 1.3e-5, "envelope": 7e-8}


@each_hull
@each_arm
@pytest.mark.parametrize(
    ("distance", "tolerance"),
    [pytest.param(*QPTH[key].values, bound, marks=needs_qpth) for key, bound in QPTH_GRADIENTS.items()],
    ids=QPTH_GRADIENTS,
)
@unchecked()
def test_qpth_agrees_with_the_closed_form(name, hull, distance, tolerance):
    scene = paper_scene(name, grad=True) if hull == "exact" else paper_scene(name, loads=1, nodes=4, grad=True)
    options = {"hull": hull, "samples": SAMPLES[hull]}
    expected, found = (scene.evaluate(distance=solver, **options) for solver in ("closed_form", distance))
    assert (expected.absolute_per_node > 0).any()
    assert found.converged.all()
    assert largest_error(scene, found, expected, **options) < 1e-6
    assert gradient_error(scene, found, expected) < tolerance


@each_arm
def test_slsqp_is_right_where_it_says_so(name):
    scene, options = paper_scene(name, loads=1, nodes=4), {"hull": "exact", "samples": 3}
    expected = scene.evaluate(**options)
    found = scene.evaluate(distance=ta.slsqp_distance, residuals=True, **options)
    sure = torch.ones_like(found.converged)
    for metric in METRICS:
        own = found.residuals[metric].converged
        error = (getattr(found, metric + "_per_node") - getattr(expected, metric + "_per_node")).abs()
        assert (error / scene.scale(metric, **options))[own].max() < 1e-6
        assert own.double().mean() > 0.5
        sure &= own.all(-1)
    assert torch.equal(found.converged, sure)


# --- two thousand problems ---

RANDOM = {"designs": 7, "tasks": 6, "nodes": 8}  # 336 nodes an arm, each with two distances: 2016 in all


@each_arm
@pytest.mark.parametrize(
    ("distance", "tolerance"), [("scipy", 1e-12), pytest.param("qpth", 1e-6, marks=needs_qpth)], ids=["scipy", "qpth"]
)
@unchecked()
def test_random_problems_agree(name, distance, tolerance):
    scene = random_scene(name, **RANDOM)
    expected, found = scene.evaluate(samples=4), scene.evaluate(samples=4, distance=distance)
    assert expected.absolute_per_node.shape == (7, 6, 8)
    assert (expected.absolute_per_node > 0).sum() > 100
    assert (expected.absolute_per_node == 0).sum() > 3
    assert found.converged.all()
    assert largest_error(scene, found, expected, samples=4) < tolerance  # measured: scipy 4e-16, qpth 2e-13
    for metric in METRICS:  # touching or not is never a matter of tolerance
        one, other = (getattr(result, metric + "_per_node") for result in (expected, found))
        assert torch.equal(one == 0, other == 0)


@each_arm
@pytest.mark.parametrize(
    ("distance", "tolerance", "every"),
    # measured, over max|H - w|: 0, 0 and 1e-11; qpth iterates for the batch as a whole
    [("closed_form", 1e-14, 1), ("scipy", 1e-14, 3), pytest.param("qpth", 1e-8, 21, marks=needs_qpth)],
    ids=["closed form", "scipy", "qpth"],
)
@unchecked()
def test_alone_and_in_the_batch_the_answers_are_the_same(name, distance, tolerance, every):
    scene = random_scene(name, **RANDOM)
    options = {"samples": 4, "distance": distance}
    batch, scale = scene.evaluate(**options), {metric: scene.scale(metric, samples=4) for metric in METRICS}
    for design, task in list(np.ndindex(7, 6))[::every]:
        alone = replace(scene, leaves=one_of(scene.leaves, design, task)).evaluate(**options)
        for metric in METRICS:
            error = getattr(alone, metric + "_per_node") - getattr(batch, metric + "_per_node")[design, task]
            assert (error.abs() <= tolerance * scale[metric][design, task]).all()


def one_of(leaves, design, task):
    return {
        key: leaf.detach()[task if key in ("twists", "tip_load") else design].requires_grad_(leaf.requires_grad)
        for key, leaf in leaves.items()
    }


@pytest.mark.parametrize(
    ("distance", "tolerance"),
    [("closed_form", 1e-14), ("scipy", 1e-14), pytest.param("qpth", 1e-8, marks=needs_qpth)],
    ids=["closed form", "scipy", "qpth"],
)
@unchecked()
def test_one_problem_at_a_time_and_two_thousand_at_once(distance, tolerance):
    """The solvers themselves, on the hulls of real arms: points alone, and all together (measured: 0, 0 and 2e-11)."""
    solve = {"closed_form": ta.planar_distance, "scipy": ta.nnls_distance, "qpth": ta.qp_distance}[distance]
    sets = [
        random_scene(name, **RANDOM).vertices_and_required(metric, samples=4)
        for name in PAPER_ARMS
        for metric in METRICS
    ]
    vertices = torch.cat([hulls.flatten(0, 2) for hulls, _ in sets])
    points = torch.cat([required.expand(*hulls.shape[:-2], 2).flatten(0, 2) for hulls, required in sets])
    assert len(points) == 2016
    together = solve(points, vertices)
    scale = (vertices - points.unsqueeze(1)).abs().amax((1, 2))
    for index in range(0, 2016, 63):
        alone = solve(points[index], vertices[index])
        assert (alone.value - together.value[index]).abs() <= tolerance * scale[index]
        assert alone.converged
        assert together.converged[index]


# --- residuals ---

FIELDS = ("primal", "dual", "gap", "converged", "resolved")


@each_hull
@pytest.mark.parametrize("metrics", [("relative",), METRICS], ids="+".join)
@pytest.mark.parametrize("distance", ["closed_form", *SOLVERS.values()], ids=["closed form", *SOLVERS])
@unchecked()
def test_residuals_are_there_for_what_was_asked_and_small(distance, metrics, hull):
    options = {"hull": hull, "samples": 3, "distance": distance, "metrics": metrics}
    scene = paper_scene("antagonistic", loads=2, nodes=2)
    found = scene.evaluate(residuals=True, **options)
    assert set(found.residuals) == set(metrics)
    for own in found.residuals.values():
        for field in FIELDS:
            value = getattr(own, field)
            assert value.shape == (3, 2, 2)
            assert value.dtype == (torch.bool if field in ("converged", "resolved") else torch.float64)
            assert not value.requires_grad
        assert own.converged.all()
        assert own.primal.max() <= 1e-6
        # what is kept is good to 1e-6 of max|H - w|, so its gap to that times the distance, and at most the scale
        assert own.gap.abs().max() <= 1e-6
        assert own.dual.max() <= 1e-6
        if distance in ("closed_form", "scipy"):
            assert max(own.primal.max(), own.dual.max(), own.gap.abs().max()) < 1e-14
            assert not own.resolved.any()
    plain = scene.evaluate(**options)
    assert plain.residuals is None
    for metric in metrics:
        assert torch.equal(getattr(plain, metric), getattr(found, metric))


class Recorded:
    """A solver that remembers what it was asked and what it answered."""

    def __init__(self, solve):
        self.solve, self.calls = solve, []

    def __call__(self, point, vertices):
        found = self.solve(point, vertices)
        self.calls.append((point, vertices, found))
        return found


@pytest.mark.parametrize(("hull", "weights"), [("exact", (0.25, 9.0)), ("edges", (1.0, 1.0))])
@pytest.mark.parametrize(
    "solve",
    [ta.planar_distance, ta.nnls_distance, pytest.param(ta.qp_distance, marks=needs_qpth)],
    ids=["closed form", "scipy", "qpth"],
)
def test_residuals_are_those_of_the_weights_on_the_arms_own_hulls(solve, weights, hull):
    """Recomputed in numpy from the vertices of `wrench_hulls`, required wrenches by plain statics, and the weights."""
    options = {"hull": hull, "samples": 3}
    scene = paper_scene("antagonistic", loads=2, nodes=3)
    solver = Recorded(solve)
    found = scene.evaluate(distance=solver, weights=weights, residuals=True, **options)
    assert len(solver.calls) == 2
    factor = np.sqrt(weights)
    twists, loads = scene.leaves["twists"][:, 0], scene.leaves["tip_load"]
    for metric, (_, asked, answer) in zip(METRICS, solver.calls, strict=True):
        hulls = scene.vertices_and_required(metric, **options)[0][:, 0].numpy() * factor  # (3, N, V, 2)
        # the solver was given the same hull, its vertices perhaps in another order
        nearest = (answer.weights.unsqueeze(-1) * asked).sum(-2).unflatten(0, (3, 3)).numpy()
        convex = answer.weights.unflatten(0, (3, 3)).numpy()  # (3, N, L, V)
        for shape, load in np.ndindex(3, 2):
            required = oracle.required_wrenches(twists[shape], loads[load])[:, [0, 2]] * factor
            if metric == "relative":
                required = required - required[0]
            for node in range(3):
                away, mix = hulls[shape, node] - required[node], convex[shape, node, load]
                residual = nearest[shape, node, load] - required[node]
                scale = np.abs(away).max() or 1.0  # node 1 differs by nothing from itself
                square, least = residual @ residual, (away @ residual).min()
                gap = (square - least) / scale**2
                expected = {"primal": max(abs(mix.sum() - 1), -mix.min()), "dual": max(0.0, gap), "gap": gap}
                reported = found.residuals[metric]
                own = {field: getattr(reported, field)[shape, load, node].item() for field in expected}
                assert own == pytest.approx(expected, rel=1e-6, abs=1e-14)
                length = getattr(found, metric + "_per_node")[shape, load, node].item()
                assert length == pytest.approx(np.sqrt(square), abs=1e-6 * scale)


@pytest.mark.parametrize("residuals", [False, True])
@pytest.mark.parametrize("fault", [{"converged": False}, {"value": float("nan")}], ids=["not converged", "NaN"])
@pytest.mark.parametrize("wrong", METRICS)
def test_one_wrong_answer_is_marked_and_no_other(wrong, fault, residuals):
    scene = paper_scene("bellows", loads=2, nodes=4)
    calls = []

    def solve(point, vertices):
        found = ta.nnls_distance(point, vertices)
        calls.append(len(calls))
        if METRICS[calls[-1]] != wrong:
            return found
        field, bad = next(iter(fault.items()))
        value = getattr(found, field).clone()
        assert value.shape == (3 * 4, 2)  # shapes × nodes, loads
        value[1 * 4 + 2, 1] = bad
        return replace(found, **{field: value})

    found = scene.evaluate(samples=3, distance=solve, residuals=residuals)
    expected = torch.ones(3, 2, dtype=torch.bool)
    expected[1, 1] = False
    assert torch.equal(found.converged, expected)
    clean = scene.evaluate(samples=3)
    for metric in METRICS:
        same = expected if "value" in fault and metric == wrong else torch.ones_like(expected)
        error = getattr(found, metric) - getattr(clean, metric)
        assert error[same].abs().max() < 1e-10
        assert error[~same].isnan().all()
        if residuals:
            bad = (~found.residuals[metric].converged).nonzero().tolist()
            assert bad == ([[1, 1, 2]] if metric == wrong and "converged" in fault else [])


def test_a_residual_is_asked_for_with_a_custom_distance_too():
    """A converged answer with weights of one's own: what counts is what the function says."""
    scene = paper_scene("bellows", loads=1, nodes=2)

    def solve(point, vertices):
        found = ta.planar_distance(point, vertices)
        return replace(found, value=2 * found.value, gap=found.gap + 0.5, resolved=~found.resolved)

    found, exact = scene.evaluate(samples=3, distance=solve, residuals=True), scene.evaluate(samples=3)
    for metric in METRICS:
        torch.testing.assert_close(getattr(found, metric), 2 * getattr(exact, metric), rtol=1e-12, atol=0)
        np.testing.assert_allclose(found.residuals[metric].gap, 0.5, atol=1e-14)
        assert found.residuals[metric].resolved.all()


# --- what is refused ---


@each_solver
def test_solvers_know_no_margin(distance):
    with pytest.raises(ValueError, match=r"^signed: ") as caught:
        paper_scene("bellows").evaluate(signed=True, distance=distance)
    assert "closed_form" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("distance", ["gjk", "", "QPTH", "nnls"])
def test_an_unknown_distance_is_refused_with_those_there_are(distance):
    with pytest.raises(ValueError, match=r"^distance: ") as caught:
        paper_scene("bellows").evaluate(distance=distance)
    for name in ("closed_form", "qpth", "scipy"):
        assert name in str(caught.value)


WITHOUT_QPTH = (
    "distance: 'qpth' needs the package qpth, which has no release for Python 3.13 and later; use 'closed_form'"
)


@pytest.fixture
def without_qpth(monkeypatch):
    """As if qpth were not installed: importing it, or any part of it, fails."""
    for module in ("qpth", "qpth.qp"):
        monkeypatch.setitem(sys.modules, module, None)


@pytest.mark.usefixtures("without_qpth")
@pytest.mark.parametrize("distance", ["qpth", HALFSPACES], ids=["qpth", "half-spaces"])
def test_without_qpth_one_line_says_so_and_the_rest_works(distance):
    scene = paper_scene("bellows", loads=1, nodes=2)
    with pytest.raises(ValueError, match=r"^distance: 'qpth' needs") as caught:
        scene.evaluate(distance=distance)
    assert str(caught.value) == WITHOUT_QPTH
    closed, scipy = scene.evaluate(samples=3, residuals=True), scene.evaluate(samples=3, distance="scipy")
    torch.testing.assert_close(scipy.absolute, closed.absolute, rtol=1e-12, atol=1e-12)
    assert closed.converged.all()


# --- studies ---

STUDY = """
name = "through a solver"
[[arm]]
name = "antagonistic"
kind = "antagonistic"
[[arm]]
name = "muscles"
kind = "mckibben"
[[task]]
name = "bent"
shape = {{ kind = "affine", slope = 1, intercept = 1.5, nodes = 5 }}
loads = {{ count = 3 }}
[evaluate]
distance = "{distance}"
samples = 4
"""


def study_rows(folder, distance):
    """What the command writes for a study with this distance."""
    path, out = folder / f"{distance}.toml", folder / f"{distance}.csv"
    path.write_text(STUDY.format(distance=distance), encoding="utf-8")
    result = CliRunner().invoke(cli.app, ["evaluate", str(path), "--out", str(out)], env={"COLUMNS": "80"})
    assert result.exit_code == 0, result.output
    with out.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("distance", ["scipy", pytest.param("qpth", marks=needs_qpth)])
def test_a_study_names_its_distance(tmp_path, distance):
    rows, expected = study_rows(tmp_path, distance), study_rows(tmp_path, "closed_form")
    assert len(rows) == 6
    for row, exact in zip(rows, expected, strict=True):
        for column, value in exact.items():
            if column in ("absolute", "relative"):
                assert float(row[column]) == pytest.approx(float(value), rel=1e-6)
            else:
                assert row[column] == value
    assert {row["worst_node"] for row in rows} != {"0"}


@pytest.mark.usefixtures("without_qpth")
def test_a_study_that_asks_for_what_is_not_there_ends_in_one_line(monkeypatch, capsys, tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY.format(distance="qpth"), encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["torcharm", "evaluate", str(path)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err == f"torcharm: {WITHOUT_QPTH}\n"


# --- second derivatives, chunks, empty batches ---


@each_solver
@pytest.mark.parametrize("chunk_size", [None, 1])
@unchecked()
def test_second_derivatives_through_a_solver_are_refused(distance, chunk_size):
    """Of each input alone: also where only the required wrench, or only the hull, has a gradient."""
    scene = paper_scene("antagonistic", loads=1, nodes=2)
    options = {"samples": 2, "distance": distance, "chunk_size": chunk_size}
    for key in SIZES if chunk_size is None else ("radii",):
        leaf = scene.leaves[key].clone().requires_grad_()
        found = scene.evaluate({key: leaf}, **options)
        (first,) = torch.autograd.grad((found.absolute + found.relative).sum(), leaf, create_graph=True)
        assert first.abs().max() > 0
        with pytest.raises(RuntimeError, match="second derivatives"):
            torch.autograd.grad(first.square().sum(), leaf)


CHUNKED = {
    "scipy, exact": ("scipy", "exact"),
    "scipy, edges": ("scipy", "edges"),
    "qpth": pytest.param("qpth", "exact", marks=needs_qpth),
    "half-spaces": pytest.param(HALFSPACES, "edges", marks=needs_qpth),
}


@pytest.mark.parametrize(("distance", "hull"), CHUNKED.values(), ids=CHUNKED)
@unchecked()
def test_chunks_change_neither_values_nor_gradients(distance, hull):
    # scipy solves one problem after the other. qpth ends when a whole batch is good enough: measured, values
    # differ by 2e-12 of max|H - w| and gradients by 2e-12, but they may by as much as they are off.
    scene = random_scene("antagonistic", designs=2, tasks=2, nodes=2, grad=True)
    options = {"hull": hull, "samples": 2, "distance": distance}

    def answers(chunk_size):
        found = scene.evaluate(chunk_size=chunk_size, **options)
        return found, gradients(scene, (found.absolute + found.relative).sum())

    whole, expected = answers(None)
    size = torch.stack([one.norm() for one in expected.values()]).norm()
    for chunk_size in (1, 2):
        parts, found = answers(chunk_size)
        assert largest_error(scene, parts, whole, hull=hull, samples=2) < (1e-15 if distance == "scipy" else 1e-8)
        worst = max((found[key] - one).norm() / size for key, one in expected.items())
        assert worst < (1e-14 if distance == "scipy" else 1e-6)


@each_solver
@pytest.mark.parametrize("grad", [False, True])
@pytest.mark.parametrize(
    ("designs", "tasks", "shape"), [(0, 2, (0, 2)), (2, 0, (2, 0)), (0, 0, (0, 0))], ids=["designs", "tasks", "both"]
)
@unchecked()
def test_empty_batches_give_empty_results(distance, grad, designs, tasks, shape):
    scene = random_scene("antagonistic", designs=designs, tasks=tasks, nodes=3, grad=grad)
    found = scene.evaluate(samples=3, distance=distance, residuals=True)
    for metric in METRICS:
        assert getattr(found, metric).shape == shape
        assert getattr(found, metric + "_per_node").shape == (*shape, 3)
        for field in FIELDS:
            assert getattr(found.residuals[metric], field).shape == (*shape, 3)
    assert found.converged.shape == shape
    assert found.converged.dtype == torch.bool
    assert scene.evaluate(samples=3, distance=distance).residuals is None
