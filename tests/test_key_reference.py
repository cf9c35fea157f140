"""The study that holds every key: made from the tables' models, so that it cannot go stale."""

import re

import pytest
from test_cli import invoke

import torcharm as ta
from torcharm.actuators.model_file import save_actuator
from torcharm.study import evaluate_study, key_reference, parse_study
from torcharm.study.fields import Table
from torcharm.study.tables import StudyTable

TEXT = key_reference()
ENTRY = re.compile(r"#?(\w+) = .*")
HEADING = re.compile(r"#?(\[+[\w.]+\]+)")
NEEDS = {  # keys left out that need others, and with what they are used
    ("evaluate", "samples"): ('hull = "exact"', 'hull = "edges"'),
    ("optimise.bounds", "max_pressure"): ('free = ["radii", "length"]', 'free = ["radii", "length", "max_pressure"]'),
    ("plan", "length_weight"): ("#reference_length", "reference_length"),
    ("plan", "reference_length"): ("#length_weight", "length_weight"),
}


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


def blocks(lines):
    """Of each line the number of its table's heading, or -1, and that heading's path."""
    number, path, found = -1, "", []
    for index, line in enumerate(lines):
        if HEADING.fullmatch(line):
            number, path = index, line.strip("#[]")
        found.append((number, path))
    return found


def uses(lines, index):
    """The text in which a line that was left out is used, in place of one with its key in its table."""
    key, places = ENTRY.fullmatch(lines[index])[1], blocks(lines)
    changed = list(lines)
    for other, line in enumerate(lines):
        if places[other] == places[index] and re.match(rf"{key} = ", line):
            changed[other] = f"#{line}"
    changed[index] = lines[index].removeprefix("#")
    text = "\n".join(changed)
    old, new = NEEDS.get((places[index][1], key), ("", ""))
    return text.replace(old, new)


LINES = TEXT.splitlines()
LEFT_OUT = [
    index
    for index, line in enumerate(LINES)
    if line.startswith("#") and ENTRY.fullmatch(line) and not LINES[blocks(LINES)[index][0]].startswith("#")
]


def test_it_is_a_study_as_it_is_and_is_evaluated():
    study = parse_study(TEXT)
    assert [type(model) for model in study.arms[1].design.actuators] == [ta.Bellows, ta.PolynomialActuator]
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
    begin = 0 if model is StudyTable else flat.index(" ".join(model.__doc__.split()))
    for key in model.model_fields:
        assert re.search(rf"\n#?({key} = |\[+([\w.]+\.)?{key}\]+\n)", flat[begin:]), key


def test_every_entry_says_what_it_is_by_default():
    for index, line in enumerate(LINES):
        if ENTRY.fullmatch(line) and not ENTRY.fullmatch(LINES[index - 1]):
            comment = " ".join(line.removeprefix("# ") for line in LINES[max(0, index - 6) : index])
            assert re.search(r"(Required|Left out by default|Default: .*)\.$", comment), line


@pytest.mark.parametrize("index", LEFT_OUT, ids=[f"{blocks(LINES)[i][1]}.{LINES[i][1:]}"[:60] for i in LEFT_OUT])
def test_what_is_left_out_may_be_used(index):
    key = ENTRY.fullmatch(LINES[index])[1]
    if key in ("loads", "actuators"):
        pytest.skip("stands in place of whole tables, see below")
    parse_study(uses(LINES, index))


def use_block(text, heading, without=""):
    """The text with a table that was left out, in place of another; of keys that stand twice the first."""
    parts = text.split("\n\n")
    kept = []
    for part in parts:
        lines = part.splitlines()
        if without and without in lines:
            continue
        if heading in lines:
            seen = set()
            for place, line in enumerate(lines):
                entry = ENTRY.fullmatch(line)
                if line == heading or (entry and entry[1] not in seen and entry[1] not in ("bending_stiffness",)):
                    lines[place] = line.removeprefix("#")
                    seen.add(entry[1] if entry else "")
            part = "\n".join(lines)
        kept.append(part)
    return "\n\n".join(kept)


def test_tables_that_are_left_out_may_be_used(tmp_path):
    cubic = use_block(TEXT, "#[task.shape]", without="[task.shape]")
    expected = ta.cubic_curvature(4.0, -6.0, 0.0, 1.0)
    assert parse_study(cubic).tasks[0].task.twists.tolist() == expected.tolist()

    bent = parse_study(use_block(TEXT, "#[arm.actuators.bending]")).arms[1].design.actuators[0]
    assert bent.bending_stiffness == ta.LinearBending(-0.1, 40.0)

    save_actuator(tmp_path / "my_bellows.toml", ta.Bellows())
    three = TEXT.replace("radii = [-0.05, 0.05]", "radii = [-0.05, 0.05, 0.06]")
    own = parse_study(use_block(three, "#[[arm.actuators]]"), folder=tmp_path).arms[1]
    assert own.files == (None, None, "my_bellows.toml")
    assert own.design.actuators[2].force_scale == 2.0

    drawn = "\n\n".join(part for part in TEXT.split("\n\n") if "\n[task.loads]\n" not in part)
    assert parse_study(drawn.replace("\n#loads = ", "\nloads = ")).tasks[0].task.batch_shape == (2,)

    named = "\n\n".join(part for part in TEXT.split("\n\n") if "[arm.actuators" not in part and "[[arm.act" not in part)
    arm = parse_study(named.replace("\n#actuators = ", "\nactuators = ")).arms[1].design
    assert arm.actuators == (ta.Bellows(), ta.McKibben(force_scale=2.0))


def test_init_all_writes_it(tmp_path):
    path = tmp_path / "all.toml"
    assert f"Wrote {path}. Evaluate it with: torcharm evaluate {path}" in invoke("init", "--all", path)
    assert path.read_text(encoding="utf-8") == TEXT
