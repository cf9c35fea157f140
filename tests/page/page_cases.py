"""Small studies whose pages are quick, one with names that are meant to break them."""

from torcharm.page.state import opened
from torcharm.study import parse_study

HOSTILE = "x <img src=a onerror=document.title='broken'> {1+1} `臂` åß"

PLANE = f"""
name = "{HOSTILE}"
[[arm]]
name = "mine {HOSTILE}"
kind = "antagonistic"
outer_radius = 0.05
inner_radius = 0.015
length = 0.5
mass = 0.2
[[arm]]
name = "other {HOSTILE}"
radii = [-0.05, 0.0, 0.05]
length = 0.5
actuators = "bellows"
[[task]]
name = "bend {HOSTILE}"
shape = {{ kind = "affine", slope = 0.0, intercept = 1.0, length = 0.5, nodes = 6 }}
gravity = true
payloads = [{{ mass = 0.05, at = 0.5 }}]
points = [{{ wrench = [0.1, 0.0, 0.0], at = 0.5 }}]
loads = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.05]]
"""

SPACE = """
name = "space"
[[arm]]
name = "two modules"
[[arm.segment]]
ring = { radius = "50 mm", count = 3 }
actuators = "bellows"
length = "30 cm"
mass = "0.15 kg"
torsion_stiffness = 2.0
link = { length = "30 mm", mass = "50 g" }
[[arm.segment]]
ring = { radius = "40 mm", count = 3, phase = "60 deg" }
actuators = "bellows"
length = "25 cm"
torsion_stiffness = 2.0
[[task]]
name = "S"
shape = [
    { kind = "affine", slope = "12 deg", intercept = "13 deg", direction = "-60 deg", length = "43 cm", nodes = 3 },
    { kind = "constant", curvature = "29 deg", direction = "120 deg", length = "35 cm", nodes = 4 },
]
gravity = true
"""


def plane():
    return opened(parse_study(PLANE))


def space():
    return opened(parse_study(SPACE))
