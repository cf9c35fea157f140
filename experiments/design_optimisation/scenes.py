"""The paper's arms, and its shapes under its loads."""

import torcharm as ta
from experiments.paper import paper_task

ARMS = {"antagonistic": ta.antagonistic_arm(), "bellows-only": ta.bellows_arm(), "muscle-only": ta.mckibben_arm()}
SHAPES = {"(-3, 3)": (-3.0, 3.0), "(1, 1.5)": (1.0, 1.5), "(6, -1.5)": (6.0, -1.5)}
JOINTLY = "jointly"
SCALE = (20.0, 20.0, 5.0)


def tasks_of(shape: str, loads: int) -> ta.Task:
    """A shape, or all of them, under so many of the paper's loads."""
    slope, intercept = zip(*(SHAPES.values() if shape == JOINTLY else [SHAPES[shape]]), strict=True)
    twists = ta.affine_curvature([[a] for a in slope], [[b] for b in intercept])
    return paper_task(twists, ta.sample_loads(loads, SCALE))
