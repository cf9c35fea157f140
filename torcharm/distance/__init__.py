"""Distances from required wrenches to attainable sets.

Every solver has one signature: from points and vertices to a `HullDistance`. `solver` finds them by
name; qpth and scipy load when they are first asked.
"""

from torcharm.distance.solvers import DISTANCES, DistanceFunction, find_solver

__all__ = ["DISTANCES", "DistanceFunction", "find_solver"]
