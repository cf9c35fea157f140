"""Where arms can reach, with what payload."""

from torcharm.workspaces.evaluation import workspace
from torcharm.workspaces.result import Cells, Workspace
from torcharm.workspaces.states import STATES

__all__ = ["STATES", "Cells", "Workspace", "workspace"]
