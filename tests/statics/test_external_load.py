"""Loads carried to the nodes, in the plane and in space."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from oracle import spatial as scenes

import torcharm as ta
from torcharm.geometry import rod, se2, se3
from torcharm.statics.external_load import HULL, required_wrench, task_wrench

F64 = torch.float64
GROUPS = pytest.mark.parametrize("group", [se2, se3], ids=["plane", "space"])
PLACES = pytest.mark.parametrize("wrench_at", ["start", "middle"])
COUNTS = (4, 3)


def tensor(*values):
    return torch.tensor(values, dtype=F64)


def random(group, *shape, seed=0, scale=1.0):
    columns = 3 if group is se2 else 6
    generator = torch.Generator().manual_seed(seed)
    return scale * (2 * torch.rand(*shape, columns, dtype=F64, generator=generator) - 1)


def shape_of(group, *batch, nodes=7, seed=0):
    """Shapes of about half a metre, sheared and turned."""
    twists = random(group, *batch, nodes, seed=seed, scale=1.5)
    twists[..., : group.DIMENSION] *= 0.1
    twists[..., 0] += 0.5
    return twists


def wide(load):
    """A planar load as one of the plane z = 0 of space."""
    points = [
        ta.PointLoad(
            None if point.wrench is None else se3.vector_from_plane(point.wrench),
            point.segment,
            point.at,
            point.frame,
            point.mass,
        )
        for point in load.points
    ]
    return ta.ExternalLoad(None if load.tip is None else se3.vector_from_plane(load.tip), load.gravity, points)


def everything(group):
    """A load of each kind, at nodes, inside of elements and at segments' ends; and masses and links."""
    points = [
        ta.PointLoad(random(group, seed=1), 0, 0.37, "body", mass=0.1),
        ta.PointLoad(random(group, seed=2), 1, 0.9, "world"),
        ta.PointLoad(random(group, seed=3), 0, 0.5, "body"),
        ta.PointLoad(random(group, seed=4), 1, 0.0, "world", mass=0.2),
        ta.PointLoad(mass=0.3, at=1.0),
    ]
    load = ta.ExternalLoad(random(group, seed=5), True, points)
    link = ta.RigidLink(pose=group.exp(random(group, seed=6, scale=0.1)), mass=0.2)
    return load, {"segment_nodes": COUNTS, "mass": [0.4, 0.3], "links": [link, ta.RigidLink(0.05, mass=0.1)]}


@pytest.mark.parametrize("scene", scenes.SCENES, ids=lambda scene: scene.name)
def test_the_scenes_agree_with_the_oracle(scene):
    arm, task = scenes.arm_and_task(scene)
    np.testing.assert_allclose(task_wrench(arm, task), scenes.required_wrench(scene), rtol=0, atol=1e-12)
    links = [None if s.link is None else torch.from_numpy(s.link) for s in scene.segments]
    tip = rod.poses(task.twists, task.base_pose, segment_nodes=task.segment_nodes, links=links)[-1]
    np.testing.assert_allclose(tip, scenes.node_poses(scene)[-1], rtol=0, atol=1e-14)


# First node's wrenches of the scenes by an independent prototype, to its twelve digits.
KNOWN = (
    (2.0, -1.5, 1.0, -0.06263509278, -0.430278582559, -0.725147688279),
    (3.0, -4.0, 2.0, 0.518133678463, -0.475418991834, -1.72803850136),
    (-4.905, 0.0, 0.0, 0.0, 0.106044411846, -0.184358142145),
    (-4.9614200354, 3.05206424989, -4.26906360305, 0.077447985545, 1.34099361243, 0.394876465669),
    (1.0, -2.0, -3.0, 0.170696658334, 0.945108308111, -0.639839985962),
    (-3.6012, -1.0, 0.8, -0.172028425085, -0.321220562258, -0.543195440484),
    (-4.1692308427, -2.3577761442, -2.15278395963, -0.032401632761, 0.505374036561, -0.301461817305),
    (-2.0, -2.16568302441, -2.08562149917, -0.041072018497, 0.832715850552, -0.854064146064),
)


@pytest.mark.parametrize(("scene", "known"), list(zip(scenes.SCENES, KNOWN, strict=True)))
def test_the_first_nodes_wrench_is_the_prototypes(scene, known):
    np.testing.assert_allclose(task_wrench(*scenes.arm_and_task(scene))[0], known, rtol=0, atol=1e-11)


@GROUPS
def test_plain_statics_and_the_adjoint_form_agree(group):
    """Going from the tip, every element carries on what the next one felt, and adds what sits at its own end."""
    twists, tip, at_node = shape_of(group), random(group, seed=1), random(group, seed=2)
    base, link = group.exp(random(group, seed=3)), group.exp(random(group, seed=4))
    load = ta.ExternalLoad(tip, points=[ta.PointLoad(at_node, 0, 0.5, "body"), ta.PointLoad(at_node, 1, 1 / 3)])
    links = [ta.RigidLink(pose=link), None]
    found = required_wrench(twists, load, base, wrench_at="start", segment_nodes=COUNTS, links=links)
    step = group.exp(twists / tensor(4, 4, 4, 4, 3, 3, 3).unsqueeze(-1))
    pose = rod.poses(twists, base, segment_nodes=COUNTS, links=[link, None])
    felt, expected = group.turn_wrench_back(pose[7], tip), []
    for node in reversed(range(7)):
        felt = group.carry(group.compose(step[node], link) if node == 3 else step[node], felt)
        felt = felt + group.carry(step[node], at_node) if node == 1 else felt
        felt = felt + group.carry(step[node], group.turn_wrench_back(pose[5], at_node)) if node == 4 else felt
        expected.append(-felt)
    torch.testing.assert_close(found, torch.stack(expected[::-1]), rtol=0, atol=1e-14)


def scene_of_dead_loads(planar):
    """Three elements in gravity, with dead forces at the tip and on the way, and a link; in a plane or not."""
    kx, ky = ((0, 0), (0, 0)) if planar else ((0.3, -0.4), (0.8, 0.3))
    force = (2.0, -1.0, 0.0 if planar else 1.5, 0.0, 0.0, 0.0)
    link = scenes.expm(scenes.hat((0.03, 0.01, 0, 0, 0, 0.2) if planar else (0.03, 0.01, 0.02, 0.1, 0.3, 0.2)))
    lower = scenes.Segment("bb", np.zeros((2, 2)), 0.3, scenes.shape(0.3, 2, kx, ky, (1.0, 0.5)), mass=0.5, link=link)
    upper = scenes.Segment("bb", np.zeros((2, 2)), 0.2, scenes.shape(0.2, 1, kx, ky, (-0.5, 0.5)), mass=0.2)
    loads = (scenes.Load(force, 1), scenes.Load(force, 0, 0.5))
    return scenes.Scene("dead loads", (lower, upper), loads, gravity=True)


def with_twists(scene, twists):
    lower, upper = scene.segments
    return replace(scene, segments=(replace(lower, twists=twists[:2]), replace(upper, twists=twists[2:])))


@GROUPS
def test_the_wrenches_do_the_work_of_the_potential_energy(group):
    """Virtual work: energy changes by an element's mean wrench times the change of its twist.

    Positive work on the required wrench's side: raising a weight and pulling against a force both cost energy. The
    mean over an element is that of many parts, each taken in its middle; energies come from the oracle.
    """
    planar = group is se2
    scene = scene_of_dead_loads(planar)
    twists = np.concatenate([segment.twists for segment in scene.segments])
    axes = (0, 1, 5) if planar else range(6)
    slope, small = np.zeros((3, len(axes))), 1e-5
    for index, (element, axis) in enumerate(np.ndindex(3, len(axes))):
        change = np.zeros((3, 6))
        change[element, axes[axis]] = small
        energies = [scenes.potential_energy(with_twists(scene, twists + sign * change)) for sign in (1, -1)]
        slope.flat[index] = (energies[0] - energies[1]) / (2 * small)

    points = [tensor(*np.array(load.wrench)[list(axes)]) for load in scene.loads]
    load = ta.ExternalLoad(points[0], True, ta.PointLoad(points[1], 0, 0.5))
    pose = torch.from_numpy(scene.segments[0].link)
    if planar:
        pose = torch.stack((pose[0, 3], pose[1, 3], torch.atan2(pose[1, 0], pose[0, 0])))

    def mean(parts):
        wrench = required_wrench(
            torch.from_numpy(twists[:, axes]).repeat_interleave(parts, 0),
            load,
            segment_nodes=(2 * parts, parts),
            mass=[0.5, 0.2],
            links=[ta.RigidLink(pose=pose), None],
        )
        return wrench.unflatten(0, (3, parts)).mean(1) / tensor(2, 2, 1).unsqueeze(-1)

    # the error of the parts is of second order, and falls out of this combination
    np.testing.assert_allclose((4 * mean(200) - mean(100)) / 3, slope, rtol=0, atol=1e-8)


@pytest.mark.parametrize("at", [0.0, 0.15, 0.25, 0.5, 0.7, 1.0])
def test_the_mean_over_an_element_is_exact_for_stretch(at):
    """Hanging straight down, force and weight stretch the arm as they do a continuous one, for any number of nodes."""
    for nodes in (1, 2, 3, 7, 10):
        twists = tensor(0.4, 0.0, 0.0).expand(nodes, 3)
        point = ta.ExternalLoad(points=ta.PointLoad([0.0, -2.0, 0.0], at=at))
        found = required_wrench(twists, point)[:, 0].mean().item()
        assert found == pytest.approx(-2.0 * at, abs=1e-14)
        weight = ta.ExternalLoad(gravity=True)
        found = required_wrench(twists, weight, mass=0.5)[:, 0].mean().item()
        assert found == pytest.approx(-0.5 * 9.81 / 2, abs=1e-14)
        found = required_wrench(twists, weight, wrench_at="start", mass=0.5)[:, 0].mean().item()
        assert found == pytest.approx(-0.5 * 9.81 / 2 * (1 + 1 / nodes), abs=1e-14)


def deflection(load, nodes, wrench_at):
    """Sum over the nodes of moment times lever to the tip, what a straight cantilever's tip deflects by."""
    twists = tensor(1.0, 0.0, 0.0).expand(nodes, 3)
    moment = required_wrench(twists, load, torch.zeros(3, dtype=F64), wrench_at=wrench_at, mass=1.0)[:, 2]
    arc = (torch.arange(nodes, dtype=F64) + (0.5 if wrench_at == "middle" else 0.0)) / nodes
    return (moment * (1 - arc)).mean().item()


CANTILEVER = {
    "a force at the tip": (ta.ExternalLoad([0.0, -1.0, 0.0]), 1 / 3),
    "its own weight": (ta.ExternalLoad(gravity=True), 9.81 / 8),
    "a force inside": (ta.ExternalLoad(points=ta.PointLoad([0.0, -1.0, 0.0], at=0.37)), 0.37**2 / 2 - 0.37**3 / 6),
    "a force further out": (
        ta.ExternalLoad(points=ta.PointLoad([0.0, -1.0, 0.0], at=0.777)),
        0.777**2 / 2 - 0.777**3 / 6,
    ),
    "a moment inside": (ta.ExternalLoad(points=ta.PointLoad([0.0, 0.0, -1.0], at=0.37)), 0.37 - 0.37**2 / 2),
}


@pytest.mark.parametrize("case", CANTILEVER)
def test_the_middle_is_of_second_order_and_the_start_of_first(case):
    """Against the closed forms of a straight cantilever, `w/(3EI)`, `w/(8EI)` and their kin."""
    load, exact = CANTILEVER[case]
    counts = [5, 10, 20, 40, 80, 160]
    middle = [abs(deflection(load, nodes, "middle") - exact) / exact for nodes in counts]
    start = [abs(deflection(load, nodes, "start") - exact) / exact for nodes in counts]
    assert max(error * nodes**2 for error, nodes in zip(middle, counts, strict=True)) < 1.0
    assert max(error * nodes for error, nodes in zip(start, counts, strict=True)) < 4.0
    assert start[-1] * counts[-1] > 0.1
    assert middle[1] < 0.01


def elastic_tip(load, nodes, wrench_at):
    """The tip of a linearly elastic rod, stretching and bending, in balance with its loads by fixed points."""
    rest = tensor(0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    give = tensor(0.01, 0.0, 0.0, 0.0, 0.25, 0.25)
    twists = rest.expand(nodes, 6)
    for _ in range(100):
        before = twists
        twists = rest - give * required_wrench(twists, load, wrench_at=wrench_at, mass=0.2)
        if (twists - before).abs().max() < 1e-13:
            return rod.poses(twists)[-1, :3, 3]
    raise AssertionError("no balance found")


def test_an_elastic_rod_in_balance_converges_in_second_order():
    """All loads at once, at places that fall inside of elements; against 1280 elements."""
    points = [ta.PointLoad([0.3, 0.2, -0.2, 0.0, 0.02, 0.0], at=0.37, frame="body"), ta.PointLoad(mass=0.05, at=0.81)]
    load = ta.ExternalLoad([0.5, 0.3, 0.4, 0.0, 0.0, 0.05], True, points)
    exact = elastic_tip(load, 1280, "middle")
    errors = {
        wrench_at: [(elastic_tip(load, nodes, wrench_at) - exact).norm().item() for nodes in (10, 20, 40, 80)]
        for wrench_at in ("start", "middle")
    }
    assert math.log2(errors["middle"][0] / errors["middle"][-1]) / 3 > 1.8
    assert 0.8 < math.log2(errors["start"][0] / errors["start"][-1]) / 3 < 1.3
    assert errors["middle"][0] < 0.1 * errors["start"][0]


@PLACES
def test_the_plane_is_the_plane_z_0_of_space(wrench_at):
    load, rest = everything(se2)
    twists, base = shape_of(se2, 5), se2.exp(random(se2, 5, seed=9))
    planar = required_wrench(twists, load, base, wrench_at=wrench_at, **rest)
    links = [ta.RigidLink(pose=se3.from_plane(rest["links"][0].pose), mass=0.2), rest["links"][1]]
    spatial = required_wrench(
        se3.vector_from_plane(twists), wide(load), se3.from_plane(base), wrench_at=wrench_at, **{**rest, "links": links}
    )
    torch.testing.assert_close(spatial, se3.vector_from_plane(planar), rtol=0, atol=1e-12)
    hanging = required_wrench(twists, load, wrench_at=wrench_at, **rest)
    spatial = required_wrench(
        se3.vector_from_plane(twists), wide(load), wrench_at=wrench_at, **{**rest, "links": links}
    )
    torch.testing.assert_close(spatial, se3.vector_from_plane(hanging), rtol=0, atol=1e-12)
    assert planar[..., HULL[3]].shape[-1] == 2
    assert torch.equal(se3.vector_from_plane(planar)[..., HULL[6]][..., [0, 2]], planar[..., HULL[3]])


def moved(group, load, pose):
    """Dead wrenches of the load turned as the world is; what follows the body stays."""
    points = [
        ta.PointLoad(
            None
            if point.wrench is None
            else (group.turn_wrench(pose, point.wrench) if point.frame == "world" else point.wrench),
            point.segment,
            point.at,
            point.frame,
            point.mass,
        )
        for point in load.points
    ]
    return ta.ExternalLoad(group.turn_wrench(pose, load.tip), load.gravity, points)


@PLACES
@GROUPS
def test_the_frame_of_the_world_does_not_matter(group, wrench_at):
    """Base and dead loads turned and moved together; with gravity only about the vertical."""
    load, rest = everything(group)
    twists, base = shape_of(group), group.exp(random(group, seed=9))
    upright = random(group, seed=8)
    upright[group.DIMENSION :] = 0.0
    if group is se3:
        upright[4] = 2.0
    weightless = ta.ExternalLoad(load.tip, points=[point for point in load.points if not point.mass.any()])
    for one, change in ((load, group.exp(upright)), (weightless, group.exp(random(group, seed=7, scale=3.0)))):
        expected = required_wrench(twists, one, base, wrench_at=wrench_at, **rest)
        other = required_wrench(
            twists, moved(group, one, change), group.compose(change, base), wrench_at=wrench_at, **rest
        )
        torch.testing.assert_close(other, expected, rtol=0, atol=2e-14)


@PLACES
@GROUPS
def test_loads_add(group, wrench_at):
    load, rest = everything(group)
    twists = shape_of(group)
    parts = [ta.ExternalLoad(load.tip)]
    parts += [ta.ExternalLoad(points=ta.PointLoad(p.wrench, p.segment, p.at, p.frame)) for p in load.points[:4]]
    still = {"segment_nodes": COUNTS, "links": rest["links"]}
    masses = [ta.PointLoad(segment=p.segment, at=p.at, mass=p.mass) for p in load.points if p.mass.any()]
    total = required_wrench(twists, ta.ExternalLoad(gravity=True, points=masses), wrench_at=wrench_at, **rest)
    for part in parts:
        total = total + required_wrench(twists, part, wrench_at=wrench_at, **still)
    torch.testing.assert_close(total, required_wrench(twists, load, wrench_at=wrench_at, **rest), rtol=0, atol=1e-13)


@PLACES
@GROUPS
def test_a_point_load_at_the_end_is_a_tip_load(group, wrench_at):
    twists, wrench = shape_of(group), random(group, seed=1)
    point = ta.ExternalLoad(points=ta.PointLoad(wrench))
    found = required_wrench(twists, point, wrench_at=wrench_at)
    torch.testing.assert_close(found, required_wrench(twists, wrench, wrench_at=wrench_at), rtol=0, atol=1e-15)


@PLACES
@GROUPS
def test_a_payload_weighs_as_a_force_and_only_then(group, wrench_at):
    twists = shape_of(group)
    force = [0.0, -9.81 * 0.3, *[0.0] * (1 if group is se2 else 4)]
    mass = ta.ExternalLoad(gravity=True, points=ta.PointLoad(mass=0.3, at=0.4))
    expected = required_wrench(twists, ta.ExternalLoad(points=ta.PointLoad(force, at=0.4)), wrench_at=wrench_at)
    torch.testing.assert_close(required_wrench(twists, mass, wrench_at=wrench_at), expected, rtol=0, atol=1e-15)
    assert not required_wrench(twists, ta.ExternalLoad(), wrench_at=wrench_at, mass=0.4).any()


@GROUPS
@pytest.mark.parametrize(
    ("segment", "at", "first", "last"),
    [(0, 0.0, 0, 0), (0, 0.25, 0, 1), (0, 0.3, 0, 2), (0, 1.0, 0, 4), (1, 0.0, 0, 4), (1, 2 / 3, 0, 6), (1, 0.1, 0, 5)],
)
def test_a_load_is_carried_by_the_elements_before_it(group, segment, at, first, last):
    """At "start": on a node it is carried by those before the node, inside of an element by that one, too."""
    load = ta.ExternalLoad(points=ta.PointLoad(random(group, seed=1), segment, at))
    found = required_wrench(shape_of(group), load, wrench_at="start", segment_nodes=COUNTS)
    carries = (found != 0).any(-1).tolist()
    assert carries == [first <= node < last for node in range(7)]


def test_places_that_are_nodes_but_for_rounding_are_nodes():
    """0.7 times 10 is a little above 7 in floating point."""
    for nodes in (10, 30, 100):
        for k in range(1, nodes):
            load = ta.ExternalLoad(points=ta.PointLoad([1.0, 0.0, 0.0], at=k / nodes))
            found = required_wrench(tensor(0.5, 0.0, 0.0).expand(nodes, 3), load, wrench_at="start")
            assert (found != 0).any(-1).sum() == k


@PLACES
@GROUPS
def test_wrenches_change_smoothly_as_a_load_moves_across_a_node(group, wrench_at):
    """In the middle the element behind a node begins to carry as the load moves on; at the start it jumps in."""
    twists, wrench = shape_of(group, nodes=4), random(group, seed=1)

    def at(place):
        return required_wrench(twists, ta.ExternalLoad(points=ta.PointLoad(wrench, at=place)), wrench_at=wrench_at)

    jump = (at(0.5 + 1e-6) - at(0.5)).abs().max().item()
    assert (jump < 1e-4) == (wrench_at == "middle")
    assert (at(0.5 - 1e-6) - at(0.5)).abs().max().item() < 1e-4


@GROUPS
def test_the_middles_wrench_is_the_starts_of_half_elements(group):
    """For a tip load the middle of an element is the start of its second half."""
    twists, tip = shape_of(group), random(group, seed=1)
    halves = required_wrench(twists.repeat_interleave(2, 0), tip, wrench_at="start")
    torch.testing.assert_close(required_wrench(twists, tip), halves[1::2], rtol=0, atol=1e-14)


@GROUPS
def test_the_middle_carries_the_outer_half_of_the_elements_own_weight(group):
    twists, weight = shape_of(group), ta.ExternalLoad(gravity=True)
    halves = required_wrench(twists.repeat_interleave(2, 0), weight, wrench_at="start", mass=0.7)
    found = required_wrench(twists, weight, mass=0.7)
    torch.testing.assert_close(found, halves[1::2], rtol=0, atol=1e-14)


@PLACES
@GROUPS
def test_batches_broadcast_and_give_what_each_gives_alone(group, wrench_at):
    twists, base = shape_of(group, 3, 1, 1), group.exp(random(group, 2, 1, seed=9))
    tip, wrench, mass = random(group, 4, seed=1), random(group, 2, 1, seed=2), torch.rand(4, dtype=F64)
    link, own = torch.rand(3, 1, 1, dtype=F64), torch.rand(2, 1, dtype=F64)

    def load(tip, wrench, mass):
        points = [ta.PointLoad(wrench, 0, 0.37, "body"), ta.PointLoad(mass=mass, segment=1, at=0.5)]
        return ta.ExternalLoad(tip, True, points)

    def rest(own, link):
        links = [ta.RigidLink(link, mass=0.1), None]
        return {"wrench_at": wrench_at, "segment_nodes": COUNTS, "mass": [own, 0.2], "links": links}

    found = required_wrench(twists, load(tip, wrench, mass), base, **rest(own, link))
    assert found.shape == (3, 2, 4, 7, twists.shape[-1])
    for a, b, c in np.ndindex(3, 2, 4):
        one = load(tip[c], wrench[b, 0], mass[c])
        alone = required_wrench(twists[a, 0, 0], one, base[b, 0], **rest(own[b, 0], link[a, 0, 0]))
        # Vectors of other lengths are summed otherwise, which rounds otherwise.
        torch.testing.assert_close(found[a, b, c], alone, rtol=4e-15, atol=1e-14)


@PLACES
@GROUPS
def test_gradients_reach_every_input(group, wrench_at):
    twists, base = shape_of(group), random(group, seed=9)
    given = [
        twists,
        base,
        random(group, seed=1),
        random(group, seed=2),
        tensor(0.3)[0],
        tensor(0.4)[0],
        tensor(0.05)[0],
    ]
    given += [tensor(0.1)[0]]

    def wrenches(twists, base, tip, wrench, mass, own, length, link_mass):
        points = [ta.PointLoad(wrench, 0, 0.37, "body", mass)]
        links = [ta.RigidLink(length, mass=link_mass), None]
        load = ta.ExternalLoad(tip, True, points)
        return required_wrench(
            twists,
            load,
            group.exp(base),
            wrench_at=wrench_at,
            segment_nodes=COUNTS,
            mass=[own, 0.2],
            links=links,
        )

    inputs = tuple(value.clone().requires_grad_() for value in given)
    assert torch.autograd.gradcheck(wrenches, inputs, fast_mode=True)
    gradients = torch.autograd.grad(wrenches(*inputs).square().sum(), inputs)
    assert all(bool((gradient != 0).any()) for gradient in gradients)


@GROUPS
def test_a_mass_of_zero_has_a_gradient(group):
    mass = torch.zeros((), dtype=F64, requires_grad=True)
    found = required_wrench(shape_of(group), ta.ExternalLoad(gravity=True), mass=mass)
    assert torch.autograd.grad(found.square().sum() + found.sum(), mass)[0] != 0


def test_a_tasks_wrench_takes_place_masses_and_links_from_task_and_arm():
    scene = scenes.SCENES[6]
    arm, task = scenes.arm_and_task(scene, "middle")
    direct = required_wrench(
        task.twists,
        task.load,
        task.base_pose,
        wrench_at="middle",
        segment_nodes=(5, 6),
        mass=[0.3, 0.12],
        links=arm.links,
    )
    assert torch.equal(task_wrench(arm, task), direct)
    planar = ta.antagonistic_arm()
    plain = ta.Task(ta.affine_curvature(1.0, 1.0), [1.0, 2.0, 3.0])
    assert torch.equal(task_wrench(planar, plain), ta.required_wrench(plain.twists, plain.tip_load))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"load": torch.zeros(3)}, "load: must have shape"),
        ({"load": torch.zeros(5, 6)}, "twists, load: batch shapes"),
        ({"load": ta.ExternalLoad(points=ta.PointLoad(torch.ones(5, 6)))}, "twists, load: batch shapes"),
        ({"load": ta.ExternalLoad(torch.zeros(3))}, "load: must be of 6 components"),
        ({"load": ta.ExternalLoad(points=ta.PointLoad(torch.ones(6), 2))}, r"points\[0\].segment: must be below 2"),
        ({"wrench_at": "end"}, "wrench_at: must be one of start, middle"),
        ({"segment_nodes": (3, 3)}, "segment_nodes: must sum to the 7 rows"),
        ({"mass": [0.1]}, "mass: must be one for each of 2 segments, got 1"),
        ({"links": [None]}, "links: must be one for each of the 2 segments, got 1"),
    ],
)
def test_what_does_not_fit_is_named(change, words):
    given = {"load": ta.ExternalLoad(gravity=True), "segment_nodes": COUNTS, **change}
    with pytest.raises(ValueError, match=words):
        required_wrench(shape_of(se3, 2), **given)


def test_an_arm_and_a_task_that_do_not_fit_are_named():
    arm, task = scenes.arm_and_task(scenes.SCENES[5])
    with pytest.raises(ValueError, match="task: must be of the arm's dimension 2, got 3"):
        task_wrench(ta.antagonistic_arm(), task)
    with pytest.raises(ValueError, match="segment_nodes: must hold one number for each of 1 segments"):
        task_wrench(arm.segments[0], task)
