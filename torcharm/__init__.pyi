# isort: skip_file
# fmt: off
from . import actuators as actuators, plot as plot, study as study
from .actuators import (
    Actuator as Actuator, Bellows as Bellows, BendingFunction as BendingFunction, ConstantBending as ConstantBending,
    LinearBending as LinearBending, McKibben as McKibben, PolynomialActuator as PolynomialActuator, chamber as chamber,
    elastic_core as elastic_core,
)
from .actuators.gridded import GriddedActuator as GriddedActuator
from .arm import ArmDesign as ArmDesign, ring as ring
from .arm_series import ArmSeries as ArmSeries, RigidLink as RigidLink, series as series
from .attainability import Attainability as Attainability, PoseTolerance as PoseTolerance, evaluate as evaluate
from .characterise.alignment import Recording as Recording, align as align, pool as pool
from .characterise.choice import best_fit as best_fit
from .characterise.fit import (
    FitQuality as FitQuality, FittedActuator as FittedActuator, fit_force_model as fit_force_model,
    fit_recording as fit_recording,
)
from .characterise.force_table import read_table as read_table
from .characterise.gridded_fit import fit_gridded_model as fit_gridded_model
from .characterise.model_file import load_actuator as load_actuator, save_actuator as save_actuator
from .characterise.monotonicity import Monotonicity as Monotonicity, monotonicity as monotonicity
from .characterise.offset import OffsetEstimate as OffsetEstimate, estimate_offset as estimate_offset
from .characterise.recordings import read_pressure as read_pressure, read_tester as read_tester
from .characterise.uncertainty import (
    TensorPolynomial as TensorPolynomial, coefficient_tensor as coefficient_tensor,
    standard_deviation as standard_deviation,
)
from .design import (
    Architectures as Architectures, DesignSpace as DesignSpace, Objective as Objective,
    OptimisedDesign as OptimisedDesign, optimise_architectures as optimise_architectures,
    optimise_design as optimise_design, verify_design as verify_design,
)
from .design.robust import Robust as Robust
from .design.scatter import Scatter as Scatter
from .design.shape_planning import PlannedShape as PlannedShape, Smoothness as Smoothness, plan_shape as plan_shape
from .design.tolerance import tolerance as tolerance
from .design.tolerance_result import BuiltArms as BuiltArms
from .equilibrium import (
    Equilibrium as Equilibrium, NotConvergedError as NotConvergedError, solve_equilibrium as solve_equilibrium,
)
from .geometry.rod import poses as poses
from .load import ExternalLoad as ExternalLoad, PointLoad as PointLoad
from .pressure.pose_cost import PoseCost as PoseCost
from .pressure.predicted_error import PredictedError as PredictedError, predict_error as predict_error
from .pressure.search import PressureSearch as PressureSearch, search_pressure as search_pressure
from .pressure.wrench_fit import PressureFit as PressureFit, fit_pressure as fit_pressure
from .ready_arms import (
    antagonistic_arm as antagonistic_arm, antagonistic_ring as antagonistic_ring, bellows_arm as bellows_arm,
    mckibben_arm as mckibben_arm, silicone_arm as silicone_arm, silicone_module as silicone_module,
)
from .shapes import (
    affine_curvature as affine_curvature, arc_to as arc_to, constant_curvature as constant_curvature,
    cubic_curvature as cubic_curvature, helix as helix,
)
from .statics.cross_section import reaction_wrench as reaction_wrench
from .statics.external_load import required_wrench as required_wrench
from .sweeps import SweepResult as SweepResult, open_sweep as open_sweep, sweep as sweep
from .task import Task as Task, sample_loads as sample_loads
from .workspaces import Workspace as Workspace, workspace as workspace
from .wrench_sets.capacity import LoadCapacity as LoadCapacity, load_capacity as load_capacity
from .wrench_sets.hull_distance import HullDistance as HullDistance, kkt_residuals as kkt_residuals
from .wrench_sets.qp import qp_distance as qp_distance
from .wrench_sets.reference import nnls_distance as nnls_distance, slsqp_distance as slsqp_distance
from .wrench_sets.vertices import distance_to_hull as distance_to_hull
from .wrench_sets.wrench_set import WrenchHulls as WrenchHulls, wrench_hulls as wrench_hulls

__version__: str
