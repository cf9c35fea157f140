"""The paper's arms, and its shapes under its loads."""

import torcharm as ta

ARMS = {"antagonistic": ta.antagonistic_arm(), "bellows-only": ta.bellows_arm(), "muscle-only": ta.mckibben_arm()}
SHAPES = {"(-3, 3)": (-3.0, 3.0), "(1, 1.5)": (1.0, 1.5), "(6, -1.5)": (6.0, -1.5)}
SCALE = (20.0, 20.0, 5.0)
LOADS, FEW = 100, 3
"""Loads a shape, and those of a smoke run."""


def joint(loads: int) -> ta.Task:
    """All shapes under so many of the paper's loads."""
    slope, intercept = zip(*SHAPES.values(), strict=True)
    twists = ta.affine_curvature([[a] for a in slope], [[b] for b in intercept])
    return ta.Task(twists, ta.sample_loads(loads, SCALE))


def single(shape: str, loads: int) -> ta.Task:
    """One shape under so many of the paper's loads."""
    return ta.Task(ta.affine_curvature(*SHAPES[shape]), ta.sample_loads(loads, SCALE))


def chosen_arms(quick: bool) -> dict[str, ta.ArmDesign]:
    """All arms; the first alone in a smoke run."""
    return dict(list(ARMS.items())[: 1 if quick else None])
