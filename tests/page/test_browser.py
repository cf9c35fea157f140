"""The page in a real browser: it opens, a slider moves the arm, the verdict changes, and what is saved reads back."""

import contextlib

import pytest
import torch
from page_cases import HOSTILE, PLANE

from torcharm.page.state import opened
from torcharm.study import load_study, parse_study

pytest.importorskip("viser", reason="needs torcharm[explore]")

from browser import Browser, until
from chromium import needs_chromium

from torcharm.page.server import Server

pytestmark = needs_chromium


@contextlib.contextmanager
def served(folder, text=PLANE):
    server = Server(opened(parse_study(text)), folder / "saved.toml", port=0)
    try:
        yield server
    finally:
        server.stop()


def shown(tab, words):
    return lambda: words in tab.text()


def test_a_person_explores_saves_and_reads_back(tmp_path):
    with served(tmp_path) as server, Browser(tmp_path / "profile", (1000, 640)) as browser:
        tab = browser.open(server.url)
        until(shown(tab, "tip off"), 40)
        (view,) = server.views.values()
        assert tab.text().split("Results")[-1].split()[0] == "held"
        assert tab.value("document.title") == f"{HOSTILE} – torcharm"
        assert HOSTILE in tab.text()  # as words, nothing of it is done
        assert tab.value("document.querySelectorAll('img[src=a]').length") == 0

        before = view.session.state
        until(lambda: tab.slide("limit [kPa]", 0.1) or view.session.state != before, 20)
        until(shown(tab, "missed"), 20)
        limit = view.session.state.designs[0][0].limit
        assert limit == pytest.approx(5 + 0.1 * 70, abs=4)  # of 5 to 75 kPa, as far as a hand can

        tab.press("save the study")
        until(shown(tab, "Saved to"), 20)
        saved = load_study(tmp_path / "saved.toml")
        assert saved.arms[0].name == before.named_arm.name
        assert saved.arms[0].design.max_pressure[0].item() == pytest.approx(limit, rel=1e-9)

        tab.press("undo")
        until(shown(tab, "held"), 20)
        assert view.session.state.designs == before.designs
        tab.press("load what was saved")
        until(shown(tab, "missed"), 20)
        torch.testing.assert_close(view.session.state.named_arm.design.max_pressure, saved.arms[0].design.max_pressure)
        assert tab.errors == []
        assert view.session.failures == 0

        server.stop()
        until(shown(tab, "This page has ended"), 20)
