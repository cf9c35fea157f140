"""Balance of the arm at its nodes: residual, stiffness and pose derivatives, batched and in closed form.

What the forward solver, the pressure search and predictions from the task shape share. The unknowns are

    z (..., C, N),   rows (l, κ), or (l, γ, κ) with finite shear     [m, (m,) rad]

one column a segment, and the balance at node i, the start of segment i, is

    R (..., C, N) = a + q,   rows (f_x, m), or (f_x, f_y, m)         [N, (N,) N·m]

with a the reaction to pressures and q the tip load carried to the node, in the node's frame. The load's
part of R and of its derivative depends on z alone; the actuators' part is local to a node. Rows of
components come before nodes so that every matrix is made of whole N × N blocks.

These functions check nothing: their callers do.
"""

from torcharm.mechanics.balance import Balance, assemble, balance, balance_residual, solve, solve_signed
from torcharm.mechanics.kinematics import (
    Kinematics,
    kinematics,
    pose_change,
    pose_error,
    pose_jacobian,
    to_twists,
    to_unknowns,
)
from torcharm.mechanics.load import LoadPart, load_part, load_wrench
from torcharm.mechanics.march import Arms, Marched, march, pick, put, relax
from torcharm.mechanics.sections import ActuatorPart, actuator_part, actuator_wrench

__all__ = [
    "ActuatorPart",
    "Arms",
    "Balance",
    "Kinematics",
    "LoadPart",
    "Marched",
    "actuator_part",
    "actuator_wrench",
    "assemble",
    "balance",
    "balance_residual",
    "kinematics",
    "load_part",
    "load_wrench",
    "march",
    "pick",
    "pose_change",
    "pose_error",
    "pose_jacobian",
    "put",
    "relax",
    "solve",
    "solve_signed",
    "to_twists",
    "to_unknowns",
]
