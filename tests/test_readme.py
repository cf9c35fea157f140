"""The README: short, and its examples run."""

import re
from pathlib import Path

import torch

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / ".github" / "CONTRIBUTING.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
MOST_WORDS = 1300


def test_it_is_read_in_five_minutes():
    assert len(README.split()) <= MOST_WORDS


def test_links_lead_somewhere():
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", README)
    assert targets
    assert [target for target in targets if not (ROOT / target).exists()] == []


def test_the_contributors_page_is_short_and_names_files_that_there_are():
    assert len(CONTRIBUTING.splitlines()) <= 40
    named = re.findall(r"`([\w./]+/[\w.]*)`", CONTRIBUTING)
    assert len(named) > 20
    assert [name for name in named if not any((base / name).exists() for base in (ROOT, ROOT / "torcharm"))] == []


def test_the_examples_run():
    names: dict[str, object] = {}
    for block in BLOCKS:
        exec(block, names)
    found = names["found"]
    assert (found.verdict, found.reason, found.pressure.shape) == ("held", "", (6,))
    assert f"{float(found.tip_error):.4f} m" in BLOCKS[0]
    assert names["missing"].relative.shape == (200, 100)
    assert names["radius"].grad.isfinite().all()
    assert bool((names["radius"].grad != 0).any())
    assert len(BLOCKS) >= 2
    assert isinstance(names["arm"].length, torch.Tensor)
