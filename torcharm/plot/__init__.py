"""Pictures of arms, tasks, attainable sets and results.

`import torcharm` loads no matplotlib; `from torcharm import plot` does. Except where a whole figure is made, every
function draws into the axes it is given, or makes some, and returns them. Nothing is shown, and no setting is changed.
Colour is never the only cue: the attainable is black and solid or a dot, the rest vermillion and dashed or a cross.
"""

from torcharm.plot._common import (
    ARM_COLOURS as ARM_COLOURS,
    ARM_LINES as ARM_LINES,
    ATTAINABLE as ATTAINABLE,
    KIND_STYLES as KIND_STYLES,
    LONGEST_ARROW as LONGEST_ARROW,
    OTHER_STYLES as OTHER_STYLES,
    SMOOTHING as SMOOTHING,
    UNATTAINABLE as UNATTAINABLE,
    VERDICT_STYLES as VERDICT_STYLES,
)
from torcharm.plot.arms import arm_shape as arm_shape
from torcharm.plot.histograms import unattainability_histogram as unattainability_histogram
from torcharm.plot.hulls import (
    hull_projections as hull_projections,
    hulls_along_arm as hulls_along_arm,
    node_hull as node_hull,
)
from torcharm.plot.load_figures import load_figure as load_figure
from torcharm.plot.loads import (
    attainable_load_map as attainable_load_map,
    force_directions as force_directions,
    load_grid as load_grid,
    load_map as load_map,
    polar_load_grid as polar_load_grid,
)
from torcharm.plot.optimisation import optimisation_figure as optimisation_figure
from torcharm.plot.shape_figures import plan_figure as plan_figure, search_figure as search_figure
from torcharm.plot.study import study_figure as study_figure
from torcharm.plot.tolerance import tolerance_figure as tolerance_figure
from torcharm.plot.workspaces import workspace as workspace, workspace_figure as workspace_figure
