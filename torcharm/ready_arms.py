"""Ready arms: the paper's in the plane, and some in space, with the sources of their dimensions."""

import math

import torch
from torch import Tensor

from torcharm.actuators import Bellows, McKibben, chamber, elastic_core
from torcharm.arm import ArmDesign, ring
from torcharm.arm_series import ArmSeries, RigidLink, series
from torcharm.inputs import TensorLike, as_floating, broadcast_shapes, check_finite


def antagonistic_arm(
    outer_radius: TensorLike = 0.08, inner_radius: TensorLike = 0.015, length: TensorLike = 0.5
) -> ArmDesign:
    """The paper's antagonistic arm: bellows outside, muscles inside.

    Args:
        outer_radius, inner_radius: (...) offsets [m]; tensors make a batch of designs.
        length: (...) or (..., 4) neutral lengths [m].

    Raises:
        ValueError: as for `ArmDesign`.

    Example:
        >>> ta.antagonistic_arm(outer_radius=torch.linspace(0.04, 0.1, 200))  # 200 designs
        ArmDesign(planar, 2 bellows, 2 mckibben, batch (200,), torch.float32)
    """
    return ArmDesign(_mirrored(outer_radius, inner_radius), length, (Bellows(), McKibben(), McKibben(), Bellows()))


def bellows_arm(
    outer_radius: TensorLike = 0.08, inner_radius: TensorLike = 0.015, length: TensorLike = 0.5
) -> ArmDesign:
    """The paper's bellows-only arm; arguments and errors as for `antagonistic_arm`.

    Example:
        >>> ta.bellows_arm(outer_radius=0.06).radii.tolist()
        [-0.06, -0.015, 0.015, 0.06]
    """
    return ArmDesign(_mirrored(outer_radius, inner_radius), length, (Bellows(),) * 4)


def mckibben_arm(
    outer_radius: TensorLike = 0.01, inner_radius: TensorLike = 0.01, length: TensorLike = 0.5
) -> ArmDesign:
    """The paper's muscle-only arm: four muscles at ±1 cm, every one doubled in force.

    Arguments and errors as for `antagonistic_arm`.

    Example:
        >>> [model.force_scale for model in ta.mckibben_arm().actuators]  # two muscles pull at each of four places
        [2.0, 2.0, 2.0, 2.0]
    """
    return ArmDesign(_mirrored(outer_radius, inner_radius), length, (McKibben(force_scale=2.0),) * 4)


def antagonistic_ring(
    outer_radius: TensorLike = 0.08, inner_radius: TensorLike = 0.015, length: TensorLike = 0.5, count: int = 3
) -> ArmDesign:
    """The paper's antagonistic arm in space: bellows on an outer ring, then muscles on an inner one.

    Both rings begin at the arm's left, body y: with a count of 2 it is the paper's arm. Dimensions as in the paper, of
    B. Fan, J. Roulier and G. Olson; their arms lie in the plane.

    Args:
        outer_radius, inner_radius: (...) of the rings [m]; tensors make a batch of designs.
        length: (...) or (..., 2·count) neutral lengths [m].
        count: of bellows, and of muscles.

    Raises:
        ValueError: as for `ArmDesign` and `ring`.

    Example:
        >>> ta.antagonistic_ring(count=4)
        ArmDesign(spatial, 4 bellows, 4 mckibben, batch (), torch.float64)
    """
    outer, inner = _radii(outer_radius, inner_radius)
    offsets = torch.cat((ring(outer, count), ring(inner, count)), -2)
    return ArmDesign(offsets=offsets, length=length, actuators=(Bellows(),) * count + (McKibben(),) * count)


def silicone_module() -> ArmSeries:
    """A module of silicone with three pairs of chambers, and the rigid end that carries its force sensor.

    Cited, of S. M. H. Sadati et al., *TMTDyn*, International Journal of Robotics Research 2020, doi
    10.1177/0278364919881685, and its recordings: 44 mm long, a ring of radii 4.5 and 12.5 mm less six chambers of
    radius 2.5 mm, whose axes are 8.5 mm from the centre and 3 mm from the middle of their pair there, Young's modulus
    120 kPa, 1820 kg/m³; the end 14.5 mm long, 13.47 g. Assumed: strains and pressures in range as of `chamber`, up to
    100 kPa; the recordings reach 111. Chambers 1 and 2, 3 and 4, 5 and 6 share a pressure each; actuator 7 is the body.

    Example:
        >>> bent = ta.solve_equilibrium(ta.silicone_module(), [0.0, 0.0, 60.0, 60.0, 0.0, 0.0, 0.0], [0.0] * 6, nodes=5)
        >>> (1e3 * bent.poses[-1, :3, 3]).round().tolist()  # its tip [mm]
        [-16.0, -57.0, 9.0]
    """
    outer, inner, hole, axes, length = 12.5e-3, 4.5e-3, 2.5e-3, 8.5e-3, 44e-3
    apart = math.acos(1 - 3**2 / (2 * 8.5**2))
    """Half of the angle between the two chambers of a pair [rad]."""
    area = math.pi * (outer**2 - inner**2 - 6 * hole**2)
    second = math.pi / 4 * (outer**4 - inner**4 - 6 * hole**4) - math.pi * hole**2 * 3 * axes**2
    angles = [math.radians(middle) + side * apart for middle in (90, -30, 210) for side in (-1, 1)]
    body = ArmDesign(
        offsets=[[axes * math.cos(angle), axes * math.sin(angle)] for angle in angles] + [[0.0, 0.0]],
        length=length,
        actuators=[chamber(math.pi * hole**2)] * 6 + [elastic_core(120e3 * area, 120e3 * second)],
        mass=1820.0 * area * length,
    )
    return series([body, RigidLink(length=14.5e-3, mass=13.47e-3)])


def silicone_arm() -> ArmSeries:
    """Two segments of silicone with three chambers each, and rigid connectors: SoPrA, but that it stretches.

    Cited, of Y. Toshimitsu, K. W. Wong, T. Buchner and R. Katzschmann, *SoPrA*, arXiv 2103.10726, by their model
    (github.com/srl-ethz/3d-soft-trunk, softtrunkparams_example.yaml and SoftTrunkModel.cpp): segments 125 mm long of
    160 and 82 g, the connectors behind them 20 mm long of 20 and 23 g; 35, 28 and 19.8 mm across where segments begin
    and end, each with the section at its middle: a triangle whose sides are as long as the segment is wide there, and
    on each of them a half disc, whose chamber lies behind 2 mm of wall; shear moduli G of 35 and 40 kPa; a bending
    stiffness of 4 G times the section's second moment; pressures up to 500 mbar.

    Assumed: 4 G times its area against stretch, too, as fibres keep the girth, and no core, where theirs keeps its
    length: so this arm grows under pressure. Strains in range as of `chamber`. Actuator 4 of each segment is the
    silicone.

    Example:
        >>> hanging = ta.solve_equilibrium(ta.silicone_arm(), 0.0, ta.ExternalLoad(gravity=True), nodes=5)
        >>> round(-1e3 * float(hanging.poses[-1, 1, 3]))  # of 290 mm, its weight makes so many
        293
    """
    parts: list[ArmDesign | RigidLink] = []
    across, weights, moduli = (35e-3, 28e-3, 19.8e-3), ((0.160, 0.020), (0.082, 0.023)), (35e3, 40e3)
    for begin, end, (mass, connector), modulus in zip(across, across[1:], weights, moduli, strict=False):
        place, hole, area, second = _half_discs((begin + end) / 4, 2e-3)
        body = elastic_core(4 * modulus * area, 4 * modulus * second)
        offsets = torch.cat((ring(place, 3), torch.zeros(1, 2, dtype=torch.float64)))
        own = [chamber(hole, max_pressure=50.0)] * 3 + [body]
        parts += [ArmDesign(offsets=offsets, length=0.125, actuators=own, mass=mass), RigidLink(0.02, mass=connector)]
    return series(parts)


def _half_discs(radius: float, wall: float) -> tuple[float, float, float, float]:
    """Of three half discs on the sides of a triangle as wide as they: how far a chamber's centroid is from the middle
    [m], its area [m²], and area [m²] and second moment [m⁴] of what is solid.

    A chamber is the half disc whose radius is less by the wall, less a strip as wide as it and as high as the wall.
    """
    small, base = radius - wall, radius / math.sqrt(3)
    disc, hole = ((math.pi * r**2 / 2, 2 * r**3 / 3, math.pi * r**4 / 4) for r in (radius, small))
    strip = 2 * small * wall, small * wall**2, 2 * small * wall * (small**2 + wall**2) / 3
    void = tuple(whole - part for whole, part in zip(hole, strip, strict=True))

    def polar(area: float, first: float, second: float) -> float:
        """About the middle, of moments about the base of a half disc."""
        return second + 2 * base * first + base**2 * area

    solid = math.sqrt(3) * radius**2 + 3 * (disc[0] - void[0])
    around = math.sqrt(3) / 3 * radius**4 + 3 * (polar(*disc) - polar(*void))
    return base + void[1] / void[0], void[0], solid, around / 2


def _mirrored(outer_radius: TensorLike, inner_radius: TensorLike) -> Tensor:
    """Radii (-outer, -inner, inner, outer)."""
    outer, inner = _radii(outer_radius, inner_radius)
    return torch.stack((-outer, -inner, inner, outer), -1)


def _radii(outer_radius: TensorLike, inner_radius: TensorLike) -> tuple[Tensor, ...]:
    """Both, checked, in one shape."""
    outer, inner = as_floating(outer_radius=outer_radius, inner_radius=inner_radius)
    broadcast_shapes(outer_radius=outer.shape, inner_radius=inner.shape)
    check_finite("outer_radius", outer)
    check_finite("inner_radius", inner)
    return torch.broadcast_tensors(outer, inner)
