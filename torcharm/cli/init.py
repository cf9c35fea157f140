"""`torcharm init`."""

from pathlib import Path
from typing import Annotated

import typer

from torcharm.cli.terminal import say


def init(
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Where to write it.", show_default="study.toml, space.toml, all_keys.toml"),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Write every key that a study may have, what it may be, and its default.")
    ] = False,
    space: Annotated[bool, typer.Option("--space", help="Write a study of arms in space.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file if there is one.")] = False,
) -> None:
    """Write a commented study to start from; with --all, a reference of all keys, which is a study too."""
    if every and space:
        raise ValueError("--space: must not stand beside --all, which has the keys of space too")
    from torcharm.files import atomic_write
    from torcharm.study import example_text, key_reference

    path = out or Path("all_keys.toml" if every else "space.toml" if space else "study.toml")
    if path.exists() and not force:
        raise ValueError(f"{path}: is there already; --force overwrites it")
    with atomic_write(path) as partial:
        partial.write_text(key_reference() if every else example_text(space), encoding="utf-8", newline="\n")
    say(f"Wrote {path}. Evaluate it with: torcharm evaluate {path}")
