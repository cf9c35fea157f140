"""Bad input is met with a ValueError of one line that names the field, what was given and what is allowed.

The expressions run in a process of their own, as a user would run them: under the tests' import hook
the run-time type checks would stop many of them before the library sees them.
"""

import json
import subprocess
import sys

import pytest

SETUP = """
import json, math
import numpy as np
import torch
import torcharm as ta
from torcharm import ArmDesign, Bellows, McKibben, PolynomialActuator, Task

inf, nan = math.inf, math.nan
arm = ta.antagonistic_arm()
two = (Bellows(), McKibben())
twists = ta.affine_curvature(1.0, 1.0)
task = Task(twists, [[1.0, 2.0, 3.0]])
spatial = ArmDesign(offsets=ta.ring(0.05, 3), length=0.4, actuators=Bellows())
zeros = torch.zeros(4, dtype=torch.float64)

def polynomial(*terms, **changes):
    ranges = dict(strain_range=(-1.0, 1.0), pressure_range=(0.0, 50.0), max_pressure=50.0)
    return PolynomialActuator(terms, **{**ranges, **changes})
"""

# What is tried: (the field that the message names, what the message must say was given).
CASES = {
    # evaluate: kinds of arguments
    "ta.evaluate(arm, twists)": ("task", "tensor("),
    "ta.study.arm_to_toml(task, 'a')": ("arm", "Task("),
    "ta.evaluate(task, arm)": ("arm", "Task("),
    "ta.evaluate(arm, [task, twists])": ("task[1]", "tensor("),
    "ta.predict_error(arm, [None])": ("task[0]", "None"),
    "ta.search_pressure(arm, (task, arm))": ("task[1]", "ArmDesign("),
    "ta.optimise_design(arm, [task, 3])": ("task[1]", "3"),
    "ta.optimise_design(arm, [task, Task(torch.zeros(5, 6), torch.zeros(6))])": ("task[1]", "got 3"),
    "ta.optimise_design(arm, twists)": ("task", "tensor("),
    "ta.evaluate(arm, task, metrics='absolut')": ("metrics", "'absolut'; did you mean absolute?"),
    "ta.evaluate(None, task)": ("arm", "None"),
    "ta.evaluate(arm, task, metrics=None)": ("metrics", "None"),
    "ta.evaluate(arm, task, metrics=3)": ("metrics", "3"),
    "ta.evaluate(arm, task, metrics=())": ("metrics", "()"),
    "ta.evaluate(arm, task, power=torch.tensor([1, 2]))": ("power", "tensor([1, 2])"),
    "ta.evaluate(arm, task, signed='yes')": ("signed", "'yes'"),
    "ta.evaluate(arm, task, weights=torch.ones(2, 2))": ("weights", "tensor([[1., 1.]"),
    # hulls and distances
    "ta.wrench_hulls(arm, [[0.5, 0.0, 1.0]])": ("twists", "[[0.5, 0.0, 1.0]]"),
    "ta.wrench_hulls(arm, zeros[:3])": ("twists", "(3,)"),
    "ta.distance_to_hull(zeros[:3], torch.zeros(3, 2))": ("vertices", "(3, 2)"),
    "ta.distance_to_hull(zeros[:2], zeros[:2])": ("vertices", "(2,)"),
    "ta.distance_to_hull([0.0, 1.0], torch.zeros(3, 2))": ("point", "[0.0, 1.0]"),
    "ta.distance_to_hull(torch.zeros(2, 2), torch.zeros(3, 4, 2))": ("point, vertices", "(3,)"),
    # arms: lengths
    "ta.antagonistic_arm(length=-0.5)": ("length", "-0.5"),
    "ta.bellows_arm(length=0)": ("length", "0"),
    "ta.mckibben_arm(length=nan)": ("length", "nan"),
    "ta.antagonistic_arm(length='long')": ("length", "'long'"),
    "ta.antagonistic_arm(length=None)": ("length", "None"),
    "ArmDesign([0.1, 0.2], [0.5, -0.5], two)": ("length", "-0.5"),
    "ArmDesign([0.1, 0.2], [0.5, 0.5, 0.5], two)": ("length", "(3,)"),
    "ArmDesign(torch.zeros(2, 2), [0.5, 0.4], two)": ("length", "(2,)"),
    "ArmDesign(torch.zeros(3, 2), torch.ones(4, 2), two)": ("radii, length, max_pressure", "(4, 2)"),
    # arms: radii
    "ArmDesign([0.1, nan], 0.5, two)": ("radii", "nan"),
    "ArmDesign([0.1, -inf], 0.5, two)": ("radii", "-inf"),
    "ArmDesign([0.1, 0.2, 0.3], 0.5, two)": ("radii", "(3,)"),
    "ArmDesign([[]], 0.5, two)": ("radii", "(1, 0)"),
    "ArmDesign([[0.1, 0.2], [0.1]], 0.5, two)": ("radii", "[[0.1, 0.2], [0.1]]"),
    "ArmDesign([0.1, None], 0.5, two)": ("radii", "[0.1, None]"),
    "ArmDesign([0.1, 10**400], 0.5, two)": ("radii", "[0.1, 1000"),
    "ArmDesign({'left': 0.1}, 0.5, two)": ("radii", "{'left': 0.1}"),
    "ArmDesign(np.array([['a'], ['b']]), 0.5, two)": ("radii", "array([['a'], ['b']]"),
    "ArmDesign(torch.zeros(2, dtype=torch.complex64), 0.5, two)": ("radii", "torch.complex64"),
    "ArmDesign(np.array([1j, 2j]), 0.5, two)": ("radii", "torch.complex128"),
    "ArmDesign([1j, 2j], 0.5, two)": ("radii", "[1j, 2j]"),
    "ArmDesign([torch.tensor(1j), 0.1], 0.5, two)": ("radii", "torch.complex64"),
    "ArmDesign([torch.zeros(1), torch.zeros(2)], 0.5, two)": ("radii", "[1]"),
    "ta.antagonistic_arm(outer_radius=nan)": ("outer_radius", "nan"),
    "ta.antagonistic_arm(inner_radius='narrow')": ("inner_radius", "'narrow'"),
    "ta.antagonistic_arm([0.1, 0.2], [0.1, 0.2, 0.3])": ("outer_radius, inner_radius", "(3,)"),
    # arms: actuators
    "ArmDesign([0.1, 0.2], 0.5, [])": ("actuators", "none"),
    "ArmDesign([0.1, 0.2], 0.5, None)": ("actuators", "None"),
    "ArmDesign([0.1, 0.2], 0.5, Bellows)": ("actuators", "Bellows"),
    "ArmDesign([0.1, 0.2], 0.5, 3.0)": ("actuators", "3.0"),
    "ArmDesign(length=0.5, actuators=two)": ("radii", "None"),
    "ArmDesign([0.1, 0.2], actuators=two)": ("length", "None"),
    "ArmDesign([0.1, 0.2], 0.5)": ("actuators", "None"),
    "ArmDesign([0.1, 0.2], 0.5, two, offsets=[[0.1, 0.0], [0.2, 0.0]])": ("offsets", "both"),
    "ArmDesign(offsets=[0.1, 0.2, 0.3], length=0.5, actuators=two)": ("offsets", "(3,)"),
    "ArmDesign(offsets=ta.ring(0.05, 3), length=0.5, actuators=two)": ("offsets", "got 3"),
    "ArmDesign([0.1, 0.2], 0.5, two, mass=-1)": ("mass", "-1"),
    "ArmDesign([0.1, 0.2], 0.5, two, mass=nan)": ("mass", "nan"),
    "ArmDesign(torch.zeros(3, 2), 0.5, two, mass=[0.1, 0.2])": ("radii, length, max_pressure, mass", "(2, 1)"),
    "ArmDesign([0.1, 0.2], 0.5, two, torsion_stiffness=0)": ("torsion_stiffness", "0"),
    "ArmDesign([0.1, 0.2], 0.5, two, diameter=[0.1, 0.2, 0.3])": ("diameter", "(3,)"),
    "ArmDesign([0.1, 0.2], 0.5, two, out_of_plane=[0.1])": ("out_of_plane", "(1,)"),
    "ta.ring(-0.05, 3)": ("radius", "-0.05"),
    "ta.ring(0.05, 0)": ("count", "0"),
    "ta.ring(0.05, 3, nan)": ("phase", "nan"),
    "ta.RigidLink()": ("length", "neither"),
    "ta.RigidLink(0.1, [0.0, 0.0, 0.0])": ("length", "both"),
    "ta.RigidLink(-0.1)": ("length", "-0.1"),
    "ta.RigidLink(0.1, mass=-1)": ("mass", "-1"),
    "ta.RigidLink(pose=torch.ones(4, 4))": ("pose", "1.0"),
    "ta.RigidLink(pose=[0.1, 0.2])": ("pose", "(2,)"),
    "ta.series([])": ("parts", "none"),
    "ta.series(arm)": ("parts", "ArmDesign("),
    "ta.series([ta.RigidLink(0.1), arm])": ("parts[0]", "base"),
    "ta.series([arm, ta.RigidLink(0.1), ta.RigidLink(0.1)])": ("parts[2]", "another link"),
    "ta.series([arm, 3])": ("parts[1]", "3"),
    "ta.series([arm, ArmDesign(offsets=ta.ring(0.05, 3), length=0.4, actuators=Bellows())])": ("segments[1]", "3"),
    "ta.series([arm, ta.RigidLink(pose=torch.eye(4)), arm])": ("links[0].pose", "(..., 3)"),
    "ta.PointLoad()": ("wrench", "None"),
    "ta.PointLoad(mass=-1)": ("mass", "-1"),
    "ta.PointLoad([1.0, 2.0])": ("wrench", "(2,)"),
    "ta.PointLoad([1.0, 2.0, 0.0], at=1.5)": ("at", "1.5"),
    "ta.PointLoad([1.0, 2.0, 0.0], at=-0.1)": ("at", "-0.1"),
    "ta.PointLoad([1.0, 2.0, 0.0], segment=-2)": ("segment", "-2"),
    "ta.PointLoad([1.0, 2.0, 0.0], frame='tip')": ("frame", "'tip'"),
    "ta.PointLoad([1.0, 2.0, 0.0], mass=-1)": ("mass", "-1"),
    "ta.ExternalLoad(points=[ta.PointLoad(mass=0.1)])": ("points[0].mass", "gravity=True"),
    "ta.ExternalLoad([1.0, 2.0, 0.0], points=[ta.PointLoad(torch.zeros(6))])": ("points[0].wrench", "6"),
    "ta.ExternalLoad(gravity=9.81)": ("gravity", "9.81"),
    "ta.ExternalLoad(points=[3])": ("points[0]", "3"),
    "Task(twists, load=[0.0, 0.0, 0.0])": ("load", "[0.0, 0.0, 0.0]"),
    "Task(twists, [0.0, 0.0, 0.0], load=ta.ExternalLoad(points=ta.PointLoad(torch.zeros(6))))": ("load", "6"),
    "Task(twists, load=ta.ExternalLoad(points=ta.PointLoad([1.0, 0.0, 0.0], segment=1)))": (
        "points[0].segment",
        "got 1",
    ),
    "Task(twists, [0.0, 0.0, 0.0], segment_nodes=[4, 5])": ("segment_nodes", "[4, 5]"),
    "Task(twists, [0.0, 0.0, 0.0], wrench_at='end')": ("wrench_at", "'end'"),
    "Task(torch.zeros(5, 6), torch.zeros(3))": ("tip_load", "(3,)"),
    "Task(torch.zeros(5, 6), torch.zeros(6), torch.zeros(3))": ("base_pose", "(3,)"),
    "ta.optimise_design(spatial, task)": ("task", "got 2"),
    "ta.optimise_design(ta.series([arm, arm]), task)": ("segment_nodes", "got none"),
    "ta.optimise_design(arm, task, objective='mean')": ("objective", "'mean'"),
    "ta.optimise_architectures(ta.series([arm, arm]), task)": ("segment_nodes", "got none"),
    "ta.Objective(pose_cost=3)": ("pose_cost", "3"),
    "ta.DesignSpace(in_range=1)": ("in_range", "1"),
    "ta.evaluate(arm, Task(torch.zeros(5, 6), torch.zeros(6)))": ("task", "got 3"),
    "ta.solve_equilibrium(spatial, [1.0, 1.0, 1.0], [0.0, 0.0, 0.0])": ("load", "(3,)"),
    "ta.solve_equilibrium(ta.series([arm, arm]), [1.0] * 4, [0.0, 0.0, 0.0])": ("pressure", "(4,)"),
    "ta.evaluate(spatial, task)": ("task", "got 2"),
    "ta.wrench_hulls(spatial, twists)": ("twists", "(10, 3)"),
    "ArmDesign([0.1, 0.2], 0.5, 'bellow')": ("actuators", "'bellow'; did you mean bellows?"),
    "ArmDesign([0.1, 0.2], 0.5, ['bellows', 'McKibben'])": ("actuators[1]", "'McKibben'; did you mean mckibben?"),
    "ArmDesign([0.1, 0.2], 0.5, ['', Bellows()])": ("actuators[0]", "''"),
    "ArmDesign(0.1, 0.5, two, max_pressure=-1)": ("max_pressure", "-1"),
    "ArmDesign(nan, 0.5, two)": ("radii", "nan"),
    "ArmDesign([0.1, 0.2], 0.5, two, out_of_plane=nan)": ("out_of_plane", "nan"),
    "ArmDesign([0.1, 0.2], 0.5, two, diameter=0)": ("diameter", "0"),
    "ta.optimise_architectures(arm, task, models='bellows')": ("models", "'bellows'"),
    "ta.optimise_architectures(arm, task, models=['bellows', 'muscle'])": ("models[1]", "'muscle'"),
    "ta.optimise_architectures(arm, task, models=[Bellows])": ("models[0]", "Bellows"),
    "ta.monotonicity('bellow')": ("model", "'bellow'; did you mean bellows?"),
    "ta.monotonicity(3)": ("model", "3"),
    "ArmDesign([0.1, 0.2], 0.5, [Bellows(), McKibben])": ("actuators[1]", "McKibben"),
    "ArmDesign([0.1, 0.2], 0.5, [Bellows(), 3])": ("actuators[1]", "3"),
    "ArmDesign([0.1, 0.2], 0.5, [torch.zeros(3, 3), Bellows()])": ("actuators[0]", "tensor("),
    "ArmDesign([0.1, 0.2, 0.3], 0.5, [Bellows()] * 2)": ("radii", "(3,)"),
    # arms: limits
    "ArmDesign([0.1, 0.2], 0.5, two, [50.0, -1.0])": ("max_pressure", "-1"),
    "ArmDesign([0.1, 0.2], 0.5, two, [50.0, nan])": ("max_pressure", "nan"),
    "ArmDesign([0.1, 0.2], 0.5, two, [50.0] * 3)": ("max_pressure", "(3,)"),
    "ArmDesign([0.1, 0.2], 0.5, two, 'high')": ("max_pressure", "'high'"),
    "arm[0]": ("index", "single design"),
    # force models
    "Bellows(max_pressure=0.0)": ("max_pressure", "0.0"),
    "McKibben(max_pressure=nan)": ("max_pressure", "nan"),
    "McKibben(bending_stiffness=inf)": ("bending_stiffness", "inf"),
    "McKibben(force_scale=nan)": ("force_scale", "nan"),
    "Bellows(strain_range=(1.0, -1.0))": ("strain_range", "(1.0, -1.0)"),
    "Bellows(pressure_range=50.0)": ("pressure_range", "50.0"),
    "polynomial((0.5, 0, 1.0))": ("coefficients", "(0.5, 0)"),
    "polynomial((0, -1, 1.0))": ("coefficients", "(0, -1)"),
    "polynomial((inf, 0, 1.0))": ("coefficients", "(inf, 0)"),
    "polynomial((0, 1))": ("coefficients", "((0, 1),)"),
    "polynomial(('strain', 0, 1.0))": ("coefficients", "(('strain', 0, 1.0),)"),
    "polynomial((0, 1, nan))": ("coefficients", "nan"),
    "polynomial((0, 1, 1.0), max_pressure='high')": ("max_pressure", "'high'"),
    "ta.GriddedActuator('ab', (0, 1), ((0, 1), (0, 1)), 1.0)": ("strains", "'ab'"),
    "ta.GriddedActuator((0, 1), None, ((0, 1), (0, 1)), 1.0)": ("pressures", "None"),
    "ta.GriddedActuator((0, 1), (0, 1), 3, 1.0)": ("forces", "3"),
    "Bellows(bending_stiffness='stiff')": ("bending_stiffness", "'stiff'"),
    "ta.LinearBending('stiff')": ("stiffness", "'stiff'"),
    "ta.LinearBending(-0.1, reference_pressure='high')": ("reference_pressure", "'high'"),
    "ta.ConstantBending(None)": ("stiffness", "None"),
    "ta.BendingFunction(3, 50.0)": ("function", "3"),
    # characterisation
    "ta.fit_force_model('a', [1.0], [1.0])": ("strain", "'a'"),
    "ta.fit_force_model([1.0, None], [1.0, 2.0], [1.0, 2.0])": ("strain", "[1.0, None]"),
    "ta.fit_force_model([[1.0], [2.0, 3.0]], [1.0], [1.0])": ("strain", "[[1.0], [2.0, 3.0]]"),
    "ta.fit_force_model([1.0], [1.0], [1.0], degree='three')": ("degree", "'three'"),
    "ta.fit_force_model([1.0], [1.0], [1.0], loss=None)": ("loss", "None"),
    "ta.fit_force_model([1.0], [1.0], [1.0], max_pressure='high')": ("max_pressure", "'high'"),
    "ta.read_pressure('no/such/file.txt', unit=3)": ("unit", "3"),
    "ta.save_actuator('x.toml', 3)": ("model", "3"),
    "ta.save_actuator('x.toml', 'mckiben')": ("model", "'mckiben'; did you mean mckibben?"),
    "ta.pool([])": ("recordings", "none"),
    "ta.monotonicity(Bellows(), strain_range=(1.0, nan))": ("strain_range", "nan"),
    # tasks
    "Task(twists[:, :2], [0.0, 0.0, 0.0])": ("twists", "(10, 2)"),
    "Task(torch.zeros(3), [0.0, 0.0, 0.0])": ("twists", "(3,)"),
    "Task(torch.zeros(0, 3), [0.0, 0.0, 0.0])": ("twists", "(0, 3)"),
    "Task('straight', [0.0, 0.0, 0.0])": ("twists", "'straight'"),
    "Task([[[1, 2, 3], [1, 2]]], [0.0, 0.0, 0.0])": ("twists", "[[[1, 2, 3], [1, 2]]]"),
    "Task(twists * inf, [0.0, 0.0, 0.0])": ("twists", "inf"),
    "Task(twists, [0.0, 0.0])": ("tip_load", "(2,)"),
    "Task(twists, 1.0)": ("tip_load", "()"),
    "Task(twists, [nan, 0.0, 0.0])": ("tip_load", "nan"),
    "Task(twists, np.ones(3, dtype=complex))": ("tip_load", "torch.complex128"),
    "Task(twists.expand(4, 10, 3), torch.zeros(3, 3))": ("twists, tip_load", "(3,)"),
    "Task(twists, [0.0, 0.0, 0.0], [0.0, 0.0])": ("base_pose", "(2,)"),
    "Task(twists, [0.0, 0.0, 0.0], [0.0, 0.0, inf])": ("base_pose", "inf"),
    # shapes
    "ta.affine_curvature(1.0, 1.0, nodes=0)": ("nodes", "0"),
    "ta.affine_curvature(1.0, 1.0, nodes=2.5)": ("nodes", "2.5"),
    "ta.affine_curvature(1.0, 1.0, nodes=True)": ("nodes", "True"),
    "ta.affine_curvature(1.0, 1.0, nodes='ten')": ("nodes", "'ten'"),
    "ta.cubic_curvature(1.0, 1.0, 1.0, 1.0, nodes=-3)": ("nodes", "-3"),
    "ta.affine_curvature(nan, 1.0)": ("slope", "nan"),
    "ta.affine_curvature(1.0, 'flat')": ("intercept", "'flat'"),
    "ta.affine_curvature(1.0, 1.0, length=-0.5)": ("length", "-0.5"),
    "ta.affine_curvature([1.0, 2.0], [1.0, 2.0, 3.0])": ("slope, intercept, length", "(3,)"),
    "ta.cubic_curvature(1.0, inf, 1.0, 1.0)": ("quadratic", "inf"),
    # loads
    "ta.sample_loads(-1)": ("count", "-1"),
    "ta.load_actuator(3)": ("path", "3"),
    "ta.sample_loads(1.5)": ("count", "1.5"),
    "ta.sample_loads(True)": ("count", "True"),
    "ta.sample_loads(3, seed=2**32)": ("seed", "4294967296"),
    "ta.sample_loads(3, seed=-1)": ("seed", "-1"),
    "ta.sample_loads(3, seed=None)": ("seed", "None"),
    "ta.sample_loads(3, [1.0, 2.0])": ("scale", "(2,)"),
    "ta.sample_loads(3, [1.0, 2.0, nan])": ("scale", "nan"),
    "ta.sample_loads(3, 'big')": ("scale", "'big'"),
    # evaluate
    "ta.evaluate(arm, task, metrics=('absolute', 'speed'))": ("metrics", "'speed'"),
    "ta.evaluate(arm, task, metrics='speed')": ("metrics", "'speed'"),
    "ta.evaluate(arm, task, hull='round')": ("hull", "'round'"),
    "ta.evaluate(arm, task, hull=None)": ("hull", "None"),
    "ta.evaluate(arm, task, hull=np.array(['exact', 'edges']))": ("hull", "array(['exact', 'edges']"),
    "ta.evaluate(arm, task, hull='edges', samples=1)": ("samples", "1"),
    "ta.evaluate(arm, task, distance='scipy', samples=2.5)": ("samples", "2.5"),
    "ta.evaluate(arm, task, hull='edges', samples=True)": ("samples", "True"),
    "ta.evaluate(arm, task, samples=9)": ("samples", "9"),
    "ta.evaluate(arm, task, hull='edges', signed=True)": ("signed", "True"),
    "ta.evaluate(ArmDesign([0.01] * 13, 0.5, [Bellows()] * 13), task, hull='edges')": ("hull", "13"),
    "ta.evaluate(arm, task, distance='closed_form')": ("distance", "'closed_form'"),
    "ta.evaluate(arm, task, power=3)": ("power", "3"),
    "ta.evaluate(arm, task, power=True)": ("power", "True"),
    "ta.evaluate(arm, task, weights=(0.0, 1.0))": ("weights", "(0.0, 1.0)"),
    "ta.evaluate(arm, task, weights=(1.0, -1.0))": ("weights", "(1.0, -1.0)"),
    "ta.evaluate(arm, task, weights=(1.0, 1.0, 1.0))": ("weights", "(1.0, 1.0, 1.0)"),
    "ta.evaluate(arm, task, weights=(1.0, inf))": ("weights", "inf"),
    "ta.evaluate(arm, task, weights=2.0)": ("weights", "2.0"),
    "ta.evaluate(arm, task, chunk_size=0)": ("chunk_size", "0"),
    "ta.evaluate(arm, task, chunk_size=2.5)": ("chunk_size", "2.5"),
    # hulls and distances
    "ta.wrench_hulls(arm, twists, hull='round')": ("hull", "'round'"),
    "ta.wrench_hulls(arm, twists, samples=1)": ("samples", "1"),
    "ta.distance_to_hull(torch.zeros(2), torch.zeros(0, 2))": ("vertices", "none"),
    # poses and wrenches
    "ta.poses(twists[:, :2])": ("twists", "(10, 2)"),
    "ta.poses(torch.zeros(3))": ("twists", "(3,)"),
    "ta.poses(torch.zeros(0, 3))": ("twists", "(0, 3)"),
    "ta.poses(twists.tolist())": ("twists", "[[0.5, 0.0, 1.0], "),
    "ta.poses(torch.zeros(10, 3, dtype=torch.int64))": ("twists", "tensor([[0, 0, 0], [0, 0, 0]"),
    "ta.poses(twists, torch.zeros(2))": ("base_pose", "(2,)"),
    "ta.poses(twists, [0.0, 0.0, 0.0])": ("base_pose", "[0.0, 0.0, 0.0]"),
    "ta.poses(twists.expand(2, 10, 3), torch.zeros(5, 3))": ("twists, base_pose", "(5,)"),
    "ta.required_wrench(twists[:, :2], torch.zeros(3))": ("twists", "(10, 2)"),
    "ta.required_wrench(twists, torch.zeros(2))": ("load", "(2,)"),
    "ta.required_wrench(twists, [0.0, 0.0, 1.0])": ("load", "[0.0, 0.0, 1.0]"),
    "ta.required_wrench(twists, torch.zeros(3), torch.zeros(2))": ("base_pose", "(2,)"),
    "ta.required_wrench(twists.expand(2, 10, 3), torch.zeros(5, 3))": ("twists, load", "(5,)"),
    "ta.reaction_wrench(arm, twists, [-1.0, 0.0, 0.0, 0.0])": ("pressure", "-1"),
    "ta.reaction_wrench(arm, twists, [nan, 0.0, 0.0, 0.0])": ("pressure", "nan"),
    "ta.reaction_wrench(arm, twists, [0.0, 0.0, 0.0])": ("pressure", "(3,)"),
    "ta.reaction_wrench(arm, twists, -50.0)": ("pressure", "-50"),
    "ta.solve_equilibrium(arm, nan, zeros[:3])": ("pressure", "nan"),
    "ta.reaction_wrench(arm, twists, None)": ("pressure", "None"),
    "ta.reaction_wrench(arm, twists[:, :2], zeros)": ("twists", "(10, 2)"),
    "ta.reaction_wrench(arm, twists.tolist(), zeros)": ("twists", "[[0.5, 0.0, 1.0], "),
    "ta.reaction_wrench(arm, twists.expand(2, 10, 3), zeros.expand(3, 4))": ("twists, pressure, radii", "(3,)"),
}

# What looks odd and is nevertheless understood.
ACCEPTED = {
    "ta.affine_curvature(1.0, 1.0, nodes=np.int64(5)).shape == (5, 3)",
    "ta.sample_loads(np.int32(2), seed=np.uint32(3)).shape == (2, 3)",
    "ta.reaction_wrench(arm, twists, [10, 20, 30, 40]).dtype == torch.float64",
    "ta.reaction_wrench(arm, twists, 20).equal(ta.reaction_wrench(arm, twists, [20] * 4))",
    "ArmDesign(0.1, 0.5, Bellows()).radii.tolist() == [0.1]",
    "ArmDesign(np.float64(0.1), 0.5, two).radii.tolist() == [0.1, 0.1]",
    "ta.reaction_wrench(ta.antagonistic_arm(torch.tensor(0.08)), twists.float(), [10] * 4).dtype == torch.float32",
    "PolynomialActuator([[1.0, 2.0, 3], (0, 0, 1)], (-1, 1), (0, 50), 50) == polynomial((1, 2, 3.0), (0, 0, 1.0))",
    "polynomial().force(torch.ones(3), torch.ones(2, 1)).tolist() == [[0.0] * 3] * 2",
    "ArmDesign(np.array([0.1, 0.2])[::-1], 0.5, two).radii.tolist() == [0.2, 0.1]",
    "Bellows(strain_range=(-inf, inf)).strain_range == (-inf, inf)",
}

RUN = """
def outcome(expression):
    try:
        return ["value", repr(eval(expression))]
    except Exception as error:
        return [type(error).__name__, str(error)]

print(json.dumps({expression: outcome(expression) for expression in json.loads(input())}))
"""


@pytest.fixture(scope="module")
def outcomes():
    expressions = json.dumps([*CASES, *sorted(ACCEPTED)])
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SETUP + RUN],
        input=expressions,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("expression", CASES)
def test_bad_input_is_refused_in_one_line_that_names_the_field(outcomes, expression):
    kind, message = outcomes[expression]
    field, given = CASES[expression]
    assert kind == "ValueError", message
    assert message.startswith(f"{field}: ")
    assert given in message.removeprefix(f"{field}: ")
    assert "\n" not in message
    assert any(
        word in message for word in ("must", "at most", "do not broadcast", "give (", "has no")
    )  # what is allowed
    assert len(message) < 400


@pytest.mark.parametrize("expression", sorted(ACCEPTED))
def test_unusual_but_sensible_input_is_accepted(outcomes, expression):
    assert outcomes[expression] == ["value", "True"]
