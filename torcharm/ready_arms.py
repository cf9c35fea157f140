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
    """
    return ArmDesign(_mirrored(outer_radius, inner_radius), length, (Bellows(), McKibben(), McKibben(), Bellows()))


def bellows_arm(
    outer_radius: TensorLike = 0.08, inner_radius: TensorLike = 0.015, length: TensorLike = 0.5
) -> ArmDesign:
    """The paper's bellows-only arm; arguments as for `antagonistic_arm`."""
    return ArmDesign(_mirrored(outer_radius, inner_radius), length, (Bellows(),) * 4)


def mckibben_arm(
    outer_radius: TensorLike = 0.01, inner_radius: TensorLike = 0.01, length: TensorLike = 0.5
) -> ArmDesign:
    """The paper's muscle-only arm: four muscles at ±1 cm, every one doubled in force.

    Arguments as for `antagonistic_arm`.
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
    """
    outer, inner = _radii(outer_radius, inner_radius)
    offsets = torch.cat((ring(outer, count), ring(inner, count)), -2)
    return ArmDesign(offsets=offsets, length=length, actuators=(Bellows(),) * count + (McKibben(),) * count)


def silicone_module() -> ArmSeries:
    """A module of silicone with three pairs of chambers, and the rigid end that carries its force sensor.

    Dimensions, density and Young's modulus as published with S. M. H. Sadati et al., *TMTDyn*, International Journal of
    Robotics Research 2020, doi 10.1177/0278364919881685: 44 mm long, a ring of radii 4.5 and 12.5 mm less six chambers
    of radius 2.5 mm, whose axes are 8.5 mm from the centre, 120 kPa, 1820 kg/m³; the end 14.5 mm long, 13.47 g.
    Chambers 1 and 2, 3 and 4, 5 and 6 share a pressure each; actuator 7 is the body.
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


def bionic_trunk(length: TensorLike) -> ArmSeries:
    """Three segments of three bellows each, as wide as those of the Bionic Handling Assistant.

    Radii of 100, 93 and 79 mm as in the kinematic model of R. F. Reinhart, K. Neumann and A. Lemme, CoR-Lab, Bielefeld
    University 2013 (in Python: smp_sys, systems_bhasim), in which bellows are 0.1 to 0.3 m long. That model has no
    forces: here the bellows push as the paper's do, which are others. It has no masses either.

    Args:
        length: neutral length of all bellows, or one for each segment [m].
    """
    (lengths,) = as_floating(length=length)
    radii = (0.1, 0.093, 0.079)
    if lengths.shape not in ((), (3,)):
        raise ValueError(f"length: must be one number or three, got shape {tuple(lengths.shape)}")
    each = lengths.expand(3)
    return series(
        [ArmDesign(offsets=ring(r, 3), length=own, actuators=Bellows()) for r, own in zip(radii, each, strict=True)]
    )


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
