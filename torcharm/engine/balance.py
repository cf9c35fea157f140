"""What Newton's step knows of the balance of one arm."""

from typing import NamedTuple

from jaxtyping import Float64, Int64

from torcharm.engine.arrays import Array
from torcharm.engine.carried_load import Share, Spot
from torcharm.engine.references import by_reference
from torcharm.engine.sections import Drive, Sections


@by_reference
class Balance(NamedTuple):
    """Poses, sections, residual and factors of one arm, written anew for each. Letters are those of `newton_step`."""

    drive: Drive
    sections: Sections
    node: Float64[Array, "N+1 P"]  # poses of the nodes and the tip
    end: Float64[Array, "S P"]  # poses of the segments' ends, before their links
    frame: Float64[Array, "N P"]  # poses at which wrenches are taken
    move: Float64[Array, "N K C"]  # B
    half_move: Float64[Array, "N K C"]  # B'
    lever: Float64[Array, "N K C"]  # C
    carried: Float64[Array, "N C"]  # q at full load, which is ∂R/∂λ
    residual: Float64[Array, "N C"]  # R
    factor: Float64[Array, "N C C"]  # L in triangular factors, with the inverse pivots on the diagonal
    feed: Float64[Array, "N C K"]  # L⁻¹ G
    pull: Float64[Array, "N K C"]  # how an element's own unknowns change the wrench before it
    beyond: Share  # what loads inside of an element add to what lies before it
    section: Share  # and to its own section
    spot: Spot
    pivots: Int64[Array, "2"]  # numbers of positive pivots, and of those that are zero
