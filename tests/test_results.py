"""What results look like at a prompt, in another dtype, and after they were kept in a file."""

import dataclasses
import io
import pickle
from functools import cache

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.characterise.uncertainty import TensorPolynomial
from torcharm.study import NamedArm, NamedTask, evaluate_study, parse_study

D = torch.float64
ARM, TASK = ta.antagonistic_arm(), ta.Task(ta.affine_curvature(0.5, 0.5, length=0.5, nodes=4), ta.sample_loads(3))
NEWTONS = ta.Objective("unattainability")
SQUARE = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], dtype=D)
STUDY = """
name = "kept"
[[arm]]
name = "bellows"
kind = "bellows"
[[task]]
name = "bend"
shape = { kind = "affine", slope = -0.5, intercept = 0.5, nodes = 3 }
loads = [[0.0, -1.0, 0.0]]
"""


@cache
def optimised():
    return ta.optimise_design(ARM, TASK, objective=NEWTONS, starts=1, iterations=2)


def planned():
    tip = ta.poses(ta.affine_curvature(0.2, 0.8, nodes=4))[-1]
    return ta.plan_shape(ARM, tip, [0.0, -0.5, 0.0], nodes=4, starts=1)


def architectures():
    arm = ta.ArmDesign([-0.03, 0.03], 0.5, "bellows")
    return ta.optimise_architectures(arm, TASK, objective=NEWTONS, starts=1, iterations=2, models=["bellows"])


RESULTS = {
    "evaluation": lambda: ta.evaluate(ARM, TASK),
    "hulls": lambda: ta.wrench_hulls(ARM, TASK.twists),
    "capacity": lambda: ta.load_capacity(ARM, TASK),
    "equilibrium": lambda: ta.solve_equilibrium(ARM, [1.0, 2.0, 3.0, 4.0], TASK.tip_load, nodes=4),
    "prediction": lambda: ta.predict_error(ARM, TASK),
    "search": lambda: ta.search_pressure(ARM, TASK),
    "fit": lambda: ta.fit_pressure(ARM, TASK),
}
KEPT = RESULTS | {
    "evaluation of a series": lambda: ta.evaluate(
        ta.series([ARM, ta.RigidLink(0.1), ARM]), ta.Task(TASK.twists, [0.0, 1.0, 0.0], segment_nodes=(2, 2))
    ),
    "optimised design": optimised,
    "task errors": lambda: optimised().after,
    "verification": lambda: ta.verify_design(optimised(), TASK, starts=1),
    "architectures": architectures,
    "planned shape": planned,
    "distance to a hull": lambda: ta.distance_to_hull(torch.tensor([2.0, 0.5], dtype=D), SQUARE),
    "residuals": lambda: ta.kkt_residuals(SQUARE[0] + 2.0, SQUARE, torch.full((4,), 0.25, dtype=D)),
    "bellows": lambda: ta.Bellows(force_scale=torch.tensor(2.0, dtype=D)),
    "mckibben": lambda: ta.McKibben(bending_stiffness=ta.LinearBending(torch.tensor(-0.2, dtype=D))),
    "gridded": lambda: ta.GriddedActuator((0, 1), (0, 1), ((0, 1), (1, 2)), torch.tensor(1.0, dtype=D)),
    "constant bending": lambda: ta.ConstantBending(torch.tensor(-0.2, dtype=D)),
    "coefficients": lambda: TensorPolynomial(ta.Bellows(), ta.coefficient_tensor(ta.Bellows())),
    "named arm": lambda: NamedArm("a", ARM),
    "named task": lambda: NamedTask("t", TASK),
    "study": lambda: parse_study(STUDY),
    "study result": lambda: next(evaluate_study(parse_study(STUDY))),
}


@pytest.fixture(scope="module")
def make():
    """Each object, made once."""
    return cache(lambda name: KEPT[name]())


def tensors_of(value):
    """All public tensors in an object, by their paths; force models of an arm are left out, which stay as they are."""
    if isinstance(value, torch.Tensor):
        return {"": value}
    if isinstance(value, tuple):
        inner = dict(enumerate(value))
    elif dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        inner = {name: getattr(value, name) for name in names if name[0] != "_" and name != "actuators"}
    else:
        return {}
    return {f"{name}.{path}": tensor for name, item in inner.items() for path, tensor in tensors_of(item).items()}


@pytest.mark.parametrize("name", RESULTS)
def test_results_print_as_shapes_and_counts(make, name):
    found = make(name)
    assert repr(found).startswith(type(found).__name__ + "(")
    assert len(repr(found)) < 400
    assert "tensor(" not in repr(found)
    if name == "equilibrium":
        assert "converged (3,): 3 of 3" in repr(found)


@pytest.mark.parametrize("name", KEPT)
def test_what_holds_tensors_survives_pickle_and_torch_save(make, name):
    value = make(name)
    buffer = io.BytesIO()
    torch.save(value, buffer)
    buffer.seek(0)
    for other in (pickle.loads(pickle.dumps(value)), torch.load(buffer, weights_only=False)):
        assert repr(other) == repr(value)
        assert tensors_of(other).keys() == tensors_of(value).keys() != set()
        for path, tensor in tensors_of(value).items():
            torch.testing.assert_close(tensors_of(other)[path], tensor, rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize("name", KEPT)
def test_to_moves_every_tensor(make, name):
    value = make(name)
    before = tensors_of(value)
    for single in (value.to(torch.float32), value.to(dtype=torch.float32, device="cpu"), value.to(torch.zeros(1))):
        after = tensors_of(single)
        assert type(single) is type(value)
        assert after.keys() == before.keys()
        for path, tensor in before.items():
            real = tensor.is_floating_point()
            assert after[path].dtype == (torch.float32 if real else tensor.dtype), path
            assert after[path].requires_grad == tensor.requires_grad
            torch.testing.assert_close(after[path].to(tensor.dtype), tensor, rtol=1e-6, atol=1e-6, equal_nan=True)
    elsewhere = tensors_of(value.to(device="meta"))
    assert {tensor.device.type for tensor in elsewhere.values()} == {"meta"}
    assert {path: tensor.dtype for path, tensor in elsewhere.items()} == {
        path: tensor.dtype for path, tensor in before.items()
    }


def test_a_result_in_single_precision_still_answers(make):
    found, single = make("evaluation"), make("evaluation").to(torch.float32)
    assert np.array_equal(single.verdict, found.verdict)
    assert single.worst_node.equal(found.worst_node)
    assert single.task.twists.dtype == single.arm.radii.dtype == single.tip_error.dtype == torch.float32
    bent = make("equilibrium").to(torch.float32)
    assert bent.poses.dtype == torch.float32
    assert make("optimised design").to(torch.float32).best.radii.dtype == torch.float32
