"""Machine code against what it stands for: the same numbers, one element after the other."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import torcharm as ta
from torcharm import _box, mechanics
from torcharm._continuation import Problem, can_compile, loaded, settle, solved, unloaded
from torcharm.engine.forces import muscle
from torcharm.kernels.arms import arms_of
from torcharm.kernels.box import box_step
from torcharm.kernels.march import BY_LOAD, NONE, imbalance, look, moves, new_march, solve

ODD = ta.PolynomialActuator(((0, 1, 2.0), (1, 0, -30.0), (2, 4, 1e-6)), (-0.5, 1.0), (0.0, 40.0), 40.0, 0.0, 1.5)
STILL = ta.PolynomialActuator(((1, 0, -200.0),), (-0.5, 1.0), (0.0, 40.0), 40.0)
ARMS = {
    "antagonistic": ta.antagonistic_arm(),
    "bellows": ta.bellows_arm(),
    "muscles": ta.mckibben_arm(),
    "mixed": ta.ArmDesign(
        [-0.05, 0.0, 0.02, 0.06, 0.07], 0.4, [ODD, ta.McKibben(force_scale=0.5), STILL, ta.Bellows(), ODD]
    ),
    "one": ta.ArmDesign([0.03], 0.5, [STILL]),
}


def problem_of(arm, pressure, load, base=(0.1, -0.2, -1.5)):
    count = len(pressure)
    designs = ta.ArmDesign(
        arm.radii.expand(count, -1), arm.length.expand(count, -1), arm.actuators, arm.max_pressure.expand(count, -1)
    )
    return Problem.of(designs, pressure, load, torch.tensor([base] * count).double(), None, 1e-10)


def random_problem(arm, count, seed, force=20.0):
    draw = torch.Generator().manual_seed(seed)
    pressure = arm.max_pressure * torch.rand(count, len(arm.actuators), generator=draw).double()
    scale = torch.tensor([force, force, 2.0]).double()
    return problem_of(arm, pressure, (torch.rand(count, 3, generator=draw).double() - 0.5) * scale)


@pytest.mark.parametrize("nodes", [1, 2, 10])
@pytest.mark.parametrize("name", ARMS)
def test_the_march_of_one_is_that_of_a_batch(name, nodes):
    arm, count = ARMS[name], 12
    problem, draw = random_problem(arm, count, nodes), torch.Generator().manual_seed(1)
    z = torch.rand(2, nodes, count, generator=draw).double() * torch.tensor([0.3, 8.0]).view(2, 1, 1)
    z = z + torch.tensor([0.3, -4.0]).view(2, 1, 1)
    z[1, :, 0], z[1, :, 1] = 0.0, 1e-9
    share, limits = torch.rand(count, generator=draw).double(), arm.max_pressure.expand(count, -1).mT.contiguous()
    wanted = mechanics.march(
        problem.arms, z, problem.pressure.mT, share, each_pressure=limits, load=problem.arms.tip_load
    )
    arms = arms_of(problem.arms, problem.scale, limits, 1e-10)
    march = new_march(arms, nodes)
    for at in range(count):
        one, pressure = np.ascontiguousarray(z[:, :, at].numpy()), problem.pressure[at].numpy()
        force, moment = look(arms, at, one, pressure, float(share[at]), True, march)
        sides, sign = solve(arms, at, one, pressure, float(share[at]), BY_LOAD, True, True, 0.0, 0.0, march)
        assert sides == 3 + len(arm.actuators)
        assert sign == wanted.sign[at]
        np.testing.assert_allclose([force, moment], [wanted.force[at], wanted.moment[at]], rtol=1e-12)
        for mine, other in (
            (march.change[1:], wanted.change[..., at].permute(2, 0, 1)),
            (march.turned[1:], wanted.turned[..., at].mT),
            (march.slid[1:], wanted.slid[..., at].permute(2, 0, 1)),
            (march.pose, torch.cat((wanted.position[..., at], wanted.heading[None, :, at]))),
        ):
            scale = float(other.abs().max())
            np.testing.assert_allclose(mine, other.numpy(), rtol=1e-9, atol=1e-11 * scale)
        size = problem.scale.moves(wanted.change[:, :, :1], wanted.turned[:, :1])[0, at]
        np.testing.assert_allclose(moves(arms, at, march.change[1], march.turned[1]), size, rtol=1e-9)
        np.testing.assert_allclose(imbalance(arms, at, force, moment), problem.scale.imbalance(wanted)[at], rtol=1e-12)


def test_what_is_no_number_stays_none():
    arm, problem = ARMS["antagonistic"], random_problem(ARMS["antagonistic"], 1, 0)
    arms = arms_of(problem.arms, problem.scale, arm.max_pressure.unsqueeze(-1), 1e-10)
    march, z = new_march(arms, 3), np.full((2, 3), 0.5)
    z[1, 1] = np.nan
    force, moment = look(arms, 0, z, problem.pressure[0].numpy(), 1.0, False, march)
    solve(arms, 0, z, problem.pressure[0].numpy(), 1.0, NONE, False, False, 0.0, 0.0, march)
    assert np.isnan(imbalance(arms, 0, force, moment))
    assert np.isnan(moves(arms, 0, march.change[1], march.turned[1]))


def test_a_muscle_at_every_branch():
    strain = torch.tensor(
        [-0.6, -0.4, -0.303225592, -0.29, -0.274484489, -0.2, -0.1, -1e-3, 0.0, 1e-3, 0.05, 0.2]
    ).double()
    pressure = torch.tensor([0.0, 1e-31, 1e-3, 1.0, 20.0, 49.0, 100.0]).double()
    grid = torch.cartesian_prod(strain, pressure)
    model = ta.McKibben()
    force, slope, rate = model.force_slopes(grid[:, 0], grid[:, 1])
    for (x, p), *wanted in zip(grid.tolist(), force, slope, rate, strict=True):
        found = muscle(x, p, float(np.log(max(p, 1e-30))))
        np.testing.assert_allclose(
            [-value for value in found], [float(value) for value in wanted], rtol=1e-12, atol=1e-12
        )


@settings(max_examples=200, deadline=None)
@given(st.integers(1, 6), st.integers(0, 10**6), st.sampled_from([1e-12, 1e-2, 1.0, 1e5]))
def test_steps_in_the_box(size, seed, damping):
    draw = torch.Generator().manual_seed(seed)
    columns = torch.randn(size + seed % 3 - 1, size, generator=draw).double()
    normal, gradient = columns.mT @ columns, torch.randn(size, generator=draw).double()
    place = (2 * torch.rand(size, generator=draw).double() - 0.5).clamp(0, 1)
    if damping < 1e-3:  # regular without damping
        normal = normal + torch.eye(size).double()
    wanted = _box.box_step(
        normal.unsqueeze(-1), gradient.unsqueeze(-1), place.unsqueeze(-1), torch.tensor([damping]).double()
    )
    step = np.empty(size)
    box_step(normal.numpy(), gradient.numpy(), place.numpy(), damping, step)
    np.testing.assert_allclose(step, wanted[:, 0].numpy(), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_equilibria_along_paths_and_let_go(name):
    problem = random_problem(ARMS[name], 300, 3, force=60.0)  # some snap
    compiled = replace(problem, compiled=True)
    rest, other = unloaded(problem), unloaded(compiled)
    assert torch.equal(rest.arrived, other.arrived)
    torch.testing.assert_close(rest.unknowns, other.unknowns, rtol=0, atol=1e-9)
    start = rest.unknowns.expand(-1, -1, 8).contiguous()
    path, other = loaded(problem, start), loaded(compiled, start)
    assert torch.equal(path.arrived, other.arrived)
    torch.testing.assert_close(path.unknowns[path.arrived], other.unknowns[path.arrived], rtol=0, atol=1e-9)
    rest, other = settle(problem, start), settle(compiled, start)
    assert torch.equal(rest.arrived, other.arrived)
    torch.testing.assert_close(rest.unknowns[rest.arrived], other.unknowns[rest.arrived], rtol=0, atol=1e-7)
    plain, found = solved(problem, 8), solved(compiled, 8)
    assert torch.equal(plain.continued, found.continued)
    # a lone actuator that is let go may need all of the steps, and rounding decides
    assert int((plain.converged != found.converged).sum()) <= (name == "one")
    both = plain.converged & found.converged
    torch.testing.assert_close(found.unknowns[both], plain.unknowns[both], rtol=0, atol=1e-6)
    assert float(found.residual[found.converged].max()) <= 1e-10


SHAPE = ta.affine_curvature(-3.0, 3.0, nodes=6)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("error_weights", [(1.0, 1.0, 0.05), (1.0, 0.2, 0.0)])
def test_a_search_is_the_same(name, error_weights):
    task = ta.Task(SHAPE, ta.sample_loads(6))
    options = {"error_weights": error_weights, "starts": 4, "hops": 3}
    plain = ta.search_pressure(ARMS[name], task, **options)
    found = ta.search_pressure(ARMS[name], task, compiled=True, **options)
    if name == "one":  # resists no bending at rest: rounding decides where its paths begin
        assert (found.cost <= 1.01 * plain.cost + 1e-9).all()
    else:
        torch.testing.assert_close(found.cost, plain.cost, rtol=1e-7, atol=1e-10)
        torch.testing.assert_close(found.start_cost, plain.start_cost, rtol=1e-5, atol=1e-9)
    assert (found.residual <= 1e-10).all()
    there = ta.solve_equilibrium(ARMS[name], found.pressure, task.tip_load, 6)
    sure = found.continued & there.continued
    torch.testing.assert_close(there.twists[sure], found.twists[sure], rtol=0, atol=1e-7)


def test_threads_make_no_difference():
    task, threads = ta.Task(SHAPE, ta.sample_loads(40)), torch.get_num_threads()
    found = []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            found.append(ta.search_pressure(ARMS["antagonistic"], task, starts=2, hops=1, compiled=True))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(found[0].pressure, found[1].pressure)
    assert torch.equal(found[0].twists, found[1].twists)


class Spring(ta.Bellows):
    """A bellows of one's own."""

    def force(self, strain, pressure):
        return super().force(strain, pressure) - 5.0 * strain


class Twice(ta.Bellows):
    """The same force, by slopes of one's own."""

    def force_slopes(self, strain, pressure, by_pressure=True):
        return super().force_slopes(strain, pressure, by_pressure)


def test_what_the_kernels_do_not_know_is_searched_without_them():
    load = ta.sample_loads(2)
    soft = ta.Bellows(bending_stiffness=ta.ConstantBending(-0.2))
    cases = (
        (ta.ArmDesign([-0.05, 0.05], 0.5, [Spring(), ta.Bellows()]), load, {}),
        (ta.ArmDesign([-0.05, 0.05], 0.5, [Twice(), ta.Bellows()]), load, {}),
        (ta.ArmDesign([-0.05, 0.05], 0.5, [soft, ta.Bellows()]), load, {}),
        (ARMS["bellows"], load, {"shear_stiffness": 1e5}),
        (
            ta.ArmDesign(ARMS["bellows"].radii.float(), ARMS["bellows"].length.float(), ARMS["bellows"].actuators),
            load.float(),
            {},
        ),
    )
    for arm, loads, options in cases:
        task = ta.Task(SHAPE.to(loads), loads)
        plain = ta.search_pressure(arm, task, starts=2, hops=0, **options)
        found = ta.search_pressure(arm, task, starts=2, hops=0, compiled=True, **options)
        assert torch.equal(plain.pressure, found.pressure)
    pressure = torch.zeros(1, 2).double()
    assert not can_compile(problem_of(cases[0][0], pressure, load[:1]))
    assert can_compile(problem_of(ta.ArmDesign([-0.05, 0.05], 0.5, [ta.Bellows(), ta.McKibben()]), pressure, load[:1]))


@dataclass(frozen=True)
class Own:
    """A model that borrows its force."""

    force: object
    bending_stiffness: float = -0.2
    max_pressure: float = 50.0
    strain_range: tuple[float, float] = (-0.2, 0.7)
    pressure_range: tuple[float, float] = (0.0, 92.0)


class Borrowed:
    """Another, as a method."""

    force, force_scale, bending_stiffness = ta.McKibben.force, 1.0, -0.2
    max_pressure, strain_range, pressure_range = 50.0, (-0.2, 0.7), (0.0, 92.0)


@pytest.mark.parametrize("model", [Own(ta.Bellows().force), Borrowed()])
def test_a_borrowed_force_is_not_known(model):
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [model] * 2)
    kind = ta.Bellows if isinstance(model, Own) else ta.McKibben
    known = kind(bending_stiffness=model.bending_stiffness, max_pressure=model.max_pressure)
    plain = ta.solve_equilibrium(ta.ArmDesign([-0.05, 0.05], 0.5, [known] * 2), [25.0, 25.0], [1.0, 2.0, 0.1])
    found = ta.solve_equilibrium(arm, [25.0, 25.0], [1.0, 2.0, 0.1])
    assert found.converged
    torch.testing.assert_close(plain.twists, found.twists, rtol=0, atol=1e-8)


@pytest.mark.parametrize("model", [ta.McKibben(), ta.Bellows()])
def test_actuators_at_one_offset_that_resist_no_bending_at_rest(model):
    draw = torch.Generator().manual_seed(0)
    load = torch.randn(10, 3, generator=draw).double() * torch.tensor([1.0, 1.0, 0.1]).double()
    task = ta.Task(ta.affine_curvature(1.0, 1.5, nodes=4), load)
    for count in (1, 2):
        arm = ta.ArmDesign([0.03] * count, 0.5, [model] * count)
        plain, found = (ta.search_pressure(arm, task, starts=3, compiled=way) for way in (False, True))
        assert int(found.converged.sum()) >= int(plain.converged.sum()) - 2
        assert (found.cost <= 1.01 * plain.cost + 1e-9).all()


def test_where_code_is_kept(tmp_path, monkeypatch):
    from torcharm import _compiled

    told, blocked = tmp_path / "told", tmp_path / "file"
    blocked.write_text("")
    for value, home, wanted in ((told, tmp_path, told), (blocked, tmp_path, None), (blocked, blocked, None)):
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(value))
        monkeypatch.setenv("HOME", str(home))
        _compiled._folder.cache_clear()
        folder = _compiled._folder()
        assert folder is not None  # beside the sources, if nowhere else
        assert folder.endswith(f"torcharm-{_compiled._version()}")
        assert wanted is None or folder.startswith(str(wanted))
    with monkeypatch.context() as patch:  # nowhere to write
        patch.setattr(_compiled.Path, "mkdir", refuse)
        _compiled._folder.cache_clear()
        assert _compiled._folder() is None
        square = _compiled.jit(lambda x: x * x)
        assert square(3.0) == 9.0
    _compiled._folder.cache_clear()


def refuse(*_, **__):
    raise PermissionError("read-only")


def test_code_on_disk_is_of_these_sources(tmp_path, monkeypatch):
    """A change of what a kernel calls, or of a constant, makes it another."""
    from torcharm import _compiled

    before = _compiled._version()
    copy = tmp_path / "torcharm"
    (copy / "kernels").mkdir(parents=True)
    for path in ("_compiled.py", "kernels/march.py"):
        (copy / path).write_bytes((_compiled.Path(_compiled.__file__).parent / path).read_bytes())
    monkeypatch.setattr(_compiled, "__file__", str(copy / "_compiled.py"))
    versions = [before]
    for text in ("", "# changed"):
        _compiled._version.cache_clear()
        (copy / "kernels" / "march.py").write_text(text)
        versions.append(_compiled._version())
    _compiled._version.cache_clear()
    assert len(set(versions)) == 3
