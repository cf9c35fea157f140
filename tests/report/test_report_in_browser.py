"""The report in headless Chromium: no errors, no hostile name run, no request, in the light, in the dark, on paper."""

import re
import subprocess

import pytest
from chromium import CHROMIUM, needs_chromium
from report_cases import IMAGE, SCRIPT, TASK, TEMPLATE, UNICODE

from torcharm.report import Evaluated, study_report, with_margins
from torcharm.study import evaluate_study, parse_study

pytestmark = needs_chromium
OPTIONS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars")

STUDY = f"""
name = '''{SCRIPT} {UNICODE}'''
description = '''{TEMPLATE}'''
[[arm]]
name = '''{IMAGE}'''
kind = "antagonistic"
outer_radius = 0.05
[[task]]
name = '''{TASK}'''
shape = {{ kind = "affine", slope = 0.0, intercept = 1.0, length = 0.5, nodes = 4 }}
loads = {{ count = 3, scale = [4, 4, 0.4] }}
"""


@pytest.fixture(scope="module")
def html():
    study = with_margins(parse_study(STUDY))
    return study_report(Evaluated(study, list(evaluate_study(study))))


def visit(folder, html, *options):
    """What the browser prints of a page, and what its console said."""
    page = folder / "page.html"
    page.write_text(html, encoding="utf-8")
    own = ("--enable-logging=stderr", f"--user-data-dir={folder / 'profile'}", f"file://{page}")
    done = subprocess.run([CHROMIUM, *OPTIONS, *options, *own], capture_output=True, timeout=60, check=True)
    console = re.findall(r":CONSOLE.*", done.stderr.decode("utf-8", "replace"))
    return done.stdout.decode("utf-8"), console


def test_it_opens_without_a_word_on_the_console_and_its_script_runs(tmp_path, html):
    page, console = visit(tmp_path, html, "--dump-dom")
    assert console == []
    assert (
        html.count('class="copy" hidden') == page.count('class="copy"') == 2
    )  # the script shows what works by it alone
    assert 'class="copy" hidden' not in page
    assert page.count("<script>") == 1
    assert "<img" not in page


def test_what_a_hostile_name_might_do_would_be_seen_and_is_forbidden(tmp_path, html):
    unescaped = html.replace("</h1>", '</h1><img src="http://127.0.0.1:9/x"><script>document.title = 7</script>', 1)
    page, console = visit(tmp_path, unescaped, "--dump-dom")
    assert len([line for line in console if "Content Security Policy" in line]) == 2
    assert "<title>7</title>" not in page
    _, console = visit(tmp_path, "<script>nothing()</script>", "--dump-dom")
    assert "nothing is not defined" in console[0]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_figures_are_as_light_or_dark_as_the_page(tmp_path, html, scheme):
    import matplotlib.image

    picture = tmp_path / "page.png"
    options = ("--window-size=900,1600", f"--blink-settings=preferredColorScheme={int(scheme == 'light')}")
    visit(tmp_path, html, *options, f"--screenshot={picture}")
    grey = matplotlib.image.imread(picture)[..., :3].mean(-1)
    dark, light = float((grey < 0.2).mean()), float((grey > 0.8).mean())
    assert (dark > 0.7, light > 0.7) == ((True, False) if scheme == "dark" else (False, True))


def test_it_prints(tmp_path, html):
    paper = tmp_path / "page.pdf"
    visit(tmp_path, html, "--no-pdf-header-footer", f"--print-to-pdf={paper}")
    pages = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", paper.read_bytes())
    sizes = {(round(float(wide)), round(float(high))) for wide, high in pages}
    assert sizes == {(595, 842), (842, 595)}  # A4: figures upright, tables across
    assert 3 <= len(pages) <= 6
