"""The `torcharm` command: evaluate or search a study, write one to start from, fit force models, solve shapes.

A mistake that a person can make ends in one line on the standard error and exit code 2.
"""

import sys
from typing import Annotated

import typer

from torcharm.cli import evaluate, fit, init, optimise, plan, search, shape
from torcharm.cli.terminal import INTERRUPTED, fail

_UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # click's own, which newer typers hold inside

app = typer.Typer(
    name="torcharm",
    help="Can a soft continuum arm hold these shapes under these loads, and if not, by how much does it miss?",
    epilog="Example: torcharm init writes study.toml, torcharm evaluate study.toml evaluates it.",
    rich_markup_mode="rich",
    add_completion=False,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command and exit: 0, or 2 after a mistake, or 130 after Ctrl-C."""
    # What the terminal's encoding lacks becomes a question mark, rather than the end of the work.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        code = app(sys.argv[1:] or ["--help"], prog_name="torcharm", standalone_mode=False)
    except _UsageError as error:
        fail(error.format_message() if hasattr(error, "format_message") else str(error))
    except (typer.Abort, KeyboardInterrupt):
        code = INTERRUPTED
    sys.exit(code if isinstance(code, int) else 0)


def _show_version(wanted: bool) -> bool:
    if wanted:
        from torcharm import __version__

        typer.echo(f"torcharm {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass  # holds the options of torcharm itself; `main` shows the help if there are none


app.command(epilog="Example: torcharm init arms.toml")(init.init)
app.command(epilog="Example: torcharm evaluate study.toml --out results.csv --figure picture.png")(evaluate.evaluate)
app.command(epilog="Example: torcharm fit --instron run.csv --pressure run.txt --actuators 4 --out my_bellows.toml")(
    fit.fit
)
app.command(epilog="Example: torcharm search study.toml --out pressures.csv")(search.search)
app.command(epilog="Example: torcharm shape --pressure 20,30,20,25 --load 2,-3,0.1 --figure shape.png")(shape.shape)
app.command(epilog="Example: torcharm optimise study.toml --out best.csv --figure best.png")(optimise.optimise)
app.command(epilog="Example: torcharm plan study.toml --out shapes.csv")(plan.plan)
