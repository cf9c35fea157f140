"""What the tables of a study's arms may hold, each value by itself."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, Tag

from torcharm.actuators import SHIPPED
from torcharm.actuators.ready import USUAL_STRAINS
from torcharm.arm import ArmDesign
from torcharm.ready_arms import antagonistic_arm, bellows_arm, mckibben_arm
from torcharm.study.fields import (
    Name,
    Needed,
    Range,
    Table,
    by_key,
    by_kinds,
    entries,
    filled,
    one_key,
    one_of,
    one_or_list,
)
from torcharm.study.units import (
    Angle,
    Area,
    Length,
    Lengths,
    Limits,
    Mass,
    NotNegativeLength,
    Offset,
    PositivePressure,
    PressureRange,
)


class BendingTable(Table):
    """A bending moment that does not simply follow pressure."""

    kind: Annotated[str, one_of(("linear", "constant"))] = Field(examples=["linear", "constant"])
    """Whether the moment grows with pressure, up to K times the curvature, or is so at any pressure."""
    stiffness: float = Field(examples=[-0.1])
    """K [N·m²]; negative resists bending."""
    reference_pressure: PositivePressure | None = Field(default=None, examples=[40.0])
    """Pressure at which K holds, of linear bending alone. Without it, the actuator's max_pressure."""


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

    kind: Annotated[str, one_of(tuple(SHIPPED))] = Field(examples=list(SHIPPED))
    """Which of them it is."""
    bending_stiffness: float | None = _bending_stiffness
    bending: BendingTable | None = _bending
    max_pressure: PositivePressure | None = Field(default=None, examples=[50.0, "0.5 bar"])
    """Highest pressure in use. Without it, the model's own."""
    force_scale: float | None = _force_scale


class FileActuator(ShippedActuator):
    """A force model from a file, such as torcharm fit writes, perhaps changed."""

    stands_alone: ClassVar[bool] = False
    kind: Annotated[str, one_of(("file",))] = Field(examples=["file"])
    """That it is such a model."""
    path: str = Field(examples=["my_bellows.toml"])
    """Path of the force model's file, from the study's folder."""


class PolynomialTable(Table):
    """A force model of your own: the sum of c ε^i p^j [N] of strain ε and pressure p [kPa]; what pushes is positive."""

    kind: Annotated[str, one_of(("polynomial",))] = Field(examples=["polynomial"])
    """That it is such a model."""
    coefficients: Annotated[
        list[Annotated[list[float], entries("power of strain", "power of pressure", "coefficient")]],
        filled("a list of terms"),
    ] = Field(examples=[[[1, 0, -120.0], [0, 1, 0.9]]])
    """The terms [i, j, c]."""
    strain_range: Range = Field(examples=[[-0.1, 0.4]])
    """Strains that were characterised."""
    pressure_range: PressureRange = Field(examples=[[0.0, 60.0]])
    """Pressures that were characterised."""
    max_pressure: PositivePressure = Field(examples=[60.0])
    """Highest pressure in use."""
    bending_stiffness: float | None = Field(default=None, examples=[-0.2857])
    """Bending stiffness K [N·m²] at max_pressure; negative resists bending. Without it 0: it does not resist bending by
    itself."""
    bending: BendingTable | None = _bending
    force_scale: float | None = _force_scale


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


def _named_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


ActuatorTable: Any = Annotated[
    by_kinds(ShippedActuator, PolynomialTable, ChamberTable, CoreTable, FileActuator), BeforeValidator(_named_kind)
]
ActuatorsTable: Any = one_or_list(
    ActuatorTable,
    Annotated[list[ActuatorTable], filled("a list of force models such as bellows")],
    "a list of force models such as bellows, or one for all",
    *(str, list, dict),
)


class RingTable(Table):
    """Actuators evenly spaced on a circle around the centreline."""

    radius: Length = Field(examples=["50 mm"])
    """Of the circle; 0 is the centreline itself."""
    count: Annotated[int, Field(ge=1, le=1000)] = Field(default=1, examples=[3])
    """How many."""
    phase: Angle = Field(default=0.0, examples=["90 deg"])
    """Angle of the first from the arm's left (y) towards z."""


_rings = Annotated[list[RingTable], filled("a list of rings")]
RingsTable: Any = one_or_list(RingTable, _rings, "a table with radius, count and phase, or a list of them", list, dict)


class LinkTable(Table):
    """What does not deform: a straight connector to the next segment, or a mount that carries the tip."""

    length: Length = Field(examples=["30 mm"])
    """Along the backbone."""
    mass: Mass = Field(default=0.0, examples=["50 g"])
    """At its middle."""


def name_as(example: str) -> Any:
    """The field of a name."""
    return Field(description="What tables and files call it; no two have the same name.", examples=[example])


Names = Annotated[list[Name], filled("a list of names of arms")]


class NamedTable(Table):
    """What has a name."""

    name: Name = name_as("one")


_limits: Any = Field(
    default=None,
    description="Pressure limits: one for all, or one for each ring or actuator. Without it, the force models' own.",
    examples=[50.0],
)
_mass: Any = Field(
    default=0.0, description="Of the arm or segment, spread evenly along it; for gravity.", examples=["0.6 kg"]
)
_diameter: Any = Field(
    default=None,
    description="Outer diameter: one for all, or one for each ring or actuator; for the spacing of better arms.",
    examples=["30 mm"],
)


PAPER_ARMS: dict[str, Callable[..., ArmDesign]] = {
    "antagonistic": antagonistic_arm,
    "bellows": bellows_arm,
    "mckibben": mckibben_arm,
}
"""The paper's arms, by what a study calls them."""


class PaperArm(NamedTable):
    """One of the paper's arms, with four actuators: two outside, two inside."""

    name: Name = name_as("paper")
    kind: Annotated[str, one_of(tuple(PAPER_ARMS))] = Field(examples=list(PAPER_ARMS))
    """Bellows outside and muscles inside, four bellows, or four muscles, each doubled in force."""
    outer_radius: NotNegativeLength | None = Field(default=None, examples=[0.08, "80 mm"])
    """Distance of the two outer actuators from the centreline. Without it, the paper's."""
    inner_radius: NotNegativeLength | None = Field(default=None, examples=[0.015])
    """Distance of the two inner actuators from the centreline. Without it, the paper's."""
    length: Lengths = Field(default=0.5, examples=["50 cm", [0.5, 0.4, 0.4, 0.5]])
    """Neutral length, one for all actuators or one for each."""
    max_pressure: Limits | None = _limits
    mass: Mass = _mass
    diameter: Lengths | None = _diameter


class SegmentTable(Table):
    """Any actuators side by side, in the plane (radii) or in space (offsets, or rings)."""

    radii: Annotated[Annotated[list[Length], filled("a list of numbers [m]")] | None, Needed()] = Field(
        default=None, examples=[[-0.05, 0.05]]
    )
    """Offset of each actuator across an arm in the plane, positive to the left, looking from the base to the tip. In
    space offsets or a ring stand in its place."""
    offsets: Annotated[list[Offset], filled("a list of [y, z], one for each actuator")] | None = Field(
        default=None, examples=[[["50 mm", 0.0], [-0.05, 0.0]]]
    )
    """Offset of each actuator across an arm in space, y to the left and z out of the plane."""
    ring: RingsTable | None = Field(
        default=None,
        examples=[
            {"radius": "50 mm", "count": 2, "phase": "90 deg"},
            [{"radius": "50 mm"}, {"radius": "15 mm"}],
        ],
    )
    """Offsets on a circle, or on each of a list of them."""
    length: Lengths = Field(examples=[0.5, ["50 cm", 0.5]])
    """Neutral length: one for all, or one for each ring or actuator."""
    actuators: ActuatorsTable = Field(examples=[["bellows", {"kind": "mckibben", "force_scale": 2.0}], "bellows"])
    """Force models: one for all, or one for each ring or actuator; the names bellows or mckibben alone, or tables."""
    max_pressure: Limits | None = _limits
    mass: Mass = _mass
    diameter: Lengths | None = _diameter
    torsion_stiffness: float | None = Field(default=None, examples=[0.5])
    """G J [N·m²], in space. Without it, the arm does not twist."""
    link: LinkTable | None = Field(default=None, examples=[{"length": "30 mm", "mass": "50 g"}])
    """A rigid link after the actuators."""


class FreeArm(SegmentTable, NamedTable):
    """Any actuators side by side, in the plane (radii) or in space (offsets, or rings)."""

    name: Name = name_as("own")


_PLACES = ("radii", "offsets", "ring")


class SeriesArm(NamedTable):
    """An arm of segments in series, from the base on; tasks name the arms that they are for."""

    name: Name = name_as("two modules")
    stands_alone: ClassVar[bool] = False
    segment: Annotated[
        list[Annotated[SegmentTable, one_key(*_PLACES)]], filled("tables that begin with [[arm.segment]]")
    ] = Field(
        examples=[
            [
                {"radii": [-0.05, 0.05], "length": 0.3, "actuators": "bellows", "link": {"length": "30 mm"}},
                {"radii": [-0.03, 0.03], "length": 0.2, "actuators": "bellows"},
            ]
        ]
    )
    """The segments, as tables [[arm.segment]] or a list, each with the keys of an arm but its name."""


ArmTable = Annotated[
    Annotated[PaperArm, Tag("<kind>")] | Annotated[FreeArm, Tag("<without>")] | Annotated[SeriesArm, Tag("<segment>")],
    by_key("kind", "segment"),
    one_key("kind", *_PLACES, "segment"),
]
