"""Studies of arms in space, with weight and in series: read, evaluated, told and drawn."""

import csv
import json
import math
import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import pytest
import torch
from commands import invoke, mistake, one_start, twists_of

import torcharm as ta
from torcharm.cli import optimise
from torcharm.pressure.search import WORDS
from torcharm.study import evaluate_study, example_text, parse_study, result_rows, summarise, write_rows

D = torch.float64
STIFF = '{ kind = "bellows", bending = { kind = "constant", stiffness = -0.05 } }'
"""Bellows that resist bending in all directions: collinear ones alone have no stiffness out of their plane."""


def study_text(arm, task, more=""):
    return f'name = "s"\n[[arm]]\nname = "a"\n{arm}\n[[task]]\nname = "t"\n{task}\n{more}'


RING = 'ring = { radius = "50 mm", count = 3 }\nlength = 0.3\nactuators = "bellows"'
BEND = (
    'shape = { kind = "constant", curvature = "15 deg", direction = "0 deg", length = 0.35, nodes = 4 }\n'
    "loads = [[0, 0, 0, 0, 0, 0], [0.5, 0, 0.1, 0, 0, 0]]"
)
SMALL = study_text(f"{RING}\nmass = 0.1", f"{BEND}\ngravity = true")
SEGMENTS = f"[[arm.segment]]\n{RING}\n[[arm.segment]]\n{RING}\n"
TWO = study_text(SEGMENTS, "twists = [[0.3, 0, 0, 0, 0, 0], [0.3, 0, 0, 0, 0, 0]]\nloads = [[0, 0, 0, 0, 0, 0]]\n@")


# What is read


def test_rings_and_lists_of_one_for_each_ring():
    arm = parse_study(
        study_text(
            'ring = [{ radius = "50 mm", count = 3, phase = "90 deg" }, { radius = "1 cm", count = 2 }]\n'
            'actuators = ["bellows", { kind = "mckibben", force_scale = 2.0 }]\nlength = [0.5, 0.4]\n'
            'max_pressure = [40, "0.3 bar"]\nmass = "300 g"\ndiameter = ["30 mm", "20 mm"]\ntorsion_stiffness = 0.5',
            BEND,
        )
    ).arms[0]
    design = arm.design
    torch.testing.assert_close(design.offsets, torch.cat((ta.ring(0.05, 3, math.pi / 2), ta.ring(0.01, 2))))
    assert design.actuators == (ta.Bellows(),) * 3 + (ta.McKibben(force_scale=2.0),) * 2
    assert design.length.tolist() == [0.5] * 3 + [0.4] * 2
    assert design.max_pressure.tolist() == [40.0] * 3 + [30.0] * 2
    assert (design.mass.item(), design.torsion_stiffness.item()) == (0.3, 0.5)
    assert design.diameter.tolist() == [0.03] * 3 + [0.02] * 2


def test_chambers_and_a_core_are_those_of_the_library():
    arm = parse_study(
        study_text(
            'ring = [{ radius = "9 mm", count = 3 }, { radius = 0 }]\nlength = 0.1\nactuators = [{ kind = "chamber", '
            'area = "110 mm²", max_pressure = 80 }, { kind = "elastic_core", axial_stiffness = 45, '
            "bending_stiffness = 3.6e-3, strain_range = [-0.2, 0.5] }]",
            BEND,
        )
    ).arms[0]
    hole, *_, core = arm.design.actuators
    assert hole.force_scale == pytest.approx(1.1e-4)
    assert replace(hole, force_scale=1.1e-4) == ta.chamber(1.1e-4, 80.0)
    assert core == ta.elastic_core(45.0, 3.6e-3, (-0.2, 0.5))
    assert arm.design.max_pressure.tolist() == [80.0] * 3 + [0.0]


def test_segments_links_and_what_loads_them():
    study = parse_study(
        study_text(
            f'[[arm.segment]]\n{RING}\nmass = 0.2\nlink = {{ length = "30 mm", mass = "50 g" }}\n'
            '[[arm.segment]]\noffsets = [["40 mm", 0], [0, "40 mm"]]\nlength = 0.2\nactuators = "mckibben"\n',
            'shape = [{ kind = "helix", curvature = 1, torsion = 2, nodes = 3 }, '
            '{ kind = "constant", curvature = 1, direction = 1, nodes = 2 }]\n'
            'loads = { count = 5, scale = [1, 2, 3, 0.1, 0.2, 0.3], seed = 7 }\nbase_pose = "upright"\n'
            'gravity = true\npayloads = [{ mass = "100 g", at = 0.5, segment = 2 }]\n'
            'points = [{ wrench = [0, 0, 1, 0, 0, 0], frame = "body" }]',
        )
    )
    (arm,), (task,) = study.arms, study.tasks
    lower, upper = arm.design.segments
    assert (lower.actuator_count, upper.offsets.tolist()) == (3, [[0.04, 0.0], [0.0, 0.04]])
    link, none = arm.design.links
    assert (link.length.item(), link.mass.item(), none) == (0.03, 0.05, None)
    assert task.task.segment_nodes == (3, 2)
    bend = ta.constant_curvature(1.0, nodes=2, direction=1.0)
    assert task.task.twists.tolist() == torch.cat((ta.helix(1.0, 2.0, nodes=3), bend)).tolist()
    assert task.task.tip_load.tolist() == ta.sample_loads(5, (1, 2, 3, 0.1, 0.2, 0.3), 7).tolist()
    assert task.task.load.gravity
    mass, pull = task.task.load.points
    assert (mass.mass.item(), mass.at, mass.segment) == (0.1, 0.5, 1)
    assert (pull.wrench.tolist(), pull.frame, pull.segment, pull.at) == ([0, 0, 1, 0, 0, 0], "body", -1, 1.0)
    assert task.task.base_pose[:3, 0].tolist() == [0.0, 1.0, 0.0]


def test_a_tip_mount_makes_a_series_of_one():
    design = parse_study(study_text(f"{RING}\nlink = {{ length = 0.02 }}", BEND)).arms[0].design
    assert isinstance(design, ta.ArmSeries)
    assert design.links[0].length.item() == 0.02


def test_tasks_for_some_arms_are_evaluated_by_them_alone():
    more = f'[[arm]]\nname = "b"\n{RING}\n[[task]]\nname = "u"\narms = ["b"]\n{BEND}'
    study = parse_study(SMALL.replace('name = "t"', 'name = "t"\narms = ["a"]') + more)
    assert [(r.arm.name, r.task.name) for r in evaluate_study(study)] == [("a", "t"), ("b", "u")]
    assert [task.name for task in study.tasks_of(study.arms[1])] == ["u"]


# A study in the plane, and the same in space


def lifted(numbers, where):
    return [[dict(zip(where, row, strict=True)).get(place, 0.0) for place in range(6)] for row in numbers]


@cache
def both():
    loads = [[0.0, 0.0, 0.0], [0.5, -1.0, 0.05], [-2.0, 1.0, 0.2]]
    pull = [[0.3, 0.2, -0.02]]
    bellows = ta.Bellows(bending_stiffness=ta.ConstantBending(-0.05))
    arm = ta.ArmDesign([-0.05, 0.0, 0.05], [0.5, 0.54, 0.5], [bellows, ta.McKibben(), bellows], mass=0.4)
    points = [ta.PointLoad(mass=0.05, at=0.6), ta.PointLoad(pull[0], at=0.3, frame="body")]
    load = ta.ExternalLoad(torch.tensor(loads[0], dtype=D), gravity=True, points=points)
    twists = ta.solve_equilibrium(arm, [4.0, 60.0, 10.0], load, 4).twists.tolist()  # which the first load holds
    texts = []
    for flat in (True, False):
        place, load, pulls, shape = "radii = [-0.05, 0.0, 0.05]", loads, pull, twists
        if not flat:
            place = "offsets = [[-0.05, 0], [0, 0], [0.05, 0]]"
            load, pulls, shape = lifted(loads, (0, 1, 5)), lifted(pull, (0, 1, 5)), lifted(twists, (0, 1, 5))
        arm = f'{place}\nlength = [0.5, 0.54, 0.5]\nmass = 0.4\nactuators = [{STIFF}, "mckibben", {STIFF}]'
        rest = (
            f'gravity = true\npayloads = [{{ mass = "50 g", at = 0.6 }}]\npoints = [{{ wrench = {pulls[0]}, at = 0.3,'
        )
        texts.append(study_text(arm, f'twists = {shape}\nloads = {load}\n{rest} frame = "body" }}]'))
    return [next(evaluate_study(parse_study(text))) for text in texts]


def test_the_plane_in_space_gives_the_same_table():
    plane, space = both()
    rows, others = list(result_rows(plane)), list(result_rows(space))
    assert {row["verdict"] for row in rows} >= {"held", "missed"}
    for row, other in zip(rows, others, strict=True):
        shared = [name for name in row if name in other]
        assert {"tip_error_mm", "absolute_N", "relative_N", "worst_miss_N", "pressure_3_kPa"} <= set(shared)
        for name in shared:
            if isinstance(row[name], float):
                assert other[name] == pytest.approx(row[name], rel=1e-8, abs=1e-8), name
            elif name != "reason":
                assert other[name] == row[name], name
        assert [other[name] for name in ("force_z_N", "moment_x_Nm", "moment_y_Nm")] == [0.0] * 3
    one, other = summarise(plane), summarise(space)
    assert (one.verdicts, one.not_excluded, one.worst_node) == (other.verdicts, other.not_excluded, other.worst_node)
    assert other.median == pytest.approx(one.median, rel=1e-8, abs=1e-8)


# The shipped study


def test_the_shipped_study_holds_some_and_misses_some_in_range():
    for result in evaluate_study(parse_study(example_text(space=True))):
        assert set(result.verdicts) == {"held", "missed"}, result.arm.name
        assert bool(result.attainability.in_range.all())


def test_its_commented_lines_may_be_used():
    text = example_text(space=True)
    lines = [line.removeprefix("# ") for line in text.splitlines()]
    (offsets,) = (line for line in lines if line.startswith("offsets = "))
    rings = re.findall(r"ring = \[.*\]\nactuators = \[\"bell", text)
    assert len(rings) == 1
    own = text.replace(rings[0], f'{offsets}\nactuators = ["bell').replace("\n# points = ", "\npoints = ")
    study = parse_study(own.replace("\n# base_pose = ", "\nbase_pose = ").replace("\n# tolerance", "\ntolerance"))
    assert study.arms[1].design.offsets.tolist() == [[0.05, 0.0], [0.0, 0.05]]
    assert study.tasks[2].task.load.points[0].frame == "body"
    head, plan = text.split("# [[plan]]")
    (planned,) = parse_study(f"{head}[[plan]]{plan.replace('# ', '')}").plans
    assert [row[3] for row in planned.tip_pose[:3]] == [0.1, -0.46, 0.05]


# Commands


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL, encoding="utf-8")
    return path


def test_init_writes_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert "Wrote space.toml. Evaluate it with: torcharm evaluate space.toml" in invoke("init", "--space")
    assert (tmp_path / "space.toml").read_text(encoding="utf-8") == example_text(space=True)
    assert mistake(monkeypatch, capsys, "init", "--space", "--all").startswith("--space: must not stand beside --all")


def test_evaluate_tells_six_components_in_80_columns(small, tmp_path):
    out, picture = tmp_path / "out.csv", tmp_path / "p.png"
    text = invoke("evaluate", small, "--out", out, "--figure", picture)
    assert max(len(line) for line in text.splitlines() if line.startswith(("arm", "a ", "─"))) <= 80
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    names = ("force_x_N", "force_y_N", "force_z_N", "moment_x_Nm", "moment_y_Nm", "moment_z_Nm")
    assert [float(rows[1][name]) for name in names] == [0.5, 0.0, 0.1, 0.0, 0.0, 0.0]
    assert len(json.loads(invoke("evaluate", small, "--json"))) == 2
    assert picture.stat().st_size > 10_000


def test_search_finds_what_evaluate_predicts(small, tmp_path):
    small.write_text(
        SMALL.replace("[[task]]", f'[[arm]]\nname = "two"\n{RING.replace("count = 3", "count = 2")}\n[[task]]')
    )
    out = tmp_path / "found.csv"
    text = invoke("search", small, "--out", out, "--figure", tmp_path / "p.png")
    assert max(len(line) for line in text.splitlines() if line.startswith(("arm", "a ", "two"))) <= 80
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    assert [row["arm"] for row in rows] == ["a", "a", "two", "two"]
    assert {row["status"] for row in rows} <= set(WORDS)
    assert (rows[0]["pressure_3_kPa"] == "", rows[2]["pressure_3_kPa"]) == (False, "")
    evaluated = next(evaluate_study(parse_study(SMALL)))
    assert [row["verdict"] for row in rows[:2]] == evaluated.verdicts
    predicted = 1e3 * evaluated.attainability.tip_error
    assert [float(row["tip_error_mm"]) for row in rows[:2]] == pytest.approx(predicted.tolist(), rel=1e-3, abs=1e-3)


def test_shape_says_where_the_tip_is(small, tmp_path):
    options = ("--study", small, "--pressure", "5,5,5", "--figure", tmp_path / "p.png")
    weighing = invoke("shape", "--gravity", *options)
    x, y, z = (float(number) for number in re.findall(r"[xyz] (\S+) mm", weighing)[:3])
    arm = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.3, actuators="bellows", mass=0.1)
    load = ta.ExternalLoad(torch.zeros(6, dtype=D), gravity=True)
    expected = ta.solve_equilibrium(arm, [5.0, 5.0, 5.0], load).poses[-1, :3, 3].tolist()
    assert [x, y, z] == pytest.approx([1e3 * one for one in expected], rel=1e-5, abs=1e-6)
    assert "pointing to (" in weighing
    assert invoke("shape", *options, "--load", "0,0,0,0,0,0") != weighing


def test_optimise_tells_and_writes_arms_in_space(small, tmp_path):
    small.write_text(f'{SMALL}\n[optimise]\nmetric = "unattainability"\nstarts = 1\niterations = 2\n')
    for name in ("best.toml", "best.csv", "best.json"):
        text = invoke("optimise", small, "--out", tmp_path / name)
        assert max(len(line) for line in text.splitlines() if line.startswith(("arm", "a ", "─"))) <= 80
    best = parse_study((tmp_path / "best.toml").read_text())
    assert best.arms[0].design.mass.item() == 0.1
    rows = list(csv.DictReader((tmp_path / "best.csv").open(encoding="utf-8")))
    assert [float(row["given_radius_mm"]) for row in rows] == pytest.approx([50.0] * 3)
    assert float(rows[1]["given_angle_deg"]) == pytest.approx(120.0)
    same = json.loads((tmp_path / "best.json").read_text(encoding="utf-8"))
    assert [list(row) for row in same] == [list(rows[0])] * 3
    assert [row["radius_mm"] for row in same] == [float(row["radius_mm"]) for row in rows]
    found = best.arms[0].design.offsets
    assert [float(row["radius_mm"]) for row in rows] == pytest.approx((1e3 * found.norm(dim=-1)).tolist())


def test_plan_finds_a_shape_in_space(small, tmp_path, monkeypatch):
    one_start(monkeypatch)
    pose = ta.poses(ta.constant_curvature(0.26, 0.35, 4, direction=0.0))[-1]
    table = f'[[plan]]\nname = "p"\ntip_pose = {pose.tolist()}\ntip_load = [0, 0, 0, 0, 0, 0]\nnodes = 3\n'
    small.write_text(f"{SMALL}\n{table}")
    out = tmp_path / "plan.csv"
    invoke("plan", small, "--out", out, "--figure", tmp_path / "p.png")
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    torch.testing.assert_close(ta.poses(twists_of(rows))[-1], pose, atol=1e-7, rtol=0)


SERIES = "[[arm.segment]]\nradii = [-0.05, 0.05]\nlength = 0.3\nactuators = 'bellows'\n"
MIXED = SMALL.replace('name = "t"', 'name = "t"\narms = ["a"]').replace(
    "actuators = ", 'diameter = "20 mm"\nactuators = '
)
MIXED = (
    MIXED.replace('[[arm]]\nname = "a"', '[[arm]]\nname = "flat"\nkind = "bellows"\n[[arm]]\nname = "a"')
    + f'[[arm]]\nname = "row"\n{SERIES}{SERIES}[[task]]\nname = "f"\narms = ["flat"]\n'
    + "twists = [[0.5, 0, 0], [0.5, 0, 0]]\nloads = [[0.5, 0, 0.01]]\n"
    + '[[task]]\nname = "r"\narms = ["row"]\nshape = [{ kind = "constant", curvature = 0, nodes = 1, length = 0.3 }, '
    + '{ kind = "constant", curvature = 0, nodes = 1, length = 0.3 }]\nloads = [[0, 0, 0]]\n'
)
"""Arms in the plane, in space and in series, each with a task."""
IN_THE_PLANE = '[[plan]]\nname = "q"\ntip_pose = [0.0, -0.5, "-90 deg"]\ntip_load = [0, 0, 0]\nnodes = 3\n'


def test_files_of_studies_in_the_plane_and_in_space_name_every_column(tmp_path, monkeypatch):
    one_start(monkeypatch)
    path, out = tmp_path / "s.toml", tmp_path / "out.csv"
    pose = ta.poses(ta.constant_curvature(0.26, 0.35, 4, direction=0.0))[-1]
    plan = f'[[plan]]\nname = "p"\ntip_pose = {pose.tolist()}\ntip_load = [0, 0, 0, 0, 0, 0]\nnodes = 3\n'
    path.write_text(MIXED + IN_THE_PLANE + plan)

    invoke("search", path, "--starts", 1, "--out", out)
    space, _, flat, row = csv.DictReader(out.open(encoding="utf-8"))
    assert [one["arm"] for one in (space, flat, row)] == ["a", "flat", "row"]
    assert (flat["moment_Nm"], flat["moment_z_Nm"], space["moment_Nm"], space["moment_z_Nm"]) == ("0.01", "", "", "0.0")
    assert (flat["pressure_4_kPa"] != "", space["pressure_3_kPa"] != "", space["pressure_4_kPa"]) == (True, True, "")

    invoke("plan", path, "--out", out)
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    assert [(one["plan"], one["arm"]) for one in rows] == [("q", "flat")] * 3 + [("q", "row")] * 6 + [("p", "a")] * 3
    assert (rows[0]["twist_curvature_deg"] != "", rows[0]["twist_curvature_z_deg"]) == (True, "")
    assert ta.poses(twists_of(rows[:3]))[-1].tolist() == pytest.approx([0.0, -0.5, -math.pi / 2], abs=1e-7)
    assert (rows[-1]["twist_curvature_deg"], rows[-1]["twist_curvature_z_deg"] != "") == ("", True)


def test_angles_of_arms_in_space_are_told_beside_arms_in_the_plane(tmp_path):
    out = tmp_path / "out.csv"
    arms = parse_study(MIXED).arms[:2]
    results = [(arm, SimpleNamespace(given=arm.design, best=arm.design)) for arm in arms]
    write_rows(out, list(optimise.best_rows(results)))
    text = " ".join(cell for column in optimise.design_columns(results) for cell in column.cells)
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    angles = {name: [one["given_angle_deg"] for one in rows if one["arm"] == name] for name in ("flat", "a")}
    assert angles["flat"] == [""] * 4
    assert float(angles["a"][1]) == pytest.approx(120.0)
    assert "120 → 120" in text


def test_loads_may_be_left_out():
    """Then there is none at the tip; weight and payloads count all the same."""
    bare = re.sub(r"\nloads = .*", "", study_text(RING, BEND))
    assert "loads" not in bare
    task = parse_study(f"{bare}gravity = true\npayloads = [{{ mass = 0.1 }}]\n").tasks[0].task
    assert (task.tip_load.tolist(), task.load.gravity) == ([[0.0] * 6], True)
    assert parse_study(bare).tasks[0].task.batch_shape == (1,)
    plan = parse_study(MIXED + IN_THE_PLANE.replace("tip_load = [0, 0, 0]\n", "")).plans[0]
    assert plan.load.tip.tolist() == [0.0, 0.0, 0.0]


def test_plans_know_weight_and_payloads():
    text = MIXED + IN_THE_PLANE + 'gravity = true\npayloads = [{ mass = "50 g", at = 0.5 }]\narms = ["flat"]\n'
    load = parse_study(text).plans[0].load
    assert (load.gravity, [(float(one.mass), one.at) for one in load.points]) == (True, [(0.05, 0.5)])
    several = parse_study(text.removesuffix('arms = ["flat"]\n')).plans[0]
    assert (several.arms, [one.segment for one in several.load.points]) == (("flat", "row"), [-1])  # each arm's last
    with pytest.raises(ValueError, match=re.escape("plan[1].payloads[1].segment: must be at most 1, the number of")):
        parse_study(text.replace("at = 0.5", "segment = 2"))


def test_plans_name_their_arms():
    study = parse_study(MIXED + IN_THE_PLANE)
    assert [arm.name for arm in study.arms_of(study.plans[0])] == ["flat", "row"]
    for names, words in (
        ('["flat", "flt"]', 'plan[1].arms[2]: must be one of flat, a, row, got "flt"; did you mean flat?'),
        ('["a"]', 'plan[1].arms: must be in the plane, as tip_pose is, got "a"'),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            parse_study(f"{MIXED}{IN_THE_PLANE}arms = {names}\n")
    with pytest.raises(ValueError, match="tip_pose: must fit an arm in the plane, of"):
        parse_study(SMALL + IN_THE_PLANE)


def test_angles_have_bounds():
    space = parse_study(
        f'{SMALL}[optimise]\nfree = ["angles"]\nbounds = {{ angles = ["-60 deg", 1] }}'
    ).optimisation.space
    assert space.bounds["angles"] == pytest.approx((-math.pi / 3, 1.0))


def test_shape_of_heavy_segments_in_the_plane_is_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text(MIXED)
    text = invoke(
        *("shape", "--study", "s.toml", "--arm", "row", "--pressure", "5,6,5,6", "--nodes", 3, "--gravity"),
        *("--figure", "p.png"),
    )
    arm = ta.series([ta.ArmDesign([-0.05, 0.05], 0.3, "bellows")] * 2)
    x, y, _ = ta.solve_equilibrium(arm, [5.0, 6.0, 5.0, 6.0], (0.0, 0.0, 0.0), 3).poses[-1].tolist()
    assert text.startswith(f"row: tip at x {1e3 * x:.6g} mm, y {1e3 * y:.6g} mm")
    assert text.endswith("Wrote p.png.\n")
    assert (tmp_path / "p.png").stat().st_size > 10_000


def test_tasks_of_the_plane_with_weight_are_drawn(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(study_text('kind = "bellows"', "twists = [[0.5, 0, 0]]\nloads = [[0, 0, 0]]\ngravity = true"))
    assert "p.png" in invoke("evaluate", path, "--figure", tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 10_000


# Mistakes

FLAT = 'kind = "bellows"'
FLAT_TASK = "twists = [[0.5, 0, 0]]\nloads = [[0, 0, 0]]"
HELIX = '{ kind = "helix", curvature = 1, torsion = 1 }'
MATRIX = "[[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
BAD = {
    "a task in the plane": (study_text(RING, FLAT_TASK), "twists: must be in space", 'the arm "a" is'),
    "an arm in the plane": (study_text(FLAT, BEND), "shape: must be in the plane, as the arm", '(in "t")'),
    "mixed arms": (SMALL + f'[[arm]]\nname = "b"\n{FLAT}', "task[1].shape: must be in the plane", 'arm "b"'),
    "mixed segments": (
        study_text(f"[[arm.segment]]\n{RING}\n[[arm.segment]]\nradii = [0]\nlength = 1\nactuators = 'bellows'", BEND),
        "arm[1].segment[2]: must be in the plane (radii) or in space (offsets, ring) as the first segment is",
    ),
    "mixed loads": (
        study_text(RING, BEND.replace("[0.5, 0, 0.1, 0, 0, 0]", "[0, 0, 0]")),
        "loads[2]: must have 6 numbers",
        "got 3",
    ),
    "mixed twists": (
        study_text(RING, "twists = [[0.5, 0, 0, 0, 0, 0], [0.5, 0, 0]]\nloads = [[0, 0, 0]]"),
        "twists[2]: must have 6 numbers",
    ),
    "mixed shapes": (
        study_text(
            RING,
            f'shape = [{HELIX}, {{ kind = "constant", curvature = 1 }}]\nloads = [[0, 0, 0]]',
        ),
        "shape[2].direction: must be given for all segments that bend, or for none",
    ),
    "scale of loads": (
        study_text(RING, BEND.split("\n")[0] + "\nloads = { count = 2 }"),
        "loads.scale: must have 6",
        "got 3",
    ),
    "load of four": (
        study_text(RING, BEND.replace("[0.5, 0, 0.1, 0, 0, 0]", "[1, 2, 3, 4]")),
        "loads[2]: must be a list of 3",
        "got [1, 2, 3, 4]",
    ),
    "pose of the plane": (
        study_text(RING, f"{BEND}\nbase_pose = [0, 0, 0]"),
        "base_pose: must be hanging, upright, horizontal or a table of position",
        "got [0",
    ),
    "pose of space": (
        study_text(FLAT, f"{FLAT_TASK}\nbase_pose = {MATRIX}"),
        "base_pose: must be hanging, upright, horizontal or a list [x, y, θ]",
    ),
    "pose of three rows": (
        study_text(RING, f"{BEND}\nbase_pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]"),
        "base_pose: must be a list of 4",
    ),
    "short row": (
        study_text(RING, f"{BEND}\nbase_pose = {MATRIX.replace('[0, 0, 0, 1]', '[0, 1]')}"),
        "base_pose[4]: must be a list of 4",
    ),
    "no rotation": (
        study_text(RING, f"{BEND}\nbase_pose = {MATRIX.replace('-1', '2')}"),
        "base_pose: must be a homogeneous matrix",
    ),
    "nodes of segments": (
        TWO.replace("@", "segment_nodes = [1, 2]"),
        "segment_nodes: must sum to the 2 rows of twists, got [1, 2]",
    ),
    "one segment for two": (TWO.replace("@", ""), "twists: must be rows", "each of the 2 segments", "got 1"),
    "one shape for two": (
        study_text(SEGMENTS, BEND),
        "shape: must be a list of shapes for each of the 2 segments",
        "got 1",
    ),
    "two shapes for one": (
        study_text(
            RING,
            f"shape = [{HELIX}, {HELIX}]\nloads = [[0, 0, 0, 0, 0, 0]]",
        ),
        "shape: must be a list of shapes for each of the 1 segments",
        "got 2",
    ),
    "mass below zero": (
        study_text(f"{RING}\nmass = -0.1", BEND),
        "arm[1].mass: must be at least 0 kg, got -0.1",
        '(in "a")',
    ),
    "mass of a link": (
        study_text(f"[[arm.segment]]\n{RING}\nlink = {{ length = 0, mass = -1 }}", BEND),
        "arm[1].segment[1].link.mass: must be at least 0 kg, got -1",
    ),
    "mass of a payload": (
        study_text(RING, f"{BEND}\ngravity = true\npayloads = [{{ mass = -1 }}]"),
        "task[1].payloads[1].mass: must be at least 0 kg, got -1",
    ),
    "payload of no weight": (
        study_text(RING, f"{BEND}\npayloads = [{{ mass = 1 }}]"),
        "gravity: must be true where there are payloads",
    ),
    "no such segment": (
        study_text(RING, f"{BEND}\ngravity = true\npayloads = [{{ mass = 1, segment = 2 }}]"),
        "payloads[1].segment: must be at most 1, the number of them, got 2",
    ),
    "off the arm": (
        study_text(RING, f"{BEND}\npoints = [{{ wrench = [0, 0, 0, 0, 0, 0], at = 2 }}]"),
        "points[1].at: must be a share of its segment, a number from 0 (start) to 1 (end), got 2",
    ),
    "place in millimetres": (
        study_text(RING, f'{BEND}\ngravity = true\npayloads = [{{ mass = 1, at = "60 mm" }}]'),
        'payloads[1].at: must be a share of its segment, a number from 0 (start) to 1 (end), got "60 mm"',
    ),
    "plan's load of the plane": (
        study_text(RING, f'{BEND}\n[[plan]]\nname = "p"\ntip_pose = {MATRIX}\ntip_load = [0, 0, 0]'),
        "plan[1].tip_load: must have 6 numbers in space, as tip_pose is, got 3",
    ),
    "plan's base of the plane": (
        study_text(RING, f'{BEND}\n[[plan]]\nname = "p"\ntip_pose = {MATRIX}\nbase_pose = [0, 0, 0]'),
        "plan[1].base_pose: must be hanging, upright, horizontal or a table of position, direction and turn, or the "
        "four rows of a homogeneous matrix [m] in space, as",
    ),
    "wrench of the plane": (
        study_text(RING, f"{BEND}\npoints = [{{ wrench = [0, 0, 0] }}]"),
        "points[1].wrench: must have 6 numbers",
        "got 3",
    ),
    "diameter of nothing": (study_text(f"{RING}\ndiameter = 0", BEND), "arm[1].diameter: must be above 0, got 0"),
    "torsion": (
        study_text(f"{RING}\ntorsion_stiffness = 0", BEND),
        "arm[1].torsion_stiffness: must be above 0 N·m², got 0",
    ),
    "radius of a ring": (
        study_text(RING.replace("50 mm", "-50 mm"), BEND),
        "arm[1].ring.radius: must be at least 0, got -0.05",
    ),
    "lists for rings": (
        study_text(f"{RING}\nmax_pressure = [1, 2]", BEND),
        "arm[1].max_pressure: must hold one number for each of the 3 actuators or 1 rings, got 2",
    ),
    "actuators for rings": (
        study_text(RING.replace('"bellows"', '["bellows", "bellows"]'), BEND),
        "arm[1].actuators: must hold one entry for each of the 3 actuators or 1 rings, got 2",
    ),
    "area in other units": (
        study_text(RING.replace('"bellows"', '{ kind = "chamber", area = 80 }'), BEND),
        "arm[1].actuators.area: must be at most 1 m²",
    ),
    "both places": (
        study_text(f"{RING}\nradii = [1]", BEND),
        "arm[1]: must have one of kind, radii",
        "got radii and ring together",
    ),
    "a segment without": (
        study_text("[[arm.segment]]\nlength = 1", BEND),
        "arm[1].segment[1]: must have one of radii, offsets, ring, got none",
    ),
    "no pose": (
        study_text(RING, f"{BEND}\nbase_pose = 5"),
        "task[1].base_pose: must be hanging, upright, horizontal, a list [x, y, θ], or in space a table of position",
    ),
    "no tip pose": (
        study_text(RING, f'{BEND}\n[[plan]]\nname = "p"\ntip_pose = "x"\ntip_load = [0, 0, 0, 0, 0, 0]'),
        "plan[1].tip_pose: must be a list [x, y, θ], or in space a table of position, direction and turn, or the four",
    ),
    "no segment nodes": (TWO.replace("@", "segment_nodes = []"), "task[1].segment_nodes: must be a list of numbers"),
    "no such arm": (study_text(RING, f'{BEND}\narms = ["b"]'), "task[1].arms[1]: must be one of a, got"),
    "an arm without tasks": (
        SMALL.replace('name = "t"', 'name = "t"\narms = ["a"]') + f'[[arm]]\nname = "b"\n{RING}',
        'arm[2]: must have a task, but all are for other arms: add "b" to the list task[1].arms, or to another task\'s',
    ),
    "unknown frame": (
        study_text(RING, f'{BEND}\npoints = [{{ wrench = [0, 0, 0, 0, 0, 0], frame = "tip" }}]'),
        "points[1].frame: must be one of world, body",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_mistake_is_one_line_that_names_the_field(case):
    text, *parts = BAD[case]
    with pytest.raises(ValueError, match=r"^study\.toml: ") as caught:
        parse_study(text, "study.toml")
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 300
    for part in parts:
        assert part in message
