"""Options that several commands have."""

from pathlib import Path
from typing import Annotated, Any

import typer

from torcharm.cli.outputs import FIGURE_FORMATS

Study = Annotated[Path | None, typer.Argument(help="A study, as TOML. Without one, the example of torcharm init.")]
Rows = Annotated[
    Path | None, typer.Option("--out", help="Write a row for every arm, task and load, to a file .csv or .json.")
]
Json = Annotated[bool, typer.Option("--json", help="Print the rows of --out as JSON, and no tables.")]
Sums = Annotated[bool, typer.Option("--sums", help="Show the paper's sums over the nodes, too.")]
Nodes = Annotated[int, typer.Option("--nodes", help="Elements of the arm, or of each segment.")]


def figure(draws: str) -> Any:
    """The option --figure of a command, which draws something."""
    return typer.Option("--figure", help=f"{draws}, to a file ending in {', '.join(FIGURE_FORMATS)}.")
