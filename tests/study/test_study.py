import csv
import dataclasses
import inspect
import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.study import (
    NamedArm,
    NamedTask,
    Settings,
    Study,
    StudyResult,
    evaluate_study,
    example_study,
    example_text,
    load_study,
    paper_study,
    parse_study,
    summarise,
    write_results,
)
from torcharm.wrench_sets.vertex_sets import EDGE_SAMPLES

SHAPE = 'shape = { kind = "affine", slope = -3, intercept = 3 }'
LOADS = "loads = [[1, 2, 0.1], [0, 0, 0]]"
FREE = "radii = [-0.05, 0.05]\nlength = 0.5"
POLYNOMIAL = '{ kind = "polynomial", coefficients = [[1, 0, -120], [0, 1, 0.9]], strain_range = [-0.1, 0.4], pressure_range = [0, 60], max_pressure = 60 }'  # noqa: E501


def study_text(
    arm: str = 'kind = "bellows"', task: str = f"{SHAPE}\n{LOADS}", evaluate: str = "", top: str = ""
) -> str:
    return f"""
name = "study"
{top}
[[arm]]
name = "one arm"
{arm}
[[task]]
name = "one task"
{task}
[evaluate]
{evaluate}
"""


def arm_of(lines: str) -> ta.ArmDesign:
    return parse_study(study_text(arm=lines)).arms[0].design


def task_of(lines: str) -> ta.Task:
    return parse_study(study_text(task=lines)).tasks[0].task


# The shipped studies


def test_paper_study_is_the_papers():
    study = paper_study()
    assert [arm.name for arm in study.arms] == ["antagonistic", "bellows-only"]
    for arm, expected in zip(study.arms, (ta.antagonistic_arm(), ta.bellows_arm()), strict=True):
        torch.testing.assert_close(arm.design.radii, expected.radii)
        torch.testing.assert_close(arm.design.length, expected.length)
        torch.testing.assert_close(arm.design.max_pressure, expected.max_pressure)
        assert arm.design.actuators == expected.actuators
    (task,) = study.tasks
    torch.testing.assert_close(task.task.twists, ta.affine_curvature(-3.0, 3.0, 0.5, 10))
    torch.testing.assert_close(task.task.tip_load, ta.sample_loads(100))
    assert study.settings == Settings(metrics=("absolute", "relative"))
    assert task.task.wrench_at == "start"


def test_paper_study_gives_the_published_numbers():
    study = paper_study()
    sampled = replace(study, settings=Settings(metrics=("absolute",), hull="edges", samples=3))
    bellows = list(evaluate_study(sampled))[1].attainability
    published = torch.tensor([44.4031, 116.7625, 16.6250, 9.2688, 47.7773], dtype=torch.float64)
    torch.testing.assert_close(bellows.absolute[:5], published, atol=1e-3, rtol=0)


def test_the_example_is_feasible_and_tells_the_arms_apart():
    results = list(evaluate_study(example_study()))
    held = {(result.task.name, result.arm.name): summarise(result).held for result in results}
    assert held["bend", "antagonistic"] > 30
    assert 0 < held["bend", "one muscle"] < held["bend", "antagonistic"]
    assert held["bend", "bellows only"] == 0
    words = {word for result in results for word in result.verdicts}
    assert {"held", "missed"} <= words
    assert "impossible" not in words


def test_examples_commented_lines_are_the_defaults():
    text = example_text()
    for key in ("max_pressure", "base_pose", "wrench_at", "hull", "weights", "power", "signed", "distance", "metrics"):
        assert f"\n# {key} = " in text
        text = text.replace(f"\n# {key} = ", f"\n{key} = ")
    text = text.replace("\n# rotation_tolerance = ", "\nrotation_tolerance = ")
    plain, spelt_out = parse_study(example_text()), parse_study(text)
    assert spelt_out.settings == plain.settings == Settings()
    torch.testing.assert_close(spelt_out.arms[0].design.max_pressure, plain.arms[0].design.max_pressure)
    torch.testing.assert_close(spelt_out.tasks[1].task.base_pose, plain.tasks[1].task.base_pose)
    assert spelt_out.tasks[1].task.wrench_at == plain.tasks[1].task.wrench_at == "middle"


def test_examples_edges_are_the_papers():
    text = example_text().replace('\n# hull = "exact"', '\nhull = "edges"').replace("\n# samples = ", "\nsamples = ")
    settings = parse_study(text).settings
    assert (settings.hull, settings.samples) == ("edges", EDGE_SAMPLES)


def test_examples_alternatives_load():
    lines = [line.removeprefix("# ") for line in example_text().splitlines()]
    model = " ".join(line.split("(in the")[0].strip() for line in lines if '{ kind = "poly' in line or "60 }" in line)
    (twists,) = (line for line in lines if line.startswith("twists = "))
    study = parse_study(study_text(f"radii = [0]\nlength = 0.5\nactuators = [{model}]", f"{twists}\n{LOADS}"))
    assert isinstance(study.arms[0].design.actuators[0], ta.PolynomialActuator)
    assert study.tasks[0].task.nodes == 3


def test_defaults_are_those_of_evaluate():
    parameters = inspect.signature(ta.evaluate).parameters
    for field in dataclasses.fields(Settings):
        if field.name != "tolerance":
            assert field.default == parameters[field.name].default, field.name
    assert (
        Settings().tolerance == ta.evaluate(ta.bellows_arm(), ta.Task([[0.5, 0, 0]], [0, 0, 0]), "absolute").tolerance
    )
    without = parse_study(study_text().replace("[evaluate]", ""))
    assert without.settings == Settings() == parse_study(study_text()).settings


# Arms


@pytest.mark.parametrize(
    ("kind", "build"),
    [("antagonistic", ta.antagonistic_arm), ("bellows", ta.bellows_arm), ("mckibben", ta.mckibben_arm)],
)
def test_paper_arms(kind, build):
    expected = build()
    design = arm_of(f'kind = "{kind}"')
    assert design.actuators == expected.actuators
    for name in ("radii", "length", "max_pressure"):
        torch.testing.assert_close(getattr(design, name), getattr(expected, name))

    expected = build(0.07, 0.02, 0.4)
    design = arm_of(f'kind = "{kind}"\nouter_radius = 0.07\ninner_radius = 0.02\nlength = 0.4\nmax_pressure = 30')
    torch.testing.assert_close(design.radii, expected.radii)
    torch.testing.assert_close(design.length, expected.length)
    assert design.max_pressure.tolist() == [30.0] * 4


def test_lengths_and_limits_of_each_actuator():
    design = arm_of('kind = "antagonistic"\nlength = [0.5, 0.4, 0.4, 0.5]\nmax_pressure = [50, 0, 100, 20]')
    assert design.length.tolist() == [0.5, 0.4, 0.4, 0.5]
    assert design.max_pressure.tolist() == [50, 0, 100, 20]
    assert design.radii.dtype == torch.float64


def test_free_arm_with_every_kind_of_actuator():
    design = arm_of(f"""
radii = [-0.05, 0, 0.01, 0.05]
length = [0.5, 0.4, 0.3, 0.2]
actuators = [
    "bellows",
    {{ kind = "mckibben", force_scale = 2, bending_stiffness = 0, max_pressure = 80 }},
    {{ kind = "bellows", bending_stiffness = -0.1 }},
    {POLYNOMIAL},
]
""")
    bellows, muscle, stiff, own = design.actuators
    assert bellows == ta.Bellows()
    assert muscle == ta.McKibben(force_scale=2.0, bending_stiffness=0.0, max_pressure=80.0)
    assert stiff == ta.Bellows(bending_stiffness=-0.1)
    assert own == ta.PolynomialActuator(
        coefficients=((1, 0, -120.0), (0, 1, 0.9)),
        strain_range=(-0.1, 0.4),
        pressure_range=(0.0, 60.0),
        max_pressure=60.0,
    )
    assert design.max_pressure.tolist() == [50, 80, 50, 60]
    force = own.force(torch.tensor(0.1, dtype=torch.float64), torch.tensor(10.0, dtype=torch.float64))
    assert force.item() == pytest.approx(-12 + 9)


def test_one_actuator_is_an_arm():
    design = arm_of('radii = [0]\nlength = [0.5]\nactuators = ["bellows"]\nmax_pressure = [10]')
    assert design.actuator_count == 1
    assert design.max_pressure.tolist() == [10]


# Tasks


def test_affine_and_cubic_shapes():
    task = task_of(f'shape = {{ kind = "affine", slope = -1, intercept = 2, length = 0.3, nodes = 4 }}\n{LOADS}')
    torch.testing.assert_close(task.twists, ta.affine_curvature(-1.0, 2.0, 0.3, 4))
    torch.testing.assert_close(task.tip_load, torch.tensor([[1, 2, 0.1], [0, 0, 0]], dtype=torch.float64))
    task = task_of(f'shape = {{ kind = "cubic", cubic = 1, quadratic = 2, slope = 3, intercept = 4 }}\n{LOADS}')
    torch.testing.assert_close(task.twists, ta.cubic_curvature(1.0, 2.0, 3.0, 4.0))


def test_shape_as_a_table_of_its_own():
    lines = f'{LOADS}\n[task.shape]\nkind = "affine"\nslope = -3\nintercept = 3'
    torch.testing.assert_close(task_of(lines).twists, ta.affine_curvature(-3.0, 3.0))


def test_twists_base_pose_and_drawn_loads():
    task = task_of(
        "twists = [[0.5, 0, 1], [0.4, 0.01, 0.5]]\nbase_pose = [0.1, 0.2, 0]\n"
        "loads = { count = 7, scale = [1, 2, 3], seed = 5 }"
    )
    assert task.twists.tolist() == [[0.5, 0, 1], [0.4, 0.01, 0.5]]
    assert task.base_pose.tolist() == [0.1, 0.2, 0]
    torch.testing.assert_close(task.tip_load, ta.sample_loads(7, (1.0, 2.0, 3.0), 5))


def test_drawn_loads_default_to_the_papers():
    torch.testing.assert_close(task_of(f"{SHAPE}\nloads = {{ count = 5 }}").tip_load, ta.sample_loads(5))


def test_values_may_be_texts_with_units():
    arm = arm_of(
        'radii = ["-50 mm", 0.05]\nlength = "20 in"\nmax_pressure = ["0.5 bar", "5 psi"]\n'
        'actuators = ["bellows", "bellows"]'
    )
    assert arm.radii.tolist() == [-0.05, 0.05]
    assert arm.length.tolist() == pytest.approx([0.508, 0.508])
    assert arm.max_pressure.tolist() == pytest.approx([50.0, 34.47378646584])
    task = task_of('twists = [["48 cm", "1 mm", "30 deg"]]\nloads = [["200 gf", "1e-3 kN", "100 N·mm"]]')
    assert task.twists.tolist()[0] == pytest.approx([0.48, 0.001, math.pi / 6])
    assert task.tip_load.tolist()[0] == pytest.approx([1.96133, 1.0, 0.1])
    assert task_of(f'{SHAPE}\n{LOADS}\nbase_pose = [0, 0, "90°"]').base_pose.tolist()[2] == pytest.approx(math.pi / 2)


def test_settings():
    study = parse_study(
        study_text(
            evaluate='metrics = ["relative", "absolute", "relative"]\nhull = "edges"\nsamples = 4\n'
            "weights = [2, 0.5]\npower = 2\ndistance = 'scipy'"
        )
    )
    assert study.settings == Settings(
        ("absolute", "relative"), hull="edges", samples=4, distance="scipy", weights=(2.0, 0.5), power=2
    )
    assert parse_study(study_text(evaluate="signed = true")).settings == Settings(signed=True)
    near = parse_study(study_text(evaluate='tolerance = "5 mm"\nrotation_tolerance = "3 deg"')).settings.tolerance
    assert near == ta.PoseTolerance(tip=0.005, rotation=math.radians(3))


def test_several_arms_and_tasks_are_evaluated_task_by_task():
    more = '\n[[arm]]\nname = "two"\nkind = "antagonistic"\n[[task]]\nname = "two"\n'
    study = parse_study(study_text().replace("[evaluate]", "") + more + f"{SHAPE}\n{LOADS}")
    results = list(evaluate_study(study))
    assert [(result.task.name, result.arm.name) for result in results] == [
        ("one task", "one arm"),
        ("one task", "two"),
        ("two", "one arm"),
        ("two", "two"),
    ]


# Results


@pytest.fixture(scope="module")
def paper_results() -> list[StudyResult]:
    return list(evaluate_study(paper_study()))


def test_results_are_those_of_evaluate(paper_results):
    task = ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(100), wrench_at="start")
    for result, arm in zip(paper_results, (ta.antagonistic_arm(), ta.bellows_arm()), strict=True):
        expected = ta.evaluate(arm, task, ("absolute", "relative"))
        torch.testing.assert_close(result.attainability.absolute, expected.absolute)
        torch.testing.assert_close(result.attainability.relative, expected.relative)
        summary = summarise(result)
        assert summary.loads == 100
        assert summary.verdicts is None
        assert summary.median["absolute"] == pytest.approx(expected.absolute.quantile(0.5).item())
        assert summary.median["relative"] == pytest.approx(expected.relative.quantile(0.5).item())
        mean = expected.absolute_per_node.mean(0)
        assert (summary.worst_node, summary.worst_miss) == (int(mean.argmax()) + 1, pytest.approx(float(mean.max())))
        load, word, why = summary.example
        assert word == ""
        assert load == int(expected.absolute.argmax()) + 1
        assert why == "actuator 4 is strained to -0.48 at node 1, characterised from -0.17 to +0.67"


def test_csv_of_the_paper_study(paper_results, tmp_path):
    path = tmp_path / "results.csv"
    assert write_results(path, paper_results) == 200
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 200
    assert list(rows[0]) == [
        *("arm", "task", "load", "force_x_N", "force_y_N", "moment_Nm", "reason", "worst_node", "worst_miss_N"),
        *("absolute_N", "relative_N", "in_range", "strain_excess", "status"),
    ]
    assert [row["arm"] for row in rows] == ["antagonistic"] * 100 + ["bellows-only"] * 100
    assert [int(row["load"]) for row in rows] == [*range(1, 101)] * 2
    loads = [[float(row[key]) for key in ("force_x_N", "force_y_N", "moment_Nm")] for row in rows[:100]]
    assert loads == ta.sample_loads(100).tolist()
    for result, part in zip(paper_results, (rows[:100], rows[100:]), strict=True):
        found = result.attainability
        assert [float(row["absolute_N"]) for row in part] == found.absolute.tolist()
        assert [float(row["relative_N"]) for row in part] == found.relative.tolist()
        assert [int(row["worst_node"]) - 1 for row in part] == found.worst_node.tolist()
        assert [float(row["worst_miss_N"]) for row in part] == found.absolute_per_node.amax(-1).tolist()
        assert [float(row["strain_excess"]) for row in part] == found.strain_excess.tolist()
        assert {(row["in_range"], row["status"]) for row in part} == {("false", "converged")}


def test_json_holds_the_same_rows(paper_results, tmp_path):
    path = tmp_path / "results.json"
    assert write_results(path, paper_results) == 200
    rows = json.loads(path.read_text(encoding="utf-8"))
    assert [row["absolute_N"] for row in rows[:100]] == paper_results[0].attainability.absolute.tolist()
    assert rows[0]["in_range"] is False


def test_results_have_one_of_two_endings(paper_results, tmp_path):
    with pytest.raises(ValueError, match=r"results\.txt: must end in \.csv or \.json, got txt"):
        write_results(tmp_path / "results.txt", paper_results)
    assert not list(tmp_path.iterdir())


def test_csv_of_one_metric_and_one_load(tmp_path):
    study = parse_study(study_text(task=f"{SHAPE}\nloads = [[0, 0, 0]]", evaluate='metrics = ["relative"]'))
    (result,) = evaluate_study(study)
    write_results(tmp_path / "results.csv", [result])
    with (tmp_path / "results.csv").open(encoding="utf-8") as file:
        (values,) = csv.DictReader(file)
    assert "absolute_N" not in values
    assert "relative_N" in values
    assert int(values["worst_node"]) == result.attainability.relative_per_node[0].argmax().item() + 1


def test_what_is_held_has_no_worst_node(tmp_path):
    straight = "twists = [[0.5, 0, 0], [0.5, 0, 0]]\nloads = [[0, 0, 0]]"
    (result,) = evaluate_study(parse_study(study_text(task=straight)))
    summary = summarise(result)
    assert summary.worst_node is None
    assert summary.verdicts == {"held": 1}
    assert summary.held == summary.not_excluded == 1
    assert summary.example is None
    write_results(tmp_path / "results.csv", [result])
    with (tmp_path / "results.csv").open(encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert (row["verdict"], row["reason"], row["worst_node"], row["worst_miss_N"]) == ("held", "", "", "0.0")


def test_signed_margins_are_not_excluded():
    study = example_study()
    sets = replace(study.settings, metrics=("absolute", "relative"))
    plain = [summarise(result) for result in evaluate_study(replace(study, settings=sets))]
    signed = [summarise(r) for r in evaluate_study(replace(study, settings=replace(sets, signed=True)))]
    for before, after in zip(plain, signed, strict=True):
        assert before.not_excluded == after.not_excluded
        assert before.worst_node == after.worst_node
    assert min(summary.median["absolute"] for summary in signed) < 0


def test_a_nan_is_excluded_and_no_number(tmp_path):
    (result,) = evaluate_study(parse_study(study_text(evaluate='metrics = ["absolute"]')))
    found = result.attainability
    broken = replace(result, attainability=replace(found, absolute=found.absolute * float("nan")))
    summary = summarise(broken)
    assert np.isnan(summary.median["absolute"])
    assert summary.not_excluded == 0
    write_results(tmp_path / "results.json", [broken])
    assert all(row["absolute_N"] is None for row in json.loads((tmp_path / "results.json").read_text()))


def test_limits_beyond_the_model_are_told_from_strains():
    text = study_text('kind = "bellows"\nmax_pressure = 95', "twists = [[0.5, 0, 0]]\nloads = [[0, 0, 0]]")
    (result,) = evaluate_study(parse_study(text))
    assert result.verdicts == ["excluded by range"]
    assert result.reasons == ["actuator 1 is driven to 95 kPa, characterised to 92 kPa"]
    assert float(result.attainability.strain_excess) == 0


def test_a_hand_made_study_of_many_shapes(tmp_path):
    loads = ta.sample_loads(3)
    task = NamedTask("many", ta.Task(ta.affine_curvature([-3.0, 1.0], 2.0).unsqueeze(1), loads))
    study = Study("by hand", "", (NamedArm("arm", ta.bellows_arm()),), (task,), Settings(metrics=("absolute",)))
    (result,) = evaluate_study(study)
    assert summarise(result).loads == 6
    assert write_results(tmp_path / "results.csv", [result]) == 6
    with (tmp_path / "results.csv").open() as file:
        found = [float(row["absolute_N"]) for row in csv.DictReader(file)]
    assert found == result.attainability.absolute.flatten().tolist()


def test_a_hand_made_study_of_a_single_task(tmp_path):
    task = NamedTask("one", ta.Task(ta.affine_curvature(-3.0, 3.0), [0.0, 0.0, 0.0]))
    (result,) = evaluate_study(Study("by hand", "", (NamedArm("arm", ta.bellows_arm()),), (task,), Settings()))
    assert summarise(result).loads == write_results(tmp_path / "results.csv", [result]) == 1
    assert summarise(result).median["absolute"] == result.attainability.absolute.item()


def test_results_of_different_metrics_leave_cells_empty(tmp_path):
    results = [
        next(evaluate_study(parse_study(study_text(evaluate=f'metrics = ["{name}"]'))))
        for name in ("absolute", "relative")
    ]
    write_results(tmp_path / "results.csv", results)
    with (tmp_path / "results.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {(row["absolute_N"] == "", row["relative_N"] == "") for row in rows} == {(False, True), (True, False)}


def test_a_batch_of_designs_is_no_named_arm():
    with pytest.raises(ValueError, match=r"design: must be a single design, got a batch of \(2,\)"):
        NamedArm("two", ta.bellows_arm(outer_radius=[0.07, 0.08]))


# Mistakes


def bad_actuator(actuator: str) -> str:
    return study_text(arm=f'{FREE}\nactuators = ["bellows", {actuator}]')


def bad_task(lines: str) -> str:
    return study_text(task=lines)


def bad_loads(loads: str) -> str:
    return study_text(task=f"{SHAPE}\nloads = {loads}")


def bad_shape(shape: str) -> str:
    return study_text(task=f"shape = {{ {shape} }}\n{LOADS}")


def bad_arm(line: str) -> str:
    return study_text(arm=f'kind = "bellows"\n{line}')


def bad_settings(line: str) -> str:
    return study_text(evaluate=line)


AFFINE = 'kind = "affine", slope = 1, intercept = 1'
HUGE = "0x" + "f" * 5000

# text, then what the message must hold: the field, what is allowed, what was given
BAD_STUDIES = {
    "TOML syntax": ("name =\n", "study.toml: line 1, column 7: is not valid TOML: Invalid value"),
    "TOML, cut short": (
        'name = "x"\n[[arm]]\nradii = [1, 2',
        "study.toml: line 3: is not valid TOML",
        "it is cut short",
    ),
    "TOML, key twice": ('name = "a"\nname = "b"\n', "is not valid TOML", "line 2"),
    "TOML, too deep": ("a = " + "[" * 5000, "is not valid TOML"),
    "TOML, too many digits": ("a = " + "1" * 5000, "too many digits"),
    "empty": ("", "study.toml: name: missing; must be a text"),
    "no arm": ('name = "x"', "arm: missing; must be tables that begin with [[arm]]"),
    "no task": (
        'name = "x"\n[[arm]]\nname = "a"\nkind = "bellows"',
        "task: missing; must be tables that begin with [[task]]",
    ),
    "empty arms": ('name = "x"\narm = []\ntask = []', "arm: must be tables that begin with [[arm]], got []"),
    "one bracket": (
        'name = "x"\ntask = []\n[arm]\nname = "a"',
        "arm: must be tables that begin with [[arm]]",
        "a table",
    ),
    "arm is no table": ('name = "x"\narm = [3]\ntask = []', "arm[1]: must be a table, got 3"),
    "name is a number": ("name = 3\narm = []\ntask = []", "name: must be a text of one line", "got 3"),
    "name is blank": (study_text().replace("one arm", " "), "arm[1].name: must be a text", "not blank", 'got " "'),
    "name of two lines": (study_text().replace("one arm", "a\\nb"), "arm[1].name: must be a text of one line"),
    "description": (study_text(top="description = 3"), "description: must be a text in quotes, got 3"),
    "unknown section": (study_text(top="nam = 'x'"), "nam: unknown key; did you mean name? allowed: name, desc"),
    "unknown arm key": (
        bad_arm("outr_radius = 1"),
        "arm[1].outr_radius: unknown key; did you mean outer_radius?",
        "allowed: name, length, max_pressure, mass, diameter, kind, outer_radius, inner_radius",
        '(in "one arm")',
    ),
    "odd key": (bad_arm('"a\\nb" = 1'), 'arm[1]."a\\nb": unknown key'),
    "duplicate arm": (
        study_text(arm='kind = "bellows"\n[[arm]]\nname = "one arm"\nkind = "bellows"'),
        'arm[2].name: must be a name of its own, got "one arm", the name of arm[1]',
    ),
    "duplicate task": (
        study_text(task=f'{SHAPE}\n{LOADS}\n[[task]]\nname = "one task"\n{SHAPE}\n{LOADS}'),
        'task[2].name: must be a name of its own, got "one task"',
    ),
    "neither kind nor actuators": (
        study_text(arm="knd = 'bellows'"),
        "arm[1]: must have one of kind, radii, offsets, ring, segment",
        "got none in a table with name, knd",
    ),
    "both kind and radii": (
        bad_arm("radii = [1]"),
        "arm[1]: must have one of kind, radii, offsets, ring, segment",
        "got kind and radii together",
    ),
    "unknown kind of arm": (
        study_text(arm='kind = "belows"'),
        "arm[1].kind: must be one of antagonistic, bellows, mckibben",
        'got "belows"; did you mean bellows?',
    ),
    "kind is a number": (study_text(arm="kind = 3"), "arm[1].kind: must be one of antagonistic", "got 3"),
    "radius is a text": (
        bad_arm('outer_radius = "wide"'),
        "arm[1].outer_radius: must be a number [m] or a text of one and a unit (m, cm, mm, µm, in)",
        'got "wide"',
    ),
    "radius is a truth": (bad_arm("outer_radius = true"), "arm[1].outer_radius: must be a number, got true"),
    "radius is a date": (bad_arm("outer_radius = 1979-05-27"), "must be a number, got 1979-05-27"),
    "radius is negative": (bad_arm("inner_radius = -1"), "arm[1].inner_radius: must be at least 0, got -1"),
    "radius is NaN": (bad_arm("outer_radius = nan"), "arm[1].outer_radius: must be a finite number, got nan"),
    "radius is huge": (bad_arm(f"outer_radius = {HUGE}"), "arm[1].outer_radius: must be a number, got a very large"),
    "length is zero": (bad_arm("length = 0"), "arm[1].length: must be above 0, got 0"),
    "length is a text": (
        bad_arm('length = "0.5"'),
        "arm[1].length: must be a number [m] or a text of one",
        'got "0.5"',
    ),
    "a length is a text": (bad_arm('length = [1, 1, "x", 1]'), "arm[1].length[3]: must be a number [m] or", 'got "x"'),
    "length in millimetres": (bad_arm("length = 500"), "arm[1].length: 500 m: is it in millimetres?", '"50 mm"'),
    "radii in millimetres": (bad_arm("outer_radius = 50"), "arm[1].radii: 50 m, more than the arm is long"),
    "curvature in degrees": (
        bad_shape('kind = "affine", slope = 0, intercept = 60'),
        "task[1].shape: a bend of 60 rad, 9.55 turns: are curvatures in degrees?",
        '"30 deg"',
    ),
    "twists in millimetres": (bad_task(f"twists = [[500, 0, 1]]\n{LOADS}"), "task[1].twists: lengths of up to 500 m"),
    "too few lengths": (bad_arm("length = [1, 2]"), "arm[1].length: must hold one number for each of the 4", "got 2"),
    "negative limit": (
        bad_arm("max_pressure = [50, 50, 50, -1]"),
        "arm[1].max_pressure[4]: must be at least 0, got -1",
    ),
    "too few limits": (bad_arm("max_pressure = [1]"), "arm[1].max_pressure: must hold one number for each", "got 1"),
    "no actuators": (study_text(arm=FREE), "arm[1].actuators: missing; must be a list of force models"),
    "no length": (study_text(arm='radii = [1]\nactuators = ["bellows"]'), "arm[1].length: missing; must be a number"),
    "empty actuators": (study_text(arm=f"{FREE}\nactuators = []"), "arm[1].actuators: must be a list of force models"),
    "too few actuators": (
        study_text(arm=f'{FREE}\nactuators = ["bellows"]'),
        "arm[1].actuators: must hold one entry for each of the 2 actuators, got 1",
    ),
    "unknown actuator": (
        bad_actuator('"mckiben"'),
        "arm[1].actuators[2].kind: must be one of bellows, mckibben, polynomial",
        'got "mckiben"; did you mean mckibben?',
    ),
    "actuator is a path": (
        bad_actuator('"models/mine.toml"'),
        "arm[1].actuators[2].kind: must be one of bellows",
        'got "models/mine.toml"; of a file: { kind = "file", path = "models/mine.toml" }',
    ),
    "actuator is a number": (bad_actuator("3"), "arm[1].actuators[2]: must be a table with a kind", "got 3"),
    "actuator without kind": (bad_actuator("{ force_scale = 2 }"), "arm[1].actuators[2].kind: missing; must be one of"),
    "unknown actuator key": (
        bad_actuator('{ kind = "bellows", scale = 2 }'),
        "arm[1].actuators[2].scale: unknown key; did you mean force_scale?",
    ),
    "model without pressure": (
        bad_actuator('{ kind = "mckibben", max_pressure = 0 }'),
        "arm[1].actuators[2].max_pressure: must be above 0, got 0",
    ),
    "polynomial by name": (bad_actuator('"polynomial"'), "arm[1].actuators[2].max_pressure: missing; must be a number"),
    "term of two": (
        bad_actuator(POLYNOMIAL.replace("[0, 1, 0.9]", "[0, 1]")),
        "arm[1].actuators[2].coefficients[2]: must be a list of 3, [power of strain",
        "got [0, 1]",
    ),
    "half a power": (
        bad_actuator(POLYNOMIAL.replace("[1, 0,", "[0.5, 0,")),
        "arm[1].actuators[2].coefficients[1]: powers must be whole numbers from 0 to 20, got 0.5",
    ),
    "high power": (bad_actuator(POLYNOMIAL.replace("[1, 0,", "[1, 21,")), "from 0 to 20, got 21"),
    "range backwards": (
        bad_actuator(POLYNOMIAL.replace("[-0.1, 0.4]", "[0.4, -0.1]")),
        "arm[1].actuators[2].strain_range: must be [lowest, highest], got [0.4, -0.1]",
    ),
    "neither shape nor twists": (bad_task(LOADS), "task[1]: must have one of shape, twists", "got none"),
    "both shape and twists": (bad_task(f"{SHAPE}\n{LOADS}\ntwists = [[1, 0, 0]]"), "got shape and twists together"),
    "empty loads": (bad_loads("[]"), "task[1].loads: must be at least one load [f_x, f_y, m], got []"),
    "flat loads": (
        bad_loads("[1, 2, 3]"),
        "task[1].loads[1]: must be a list of 3, [f_x, f_y, m], or a list of 6, [f_x,",
        "got 1",
    ),
    "short load": (bad_loads("[[1, 2, 3], [1, 2]]"), "task[1].loads[2]: must be a list of 3", "got [1, 2]"),
    "infinite load": (bad_loads("[[1, inf, 3]]"), "task[1].loads[1][2]: must be a finite number, got inf"),
    "loads are a text": (
        bad_loads('"many"'),
        "task[1].loads: must be a list of [f_x, f_y, m], in space of six, or a table",
        'got "many"',
    ),
    "no count": (bad_loads("{ seed = 1 }"), "task[1].loads.count: missing; must be a whole number"),
    "count of none": (bad_loads("{ count = 0 }"), "task[1].loads.count: must be at least 1, got 0"),
    "count of half": (bad_loads("{ count = 1.5 }"), "task[1].loads.count: must be a whole number, got 1.5"),
    "count too large": (bad_loads("{ count = 10000000 }"), "loads.count: must be at most 1000000, got 10000000"),
    "scale of two": (bad_loads("{ count = 1, scale = [1, 2] }"), "loads.scale: must be a list of 3", "got [1, 2]"),
    "seed": (bad_loads("{ count = 1, seed = -1 }"), "task[1].loads.seed: must be at least 0, got -1"),
    "seed too large": (bad_loads("{ count = 1, seed = 4294967296 }"), "loads.seed: must be below 4294967296"),
    "unknown shape": (bad_shape('kind = "square"'), "task[1].shape.kind: must be one of affine, cubic", 'got "square"'),
    "shape is a text": (
        bad_task(f'shape = "affine"\n{LOADS}'),
        "task[1].shape: must be a table with a kind (affine, cubic, constant, helix)",
        'got "affine"',
    ),
    "shape without kind": (bad_shape("slope = 1"), "task[1].shape.kind: missing; must be one of affine, cubic"),
    "shape without slope": (
        bad_shape('kind = "affine", intercept = 1'),
        "task[1].shape.slope: missing; must be a number",
    ),
    "cubic is a text": (
        bad_shape('kind = "cubic", cubic = "x", quadratic = 0, slope = 0, intercept = 0'),
        "task[1].shape.cubic: must be a number [rad] or a text of one and a unit (rad, deg, °, turn)",
    ),
    "affine with a cubic": (
        bad_shape(f"{AFFINE}, cubic = 1"),
        "task[1].shape.cubic: unknown key; allowed: kind, length",
    ),
    "no nodes": (bad_shape(f"{AFFINE}, nodes = 0"), "task[1].shape.nodes: must be at least 1, got 0"),
    "nodes as a float": (bad_shape(f"{AFFINE}, nodes = 10.0"), "task[1].shape.nodes: must be a whole number, got 10.0"),
    "negative shape length": (bad_shape(f"{AFFINE}, length = -1"), "task[1].shape.length: must be above 0, got -1"),
    "empty twists": (bad_task(f"twists = []\n{LOADS}"), "task[1].twists: must be a list of [l, γ, κ]", "got []"),
    "short twist": (bad_task(f"twists = [[1, 0]]\n{LOADS}"), "task[1].twists[1]: must be a list of 3, [l, γ, κ]"),
    "base pose": (
        bad_task(f"{SHAPE}\n{LOADS}\nbase_pose = [0, 0]"),
        "task[1].base_pose: must be a list of 3",
        "got [0, 0]",
    ),
    "length beside shape": (
        bad_task(f"{SHAPE}\n{LOADS}\nlength = 1"),
        "task[1].length: unknown key",
        "allowed: name, gravity, payloads, points, base_pose, arms, loads",
    ),
    "unknown metric": (
        bad_settings('metrics = ["absolute", "relativ"]'),
        "evaluate.metrics[2]: must be one of absolute, relative",
        'got "relativ"; did you mean relative?',
    ),
    "no metrics": (bad_settings("metrics = []"), "evaluate.metrics: must be a list of metrics", "got []"),
    "metric as a text": (bad_settings('metrics = "absolute"'), "evaluate.metrics: must be a list", 'got "absolute"'),
    "unknown hull": (
        bad_settings('hull = "edge"'),
        "evaluate.hull: must be one of exact, edges",
        "did you mean edges?",
    ),
    "one sample": (bad_settings("samples = 1"), "evaluate.samples: must be at least 2, got 1"),
    "too many samples": (
        bad_settings('hull = "edges"\nsamples = 900000'),
        "evaluate.samples: must make at most 5e+07 numbers at once, got ",
        "from 900000 samples, 4 actuators, 10 nodes",
    ),
    "too many loads of many nodes": (
        study_text(
            task='shape = { kind = "affine", slope = -3, intercept = 3, nodes = 100 }\nloads = { count = 900000 }'
        ),
        "loads.count: must make at most 5e+07 numbers at once, got 9e+07 from 900000 loads, 100 nodes",
    ),
    "samples of exact sets": (
        bad_settings("samples = 9"),
        "evaluate.samples: must be left out for hull='exact' and distance='gjk', which is exact, got 9",
    ),
    "margins of vertices": (
        bad_settings('hull = "edges"\nsigned = true'),
        "evaluate.signed: must be False except for hull='exact' and distance='gjk', got True",
    ),
    "power": (bad_settings("power = 3"), "evaluate.power: must be at most 2, got 3"),
    "power is a truth": (bad_settings("power = true"), "evaluate.power: must be a whole number, got true"),
    "one weight": (bad_settings("weights = [1]"), "evaluate.weights: must be a list of 2, [k_f, k_m], got [1]"),
    "no weight": (bad_settings("weights = [1, 0]"), "evaluate.weights[2]: must be above 0, got 0"),
    "signed is a number": (bad_settings("signed = 1"), "evaluate.signed: must be true or false, got 1"),
    "unknown distance": (bad_settings('distance = "far"'), "evaluate.distance: must be one of", 'got "far"'),
    "unknown setting": (bad_settings("sample = 3"), "evaluate.sample: unknown key; did you mean samples?"),
    "edges of many": (
        study_text(
            arm=f"radii = {[0.01] * 13}\nlength = 0.5\nactuators = {['bellows'] * 13}", evaluate='hull = "edges"'
        ),
        "evaluate.hull: 'edges'",
        "at most 12 actuators, got 13",
    ),
}


@pytest.mark.parametrize("case", BAD_STUDIES)
def test_a_mistake_is_one_line_that_names_file_field_and_values(case):
    text, *parts = BAD_STUDIES[case]
    with pytest.raises(ValueError, match=r"^study\.toml: ") as caught:
        parse_study(text, "study.toml")
    message = str(caught.value)
    assert type(caught.value) is ValueError
    assert message.startswith("study.toml: ")
    assert len(message.splitlines()) == 1
    assert len(message) < 300
    for part in parts:
        assert part in message


def test_the_texts_around_the_mistakes_are_right():
    for text in (study_text(), study_text(arm=f'{FREE}\nactuators = ["bellows", {POLYNOMIAL}]'), bad_shape(AFFINE)):
        parse_study(text)


def test_files_that_cannot_be_read(tmp_path):
    def message(path: Path) -> str:
        with pytest.raises(ValueError, match=path.name) as caught:
            load_study(path)
        assert len(str(caught.value).splitlines()) == 1
        assert str(caught.value).startswith(f"{path}: ")
        return str(caught.value)

    assert "No such file" in message(tmp_path / "missing.toml")
    assert "cannot be read" in message(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'name = "caf\xe9"')
    assert "must be UTF-8 text, got byte 12 that is not" in message(tmp_path / "latin.toml")
    (tmp_path / "bad.toml").write_text("name = 3")
    assert "arm: missing" in message(tmp_path / "bad.toml")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="permissions do not stop this user")
def test_a_file_without_permission(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(study_text())
    path.chmod(0)
    with pytest.raises(ValueError, match="cannot be read: Permission denied"):
        load_study(path)


def test_load_study_reads_what_editors_write(tmp_path):
    path = tmp_path / "study.toml"
    path.write_bytes(b"\xef\xbb\xbf" + study_text(top='description = "κ"').replace("\n", "\r\n").encode())
    study = load_study(str(path))
    assert study.name == "study"
    assert study.description == "κ"


def test_a_study_of_predicted_errors(tmp_path):
    text = """
        name = "predicted"
        [[arm]]
        name = "a"
        kind = "antagonistic"
        [[task]]
        name = "t"
        shape = { kind = "affine", slope = 1.0, intercept = 1.5 }
        loads = { count = 3 }
        [evaluate]
        metrics = ["predicted_error", "absolute"]
    """
    study = parse_study(text)
    assert study.settings.metrics == ("absolute", "predicted_error")
    (result,) = evaluate_study(study)
    found = ta.evaluate(study.arms[0].design, study.tasks[0].task, metrics=("predicted_error",))
    torch.testing.assert_close(result.attainability.tip_error, found.tip_error)
    assert result.verdicts == found.verdict.tolist()
    path = tmp_path / "out.csv"
    write_results(path, [result])
    with path.open(encoding="utf-8") as file:
        first, *_ = csv.DictReader(file)
    assert float(first["tip_error_mm"]) == 1e3 * float(found.tip_error[0])
    assert float(first["tip_rotation_error_deg"]) == pytest.approx(math.degrees(float(found.tip_rotation_error[0])))
    assert [float(first[f"pressure_{index}_kPa"]) for index in range(1, 5)] == found.pressure[0].tolist()

    alone = parse_study(text.replace('"predicted_error", "absolute"', '"predicted_error"'))
    (only,) = evaluate_study(alone)
    assert only.verdicts == result.verdicts
    assert summarise(only).worst_node is summarise(only).not_excluded is None


@pytest.mark.parametrize(
    ("name", "heading"), [("hanging", -math.pi / 2), ("upright", math.pi / 2), ("horizontal", 0.0)]
)
def test_a_base_goes_by_name(name, heading):
    text = example_text().replace('# base_pose = "hanging" ', f'base_pose = "{name}" #')
    assert f'base_pose = "{name}"' in text
    assert parse_study(text).tasks[1].task.base_pose.tolist() == [0.0, 0.0, heading]


def test_no_such_base_names_those_that_are():
    text = example_text().replace('# base_pose = "hanging" ', 'base_pose = "uprigt" #')
    with pytest.raises(ValueError, match=r"base_pose: must be one of hanging, .*did you mean upright"):
        parse_study(text)


def test_a_limit_may_be_free_and_fixed_by_its_bounds():
    bounds = 'free = ["radii", "max_pressure"]\nbounds = { max_pressure = [50, 50] }'
    space = parse_study(f"{study_text()}\n[optimise]\n{bounds}").optimisation.space
    assert space.bounds == {"max_pressure": (50.0, 50.0)}
