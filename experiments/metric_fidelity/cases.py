"""The arms, the shapes and the loads."""

from dataclasses import dataclass

import torch

import torcharm as ta
from experiments.paper import paper_task

SHAPES = (((-3.0, 3.0), 2.0), ((1.0, 1.5), 2.0), ((6.0, -1.5), 5.0), ((-1.0, 1.0), 5.0))
"""The paper's three, and (-1, 1): slope and intercept of the curvature, and M0, twice the largest moment [N·m]."""


@dataclass(frozen=True)
class Case:
    """One row of the table: an arm, a shape, and how many loads.

    Attributes:
        arm: its name.
        design: the arm.
        shape: slope and intercept of the affine curvature [rad].
        moment: M0 [N·m]; loads are `diag(20, 20, M0) (U - ½)`, the paper's draws.
        length: of the centreline [m].
        loads: how many.
    """

    arm: str
    design: ta.ArmDesign
    shape: tuple[float, float]
    moment: float
    length: float
    loads: int

    @property
    def name(self) -> str:
        return case_name(self.arm, self.shape, self.moment)

    @property
    def task(self) -> ta.Task:
        loads = ta.sample_loads(self.loads, (20.0, 20.0, self.moment))
        return paper_task(ta.affine_curvature(*self.shape, length=self.length), loads)


def case_name(arm: str, shape: tuple[float, float], moment: float) -> str:
    """As in the tables: the arm, its shape, and M0."""
    return f"{arm} ({shape[0]:g}, {shape[1]:g}), {moment:g}"


def six_actuators() -> ta.ArmDesign:
    """Bellows outside and in between, muscles inside."""
    kinds: list[ta.Actuator] = [ta.Bellows(), ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows(), ta.Bellows()]
    return ta.ArmDesign([-0.08, -0.045, -0.015, 0.015, 0.045, 0.08], 0.5, kinds)


def many_actuators(count: int) -> ta.ArmDesign:
    """Bellows and muscles in turn, evenly spread, for timings."""
    kinds: list[ta.Actuator] = [ta.Bellows() if index % 2 == 0 else ta.McKibben() for index in range(count)]
    return ta.ArmDesign(torch.linspace(-0.08, 0.08, count, dtype=torch.float64), 0.5, kinds)


def cases(loads: int) -> list[Case]:
    paper = {"antagonistic": ta.antagonistic_arm(), "bellows": ta.bellows_arm(), "muscle": ta.mckibben_arm()}
    found = [
        Case(name, design, shape, moment, 0.5, loads) for name, design in paper.items() for shape, moment in SHAPES
    ]
    for shape, moment in (SHAPES[0], SHAPES[3]):
        found.append(Case("six actuators", six_actuators(), shape, moment, 0.5, loads))
        found.append(Case("long antagonistic", ta.antagonistic_arm(length=0.8), shape, moment, 0.8, loads))
    return found
