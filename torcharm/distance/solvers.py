"""The distance solvers by name; each is loaded when it is first asked for."""

from collections.abc import Callable

from torch import Tensor

from torcharm._inputs import check_choice
from torcharm.distance.result import HullDistance

DISTANCES = ("closed_form", "qpth", "scipy")

DistanceFunction = Callable[[Tensor, Tensor], HullDistance]
"""What answers distances from points (*batch, D) to the convex hulls of vertices (*batch, V, D)."""


def find_solver(distance: str | DistanceFunction) -> DistanceFunction:
    """The solver of that name; a function is one already.

    Raises:
        ValueError: no solver has that name, or qpth is asked for and not installed.
    """
    if not isinstance(distance, str) and callable(distance):
        return distance
    check_choice("distance", distance, DISTANCES)
    if distance == "closed_form":
        from torcharm.distance.planar import planar_distance

        return planar_distance
    if distance == "scipy":
        from torcharm.distance.scipy_solvers import nnls_distance

        return nnls_distance
    from torcharm.distance.qp import qp_distance, require_qpth

    require_qpth()
    return qp_distance
