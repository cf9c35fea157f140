"""The balance of the nodes, assembled and solved."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.mechanics.kinematics import Kinematics, kinematics
from torcharm.mechanics.load import load_part, load_wrench
from torcharm.mechanics.sections import actuator_part, actuator_wrench


@dataclass(frozen=True)
class Balance:
    """The balance at z and its derivatives.

    Attributes:
        residual: R (..., C, N).
        stiffness: J = ∂R/∂z (..., C, N, C, N), the load's part included.
        by_pressure: ∂R/∂p (..., C, N, M).
        kinematics: of z.
    """

    residual: Tensor
    stiffness: Tensor
    by_pressure: Tensor
    kinematics: Kinematics


def balance_residual(
    arm: ArmDesign,
    unknowns: Float[Tensor, "*#batch C N"],
    pressure: Float[Tensor, "*#batch M"],
    tip_load: Float[Tensor, "*#batch 3"],
    base_pose: Float[Tensor, "*#batch 3"],
    shear_stiffness: float | None = None,
) -> Tensor:
    """R = a + q (..., C, N) [N, (N,) N·m], differentiable in everything."""
    motion = kinematics(unknowns, base_pose)
    reaction = actuator_wrench(arm, unknowns, pressure, shear_stiffness)
    return reaction + load_wrench(motion, tip_load, shear=shear_stiffness is not None)


def balance(
    arm: ArmDesign,
    unknowns: Float[Tensor, "*#batch C N"],
    pressure: Float[Tensor, "*#batch M"],
    tip_load: Float[Tensor, "*#batch 3"],
    base_pose: Float[Tensor, "*#batch 3"],
    shear_stiffness: float | None = None,
    *,
    pressure_slope: bool = True,
    create_graph: bool = False,
) -> Balance:
    """R with its derivatives by twists and pressure.

    Args:
        arm: designs (..., M).
        unknowns: z (..., C, N), C = 3 exactly if there is a shear stiffness.
        pressure: (..., M) [kPa].
        tip_load: (..., 3) in the world frame [N, N, N·m].
        base_pose: (..., 3).
        shear_stiffness: k [N/m] of each actuator; None is rigid.
        pressure_slope: whether ∂R/∂p is wanted; else it is of no actuators.
        create_graph: whether the results can be differentiated.
    """
    with torch.set_grad_enabled(create_graph):
        motion = kinematics(unknowns, base_pose)
        load = load_part(motion, tip_load, shear=shear_stiffness is not None)
        own = actuator_part(
            arm, unknowns, pressure, shear_stiffness, pressure_slope=pressure_slope, create_graph=create_graph
        )
        stiffness = load.stiffness
        if create_graph or stiffness.shape[:-4] != own.stiffness.shape[:-3]:
            stiffness = assemble(stiffness, own.stiffness)
        else:
            stiffness.diagonal(dim1=-3, dim2=-1).add_(own.stiffness)
        return Balance(load.wrench + own.wrench, stiffness, own.by_pressure, motion)


def assemble(
    load: Float[Tensor, "*#batch C N C N"], local: Float[Tensor, "*#batch C C N"]
) -> Float[Tensor, "... C N C N"]:
    """J: the load's stiffness with the sections' own on the diagonals of its blocks."""
    shape = torch.broadcast_shapes(load.shape[:-4], local.shape[:-3])
    total = load.expand(*shape, *load.shape[-4:]).clone()
    total.diagonal(dim1=-3, dim2=-1).add_(local)
    return total


def solve(
    stiffness: Float[Tensor, "*#batch C N C N"], right: Float[Tensor, "*#batch C N K"]
) -> Float[Tensor, "... C N K"]:
    """`J⁻¹ B`; what is singular comes out as NaN, and leaves the rest of the batch alone."""
    size, count = stiffness.shape[-4:-2]
    flat = stiffness.reshape(*stiffness.shape[:-4], size * count, size * count)
    answer, info = torch.linalg.solve_ex(flat, right.reshape(*right.shape[:-3], size * count, right.shape[-1]))
    answer = torch.where((info == 0)[..., None, None], answer, answer.new_tensor(float("nan")))
    return answer.unflatten(-2, (size, count))


def solve_signed(
    stiffness: Float[Tensor, "*batch C N C N"], right: Float[Tensor, "*batch C N K"]
) -> tuple[Float[Tensor, "*batch C N K"], Float[Tensor, "*batch"]]:
    """`J⁻¹ B` as by `solve`, and the sign of det J, by one factorisation."""
    size, count = stiffness.shape[-4:-2]
    flat = stiffness.reshape(*stiffness.shape[:-4], size * count, size * count)
    factors, pivots, info = torch.linalg.lu_factor_ex(flat)
    answer = torch.linalg.lu_solve(factors, pivots, right.reshape(*right.shape[:-3], size * count, right.shape[-1]))
    answer = torch.where((info == 0)[..., None, None], answer, answer.new_tensor(float("nan")))
    swaps = pivots != torch.arange(1, size * count + 1, dtype=pivots.dtype, device=pivots.device)
    negative = (factors.diagonal(dim1=-2, dim2=-1) < 0).logical_xor(swaps).sum(-1)
    return answer.unflatten(-2, (size, count)), 1.0 - 2.0 * (negative % 2).to(flat.dtype)
