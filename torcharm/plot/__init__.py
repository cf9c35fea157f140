"""Pictures of arms, tasks, attainable sets and results.

`import torcharm` loads no matplotlib; `from torcharm import plot` does. Except where a whole figure is made, every
function draws into the axes it is given, or makes some, and returns them. Nothing is shown, and no setting is changed.
Colour is never the only cue: the attainable is black and solid or a dot, the rest vermillion and dashed or a cross.
"""

from torcharm.plot._common import (
    ARM_COLOURS,
    ARM_LINES,
    ATTAINABLE,
    KIND_STYLES,
    LONGEST_ARROW,
    OTHER_STYLES,
    SMOOTHING,
    UNATTAINABLE,
    VERDICT_STYLES,
)
from torcharm.plot.arms import arm_shape
from torcharm.plot.histograms import unattainability_histogram
from torcharm.plot.hulls import hull_projections, hulls_along_arm, node_hull
from torcharm.plot.load_figures import load_figure
from torcharm.plot.loads import (
    attainable_load_map,
    force_directions,
    load_grid,
    load_map,
    polar_load_grid,
    verdict_map,
)
from torcharm.plot.optimisation import optimisation_figure
from torcharm.plot.shape_figures import plan_figure, search_figure
from torcharm.plot.study import study_figure
from torcharm.plot.tolerance import tolerance_figure
from torcharm.plot.workspaces import workspace, workspace_figure

__all__ = [
    "ARM_COLOURS",
    "ARM_LINES",
    "ATTAINABLE",
    "KIND_STYLES",
    "LONGEST_ARROW",
    "OTHER_STYLES",
    "SMOOTHING",
    "UNATTAINABLE",
    "VERDICT_STYLES",
    "arm_shape",
    "attainable_load_map",
    "force_directions",
    "hull_projections",
    "hulls_along_arm",
    "load_figure",
    "load_grid",
    "load_map",
    "node_hull",
    "optimisation_figure",
    "plan_figure",
    "polar_load_grid",
    "search_figure",
    "study_figure",
    "tolerance_figure",
    "unattainability_histogram",
    "verdict_map",
    "workspace",
    "workspace_figure",
]
