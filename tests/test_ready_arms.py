"""Ready arms in space, against their published dimensions."""

import math

import pytest
import torch

import torcharm as ta


def test_a_ring_of_two_is_the_papers_arm():
    arm = ta.antagonistic_ring(count=2)
    torch.testing.assert_close(arm.offsets[:, 0], torch.tensor([0.08, -0.08, 0.015, -0.015]).double())
    assert arm.offsets[:, 1].abs().max() < 1e-16
    assert arm.actuators == (ta.Bellows(), ta.Bellows(), ta.McKibben(), ta.McKibben())
    assert ta.antagonistic_ring(torch.tensor([0.05, 0.06])).batch_shape == (2,)
    with pytest.raises(ValueError, match="outer_radius: must be finite"):
        ta.antagonistic_ring(math.nan)


def test_the_module_resists_as_its_section_integrated_on_a_grid():
    """Area and second moments by counting the points of a grid that lie in silicone, about both axes."""
    (body,), (end,) = ta.silicone_module().segments, ta.silicone_module().links
    *holes, core = body.actuators
    step = 2e-5
    line = torch.arange(-13e-3, 13e-3, step).double()
    y, z = torch.meshgrid(line, line, indexing="ij")
    radius = (y**2 + z**2).sqrt()
    solid = (radius > 4.5e-3) & (radius < 12.5e-3)
    for one, other in body.offsets[:6].tolist():
        assert math.hypot(one, other) == pytest.approx(8.5e-3)
        solid &= (y - one) ** 2 + (z - other) ** 2 > 2.5e-3**2
    area = float(solid.sum()) * step**2
    assert core.force_scale == pytest.approx(120e3 * area, rel=2e-3)
    for across in (y, z):
        second = float((across[solid] ** 2).sum()) * step**2
        assert -core.bending_stiffness.stiffness == pytest.approx(120e3 * second, rel=5e-3)
    assert body.mass.item() == pytest.approx(1820 * area * 44e-3, rel=2e-3)
    assert [hole.force_scale for hole in holes] == pytest.approx([math.pi * 2.5e-3**2] * 6)
    assert (end.length.item(), end.mass.item()) == (14.5e-3, 13.47e-3)


def test_the_arm_of_two_segments_has_the_sections_counted_on_a_grid():
    """Half discs on a triangle, by the points of a grid that lie in silicone; masses and lengths as published."""
    arm = ta.silicone_arm()
    for segment, radius, modulus in zip(arm.segments, (15.75e-3, 11.95e-3), (35e3, 40e3), strict=True):
        *holes, core = segment.actuators
        step, base = 5e-5, radius / math.sqrt(3)
        line = torch.arange(-1.8 * radius, 1.8 * radius, step).double()
        y, z = torch.meshgrid(line, line, indexing="ij")
        inside, chambers, triangle = torch.zeros_like(y, dtype=bool), [], torch.ones_like(y, dtype=bool)
        for y0, z0 in segment.offsets[:3].tolist():
            away = math.hypot(y0, z0)
            out = (y * y0 + z * z0) / away - base  # from the triangle's side
            along = (y * z0 - z * y0) / away
            triangle &= out <= 0
            inside |= (out >= 0) & (out**2 + along**2 < radius**2)
            chambers.append((out > 2e-3) & (out**2 + along**2 < (radius - 2e-3) ** 2))
            assert float(y[chambers[-1]].mean()) == pytest.approx(y0, abs=2e-4)
            assert float(z[chambers[-1]].mean()) == pytest.approx(z0, abs=2e-4)
        solid = (inside | triangle) & ~(chambers[0] | chambers[1] | chambers[2])
        area = float(solid.sum()) * step**2
        assert core.force_scale == pytest.approx(4 * modulus * area, rel=5e-3)
        for across in (y, z):
            second = float((across[solid] ** 2).sum()) * step**2
            assert -core.bending_stiffness.stiffness == pytest.approx(4 * modulus * second, rel=5e-3)
        assert [hole.force_scale for hole in holes] == pytest.approx([float(chambers[0].sum()) * step**2] * 3, rel=1e-2)
    assert [segment.mass.item() for segment in arm.segments] == [0.160, 0.082]
    assert [(link.length.item(), link.mass.item()) for link in arm.links] == [(0.02, 0.020), (0.02, 0.023)]


def test_the_arm_of_two_segments_hangs_under_its_weight_and_bends_towards_what_is_not_pushed():
    """Straight at rest, stretched by what it bears: half of its own weight in the mean, and all below in full."""
    arm = ta.silicone_arm()
    rest = ta.solve_equilibrium(arm, [0.0] * 8, ta.ExternalLoad(gravity=True), nodes=4)
    stiff = [segment.actuators[-1].force_scale for segment in arm.segments]
    borne = (0.160 / 2 + 0.020 + 0.082 + 0.023, 0.082 / 2 + 0.023)
    grown = [1 + 9.81 * kg / axial for kg, axial in zip(borne, stiff, strict=True)]
    assert rest.poses[-1, 1, 3].item() == pytest.approx(-(0.125 * sum(grown) + 0.04), abs=1e-6)
    bent = ta.solve_equilibrium(arm, [20.0, 0, 0, 0, 20.0, 0, 0, 0], ta.ExternalLoad(gravity=True), nodes=4)
    assert bool(bent.stable)
    assert bool(bent.in_range)
    assert bent.poses[-1, 0, 3].item() < -0.02  # chamber 1 is at the arm's left, which is the world's right
