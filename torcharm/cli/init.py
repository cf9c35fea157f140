"""`torcharm init`."""

from pathlib import Path
from typing import Annotated

import typer

from torcharm.cli.terminal import mistakes, open_console, say


def init(
    path: Annotated[Path, typer.Argument(help="Where to write it.")] = Path("study.toml"),
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file if there is one.")] = False,
) -> None:
    """Write a commented study to start from."""
    with mistakes():
        from torcharm.study import example_text

        try:
            with path.open("w" if force else "x", encoding="utf-8", newline="\n") as file:
                file.write(example_text())
        except FileExistsError:
            raise ValueError(f"{path}: is there already; --force overwrites it") from None
        say(open_console(), f"Wrote {path}. Evaluate it with: torcharm evaluate {path}")
