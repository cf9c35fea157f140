"""The experiments' READMEs: short, and they name pictures and experiments that are there."""

import re

import pytest

from experiments import runner

FOUND = runner.discover()
MOST_WORDS = 300
OVERVIEW = runner.HERE / "README.md"


def prose(text):
    """The words outside of tables."""
    return [word for line in text.splitlines() if not line.startswith("|") for word in line.split()]


@pytest.mark.parametrize("experiment", FOUND, ids=lambda experiment: experiment.name)
def test_a_readme_is_short_begins_with_its_finding_and_shows_pictures_that_are_there(experiment):
    text = (experiment.folder / "README.md").read_text(encoding="utf-8")
    assert len(prose(text)) <= MOST_WORDS
    title = text.splitlines()[0]
    assert title.startswith("# ")
    assert not title.endswith("?"), "a finding is no question"
    shown = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert [name for name in shown if not (experiment.folder / name).is_file()] == []


def test_the_overview_lists_every_experiment_and_links_lead_somewhere():
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", OVERVIEW.read_text(encoding="utf-8"))
    assert [target for target in targets if not (runner.HERE / target).exists()] == []
    assert {experiment.name for experiment in FOUND} <= set(targets)
