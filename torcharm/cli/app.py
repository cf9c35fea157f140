"""The `torcharm` command: evaluate or search a study, write one to start from, fit force models, solve shapes.

A mistake that a person can make ends in one line on the standard error and exit code 2.
"""

import re
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from torcharm.cli import (
    evaluate,
    explore,
    fit,
    init,
    optimise,
    plan,
    report,
    search,
    shape,
    sweep,
    tolerance,
    workspace,
)
from torcharm.cli.terminal import INTERRUPTED, fail, mistakes

_UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # click's own, which newer typers hold inside

app = typer.Typer(
    name="torcharm",
    help="Can a soft continuum arm hold these shapes under these loads, and if not, by how much does it miss?",
    epilog="Example: torcharm init writes study.toml, torcharm evaluate study.toml evaluates it.",
    rich_markup_mode="rich",
    add_completion=False,
    pretty_exceptions_enable=False,
)


def run(arguments: Sequence[str]) -> int:
    """Run the command and return its exit code.

    Raises:
        KeyboardInterrupt: Ctrl-C came while no command was at work.
        SystemExit: with code 2 after a mistake, 130 after Ctrl-C.
    """
    # What the terminal's encoding lacks becomes a question mark, rather than the end of the work.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        code = app(arguments or ["--help"], prog_name="torcharm", standalone_mode=False)
    except _UsageError as error:
        fail(error.format_message() if hasattr(error, "format_message") else str(error))
    except typer.Abort:
        code = INTERRUPTED
    return code if isinstance(code, int) else 0


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
    pass  # holds the options of torcharm itself; `run` shows the help if nothing is given


BARE = {"--find-offset": "10"}
"""Options whose value may be left out, and what it is then."""


class _Command(TyperCommand):
    """A command in whose help texts brackets are brackets, as in [[plan]], and not rich's markup."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.help = _without_markup(self.help)
        for parameter in self.params:
            if getattr(parameter, "help", None):
                parameter.help = _without_markup(parameter.help)  # type: ignore[attr-defined]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As click does it, once options whose value is left out have one."""
        given = list[str]()
        for index, arg in enumerate(args):
            given.append(arg)
            if arg in BARE and not re.fullmatch(r"[-+]?[\d.].*|nan|inf", "".join(args[index + 1 : index + 2])):
                given.append(BARE[arg])
        return super().parse_args(ctx, given)


def _without_markup(text: str | None) -> str | None:
    """The text with a backslash before each bracket that rich would take for the beginning of a tag."""
    return text and re.sub(r"(?=\[[a-z#/@])", r"\\", text)


for _function, _example in (
    (init.init, "torcharm init --out arms.toml"),
    (evaluate.evaluate, "torcharm evaluate study.toml --out results.csv --figure picture.png"),
    (report.report, "torcharm report study.toml --out report.html"),
    (fit.fit, "torcharm fit --instron run.csv --pressure run.txt --actuators 4 --out my_bellows.toml"),
    (search.search, "torcharm search study.toml --out pressures.csv --figure reached.png"),
    (shape.shape, "torcharm shape --pressure 20,30,20,25 --load 2,-3,0.1 --figure shape.png"),
    (optimise.optimise, "torcharm optimise study.toml --out best.toml --figure best.png"),
    (workspace.workspace, "torcharm workspace study.toml --payload '200 g' --figure reach.png"),
    (plan.plan, "torcharm plan study.toml --out shapes.csv --figure shapes.png"),
    (explore.explore, "torcharm explore study.toml --out better.toml"),
    (sweep.sweep, "torcharm sweep study.toml --count 1e6 --out run"),
    (tolerance.tolerance, "torcharm tolerance study.toml --radii '1 mm' --force '5 %' --figure built.png"),
):
    app.command(cls=_Command, epilog=f"Example: {_example}")(mistakes()(_function))
