"""`torcharm explore`: a page on which an arm answers while sliders are moved."""

import logging
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from torcharm.cli import options, outputs
from torcharm.cli.terminal import compiling_told, say
from torcharm.cli.work import read_study


def explore(
    study: options.Study = None,
    out: Annotated[
        Path, typer.Option("--out", help="The one file that the page's buttons save to and load from, .toml.")
    ] = Path("explored.toml"),
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Or the next free one; 0 takes any.")] = 8080,
    host: Annotated[
        str,
        typer.Option(
            "--host",
            help="The address to serve at. By default none but this machine reaches the page; with another, such as "
            "0.0.0.0, whoever reaches this machine may see the study, move the arm and overwrite the file of --out.",
        ),
    ] = "127.0.0.1",
    no_open: Annotated[bool, typer.Option("--no-open", help="Open no browser.")] = False,
) -> None:
    """Open a page with the arm in 3-D that answers while it is changed: shape, errors, verdict, sets and margins.

    Each browser that opens it has a page of its own. Ctrl-C ends all.
    """
    outputs.check(study, out, endings=("toml",))
    import webbrowser

    from torcharm.extras import extra

    extra("viser", "explore")
    from torcharm.page.answers import answer
    from torcharm.page.server import LOOPBACK, Server
    from torcharm.page.state import BEST, BY_HAND, opened
    from torcharm.study import example_study

    plan = example_study() if study is None else read_study(study)
    if not plan.tasks:
        raise ValueError(f"{study}: task: must hold at least one table that begins with [[task]], got none")
    state = opened(plan, study)
    with compiling_told():
        for mode in (BEST, BY_HAND):  # else the page would wait for the engine, in silence
            answer(replace(state, mode=mode))
    # This process does nothing but serve: a browser may leave while its picture is on the way, and what connects
    # may be no browser, as one that tries https.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    server = Server(state, out, host, port)
    try:
        if port not in (0, server.port):
            say(f"Port {port} is in use; the page has the next one that is free.")
        say(f"{plan.name}: {server.url}")
        if host not in LOOPBACK:
            say(f"Whoever reaches this machine at {host} may see it, move the arm and overwrite {out}.")
        say(f"Its button saves to {out}{', in place of what is there' * out.exists()}. Ctrl-C ends it.")
        if not no_open:
            webbrowser.open(server.url)
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        say("Ended.")
    finally:
        server.stop()
