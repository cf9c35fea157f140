"""Room to work on the balance of one arm."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torcharm.engine.arms import Arms
from torcharm.engine.carried_load import Share, Spot, make_share, make_spot
from torcharm.engine.references import by_reference
from torcharm.engine.sections import Drive, Sections, make_drive, make_sections

Array = NDArray[Any]


@by_reference
class Room(NamedTuple):
    """Room to work in, for one thread: what belongs to one arm.

    Attributes:
        drive, sections: its actuators and sections.
        node: (N + 1, P) poses of the nodes and the tip.
        end: (S, P) poses of the segments' ends, before their links.
        frame: (N, P) poses at which wrenches are taken.
        move, half_move: (N, K, C) B and B'.
        lever: (N, K, C) C.
        carried: (N, C) q at full load, which is ∂R/∂λ.
        residual: (N, C) R.
        factor: (N, C, C) L in triangular factors, with the inverse pivots on the diagonal.
        feed: (N, C, K) L⁻¹ G.
        pull: (N, K, C) how an element's own unknowns change the wrench before it.
        beyond, section: what loads inside of an element add, to what lies before it and to its own section.
        spot: for one load.
        pivots: (2,) numbers of positive pivots, and of those that are zero.
    """

    drive: Drive
    sections: Sections
    node: Array
    end: Array
    frame: Array
    move: Array
    half_move: Array
    lever: Array
    carried: Array
    residual: Array
    factor: Array
    feed: Array
    pull: Array
    beyond: Share
    section: Share
    spot: Spot
    pivots: Array


def make_room(arms: Arms) -> Room:
    """Room for one arm of these."""
    nodes, size, columns, numbers = arms.first_node[-1], arms.size, len(arms.unknown), arms.link.shape[2]
    move, half_move, lever = np.zeros((3, nodes, size, columns))
    carried, residual = np.zeros((2, nodes, columns))
    return Room(
        drive=make_drive(arms),
        sections=make_sections(arms),
        node=np.zeros((nodes + 1, numbers)),
        end=np.zeros((arms.link.shape[1], numbers)),
        frame=np.zeros((nodes, numbers)),
        move=move,
        half_move=half_move,
        lever=lever,
        carried=carried,
        residual=residual,
        factor=np.zeros((nodes, columns, columns)),
        feed=np.zeros((nodes, columns, size)),
        pull=np.zeros((nodes, size, columns)),
        beyond=make_share(arms),
        section=make_share(arms),
        spot=make_spot(arms),
        pivots=np.zeros(2, dtype=np.int64),
    )
