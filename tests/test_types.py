"""What type checkers say: of the README's examples and of lists of tasks before they run, of shapes while tests run."""

from pathlib import Path

import pytest
import torch
from jaxtyping import TypeCheckError
from test_readme import BLOCKS

from torcharm.geometry import se2

ROOT = Path(__file__).parents[1]
RETURNED = {"evaluate": "Attainability", "predict_error": "PredictedError", "search_pressure": "PressureSearch"}
LENIENT = '# mypy: allow-untyped-defs, allow-incomplete-defs, allow-any-generics, disable-error-code="union-attr"'
"""In an example what was asked for is there, and nobody asks again; nor are its own functions typed."""


def lists_of_tasks():
    yield "from typing import assert_type"
    yield "import torcharm as ta"
    yield "def check(arm: ta.ArmDesign, task: ta.Task) -> None:"
    for name, kind in RETURNED.items():
        yield f"    assert_type(ta.{name}(arm, task), ta.{kind})"
        yield f"    assert_type(ta.{name}(arm, [task, task]), tuple[ta.{kind}, ...])"


@pytest.mark.slow
def test_they_fit(tmp_path, monkeypatch):
    """One run for all, as strict as the repository's own and with its cache: it reads torch, which takes seconds."""
    api = pytest.importorskip("mypy.api")
    monkeypatch.chdir(ROOT)
    files = {"readme.py": [LENIENT, *BLOCKS], "lists.py": lists_of_tasks()}
    for name, lines in files.items():
        (tmp_path / name).write_text("\n".join(lines), encoding="utf-8")
    wrong = tmp_path / "wrong.py"
    wrong.write_text("import torcharm as ta\nta.Task(shape=1)\n", encoding="utf-8")
    said, errors, code = api.run([*(str(tmp_path / name) for name in files), str(wrong)])
    assert (errors, code) == ("", 1), "what is wrong is found"
    assert [line for line in said.splitlines() if wrong.name not in line][:-1] == [], said


@pytest.mark.parametrize("test", ["one", "the next"])
def test_shapes_in_signatures_are_checked_in_every_test(test):
    with pytest.raises(TypeCheckError):
        se2.exp(torch.zeros(4))
    for _ in range(100):
        se2.exp(torch.zeros(3))
