"""The report as a page: everything in it, escaped, alike each time, and nothing that reaches out."""

import base64
import csv
import hashlib
import io
import math
import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch
from report_cases import IMAGE, NAMES, SCRIPT, SERIES, STUDY, TASK, TEMPLATE, UNICODE, Page

from torcharm.attainability import VERDICTS
from torcharm.report import SECTIONS, Block, Evaluated, Section, page, study_report, with_margins
from torcharm.report.figures import MISSED_BY
from torcharm.study import evaluate_study, load_study, parse_study, result_rows, summarise
from torcharm.study.reading import example_text


@pytest.fixture(scope="module")
def evaluated():
    study = with_margins(parse_study(STUDY))
    return Evaluated(study, list(evaluate_study(study)), {"no such <b>pressure</b>": [SCRIPT]}, f"{IMAGE}.toml")


@pytest.fixture(scope="module")
def html(evaluated):
    return study_report(evaluated)


@pytest.fixture(scope="module")
def found(html):
    return Page(html)


def small(metrics='["absolute", "relative", "predicted_error"]', loads=3, arms=1):
    text = f"""
name = "small"
[[task]]
name = "bend"
shape = {{ kind = "affine", slope = 0.0, intercept = 1.0, length = 0.5, nodes = 4 }}
loads = {{ count = {loads}, scale = [4, 4, 0.4] }}
[evaluate]
metrics = {metrics}
"""
    for index in range(arms):
        text += f'[[arm]]\nname = "arm {index}"\nkind = "antagonistic"\nouter_radius = {0.05 + 0.01 * index}\n'
    study = with_margins(parse_study(text))
    return Evaluated(study, list(evaluate_study(study)))


def test_names_are_words_and_nothing_else(found):
    words = "".join(found.words)
    for name in (*NAMES, TASK):
        assert name in words
    assert "49" not in re.findall(r"\b\d+\b", words.split("Designs")[0])
    assert found.tags["script"] == found.tags["title"] == found.tags["style"] == 1
    assert found.tags["img"] == found.tags["iframe"] == 0
    assert [name for _, name, _ in found.attributes if name.startswith("on")] == []


def test_characters_that_pages_must_not_hold_are_replaced(html):
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", html)
    assert "bell \ufffd, null \ufffd" in html


def test_nothing_is_fetched(html, found):
    links = [
        value for name in ("href", "xlink:href", "src", "action", "data", "srcset") for value in found.values(name)
    ]
    assert links
    assert [link for link in links if not link.startswith(("#", "data:image/png;base64,"))] == []
    assert re.findall(r"url\((?!#)", html) == []
    assert "@import" not in html
    assert "link" not in found.tags


def test_the_policy_allows_the_own_script_alone(html, found):
    policy = found.values("content")[0]
    script = re.search(r"<script>(.*)</script>", html, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'; ")
    assert html.index("Content-Security-Policy") < html.index("<title>") < html.index("<style>")


def test_identifiers_are_unique_and_all_that_is_referred_to_is_there(html, found):
    identifiers = Counter(found.values("id"))
    assert [name for name, count in identifiers.items() if count > 1] == []
    referred = set(re.findall(r'(?:href="#|url\(#)([^")]+)', html))
    assert len(referred) > 100
    assert referred <= set(identifiers)


def test_every_figure_says_what_it_shows(found):
    labels = [value for tag, name, value in found.attributes if tag == "svg" and name == "aria-label"]
    assert len(labels) == found.tags["svg"] == found.tags["figure"]
    assert f"arm: {SCRIPT}, {TASK}" in labels
    kinds = Counter(label.split(":")[0] for label in labels)
    assert kinds == {
        "arm": 6,
        "errors": 5,
        "map": 5,
        "hull": 5,
    }  # the impossible has neither errors nor sets


def test_it_can_be_mailed(html):
    assert len(html.encode()) < 3e6


def test_it_is_the_same_for_the_same_input():
    first, second = (study_report(small()) for _ in range(2))
    assert first == second


def test_the_rows_are_what_was_evaluated(evaluated, found):
    rows = {row["arm"]: row for row in csv.DictReader(io.StringIO(found.textareas[0]))}
    assert list(rows) == [name if not name.startswith("=") else f"'{name}" for name in NAMES]
    for arm in evaluated.study.arms:
        results, row = evaluated.of_arm(arm), rows[arm.name]
        errors = np.concatenate([1e3 * one.attainability.tip_error.numpy().ravel() for one in results])
        counts = Counter(word for one in results for word in one.verdicts)
        assert {word: int(row[word.replace(" ", "_")]) for word in VERDICTS} == {
            word: counts[word] for word in VERDICTS
        }
        assert float(row["tip_error_median_mm"]) == np.median(errors)
        within = float(row["tip_error_90_percent_mm"])
        assert (errors <= within).mean() >= 0.9 > (errors < within).mean()
        assert row["tip_error_largest_mm"] == (repr(errors.max().item()) if np.isfinite(errors).all() else "")
        assert int(row["in_range"]) == sum(int(one.attainability.in_range.sum()) for one in results)
        margin = min(float(one.attainability.capacity_margin.min()) for one in results)
        assert row["capacity_margin_least_N"] == (repr(margin) if np.isfinite(margin) else "")
    assert float(rows[TEMPLATE]["mass_kg"]) == 0.2
    assert rows[SERIES]["driven_actuators"] == "8"
    assert float(rows[SERIES]["length_mm"]) == pytest.approx(500)
    assert rows[SERIES]["radius_mm"] == "50.0"


def test_the_worst_node_is_that_of_the_task_that_lacks_most(evaluated, found):
    rows = {row["arm"]: row for row in csv.DictReader(io.StringIO(found.textareas[0]))}
    summary = summarise(next(one for one in evaluated.results if one.arm.name == IMAGE))
    assert (rows[IMAGE]["worst_task"], rows[IMAGE]["worst_node"]) == (TASK, str(summary.worst_node))
    assert float(rows[IMAGE]["worst_node_mean_miss_N"]) == summary.worst_miss > 0


def test_all_loads_can_be_copied(evaluated, found):
    rows = list(csv.DictReader(io.StringIO(found.textareas[1])))
    expected = [row for result in evaluated.results for row in result_rows(result)]
    assert len(rows) == len(expected) == 4 * 43 + 1 + 43
    assert [row["verdict"] for row in rows] == [row["verdict"] for row in expected]
    assert rows[0]["capacity_margin_N"] == repr(expected[0]["capacity_margin_N"])


def test_the_header_says_what_was_evaluated_by_what_and_who_was_not(found):
    header = "".join(found.words).split("Designs")[0]
    assert re.search(r"torcharm \d+\.\d+", header)
    assert re.search(r"torch \d+\.\d+.*Python 3\.", header)
    assert "10 nodes, 43 loads, in the plane" in header
    assert f"Not evaluated: {SCRIPT}: no such <b>pressure</b>" in re.sub(r"\s+", " ", header)


def test_of_missed_loads_the_error_that_is_largest_is_counted(evaluated, found):
    words, kinds = "".join(found.words), set()
    for result in evaluated.results[:4]:
        one, missed = result.attainability, torch.tensor([word == "missed" for word in result.verdicts])
        over = torch.stack([one.tip_error / 0.01, one.tip_rotation_error / math.radians(5), one.shape_error / 0.01])
        worst = over.argmax(0)[missed].tolist()
        counted = [f"{name} {worst.count(place)}" for place, name in enumerate(MISSED_BY) if place in worst]
        assert not counted or f"missed by {', '.join(counted)}" in words
        kinds |= set(worst)
    assert len(kinds) > 1


def test_what_puzzles_beside_the_table_is_explained():
    shown = small()
    (result,) = shown.results
    assert "held" in result.verdicts
    for margin in (0.1, -0.1):
        distance = torch.full_like(result.attainability.absolute_per_node, -margin)
        one = replace(result, attainability=replace(result.attainability, absolute_per_node=distance))
        words = "".join(Page(study_report(replace(shown, results=[one]))).words)
        assert ("held beside a margin below 0" in words) == (margin < 0)
    assert "N·m counted as N: so do moments count" in words


def test_what_to_try_next_names_commands_with_the_studys_file(found):
    assert f"torcharm optimise {IMAGE}.toml" in "".join(found.words)


def test_a_section_is_a_function_in_a_list(monkeypatch):
    def tolerance(evaluated):
        return Section("Tolerance", [Block(points=[("", f"{len(evaluated.results)} results")])])

    monkeypatch.setattr(page, "SECTIONS", (tolerance, lambda evaluated: None))
    told = []
    shown = Page(study_report(small(), lambda: told.append(1)))
    assert shown.tags["section"] == 1
    assert "1 results" in shown.words
    assert len(told) == 2


def test_sets_alone_have_a_report_too():
    shown = Page(study_report(small(metrics='["absolute", "relative"]', arms=2)))
    words = "".join(shown.words)
    assert "not excluded" in words
    assert "tip off" not in words
    assert "Tip errors" not in words
    assert "Load maps" in words


def test_measures_without_margins_have_none():
    study = parse_study(example_text().replace("[evaluate]", '[evaluate]\nhull = "edges"'))
    assert not with_margins(study).settings.signed
    assert with_margins(parse_study(example_text())).settings.signed


def test_studies_in_space_have_all_sections(tmp_path):
    path = tmp_path / "space.toml"
    path.write_text(example_text(space=True), encoding="utf-8")
    study = with_margins(load_study(path))
    one = next(iter(evaluate_study(replace(study, tasks=study.tasks[2:]))))
    shown = Page(study_report(Evaluated(study, [one])))
    assert shown.tags["section"] == len(SECTIONS) - 2  # without tolerances and workspaces
    assert shown.tags["figure"] == 4
    assert shown.tags["image"] >= 2  # bodies and shades, which as outlines would be megabytes
    assert "columns-1" in " ".join(shown.values("class"))


def test_nothing_is_no_report():
    with pytest.raises(ValueError, match="results: must be one or more"):
        study_report(Evaluated(parse_study(example_text()), []))


def test_unicode_is_kept(html):
    assert UNICODE in html
