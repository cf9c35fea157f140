"""The study that holds every key: made from the tables' models, so that it cannot go stale."""

import re
from typing import Annotated

import pytest
from commands import invoke
from pydantic import Field, TypeAdapter

from torcharm.characterise.toml_text import toml_value
from torcharm.study import evaluate_study, key_reference, parse_study
from torcharm.study.fields import Table
from torcharm.study.tables import StudyTable

TEXT = key_reference()
LINES = TEXT.splitlines()
ENTRY = re.compile(r"#?(\w+) = .*")


def models(model=StudyTable, found=None):
    """Every model that a study may hold."""
    found = {} if found is None else found
    if isinstance(model, type) and issubclass(model, Table):
        if model not in found:
            found[model] = None
            for field in model.model_fields.values():
                models(field.annotation, found)
    else:
        for part in getattr(model, "__args__", ()):
            models(part, found)
    return list(found)


EXAMPLES = [
    (model, key, example)
    for model in models()
    for key, field in model.model_fields.items()
    for example in field.examples or ()
]


def test_it_is_a_study_as_it_is_and_is_evaluated():
    study = parse_study(TEXT)
    assert [arm.name for arm in study.arms] == ["paper", "own"]
    assert len(study.tasks) == 2
    assert len(study.plans) == 1
    results = list(evaluate_study(study))
    assert len(results) == 4
    assert all(result.verdicts for result in results)


@pytest.mark.parametrize("model", models())
def test_every_key_of_every_model_stands_under_what_the_model_is(model):
    assert all(field.description for field in model.model_fields.values())
    assert all(field.description.endswith(".") for field in model.model_fields.values())
    flat = " ".join(line.removeprefix("# ") if line.startswith("# ") else f"\n{line}\n" for line in LINES)
    shown = next(one for one in models() if issubclass(one, model))  # a model with all of its keys stands for it
    begin = 0 if model is StudyTable else flat.index(" ".join(shown.__doc__.split()))
    for key in model.model_fields:
        assert re.search(rf"\n#?({key} = |\[+([\w.]+\.)?{key}\]+\n)", flat[begin:]), key


def test_every_entry_says_what_it_is_by_default():
    for index, line in enumerate(LINES):
        if ENTRY.fullmatch(line) and not ENTRY.fullmatch(LINES[index - 1]):
            comment = " ".join(line.removeprefix("# ") for line in LINES[max(0, index - 6) : index])
            assert re.search(r"(Required|Left out by default|Default: .*)\.$", comment), line


@pytest.mark.parametrize(("model", "key", "example"), EXAMPLES)
def test_every_example_stands_there_and_may_be_used(model, key, example):
    """By its key; what becomes of it is tested where that is read."""
    assert re.search(rf"\n#?{key} = {re.escape(toml_value(example))}\n", TEXT)
    field = model.model_fields[key]
    TypeAdapter(Annotated[(field.annotation, *field.metadata, Field())]).validate_python(example)


@pytest.mark.parametrize("model", models())
def test_every_table_may_be_used_as_it_stands(model):
    """With the first examples of what it requires; what is a table of its own there is among these models."""
    required = {key: field.examples for key, field in model.model_fields.items() if field.is_required()}
    if all(required.values()):
        model.model_validate({key: examples[0] for key, examples in required.items()})


def test_init_all_writes_it(tmp_path):
    path = tmp_path / "all.toml"
    assert f"Wrote {path}. Evaluate it with: torcharm evaluate {path}" in invoke("init", "--all", "--out", path)
    assert path.read_text(encoding="utf-8") == TEXT
