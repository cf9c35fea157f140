"""What the tables of a study's arms may hold, and the designs that come of them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import torch
from pydantic import Field

from torcharm.actuators import Actuator
from torcharm.arm import ArmDesign, ring
from torcharm.arm_series import ArmSeries, RigidLink, segments_of, series
from torcharm.attainability.questions import question_about_arm
from torcharm.ready_arms import antagonistic_arm, bellows_arm, mckibben_arm
from torcharm.study.actuator_tables import ActuatorsTable, FileActuator
from torcharm.study.data import NamedArm
from torcharm.study.fields import (
    Name,
    Needed,
    Table,
    by_key,
    either,
    filled,
    listed,
    one_key,
    one_of,
    one_or_list,
    within,
)
from torcharm.study.units import Angle, Length, Lengths, Limits, Mass, NotNegativeLength, Offset

Files = tuple[str | None, ...]
"""For each actuator the path of its force model's file, or None; or none at all."""


class RingTable(Table):
    """Actuators evenly spaced on a circle around the centreline."""

    radius: NotNegativeLength = Field(examples=["50 mm"])
    """Of the circle; 0 is the centreline itself."""
    count: Annotated[int, Field(ge=1, le=1000)] = Field(default=1, examples=[3])
    """How many."""
    phase: Angle = Field(default=0.0, examples=["90 deg"])
    """Angle of the first from the arm's left (y) towards z."""


_rings = Annotated[list[RingTable], filled("a list of rings")]
RingsTable: Any = Annotated[
    one_or_list(RingTable, _rings), either("a table with radius, count and phase, or a list of them", list, dict)
]


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


class BundleTable(Table):
    """Actuators side by side."""

    length: Lengths = Field(examples=[0.5, ["50 cm", 0.5]])
    """Neutral length: one for all, or one for each ring or actuator."""
    max_pressure: Limits | None = Field(default=None, examples=[50.0])
    """Pressure limits: one for all, or one for each ring or actuator. Without it, the force models' own."""
    mass: Mass = Field(default=0.0, examples=["0.6 kg"])
    """Of the arm or segment, spread evenly along it; for gravity."""
    diameter: Lengths | None = Field(default=None, examples=["30 mm"])
    """Outer diameter: one for all, or one for each ring or actuator; for the spacing of better arms."""

    def bundle(self, models: Sequence[Actuator], rings: Sequence[int] = (), **places: Any) -> ArmDesign:
        """The actuators, of so many on each ring if they are on any, at places or with other values of a design."""
        given = places | {name: getattr(self, name) for name in ("length", "max_pressure", "diameter")}
        each = {name: _each(name, value, rings, len(models)) for name, value in given.items()}
        return ArmDesign(actuators=models, mass=self.mass, **each)


def _each(name: str, value: Any, rings: Sequence[int], number: int) -> Any:
    """A list as one for each actuator, of one for each ring; what is no list stays."""
    if not isinstance(value, list) or len(value) == number:
        return value
    if rings and len(value) == len(rings):
        return [one for one, count in zip(value, rings, strict=True) for _ in range(count)]
    what = "entry" if name == "actuators" else "number"
    rest = f" or {len(rings)} rings" if rings else ""
    raise ValueError(f"{name}: must hold one {what} for each of the {number} actuators{rest}, got {len(value)}")


PAPER_ARMS: dict[str, Callable[..., ArmDesign]] = {
    "antagonistic": antagonistic_arm,
    "bellows": bellows_arm,
    "mckibben": mckibben_arm,
}
"""The paper's arms, by what a study calls them."""


class PaperArm(BundleTable, NamedTable):
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

    def build(self, folder: Path) -> tuple[ArmDesign, Files]:
        """The arm, which needs no files."""
        given = self.model_dump(include={"outer_radius", "inner_radius"}, exclude_none=True)
        paper = PAPER_ARMS[self.kind](**given)
        return self.bundle(paper.actuators, radii=paper.radii.tolist()), ()


class SegmentTable(BundleTable):
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
    actuators: ActuatorsTable = Field(examples=[["bellows", {"kind": "mckibben", "force_scale": 2.0}], "bellows"])
    """Force models: one for all, or one for each ring or actuator; the names bellows or mckibben alone, or tables."""
    torsion_stiffness: float | None = Field(default=None, examples=[0.5])
    """G J [N·m²], in space. Without it, the arm does not twist."""
    link: LinkTable | None = Field(default=None, examples=[{"length": "30 mm", "mass": "50 g"}])
    """A rigid link after the actuators."""

    def parts(self, folder: Path) -> tuple[list[ArmDesign | RigidLink], Files]:
        """The segment, and the link after it; and for each actuator the path of its force model's file, or None."""
        rings = [one for _, one in listed("ring", self.ring)] if self.ring is not None else []
        counts = [one.count for one in rings]
        places: dict[str, Any] = {"radii": self.radii} if self.radii is not None else {"offsets": self.offsets}
        if rings:
            places = {"offsets": torch.cat([ring(one.radius, one.count, one.phase) for one in rings])}
        models, files = [], []
        for path, one in listed("actuators", self.actuators):
            with within(path):
                models.append(one.build(folder))
            files.append(one.path if isinstance(one, FileActuator) else None)
        number = len(next(iter(places.values())))
        if not isinstance(self.actuators, list):
            models, files = models * number, files * number
        models, files = (_each("actuators", each, counts, number) for each in (models, files))
        places["torsion_stiffness"] = self.torsion_stiffness
        parts: list[ArmDesign | RigidLink] = [self.bundle(models, counts, **places)]
        if self.link is not None:
            with within("link"):
                parts.append(RigidLink(self.link.length, mass=self.link.mass))
        return parts, tuple(files)


class FreeArm(SegmentTable, NamedTable):
    """Any actuators side by side, in the plane (radii) or in space (offsets, or rings)."""

    name: Name = name_as("own")

    def build(self, folder: Path) -> tuple[ArmDesign | ArmSeries, Files]:
        """The arm, and the files of its force models."""
        parts, files = self.parts(folder)
        return parts[0] if len(parts) == 1 and isinstance(parts[0], ArmDesign) else series(parts), files


PLACES = ("radii", "offsets", "ring")


class SeriesArm(NamedTable):
    """An arm of segments in series, from the base on; tasks name the arms that they are for."""

    name: Name = name_as("two modules")
    stands_alone: ClassVar[bool] = False
    segment: Annotated[
        list[Annotated[SegmentTable, one_key(*PLACES)]], filled("tables that begin with [[arm.segment]]")
    ] = Field(
        examples=[
            [
                {"radii": [-0.05, 0.05], "length": 0.3, "actuators": "bellows", "link": {"length": "30 mm"}},
                {"radii": [-0.03, 0.03], "length": 0.2, "actuators": "bellows"},
            ]
        ]
    )
    """The segments, as tables [[arm.segment]] or a list, each with the keys of an arm but its name."""

    def build(self, folder: Path) -> tuple[ArmSeries, Files]:
        """The arm, and the files of its force models."""
        parts: list[ArmDesign | RigidLink] = []
        files: Files = ()
        for path, segment in listed("segment", self.segment):
            with within(path):
                own, its_files = segment.parts(folder)
            if parts and own[0].dimension != parts[0].dimension:
                raise ValueError(
                    f"{path}: must be in the plane (radii) or in space (offsets, ring) as the first segment is"
                )
            parts, files = parts + own, files + its_files
        return series(parts), files


ArmTable: Any = by_key({"kind": PaperArm} | dict.fromkeys(PLACES, FreeArm) | {"segment": SeriesArm})


def make_arm(table: PaperArm | FreeArm | SeriesArm, folder: Path) -> NamedArm:
    """The arm of a table; paths of force models start at the folder."""
    design, files = table.build(folder)
    question = question_about_arm(segments_of(design)[0])
    if question is not None:
        raise ValueError(f'{question} A text with a unit, such as "50 mm", is understood')
    return NamedArm(table.name, design, files if any(files) else ())
