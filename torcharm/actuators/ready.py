"""Ready models for arms of one body: its pressure chambers, and the elastic material around them."""

from dataclasses import dataclass
from typing import ClassVar

from torcharm.actuators.bending import ConstantBending, Number
from torcharm.actuators.polynomial import PolynomialActuator
from torcharm.inputs import check_number

PASCALS = 1e3
"""In a kilopascal."""
ANY_PRESSURE = 1e6
"""What does not depend on pressure is characterised at all that there are [kPa]."""
USUAL_STRAINS = (-0.3, 1.0)
"""Where soft silicones are usually taken for linear."""
LARGEST_AREA = 1.0
"""Of a chamber [m²]: more was meant in other units."""


@dataclass(frozen=True)
class Chamber(PolynomialActuator):
    """What `chamber` makes."""

    name: ClassVar[str] = "chamber"
    moulded: ClassVar[bool] = True


@dataclass(frozen=True)
class ElasticCore(PolynomialActuator):
    """What `elastic_core` makes."""

    name: ClassVar[str] = "elastic core"
    moulded: ClassVar[bool] = True


def chamber(
    area: Number,
    max_pressure: Number = 100.0,
    strain_range: tuple[float, float] = USUAL_STRAINS,
) -> Chamber:
    """A pressure chamber in an elastic body: `f = p · area`, at any strain; it resists neither stretch nor bending.

    Args:
        area: of the chamber's cross-section [m²].
        max_pressure: highest pressure in use, and to which the body is characterised [kPa].
        strain_range: to which it is.

    Raises:
        ValueError: the area is not above 0 and at most 1, or as for `PolynomialActuator`.

    Example:
        >>> round(float(ta.chamber(area=2e-4).force(torch.tensor(0.1), torch.tensor(100.0))), 3)  # 2 cm² at 100 kPa
        20.0
    """
    if check_number("area", area, 0.0, strict=True, unit="m²") > LARGEST_AREA:
        raise ValueError(f"area: must be at most {LARGEST_AREA:g} m² (is it in mm²?), got {float(area):g}")
    return Chamber(
        coefficients=((0, 1, PASCALS),),
        strain_range=strain_range,
        pressure_range=(0.0, check_number("max_pressure", max_pressure, 0.0, strict=True, unit="kPa")),
        max_pressure=max_pressure,
        bending_stiffness=0.0,
        force_scale=area,
    )


def elastic_core(
    axial_stiffness: Number,
    bending_stiffness: Number,
    strain_range: tuple[float, float] = USUAL_STRAINS,
) -> ElasticCore:
    """The body itself, a passive actuator: `f = -EA ε`, `τ = -EI κ/l`, whatever the pressure.

    An arm's limit for it is 0. Its resistance to torsion, GJ, is the arm's `torsion_stiffness`.

    Args:
        axial_stiffness: EA [N].
        bending_stiffness: EI [N·m²].
        strain_range: to which the material is characterised.

    Raises:
        ValueError: a stiffness is not above 0, or as for `PolynomialActuator`.

    Example:
        >>> round(float(ta.elastic_core(50.0, 1e-3).force(torch.tensor(0.1), torch.tensor(0.0))), 3)  # pulls back
        -5.0
    """
    check_number("axial_stiffness", axial_stiffness, 0.0, strict=True, unit="N")
    check_number("bending_stiffness", bending_stiffness, 0.0, strict=True, unit="N·m²")
    return ElasticCore(
        coefficients=((1, 0, -1.0),),
        strain_range=strain_range,
        pressure_range=(0.0, ANY_PRESSURE),
        max_pressure=1.0,
        bending_stiffness=ConstantBending(-bending_stiffness),
        force_scale=axial_stiffness,
    )
