"""What the tables of a study's arms may hold, each value by itself."""

from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Discriminator, Field, Tag

from torcharm.actuators import SHIPPED
from torcharm.study.fields import (
    Name,
    Range,
    Table,
    alternatives,
    by_key,
    by_kind,
    entries,
    filled,
    kind_among,
    one_of,
)
from torcharm.study.units import (
    Length,
    Lengths,
    Limits,
    NotNegativeLength,
    PositivePressure,
    PressureRange,
)


class BendingTable(Table):
    """A bending moment that does not simply follow pressure."""

    kind: Annotated[str, one_of(("linear", "constant"))] = Field(
        description="Whether the moment grows with pressure, up to K times the curvature, or is so at any pressure.",
        examples=["linear", "constant"],
    )
    stiffness: float = Field(description="K [N·m²]; negative resists bending.", examples=[-0.1])
    reference_pressure: PositivePressure | None = Field(
        default=None,
        description="Pressure at which K holds, of linear bending alone. Without it, the actuator's max_pressure.",
        examples=[40.0],
    )


_bending_stiffness = Field(
    default=None,
    description="Bending stiffness K [N·m²] at max_pressure. Without it, the model's own.",
    examples=[-0.2857],
)
_bending = Field(
    default=None,
    description="A bending model in place of bending_stiffness.",
    examples=[{"kind": "constant", "stiffness": -0.1}],
)
_force_scale = Field(
    default=None, description="A factor on the force: 2 stands for two of them side by side.", examples=[2.0]
)


class ShippedActuator(Table):
    """A force model that torcharm ships: the paper's extending bellows, or its contracting McKibben muscle."""

    kind: Annotated[str, one_of(tuple(SHIPPED))] = Field(description="Which of them it is.", examples=list(SHIPPED))
    bending_stiffness: float | None = _bending_stiffness
    bending: BendingTable | None = _bending
    max_pressure: PositivePressure | None = Field(
        default=None, description="Highest pressure in use. Without it, the model's own.", examples=[50.0, "0.5 bar"]
    )
    force_scale: float | None = _force_scale


class FileActuator(ShippedActuator):
    """A force model from a file, such as torcharm fit writes, perhaps changed."""

    stands_alone: ClassVar[bool] = False
    kind: Annotated[str, one_of(("file",))] = Field(description="That it is such a model.", examples=["file"])
    path: str = Field(
        description="Path of the force model's file, from the study's folder.", examples=["my_bellows.toml"]
    )


class PolynomialTable(Table):
    """A force model of your own: the sum of c ε^i p^j [N] of strain ε and pressure p [kPa]; what pushes is positive."""

    kind: Annotated[str, one_of(("polynomial",))] = Field(
        description="That it is such a model.", examples=["polynomial"]
    )
    coefficients: Annotated[
        list[Annotated[list[float], entries("power of strain", "power of pressure", "coefficient")]],
        filled("a list of terms"),
    ] = Field(description="The terms [i, j, c].", examples=[[[1, 0, -120.0], [0, 1, 0.9]]])
    strain_range: Range = Field(description="Strains that were characterised.", examples=[[-0.1, 0.4]])
    pressure_range: PressureRange = Field(description="Pressures that were characterised.", examples=[[0.0, 60.0]])
    max_pressure: PositivePressure = Field(description="Highest pressure in use.", examples=[60.0])
    bending_stiffness: float | None = _bending_stiffness
    bending: BendingTable | None = _bending
    force_scale: float | None = _force_scale


def _named_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


def _by_model(value: Any) -> str:
    return "<shipped>" if value["kind"] in SHIPPED else by_kind(value)


ActuatorTable = Annotated[
    Annotated[ShippedActuator, Tag("<shipped>")]
    | Annotated[PolynomialTable, Tag("<polynomial>")]
    | Annotated[FileActuator, Tag("<file>")],
    Discriminator(_by_model),
    kind_among(*SHIPPED, "polynomial", "file"),
    BeforeValidator(_named_kind),
]


_limits = Field(
    default=None,
    description="Pressure limits, one for all actuators or one for each. Without it, the force models' own.",
    examples=[50.0],
)


class PaperArm(Table):
    """One of the paper's arms, with four actuators: two outside, two inside."""

    name: Name = Field(description="What tables and files call the arm; no two have the same name.", examples=["paper"])
    kind: Annotated[str, one_of(("antagonistic", "bellows", "mckibben"))] = Field(
        description="Bellows outside and muscles inside, four bellows, or four muscles, each doubled in force.",
        examples=["antagonistic", "bellows", "mckibben"],
    )
    outer_radius: NotNegativeLength | None = Field(
        default=None,
        description="Distance of the two outer actuators from the centreline. Without it, the paper's.",
        examples=[0.08, "80 mm"],
    )
    inner_radius: NotNegativeLength | None = Field(
        default=None,
        description="Distance of the two inner actuators from the centreline. Without it, the paper's.",
        examples=[0.015],
    )
    length: Lengths = Field(
        default=0.5,
        description="Neutral length, one for all actuators or one for each.",
        examples=["50 cm", [0.5, 0.4, 0.4, 0.5]],
    )
    max_pressure: Limits | None = _limits


class FreeArm(Table):
    """Any actuators side by side."""

    name: Name = Field(description="What tables and files call the arm; no two have the same name.", examples=["own"])
    radii: Annotated[list[Length], filled("a list of numbers [m]")] = Field(
        description="Offset of each actuator across the arm, positive to the left, looking from the base to the tip.",
        examples=[[-0.05, 0.05]],
    )
    length: Lengths = Field(
        description="Neutral length, one for all actuators or one for each.", examples=[0.5, ["50 cm", 0.5]]
    )
    actuators: Annotated[list[ActuatorTable], filled("a list of force models such as bellows")] = Field(
        description="A force model for each radius: the names bellows or mckibben alone, or tables.",
        examples=[["bellows", {"kind": "mckibben", "force_scale": 2.0}]],
    )
    max_pressure: Limits | None = _limits


ArmTable = Annotated[
    Annotated[PaperArm, Tag("<with>")] | Annotated[FreeArm, Tag("<without>")],
    by_key("kind"),
    alternatives("kind", "radii", "actuators"),
]
