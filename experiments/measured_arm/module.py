"""The module, by its published dimensions, and what was measured of it.

Of S. M. H. Sadati et al., *TMTDyn*, International Journal of Robotics Research 2020, doi 10.1177/0278364919881685. The
recordings' frame has z along the module, which hangs; torcharm's world has y up.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

import torcharm as ta

PUBLISHED = ta.silicone_module()
(BODY,), (END,) = PUBLISHED.segments, PUBLISHED.links
assert END is not None
assert END.length is not None
LENGTH, END_LENGTH = float(BODY.length[0]), float(END.length)
"""Of the silicone body, and of the rigid end with the force sensor [m]."""
POISSON = 0.5
PULLED = 0.1
"""Force [N] from which a state counts as pulled."""
HIGHEST = 100.0
"""Pressure at which a stiffness that grows with pressure is told [kPa]."""


@dataclass(frozen=True)
class Hypothesis:
    """What is changed of the published model; at 1 and 0 nothing is.

    Attributes:
        young: factor on Young's modulus.
        thinning: power of 1/(1 + ε) by which a chamber's area shrinks as the body stretches: 1 keeps its volume, and
            below 0 it swells.
        stiffening: bending stiffness that each chamber adds at 100 kPa [1e-3 N·m²].
        twisting: torsional flexibility, as a part of that of the body by its shear modulus; 0 does not twist.
        short_of_tip: where on the rigid end the measured force acts: 0 at its tip, 1 where it sits on the body.
    """

    young: float = 1.0
    thinning: float = 0.0
    stiffening: float = 0.0
    twisting: float = 0.0
    short_of_tip: float = 0.0


@dataclass(frozen=True)
class ThinningChamber:
    """A chamber whose area shrinks with strain: `f = p a (1 + ε)^-n`."""

    area: float
    power: float
    bending_stiffness: float
    max_pressure: float = HIGHEST
    strain_range: tuple[float, float] = (-0.3, 1.0)
    pressure_range: tuple[float, float] = (0.0, HIGHEST)

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        return 1e3 * self.area * pressure * (1 + strain) ** -self.power


@dataclass(frozen=True)
class States:
    """S states at rest.

    Attributes:
        case, number: S words and numbers, as in the file.
        pressure: (S, 7) of the six chambers and of the core, which has none [kPa].
        wrench: (S, 6) at the tip, in the world frame [N, N·m].
        tip: (S, 3) its position [m].
        pulled: (S,) whether someone pulls: with more than 0.5 N, where others measure less than 0.05 N.
    """

    case: tuple[str, ...]
    number: tuple[int, ...]
    pressure: Tensor
    wrench: Tensor
    tip: Tensor

    @property
    def pulled(self) -> Tensor:
        return self.wrench[:, :3].norm(dim=-1) > PULLED


def module(how: Hypothesis) -> ta.ArmSeries:
    """The body, with six chambers around an elastic core, and its rigid end."""
    hole, core = BODY.actuators[0], BODY.actuators[-1]
    assert isinstance(hole, ta.PolynomialActuator)
    assert isinstance(core, ta.PolynomialActuator)
    assert isinstance(core.bending_stiffness, ta.ConstantBending)
    stretch, bend = how.young * float(core.force_scale), -how.young * float(core.bending_stiffness.stiffness)
    chamber = ThinningChamber(float(hole.force_scale), how.thinning, -1e-3 * how.stiffening)
    body = ta.ArmDesign(
        offsets=BODY.offsets,
        length=BODY.length,
        actuators=[chamber] * 6 + [ta.elastic_core(stretch, bend)],
        mass=BODY.mass,
        torsion_stiffness=bend / (1 + POISSON) / how.twisting if how.twisting > 0 else None,
    )
    assert END is not None
    return ta.series([body, END])


def read_states(path: Path) -> States:
    """The states of the file; pressures below 0, which are the gauges' noise, count as 0."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))

    def columns(*names: str) -> Tensor:
        return torch.tensor([[float(row[name]) for name in names] for row in rows], dtype=torch.float64)

    pairs = columns("pressure_1_kPa", "pressure_2_kPa", "pressure_3_kPa").clamp(min=0.0)
    chambers = pairs.repeat_interleave(2, dim=-1)
    force = to_world(columns("force_x_N", "force_y_N", "force_z_N"))
    moment = to_world(columns("moment_x_Nm", "moment_y_Nm", "moment_z_Nm"))
    return States(
        tuple(row["case"] for row in rows),
        tuple(int(row["state"]) for row in rows),
        torch.cat((chambers, torch.zeros_like(chambers[:, :1])), -1),
        torch.cat((force, moment), -1),
        to_world(columns("tip_x_m", "tip_y_m", "tip_z_m")),
    )


def to_world(vector: Tensor) -> Tensor:
    """Vectors (..., 3) from the recordings' frame, whose z points down."""
    x, y, z = vector.unbind(-1)
    return torch.stack((x, -z, y), -1)


def tips(how: Hypothesis, states: States, nodes: int = 10) -> Tensor:
    """(S, 3) where the model puts the tip [m]; NaN where it finds no stable equilibrium."""
    share = torch.tensor([how.short_of_tip] * 3 + [0.0] * 3, dtype=torch.float64)
    # a force between two points is one at either of them, in parts
    load = ta.ExternalLoad(
        tip=(1 - share) * states.wrench, gravity=True, points=[ta.PointLoad(share * states.wrench, at=1.0)]
    )
    held = ta.solve_equilibrium(module(how), states.pressure, load, nodes=nodes)
    place = held.poses[:, -1, :3, 3]
    return torch.where((held.converged & held.stable).unsqueeze(-1), place, torch.nan)
