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


def test_a_trunk_has_three_segments():
    arm = ta.bionic_trunk([0.2, 0.18, 0.15])
    assert [segment.offsets.norm(dim=-1).tolist() for segment in arm.segments] == [
        pytest.approx([radius] * 3) for radius in (0.1, 0.093, 0.079)
    ]
    assert [segment.length[0].item() for segment in arm.segments] == [0.2, 0.18, 0.15]
    with pytest.raises(ValueError, match="length: must be one number or three"):
        ta.bionic_trunk([0.2, 0.2])
