"""Measure the live page through its socket, as a browser meets it, and move everything on it at random.

Prints a table and writes results.csv beside this file.
"""

import argparse
import math
import random
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from experiments.live_page.socket import Page
from experiments.rows import write_rows
from torcharm.page.answers import answer
from torcharm.page.scene import draw
from torcharm.page.server import Server
from torcharm.page.state import opened
from torcharm.study import example_text, parse_study

HERE = Path(__file__).parent
STUDIES = {"plane": False, "space": True}
SLIDERS = ("distance [mm]", "length [mm]", "limit [kPa]", "force x [N]")
BUTTONS = ("undo", "reset", "save the study", "load what was saved", "fit the view")
BURST = 100
"""Moves that are sent at once."""
WAIT = 60.0
"""For a picture, at most [s]."""


@dataclass(frozen=True)
class Row:
    """Of one arm: times from a slider's move to its picture [ms], and what came of a burst.

    Attributes:
        moves: that were timed.
        median_ms, most_ms: of 95 % of them no more.
        burst_pictures: how many pictures a burst of 100 moves brought.
        burst_ms: from its last move to the last picture.
    """

    arm: str
    moves: int
    median_ms: float
    most_ms: float
    burst_pictures: int
    burst_ms: float


@contextmanager
def serving(space: bool, folder: Path, text: str | None = None) -> Iterator[Server]:
    """A server of the example study, or of another's text."""
    study = parse_study(example_text(space) if text is None else text)
    server = Server(opened(study), folder / "saved.toml", port=0)
    try:
        yield server
    finally:
        server.stop()


@contextmanager
def page_of(server: Server) -> Iterator[Page]:
    """A page that has shown its first picture."""
    with Page(server.url) as page:
        page.until(lambda: page.pictures, WAIT)
        yield page


def timed(page: Page, moves: int, draw_random: random.Random) -> list[float]:
    """Seconds from a slider's move to its picture, one after the other."""
    found = []
    while page.receive(0.2):
        pass
    for _ in range(moves):
        before = page.pictures
        move_slider(page, draw_random)
        found.append(page.until(lambda before=before: page.pictures > before, WAIT))
    return found


def move_slider(page: Page, draw_random: random.Random) -> None:
    """Some slider of the design or the load to somewhere else."""
    sliders = [uuid for uuid, part in page.controls.items() if part.props.get("label") in SLIDERS]
    uuid = draw_random.choice(sliders)
    page.move(uuid, _within(page.controls[uuid].props, draw_random))


def _within(props: dict[str, Any], draw_random: random.Random) -> float:
    return draw_random.uniform(props["min"], props["max"])


def settled(server: Server, page: Page) -> None:
    """Wait until the page has shown all that it was asked for."""
    (view,) = server.views.values()
    quiet = 0
    while quiet < 3:
        quiet = 0 if page.receive(0.2) or not view.session.wait(WAIT) else quiet + 1


def burst(server: Server, page: Page, draw_random: random.Random) -> tuple[int, float]:
    """How many pictures a burst of moves brings, and from its last move to the last of them [s]."""
    settled(server, page)
    before = page.pictures
    for _ in range(BURST):
        move_slider(page, draw_random)
    start = time.perf_counter()
    (view,) = server.views.values()
    last = page.until(lambda: page.pictures > before, WAIT)  # before that the server may not have heard of any
    count = page.pictures
    while not (view.session.wait(0.0) and not page.receive(0.3)):
        page.receive(0.05)
        if page.pictures > count:
            last, count = time.perf_counter() - start, page.pictures
    return page.pictures - before, last


def anything(page: Page, draw_random: random.Random) -> None:
    """One event at random: any control, any button, any handle, and now and then a value that no control has."""
    choice = draw_random.random()
    if choice < 0.08:
        page.press(draw_random.choice(BUTTONS))
        return
    handle = page.scene.get("/handle")
    if choice < 0.3 and handle is not None:
        place = [draw_random.uniform(-0.6, 0.6) for _ in range(3)]
        page.drag("/handle", place, [draw_random.uniform(-1, 1) for _ in range(4)])
        return
    movable = [uuid for uuid, part in page.controls.items() if part.kind in MOVABLE]
    uuid = draw_random.choice(movable)
    props = page.controls[uuid].props
    if page.controls[uuid].kind == "GuiCheckboxMessage":
        page.move(uuid, draw_random.random() < 0.5)
    elif "options" in props:
        page.move(uuid, draw_random.choice(props["options"]))
    elif choice > 0.95:
        page.move(uuid, draw_random.choice([math.inf, -math.inf, 1e300, -1.0, 0.0]))
    else:
        page.move(uuid, _within(props, draw_random))


def stale(server: Server, page: Page) -> list[str]:
    """Names of what the page shows other than its state is, once it is settled."""
    (view,) = server.views.values()
    wanted = draw(answer(view.session.state))
    names = {f"/{name}" for name in wanted}
    shown = {name for name, part in page.scene.items() if part.kind in KINDS}
    different = sorted(names ^ shown)
    for name, element in wanted.items():
        part = page.scene.get(f"/{name}")
        if part is None:
            continue
        shown_now = {**part.props, "position": part.place}
        alike = all(_same(shown_now[key], value) for key, value in element.properties.items())
        different += [] if alike else [name]
    return different


MOVABLE = ("GuiSliderMessage", "GuiDropdownMessage", "GuiCheckboxMessage")
KINDS = ("MeshMessage", "LineSegmentsMessage", "ArrowMessage", "IcosphereMessage", "LabelMessage")
"""What the page's scene is made of."""


def _same(one: Any, other: Any) -> bool:
    if isinstance(other, str) or one is None or other is None:
        return bool(one == other)
    flat, expected = np.ravel(np.asarray(one, np.float32)), np.ravel(np.asarray(other, np.float32))
    return flat.shape == expected.shape and bool(np.allclose(flat, expected, rtol=0, atol=1e-6))


def at_random(server: Server, page: Page, events: int, seed: int = 0) -> list[str]:
    """What is stale after so many random events, which are sent as fast as a hand would, or faster."""
    draw_random = random.Random(seed)
    for _ in range(events):
        anything(page, draw_random)
        page.receive(draw_random.choice((0.001, 0.001, 0.02)))
    settled(server, page)
    return stale(server, page)


def measure(arm: str, server: Server, page: Page, moves: int) -> Row:
    """The times of one arm."""
    draw_random = random.Random(1)
    times = 1e3 * np.array(timed(page, moves, draw_random))
    pictures, last = burst(server, page, draw_random)
    return Row(arm, moves, float(np.median(times)), float(np.quantile(times, 0.95)), pictures, 1e3 * last)


def rows(moves: int, tell: Callable[[str], None], events: int) -> Iterator[Row]:
    """All arms of the example studies, and then everything at random."""
    for where, space in STUDIES.items():
        with tempfile.TemporaryDirectory() as folder, serving(space, Path(folder)) as server, page_of(server) as page:
            for name in page.controls[page.find("arm")].props["options"]:
                before = page.pictures
                page.move(page.find("arm"), name)
                if before > 1:
                    page.until(lambda before=before: page.pictures > before, WAIT)
                yield measure(f"{where}: {name}", server, page, moves)
            different = at_random(server, page, events)
            (view,) = server.views.values()
            errors = view.session.failures
            tell(f"{where}: {events} random events, {errors} errors, stale after them: {different or 'nothing'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    console = Console()
    found = list(rows(5 if quick else 100, console.print, 40 if quick else 1000))
    table = Table("arm", "median ms", "95 % ms", "pictures of a burst of 100", "last after ms")
    for row in found:
        numbers = (row.median_ms, row.most_ms, row.burst_pictures, row.burst_ms)
        table.add_row(row.arm, *(f"{number:.0f}" for number in numbers))
    console.print(table)
    if not quick:
        write_rows(HERE / "results.csv", found)
