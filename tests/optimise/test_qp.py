"""Batched quadratic programs, against scipy's and their optimality conditions."""

import numpy as np
import pytest
import torch
from scipy.optimize import minimize

from torcharm.optimise import qp


def _problems(size: int, free: int, constraints: int, seed: int) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    rows = draw(size, constraints, free)
    box = torch.eye(free, dtype=torch.float64).expand(size, free, free)
    rows = torch.cat((rows / rows.norm(dim=-1, keepdim=True), box, -box), 1)
    room = 0.3 * torch.rand(size, constraints + 2 * free, generator=generator, dtype=torch.float64)
    root = draw(size, free, free)
    spread = torch.logspace(-3, 3, free, dtype=torch.float64)
    return (root * spread) @ root.mT, 10 * draw(size, free), rows, room


def test_solutions_meet_the_optimality_conditions() -> None:
    hessian, gradient, rows, room = _problems(200, 6, 20, seed=0)
    found = qp.solve(hessian, gradient, rows, room)
    assert bool(found.converged.all())
    slack = room - (rows @ found.step.unsqueeze(-1)).squeeze(-1)
    left = (hessian @ found.step.unsqueeze(-1) + rows.mT @ found.multipliers.unsqueeze(-1)).squeeze(-1) + gradient
    size = hessian.abs().amax((-1, -2))
    assert float(slack.min()) > -1e-9
    assert float((left.abs().amax(-1) / size).max()) < 1e-7
    assert float(found.multipliers.min()) >= 0
    assert float(((found.multipliers * slack).abs().amax(-1) / size).max()) < 1e-7


def test_projection_is_the_nearest_point_by_scipy() -> None:
    _, point, rows, bound = _problems(5, 4, 10, seed=1)
    found = point + qp.project(point, rows, bound).step
    for index in range(len(point)):
        matrix, limit, target = rows[index].numpy(), bound[index].numpy(), point[index].numpy()
        answer = minimize(
            lambda x, target=target: float(((x - target) ** 2).sum()),
            np.zeros(4),
            jac=lambda x, target=target: 2 * (x - target),
            constraints={"type": "ineq", "fun": lambda x, m=matrix, b=limit: b - m @ x, "jac": lambda x, m=matrix: -m},
            method="SLSQP",
            options={"ftol": 1e-15},
        )
        np.testing.assert_allclose(found[index].numpy(), answer.x, atol=1e-7)


def test_a_start_outside_comes_back_in() -> None:
    _, point, rows, bound = _problems(50, 5, 10, seed=2)
    far = 100 * point
    inside = far + qp.project(far, rows, bound).step
    assert float(((rows @ inside.unsqueeze(-1)).squeeze(-1) - bound).max()) < 1e-7


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_the_size_of_the_model_does_not_matter(scale: float) -> None:
    hessian, gradient, rows, room = _problems(20, 4, 8, seed=3)
    alone = qp.solve(hessian, gradient, rows, room).step
    torch.testing.assert_close(qp.solve(scale * hessian, scale * gradient, rows, room).step, alone, atol=1e-7, rtol=0)


def test_a_batch_is_its_problems_one_by_one() -> None:
    hessian, gradient, rows, room = _problems(8, 5, 12, seed=4)
    whole = qp.solve(hessian, gradient, rows, room).step
    for index in range(8):
        one = slice(index, index + 1)
        torch.testing.assert_close(
            qp.solve(hessian[one], gradient[one], rows[one], room[one]).step, whole[one], atol=1e-8, rtol=0
        )


@pytest.mark.parametrize("seed", range(5))
def test_one_by_one_and_in_a_batch_the_answers_are_the_same(seed: int) -> None:
    hessian, gradient, rows, room = _problems(40, 6, 20, seed)
    hessian = hessian + torch.eye(6, dtype=torch.float64)
    room[::2] -= 0.1  # some starts are outside
    feasible = qp.project(torch.zeros_like(gradient), rows, room).converged
    few = [qp.solve(hessian[i : i + 1], gradient[i : i + 1], rows[i : i + 1], room[i : i + 1]) for i in range(40)]
    many = qp.solve(hessian, gradient, rows, room)
    alone = torch.cat([one.step for one in few])
    both = feasible & many.converged & torch.cat([one.converged for one in few])
    assert int(both.sum()) >= 20
    torch.testing.assert_close(alone[both], many.step[both], rtol=1e-5, atol=1e-5)

    def value(step: torch.Tensor) -> torch.Tensor:
        return 0.5 * torch.einsum("si,sij,sj->s", step, hessian, step) + (gradient * step).sum(-1)

    assert bool((value(alone) <= value(many.step) + 1e-6 * (1 + value(many.step).abs()))[both].all())
    outside = ((rows @ alone.unsqueeze(-1)).squeeze(-1) - room).amax(-1)
    assert float(outside[both].max()) < 1e-10


def test_what_cannot_be_met_is_flagged() -> None:
    eye, zero = torch.eye(2).double()[None], torch.zeros(1, 2).double()
    rows = torch.tensor([[[1.0, 0.0], [-1.0, 0.0]]]).double()
    assert not bool(qp.solve(eye, zero, rows, torch.tensor([[-1.0, -1.0]]).double()).converged)
