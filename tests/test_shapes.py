"""Ready shapes: planes of bending, helices by their Frenet frames, arcs by their ends."""

import math

import pytest
import torch

import torcharm as ta


def turned_about_backbone(twists, angle):
    """Twists of the same shape, with the arm turned about its backbone."""
    out = twists.clone()
    c, s = math.cos(angle), math.sin(angle)
    for y, z in ((1, 2), (4, 5)):
        out[..., y], out[..., z] = c * twists[..., y] - s * twists[..., z], s * twists[..., y] + c * twists[..., z]
    return out


@pytest.mark.parametrize(
    "made",
    [
        ta.constant_curvature,
        lambda *a, **k: ta.affine_curvature(-1.5, *a, **k),
        lambda *a, **k: ta.cubic_curvature(1.0, 2.0, -3.0, *a, **k),
    ],
)
def test_direction_0_is_the_plane_and_others_are_turned_about_the_backbone(made):
    flat, space = made(0.7, length=0.4, nodes=6), made(0.7, length=0.4, nodes=6, direction=0.0)
    assert space.shape == (6, 6)
    assert torch.equal(space[:, [0, 1, 5]], flat)
    assert (space[:, 2:5] == 0).all()
    assert torch.allclose(made(0.7, length=0.4, nodes=6, direction=1.1), turned_about_backbone(space, 1.1), atol=1e-15)


def test_an_arm_bends_towards_the_direction():
    for angle in (0.0, 0.8, 2.5, -1.9):
        tip = ta.poses(ta.constant_curvature(0.6, direction=angle), torch.eye(4, dtype=torch.float64))[-1, :3, 3]
        assert math.atan2(tip[2], tip[1]) == pytest.approx(angle, abs=1e-12)


def test_batches_broadcast():
    angle = torch.linspace(0, 6, 5, dtype=torch.float64)
    assert ta.constant_curvature([[0.1], [0.2]], nodes=4, direction=angle).shape == (2, 5, 4, 6)
    assert ta.helix(0.5, [1.0, 2.0, 3.0], nodes=4).shape == (3, 4, 6)


def test_a_helix_has_its_curvature_and_torsion():
    """By differences of the centreline: `κ = |t'|`, `τ = -b'·n` of the Frenet frame."""
    bend, turn, length, nodes = 2.0, 3.0, 0.7, 4000
    place = ta.poses(ta.helix(bend, turn, length, nodes))[:, :3, 3]
    step = length / nodes
    tangent = place.diff(dim=0) / step
    curve = tangent.diff(dim=0) / step
    assert torch.allclose(curve.norm(dim=-1), torch.full((nodes - 1,), bend / length, dtype=torch.float64), rtol=1e-5)
    normal = curve / curve.norm(dim=-1, keepdim=True)
    middle = 0.5 * (tangent[1:] + tangent[:-1])
    binormal = torch.linalg.cross(middle / middle.norm(dim=-1, keepdim=True), normal)
    torsion = -(binormal.diff(dim=0) / step * 0.5 * (normal[1:] + normal[:-1])).sum(-1)
    assert torch.allclose(torsion, torch.full_like(torsion, turn / length), rtol=1e-4)


def test_a_helix_does_not_twist_and_without_torsion_is_an_arc():
    assert (ta.helix(1.0, 4.0)[:, 3] == 0).all()
    assert torch.equal(ta.helix(1.0, 0.0, 0.4, 8, 0.3), ta.constant_curvature(1.0, 0.4, 8, 0.3))


@pytest.mark.parametrize("tip", [(0.2, -0.3), (-0.1, 0.2), (0.0, -0.5), (0.3, 0.0)])
def test_an_arc_of_the_plane_ends_at_its_tip(tip):
    twists = ta.arc_to(tip, nodes=7)
    assert twists.shape == (7, 3)
    assert torch.allclose(ta.poses(twists)[-1, :2], torch.tensor(tip, dtype=torch.float64), atol=1e-14)


def test_arcs_of_space_end_at_their_tips_from_any_base():
    generator = torch.Generator().manual_seed(0)
    tips = torch.randn(20, 3, generator=generator, dtype=torch.float64)
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    base = torch.eye(4, dtype=torch.float64)
    base[:3, :3], base[:3, 3] = turn * torch.linalg.det(turn), torch.tensor([0.1, -0.2, 0.3])
    twists = ta.arc_to(tips, nodes=5, base_pose=base)
    assert twists.shape == (20, 5, 6)
    assert torch.allclose(ta.poses(twists, base)[:, -1, :3, 3], tips, atol=1e-13)
    assert (twists[..., 3] == 0).all()


def test_an_arc_has_gradients():
    tip = torch.tensor([0.2, -0.3, 0.1], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(ta.arc_to, (tip,))


@pytest.mark.parametrize("tip", [(0.4, 0.0), (0.4, 0.0, 0.0)])
def test_an_arc_straight_ahead_has_the_gradients_of_its_neighbours(tip):
    def slopes(point):
        point = torch.tensor(point, dtype=torch.float64, requires_grad=True)
        twists = ta.arc_to(point, 1, "horizontal")[0]
        return torch.stack(
            [torch.autograd.grad(entry, point, retain_graph=True)[0] for entry in twists if entry.requires_grad]
        )

    there, beside = slopes(tip), slopes((tip[0], 1e-7, *tip[2:]))
    assert torch.allclose(there, beside[: len(there)], atol=1e-5)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: ta.constant_curvature(math.nan), "curvature"),
        (lambda: ta.constant_curvature(1.0, direction=math.inf), "direction"),
        (lambda: ta.constant_curvature(1.0, length=-0.1), "length"),
        (lambda: ta.helix(1.0, math.nan), "torsion"),
        (lambda: ta.helix(1.0, 1.0, nodes=0), "nodes"),
        (lambda: ta.arc_to([0.0, 0.0]), "tip"),
        (lambda: ta.arc_to([0.0, 0.3]), "tip"),
        (lambda: ta.arc_to([0.0, 0.3, 0.1, 0.1]), "tip"),
        (lambda: ta.arc_to([0.1, 0.3], base_pose=torch.eye(4)), "base_pose"),
        (lambda: ta.sample_loads(3, scale=(1.0, 1.0)), "scale"),
    ],
)
def test_bad_input_names_the_field(call, field):
    with pytest.raises(ValueError, match=f"^{field}:"):
        call()


def test_loads_of_space_have_six_components():
    loads = ta.sample_loads(50, scale=(2.0, 2.0, 2.0, 0.2, 0.2, 0.4))
    assert loads.shape == (50, 6)
    assert (loads.abs() <= torch.tensor([1.0, 1.0, 1.0, 0.1, 0.1, 0.2], dtype=torch.float64)).all()
    assert loads.std(0).min() > 0.02
