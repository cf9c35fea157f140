"""Forward mechanics: the shapes that arms take at pressures, under loads."""

from torcharm.equilibrium.solve import Equilibrium, NotConvergedError, solve_equilibrium

__all__ = ["Equilibrium", "NotConvergedError", "solve_equilibrium"]
