"""torcharm: can a soft continuum arm do the job? Attainability from a model, with gradients.

Indices of nodes, actuators, segments and loads count from 0, in tensors, arguments and the brackets of error messages.
Words, tables, figures and study files count from 1, the base's.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torcharm.actuators import (
        Actuator,
        Bellows,
        BendingFunction,
        ConstantBending,
        LinearBending,
        McKibben,
        PolynomialActuator,
        chamber,
        elastic_core,
    )
    from torcharm.actuators.gridded import GriddedActuator
    from torcharm.arm import ArmDesign, ring
    from torcharm.arm_series import ArmSeries, RigidLink, series
    from torcharm.attainability import Attainability, PoseTolerance, evaluate
    from torcharm.characterise.alignment import Recording, align, pool
    from torcharm.characterise.choice import best_fit
    from torcharm.characterise.fit import FitQuality, FittedActuator, fit_force_model, fit_recording
    from torcharm.characterise.force_table import read_table
    from torcharm.characterise.gridded_fit import fit_gridded_model
    from torcharm.characterise.model_file import load_actuator, save_actuator
    from torcharm.characterise.monotonicity import Monotonicity, monotonicity
    from torcharm.characterise.offset import OffsetEstimate, estimate_offset
    from torcharm.characterise.recordings import read_pressure, read_tester
    from torcharm.characterise.uncertainty import TensorPolynomial, coefficient_tensor, standard_deviation
    from torcharm.design import (
        Architectures,
        DesignSpace,
        Objective,
        OptimisedDesign,
        optimise_architectures,
        optimise_design,
        verify_design,
    )
    from torcharm.design.robust import Robust
    from torcharm.design.scatter import Scatter
    from torcharm.design.shape_planning import PlannedShape, Smoothness, plan_shape
    from torcharm.design.tolerance import tolerance
    from torcharm.design.tolerance_result import BuiltArms
    from torcharm.equilibrium import Equilibrium, NotConvergedError, solve_equilibrium
    from torcharm.geometry.rod import poses
    from torcharm.load import ExternalLoad, PointLoad
    from torcharm.pressure.pose_cost import PoseCost
    from torcharm.pressure.predicted_error import PredictedError, predict_error
    from torcharm.pressure.search import PressureSearch, search_pressure
    from torcharm.pressure.wrench_fit import PressureFit, fit_pressure
    from torcharm.ready_arms import (
        antagonistic_arm,
        antagonistic_ring,
        bellows_arm,
        mckibben_arm,
        silicone_arm,
        silicone_module,
    )
    from torcharm.shapes import affine_curvature, arc_to, constant_curvature, cubic_curvature, helix
    from torcharm.statics.cross_section import reaction_wrench
    from torcharm.statics.external_load import required_wrench
    from torcharm.sweeps import SweepResult, open_sweep, sweep
    from torcharm.task import Task, sample_loads
    from torcharm.workspaces import Workspace, workspace
    from torcharm.wrench_sets.capacity import LoadCapacity, load_capacity
    from torcharm.wrench_sets.hull_distance import HullDistance, kkt_residuals
    from torcharm.wrench_sets.qp import qp_distance
    from torcharm.wrench_sets.reference import nnls_distance, slsqp_distance
    from torcharm.wrench_sets.vertices import distance_to_hull
    from torcharm.wrench_sets.wrench_set import WrenchHulls, wrench_hulls

__version__ = "0.1.0"

__all__ = [
    "Actuator",
    "Architectures",
    "ArmDesign",
    "ArmSeries",
    "Attainability",
    "Bellows",
    "BendingFunction",
    "BuiltArms",
    "ConstantBending",
    "DesignSpace",
    "Equilibrium",
    "ExternalLoad",
    "FitQuality",
    "FittedActuator",
    "GriddedActuator",
    "HullDistance",
    "LinearBending",
    "LoadCapacity",
    "McKibben",
    "Monotonicity",
    "NotConvergedError",
    "Objective",
    "OffsetEstimate",
    "OptimisedDesign",
    "PlannedShape",
    "PointLoad",
    "PolynomialActuator",
    "PoseCost",
    "PoseTolerance",
    "PredictedError",
    "PressureFit",
    "PressureSearch",
    "Recording",
    "RigidLink",
    "Robust",
    "Scatter",
    "Smoothness",
    "SweepResult",
    "Task",
    "TensorPolynomial",
    "Workspace",
    "WrenchHulls",
    "affine_curvature",
    "align",
    "antagonistic_arm",
    "antagonistic_ring",
    "arc_to",
    "bellows_arm",
    "best_fit",
    "chamber",
    "coefficient_tensor",
    "constant_curvature",
    "cubic_curvature",
    "distance_to_hull",
    "elastic_core",
    "estimate_offset",
    "evaluate",
    "fit_force_model",
    "fit_gridded_model",
    "fit_pressure",
    "fit_recording",
    "helix",
    "kkt_residuals",
    "load_actuator",
    "load_capacity",
    "mckibben_arm",
    "monotonicity",
    "nnls_distance",
    "open_sweep",
    "optimise_architectures",
    "optimise_design",
    "plan_shape",
    "pool",
    "poses",
    "predict_error",
    "qp_distance",
    "reaction_wrench",
    "read_pressure",
    "read_table",
    "read_tester",
    "required_wrench",
    "ring",
    "sample_loads",
    "save_actuator",
    "search_pressure",
    "series",
    "silicone_arm",
    "silicone_module",
    "slsqp_distance",
    "solve_equilibrium",
    "standard_deviation",
    "sweep",
    "tolerance",
    "verify_design",
    "workspace",
    "wrench_hulls",
]

_LATER = {
    "Actuator": "actuators",
    "Architectures": "design",
    "ArmDesign": "arm",
    "ArmSeries": "arm_series",
    "Attainability": "attainability",
    "Bellows": "actuators",
    "BendingFunction": "actuators",
    "BuiltArms": "design.tolerance_result",
    "ConstantBending": "actuators",
    "DesignSpace": "design",
    "Equilibrium": "equilibrium",
    "ExternalLoad": "load",
    "FitQuality": "characterise.fit",
    "FittedActuator": "characterise.fit",
    "GriddedActuator": "actuators.gridded",
    "HullDistance": "wrench_sets.hull_distance",
    "LinearBending": "actuators",
    "LoadCapacity": "wrench_sets.capacity",
    "McKibben": "actuators",
    "Monotonicity": "characterise.monotonicity",
    "NotConvergedError": "equilibrium",
    "Objective": "design",
    "OffsetEstimate": "characterise.offset",
    "OptimisedDesign": "design",
    "PlannedShape": "design.shape_planning",
    "PointLoad": "load",
    "PolynomialActuator": "actuators",
    "PoseCost": "pressure.pose_cost",
    "PoseTolerance": "attainability",
    "PredictedError": "pressure.predicted_error",
    "PressureFit": "pressure.wrench_fit",
    "PressureSearch": "pressure.search",
    "Recording": "characterise.alignment",
    "RigidLink": "arm_series",
    "Robust": "design.robust",
    "Scatter": "design.scatter",
    "Smoothness": "design.shape_planning",
    "SweepResult": "sweeps",
    "Task": "task",
    "TensorPolynomial": "characterise.uncertainty",
    "Workspace": "workspaces",
    "WrenchHulls": "wrench_sets.wrench_set",
    "affine_curvature": "shapes",
    "align": "characterise.alignment",
    "antagonistic_arm": "ready_arms",
    "antagonistic_ring": "ready_arms",
    "arc_to": "shapes",
    "bellows_arm": "ready_arms",
    "best_fit": "characterise.choice",
    "chamber": "actuators",
    "coefficient_tensor": "characterise.uncertainty",
    "constant_curvature": "shapes",
    "cubic_curvature": "shapes",
    "distance_to_hull": "wrench_sets.vertices",
    "elastic_core": "actuators",
    "estimate_offset": "characterise.offset",
    "evaluate": "attainability",
    "fit_force_model": "characterise.fit",
    "fit_gridded_model": "characterise.gridded_fit",
    "fit_pressure": "pressure.wrench_fit",
    "fit_recording": "characterise.fit",
    "helix": "shapes",
    "kkt_residuals": "wrench_sets.hull_distance",
    "load_actuator": "characterise.model_file",
    "load_capacity": "wrench_sets.capacity",
    "mckibben_arm": "ready_arms",
    "monotonicity": "characterise.monotonicity",
    "nnls_distance": "wrench_sets.reference",
    "open_sweep": "sweeps",
    "optimise_architectures": "design",
    "optimise_design": "design",
    "plan_shape": "design.shape_planning",
    "pool": "characterise.alignment",
    "poses": "geometry.rod",
    "predict_error": "pressure.predicted_error",
    "qp_distance": "wrench_sets.qp",
    "reaction_wrench": "statics.cross_section",
    "read_pressure": "characterise.recordings",
    "read_table": "characterise.force_table",
    "read_tester": "characterise.recordings",
    "required_wrench": "statics.external_load",
    "ring": "arm",
    "sample_loads": "task",
    "save_actuator": "characterise.model_file",
    "search_pressure": "pressure.search",
    "series": "arm_series",
    "silicone_arm": "ready_arms",
    "silicone_module": "ready_arms",
    "slsqp_distance": "wrench_sets.reference",
    "solve_equilibrium": "equilibrium",
    "standard_deviation": "characterise.uncertainty",
    "sweep": "sweeps",
    "tolerance": "design.tolerance",
    "verify_design": "design",
    "workspace": "workspaces",
    "wrench_hulls": "wrench_sets.wrench_set",
}


_MODULES = ("actuators", "plot", "study")


def __getattr__(name: str) -> Any:
    """What loads when it is first used: all of it, so that the command is there before torch is."""
    if name not in _LATER and name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    if name in _MODULES:
        return import_module(f"torcharm.{name}")
    return getattr(import_module(f"torcharm.{_LATER[name]}"), name)


def __dir__() -> list[str]:
    """All public names, those included that load when they are first used."""
    return sorted({*__all__, *_MODULES, *(name for name in globals() if name.startswith("__"))})
