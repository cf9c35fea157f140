"""The study that holds every key: made from the tables' models, so that it cannot go stale."""

import math
import re

import pytest
import torch
from commands import invoke

import torcharm as ta
from torcharm.actuators import Chamber, ElasticCore
from torcharm.characterise.model_file import save_actuator
from torcharm.characterise.toml_text import toml_value
from torcharm.study import evaluate_study, key_reference, parse_study
from torcharm.study.arm_tables import SegmentTable
from torcharm.study.fields import Table
from torcharm.study.tables import StudyTable

TEXT = key_reference()
ENTRY = re.compile(r"#?(\w+) = .*")
HEADING = re.compile(r"#?(\[+[\w.]+\]+)")
NEEDS = {  # keys left out that need others, and with what they are used
    ("evaluate", "samples"): ('hull = "exact"', 'hull = "edges"'),
    ("optimise.bounds", "angles"): ('free = ["radii", "length"]', 'free = ["radii", "length", "angles"]'),
    ("optimise.bounds", "max_pressure"): ('free = ["radii", "length"]', 'free = ["radii", "length", "max_pressure"]'),
    ("optimise", "robust"): ("limits = 0.0\n#limits", "limits = 1.0\n#limits"),
    ("task", "payloads"): ("gravity = false", "gravity = true"),
    ("plan", "payloads"): ("gravity = false", "gravity = true"),
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
SPACE = ("offsets", "ring", "torsion_stiffness", "direction")
"""Keys of arms and shapes in space, which the study in the plane does not hold."""
WHOLE = ("loads", "actuators")
"""Keys that stand in place of whole tables."""


def left_out():
    """Lines that are left out and may be used as they stand; those of space and of whole tables have tests below."""
    for index, line in enumerate(LINES):
        entry = ENTRY.fullmatch(line)
        if not (line.startswith("#") and entry) or LINES[blocks(LINES)[index][0]].startswith("#"):
            continue
        if entry[1] not in (*SPACE, *WHOLE) and "[[0.0, 1.0" not in line and "{ position = " not in line:
            yield index


LEFT_OUT = list(left_out())


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


@pytest.mark.parametrize("index", LEFT_OUT, ids=[f"{blocks(LINES)[i][1]}.{LINES[i][1:]}"[:60] for i in LEFT_OUT])
def test_what_is_left_out_may_be_used(index):
    parse_study(uses(LINES, index))


IN_SPACE = """
name = "space"
[[arm]]
name = "one"
length = 0.5
actuators = "bellows"
{arm}
[[task]]
name = "bend"
shape = {shape}
loads = [[0, 0, 0, 0, 0, 0]]
{task}
"""


def test_keys_of_space_may_be_used():
    placed = [f"offsets = {toml_value(value)}" for value in SegmentTable.model_fields["offsets"].examples]
    placed += [f"ring = {toml_value(value)}" for value in SegmentTable.model_fields["ring"].examples]
    assert all(f"\n#{line}\n" in TEXT for line in placed)
    assert "\n#torsion_stiffness = 0.5\n" in TEXT
    assert '\n#direction = "90 deg"\n' in TEXT
    (matrix,) = (line.removeprefix("#") for line in set(LINES) if line.startswith("#base_pose = [["))
    (base,) = (line.removeprefix("#") for line in set(LINES) if line.startswith("#base_pose = {"))
    (tip,) = (line.removeprefix("#") for line in LINES if line.startswith("#tip_pose = {"))
    arc = '{ kind = "constant", curvature = "60 deg", direction = "90 deg" }'
    for line in placed:
        text = IN_SPACE.format(arm=f"{line}\ntorsion_stiffness = 0.5", shape=arc, task=matrix)
        assert parse_study(text).arms[0].design.actuator_count == 2
    text = IN_SPACE.format(arm=placed[0], shape=arc, task=f'{base}\n[[plan]]\nname = "p"\n{tip}')
    posed = parse_study(text)
    assert posed.tasks[0].task.base_pose[:3, 3].tolist() == [0.0, 0.02, 0.0]
    assert [row[3] for row in posed.plans[0].tip_pose[:3]] == [0.1, -0.4, 0.05]
    table = TEXT.split("\n#[task.base_pose]\n")[1].split("\n\n")[0]
    table = used(table).replace("#direction", "direction")
    text = IN_SPACE.format(arm=placed[0], shape=arc, task=f"[task.base_pose]\n{table}")
    assert parse_study(text).tasks[0].task.base_pose[:3, 3].tolist() == [0.1, -0.3, 0.05]
    helix = parse_study(IN_SPACE.format(arm=placed[0], shape='{ kind = "helix", curvature = 1, torsion = 2 }', task=""))
    assert helix.tasks[0].task.twists.tolist() == ta.helix(1.0, 2.0).tolist()


def used(part):
    """A table that was left out, in use; of keys that stand twice the first."""
    lines, seen = part.splitlines(), set()
    others = ("direction", "bending_stiffness") if "#bending = " in part else ("direction",)
    for place, line in enumerate(lines):
        entry = ENTRY.fullmatch(line)
        if HEADING.fullmatch(line) or (entry and entry[1] not in (*seen, *others)):
            lines[place] = line.removeprefix("#")
            seen.add(entry[1] if entry else "")
    return "\n".join(lines)


def use_block(heading, kind="", without=""):
    """The text with a table that was left out, in place of another."""
    parts = [part for part in TEXT.split("\n\n") if not without or without not in part.splitlines()]
    place = next(
        i for i, one in enumerate(parts) if heading in one.splitlines() and f'kind = "{kind}' in f'{one}kind = "'
    )
    return "\n\n".join([*parts[:place], used(parts[place]), *parts[place + 1 :]])


def test_tables_that_are_left_out_may_be_used(tmp_path):
    for kind, expected in {
        "cubic": ta.cubic_curvature(4.0, -6.0, 0.0, 1.0),
        "constant": ta.constant_curvature(math.pi / 3),
    }.items():
        found = parse_study(use_block("#[task.shape]", kind, without="[task.shape]")).tasks[0].task
        torch.testing.assert_close(found.twists, expected)

    loaded = parse_study(use_block("#[[task.payloads]]").replace("gravity = false", "gravity = true")).tasks[0].task
    assert (loaded.load.gravity, loaded.load.points[0].mass.item()) == (True, 0.1)
    pulled = parse_study(use_block("#[[task.points]]")).tasks[0].task
    assert pulled.load.points[0].wrench.tolist() == [1.0, 0.0, 0.0]
    assert isinstance(parse_study(use_block("#[arm.link]")).arms[1].design, ta.ArmSeries)

    bent = parse_study(use_block("#[arm.actuators.bending]")).arms[1].design.actuators[0]
    assert bent.bending_stiffness == ta.LinearBending(-0.1, 40.0)

    save_actuator(tmp_path / "my_bellows.toml", ta.Bellows())
    kinds = {"bellows": ta.Bellows, "polynomial": ta.PolynomialActuator, "chamber": Chamber}
    for kind, model in (kinds | {"elastic_core": ElasticCore, "file": ta.Bellows}).items():
        mark = "" if kind == "bellows" else "#"
        text = use_block(f"{mark}[arm.actuators]", kind, without="" if kind == "bellows" else "[arm.actuators]")
        arm = parse_study(text, folder=tmp_path).arms[1]
        assert [type(one) for one in arm.design.actuators] == [model, model]
        assert arm.files == (("my_bellows.toml",) * 2 if kind == "file" else ())

    drawn = "\n\n".join(part for part in TEXT.split("\n\n") if "\n[task.loads]\n" not in part)
    assert parse_study(drawn.replace("\n#loads = ", "\nloads = ")).tasks[0].task.batch_shape == (2,)

    named = "\n\n".join(part for part in TEXT.split("\n\n") if "[arm.actuators" not in part)
    arm = parse_study(named.replace("\n#actuators = ", "\nactuators = ", 1)).arms[1].design
    assert arm.actuators == (ta.Bellows(), ta.McKibben(force_scale=2.0))


def test_init_all_writes_it(tmp_path):
    path = tmp_path / "all.toml"
    assert f"Wrote {path}. Evaluate it with: torcharm evaluate {path}" in invoke("init", "--all", "--out", path)
    assert path.read_text(encoding="utf-8") == TEXT
