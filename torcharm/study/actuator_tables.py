"""What the tables of force models in a study may hold, and the force models that come of them."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field

from torcharm.actuators import (
    SHIPPED,
    Actuator,
    Bending,
    ConstantBending,
    LinearBending,
    PolynomialActuator,
    chamber,
    elastic_core,
)
from torcharm.actuators.ready import USUAL_STRAINS
from torcharm.characterise.model_file import load_actuator
from torcharm.study.fields import Range, Table, by_kinds, checked, either, entries, filled, one_of, one_or_list
from torcharm.study.units import Area, PositivePressure, PressureRange

HIGHEST_DEGREE = 20
"""Of strain or pressure in a polynomial force model."""


class BendingTable(Table):
    """A bending moment that does not simply follow pressure."""

    kind: Annotated[str, one_of(("linear", "constant"))] = Field(examples=["linear", "constant"])
    """Whether the moment grows with pressure, up to K times the curvature, or is so at any pressure."""
    stiffness: float = Field(examples=[-0.1])
    """K [N·m²]; negative resists bending."""
    reference_pressure: PositivePressure | None = Field(default=None, examples=[40.0])
    """Pressure at which K holds, of linear bending alone. Without it, the actuator's max_pressure."""

    def build(self) -> Bending:
        """The bending model."""
        if self.kind == "linear":
            return LinearBending(self.stiffness, self.reference_pressure)
        if self.reference_pressure is not None:
            raise ValueError("bending.reference_pressure: must not be given for constant bending, got one")
        return ConstantBending(self.stiffness)


class ShippedActuator(Table):
    """A force model that torcharm ships: the paper's extending bellows, or its contracting McKibben muscle."""

    kind: Annotated[str, one_of(tuple(SHIPPED))] = Field(examples=list(SHIPPED))
    """Which of them it is."""
    bending_stiffness: float | None = Field(default=None, examples=[-0.2857])
    """Bending stiffness K [N·m²] at max_pressure; negative resists bending. Without it, the model's own; a polynomial
    has none."""
    bending: BendingTable | None = Field(default=None, examples=[{"kind": "constant", "stiffness": -0.1}])
    """A bending model in place of bending_stiffness."""
    max_pressure: PositivePressure | None = Field(default=None, examples=[50.0, "0.5 bar"])
    """Highest pressure in use. Without it, the model's own."""
    force_scale: float | None = Field(default=None, examples=[2.0])
    """A factor on the force: 2 stands for two of them side by side."""

    def build(self, folder: Path) -> Actuator:
        """The force model; paths of files start at the folder."""
        return SHIPPED[self.kind](**self.options())

    def options(self) -> dict[str, Any]:
        """What was given of the keys that several kinds have."""
        given = self.model_dump(include={"bending_stiffness", "max_pressure", "force_scale"}, exclude_none=True)
        if self.bending is None:
            return given
        if self.bending_stiffness is not None:
            raise ValueError("bending: must not stand beside bending_stiffness, got both")
        return given | {"bending_stiffness": self.bending.build()}


class FileActuator(ShippedActuator):
    """A force model from a file, such as torcharm fit writes, perhaps changed."""

    stands_alone: ClassVar[bool] = False
    kind: Annotated[str, one_of(("file",))] = Field(examples=["file"])
    """That it is such a model."""
    path: str = Field(examples=["my_bellows.toml"])
    """Path of the force model's file, from the study's folder."""

    def build(self, folder: Path) -> Actuator:
        """The force model."""
        model: Any = load_actuator(folder / self.path)
        changed: Actuator = replace(model, **self.options())
        return changed


def _wrong_powers(term: list[float]) -> str | None:
    wrong = next((power for power in term[:2] if power not in range(HIGHEST_DEGREE + 1)), None)
    return None if wrong is None else f"powers must be whole numbers from 0 to {HIGHEST_DEGREE}, got {wrong:g}"


_Term = Annotated[list[float], entries(("power of strain", "power of pressure", "coefficient")), checked(_wrong_powers)]


class PolynomialTable(ShippedActuator):
    """A force model of your own: the sum of c ε^i p^j [N] of strain ε and pressure p [kPa]; what pushes is positive."""

    kind: Annotated[str, one_of(("polynomial",))] = Field(examples=["polynomial"])
    """That it is such a model."""
    coefficients: Annotated[list[_Term], filled("a list of terms")] = Field(examples=[[[1, 0, -120.0], [0, 1, 0.9]]])
    """The terms [i, j, c]."""
    strain_range: Range = Field(examples=[[-0.1, 0.4]])
    """Strains that were characterised."""
    pressure_range: PressureRange = Field(examples=[[0.0, 60.0]])
    """Pressures that were characterised."""
    max_pressure: PositivePressure = Field(examples=[60.0])
    """Highest pressure in use."""

    def build(self, folder: Path) -> Actuator:
        """The force model."""
        terms = tuple((int(i), int(j), coefficient) for i, j, coefficient in self.coefficients)
        (low, high), (lowest, highest) = self.strain_range, self.pressure_range
        return PolynomialActuator(terms, (low, high), (lowest, highest), **self.options())


class ChamberTable(Table):
    """A pressure chamber in an elastic body: it pushes with pressure times area, at any strain."""

    kind: Annotated[str, one_of(("chamber",))] = Field(examples=["chamber"])
    """That it is a chamber."""
    area: Area = Field(examples=["80 mm²", 8e-5])
    """Of its cross-section."""
    max_pressure: PositivePressure = Field(default=100.0, examples=["1 bar"])
    """Highest pressure in use."""
    strain_range: Range = Field(default=list(USUAL_STRAINS))
    """Strains to which the body is characterised."""

    def build(self, folder: Path) -> Actuator:
        """The force model."""
        low, high = self.strain_range
        return chamber(self.area, self.max_pressure, (low, high))


class CoreTable(Table):
    """The elastic body around chambers, without pressure: it resists stretch and bending."""

    kind: Annotated[str, one_of(("elastic_core",))] = Field(examples=["elastic_core"])
    """That it is one."""
    axial_stiffness: float = Field(examples=[40.0])
    """E A [N]."""
    bending_stiffness: float = Field(examples=[1e-3])
    """E I [N·m²]."""
    strain_range: Range = Field(default=list(USUAL_STRAINS))
    """Strains to which the material is characterised."""

    def build(self, folder: Path) -> Actuator:
        """The force model."""
        low, high = self.strain_range
        return elastic_core(self.axial_stiffness, self.bending_stiffness, (low, high))


def _named_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


ActuatorTable: Any = Annotated[
    by_kinds(ShippedActuator, PolynomialTable, ChamberTable, CoreTable, FileActuator), BeforeValidator(_named_kind)
]
ActuatorsTable: Any = Annotated[
    one_or_list(ActuatorTable, Annotated[list[ActuatorTable], filled("a list of force models such as bellows")]),
    either("a list of force models such as bellows, or one for all", str, list, dict),
]
