"""The force models that torcharm ships, by the names that stand for them: in Python, in study files and model files."""

from typing import Any

from torcharm.actuators.mckibben import McKibben
from torcharm.actuators.polynomial import Bellows
from torcharm.actuators.protocol import Actuator, check_actuator
from torcharm.inputs import hint, shown

SHIPPED: dict[str, type[Bellows] | type[McKibben]] = {kind.name: kind for kind in (Bellows, McKibben)}


def model_of(field: str, given: Any) -> Actuator:
    """A force model, or the shipped one that a name stands for.

    Args:
        field: what error messages call it.
        given: a force model, or a name of `SHIPPED`.

    Raises:
        ValueError: no shipped model has that name, or the object is no force model.
    """
    if isinstance(given, str):
        if given not in SHIPPED:
            raise ValueError(
                f"{field}: must be a force model such as Bellows(), one of the names {', '.join(SHIPPED)}, or where an "
                f"arm is made the path of a file that ends in .toml, got {shown(given)}{hint(given, SHIPPED)}"
            )
        return SHIPPED[given]()
    check_actuator(field, given)
    model: Actuator = given
    return model
