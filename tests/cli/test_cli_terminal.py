"""What every command shares: help texts, widths, endings of outputs, progress bars and Ctrl-C."""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from commands import invoke, mistake
from standard_error import without_notice
from test_cli_optimise import STUDY
from typer.testing import CliRunner

from torcharm import cli
from torcharm.cli import terminal
from torcharm.cli.app import app
from torcharm.cli.tables import Column, print_table
from torcharm.design import shape_planning
from torcharm.inputs import three_digits
from torcharm.study import example_text

REFUSED_PLAN = """
[[plan]]
name = "refused"
tip_pose = [0.1, -0.4, -0.5]
tip_load = [6.0, 0.0, 0.0]
nodes = 3
"""


@pytest.fixture
def study_file(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


COMMANDS = {
    "evaluate": (".csv or .json",),
    "fit": ("[N·m²]", "[default: (440, the paper's, if forces fit better so)]", "[required]"),
    "init": ("--all",),
    "optimise": ("its table [optimise]", "as a study on the same tasks", ".toml", ".csv"),
    "plan": ("begin with [[plan]]", "to a file .csv or .json"),
    "search": ("to a file .csv or .json", "--figure"),
    "explore": ("--host", "overwrite the file of --out", "--no-open", "Ctrl-C"),
    "sweep": ("table [optimise]", "[[arm]]", "--shard", "[default: (1e6)]"),
    "workspace": ("0.2 [kg] or '200 g'", "to a file .csv or .json"),
    "shape": ("force y [N], moment [N·m]",),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_help_holds_its_brackets_within_80_columns(command):
    output = re.sub(r"\x1b\[[\d;]*m", "", invoke(command, "--help"))
    words = " ".join(output.replace("│", " ").split())
    for part in COMMANDS[command]:
        assert part in words, part
    assert "[]" not in words
    assert "\\" not in words
    assert max(len(line) for line in output.splitlines()) <= 80


def test_every_bracket_of_the_source_is_in_the_help():
    """What is written in brackets in a help text is shown, whatever command it belongs to."""
    for path in sorted(Path(cli.__file__).parent.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        written = re.findall(r'help="[^"]*?(\[+[^\]"]+\]+)', text)
        if written:
            shown = " ".join(invoke(path.stem, "--help").replace("│", " ").split())
            assert [part for part in written if part not in shown] == []


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        *((0.0, "0"), (3e-12, "<0.001"), (0.00123, "0.00123"), (12.345, "12.3"), (1034.6, "1035"), (2.5e6, "2.5e+06")),
        *((float("inf"), "-"), (float("nan"), "-"), (-45.678, "-45.7")),
    ],
)
def test_numbers_have_three_digits_and_no_exponent_where_none_is_needed(value, shown):
    assert three_digits(value) == shown


WIDE = (
    Column("arm", ["antagonistic", "an arm with a long name"], 24),
    Column("tip off\n[mm]", ["123.4", "-"]),
    Column("worst node:\nlacks [N]", ["10: 0.123", "1: 2.4e+05"]),
    Column("not held", ["12 missed,\n13 excluded by range", "1 undecided"], 24),
    *(Column(f"sum {index}\n[N]", ["1.234e-05", "0"]) for index in range(4)),
)


@pytest.mark.parametrize("width", [200, 80, 60, 40])
def test_tables_of_any_width_hold_every_word_and_number_whole(monkeypatch, capsys, width):
    monkeypatch.setenv("COLUMNS", str(width))
    print_table(WIDE)
    output = capsys.readouterr().out
    assert max(len(line.rstrip()) for line in output.splitlines()) <= width
    for column in WIDE[1:]:
        for text in (column.title, *column.cells):
            for part in text.splitlines() if not column.widest else text.split():
                assert re.search(rf"(?<!\S){re.escape(part)}(?!\S)", output), part
    tables = output.count("antagonistic")
    assert tables == len(re.findall("name", output)), "every table names the arms"
    assert (tables == 1) == (width == 200)


@pytest.mark.parametrize("width", [80, 60])
def test_sums_break_no_word(monkeypatch, tmp_path, width):
    text = example_text().replace("count = 40", "count = 12")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    answer = CliRunner().invoke(app, ["evaluate", str(tmp_path / "study.toml"), "--sums"], env={"COLUMNS": str(width)})
    output = answer.stdout.split("Next: ")[0]
    assert max(len(line.rstrip()) for line in output.splitlines()) <= width
    assert "…" not in output
    for word in ("antagonistic", "bellows only", "absolute", "relative", "missed", "tip off", "worst node:"):
        assert word in output


@pytest.mark.parametrize("command", ["search", "optimise", "plan"])
def test_tables_fit_80_columns_and_cut_no_number(study_file, command):
    named = STUDY.replace('name = "antagonistic"', 'name = "an arm with a name too long for a table"')
    study_file.write_text(named.replace('"shape 1"', '"a plan with a long name"'), encoding="utf-8")
    output = invoke(command, study_file)
    table = [line for block in re.split(r"\n\n", output) if "───" in block for line in block.splitlines()]
    assert table
    assert max(len(line.rstrip()) for line in table) <= 80
    assert "…" not in output
    assert not re.search(r"\d[.e]-?\s*$", "\n".join(table), re.MULTILINE)


@pytest.mark.parametrize(
    ("command", "out", "allowed"),
    [
        ("evaluate", "a.txt", ".csv or .json, got .txt"),
        ("search", "a.txt", ".csv or .json, got .txt"),
        ("plan", "a", "one of .csv, .json, .toml, got no ending"),
        ("optimise", "a.txt", "one of .csv, .json, .toml, got .txt"),
    ],
)
def test_outputs_of_other_endings_are_refused(monkeypatch, capsys, study_file, command, out, allowed):
    monkeypatch.chdir(study_file.parent)
    message = mistake(monkeypatch, capsys, command, "study.toml", "--out", out)
    assert message == f"--out: {out}: must end in {allowed}"
    assert [path.name for path in study_file.parent.iterdir()] == ["study.toml"]


# Pictures


def test_plan_and_search_draw_a_picture_for_each_plan_and_task(study_file):
    folder = study_file.parent
    study_file.write_text(STUDY + REFUSED_PLAN, encoding="utf-8")
    assert f"Wrote {folder / 'near-1.png'} (reach)." in invoke("search", study_file, "--figure", folder / "near.png")
    study_file.write_text(STUDY, encoding="utf-8")
    assert f"Wrote {folder / 'plan.svg'} (shape 1)." in invoke("plan", study_file, "--figure", folder / "plan.svg")
    assert sorted(path.name for path in folder.iterdir()) == ["near-1.png", "near-2.png", "plan.svg", "study.toml"]
    assert (folder / "near-2.png").read_bytes().startswith(b"\x89PNG")


# Plans that fail, and Ctrl-C


def fail_at(monkeypatch, number, error, module, name):
    """Have a function fail at one of its calls, the first of which is number 1."""
    whole, calls = getattr(module, name), []

    def failing_then(*arguments, **options):
        calls.append(1)
        if len(calls) == number:
            raise error
        return whole(*arguments, **options)

    monkeypatch.setattr(module, name, failing_then)


def interrupt_the_second_call(monkeypatch, module, name):
    """As if Ctrl-C came when a function has done its work once and begins again."""
    fail_at(monkeypatch, 2, KeyboardInterrupt(), module, name)


def test_a_plan_that_is_an_error_costs_only_its_own_row(monkeypatch, capsys, study_file):
    study_file.write_text(STUDY.replace("[[plan]]", REFUSED_PLAN + "[[plan]]"), encoding="utf-8")
    out = study_file.parent / "shapes.csv"
    fail_at(monkeypatch, 1, ValueError("tip_pose: must be finite"), shape_planning, "plan_shape")
    monkeypatch.setattr(sys, "argv", ["torcharm", "plan", str(study_file), "--out", str(out)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    output = capsys.readouterr()
    assert caught.value.code == 2
    assert without_notice(output.err).count("\n") == 1
    assert "antagonistic: refused: tip_pose: must be finite" in output.err
    with out.open(encoding="utf-8") as file:
        assert [row["plan"] for row in csv.DictReader(file)] == ["shape 1"] * 10


def interrupted(monkeypatch, capsys, *arguments):
    """What the command prints, which ends as interrupted."""
    monkeypatch.setattr(sys, "argv", ["torcharm", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    output = capsys.readouterr()
    assert caught.value.code == 130
    assert output.err.splitlines()[-1] == "torcharm: interrupted"
    return output.out


def test_search_keeps_what_was_found_before_ctrl_c(monkeypatch, capsys, study_file):
    from torcharm.pressure import search

    interrupt_the_second_call(monkeypatch, search, "search_pressure")
    out = study_file.parent / "found.csv"
    output = interrupted(monkeypatch, capsys, "search", str(study_file), "--out", str(out))
    assert "Task reach" in output
    assert "Task hold" not in output
    assert len(out.read_text(encoding="utf-8").splitlines()) == 3


def test_who_waits_without_a_terminal_is_told_once(capsys):
    with terminal.compiling_told():
        for more in (1, 2):
            assert numba.njit(lambda one, more=more: one + more)(1.0) == 1.0 + more
    assert re.fullmatch(r"torcharm: compiling, once: about \d+ s\n", capsys.readouterr().err)
    with terminal.compiling_told():
        pass
    assert capsys.readouterr().err == ""


def test_optimise_keeps_what_was_found_before_ctrl_c(monkeypatch, capsys, study_file):
    from torcharm import design

    study_file.write_text(STUDY.replace("[[task]]", '[[arm]]\nname = "b"\nkind = "bellows"\n\n[[task]]', 1))
    interrupt_the_second_call(monkeypatch, design, "optimise_design")
    out = study_file.parent / "best.toml"
    output = interrupted(monkeypatch, capsys, "optimise", str(study_file), "--out", str(out))
    assert "antagonistic: better" in output
    assert out.read_text(encoding="utf-8").count("[[arm]]") == 1


# On a terminal


def on_a_terminal(*arguments: object) -> str:
    """What the command writes to a terminal that is its standard error."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "torcharm.cli", *map(str, arguments)]
    env = os.environ | {"TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=theirs, env=env) as process:
        os.close(theirs)
        parts = []
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # Linux says so at the end
                break
            if not part:
                break
            parts.append(part)
    os.close(ours)
    assert process.returncode == 0
    return b"".join(parts).decode()


def check_bar(shown: str, words: str) -> None:
    frames = re.split(r"[\r\n]+", re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", shown))
    frames = [frame for frame in frames if words in frame]
    assert frames
    assert "100%" in frames[-1]
    assert any("0%" in frame and "100%" not in frame for frame in frames)


@pytest.mark.skipif(sys.platform == "win32", reason="terminals are other ones there")
def test_a_bar_on_a_terminal_ends_at_100_percent(study_file):
    check_bar(on_a_terminal("evaluate", study_file), "evaluating")


INTERRUPTED_IMPORT = """
import sys
from importlib.abc import MetaPathFinder

interrupted = sys.argv[1]

class CtrlC(MetaPathFinder):
    def find_spec(self, name, *_):
        if name == interrupted:
            raise KeyboardInterrupt

sys.meta_path.insert(0, CtrlC())
from torcharm.cli import main
sys.argv[1:] = ["evaluate"]
main()
"""


@pytest.mark.parametrize("module", ["typer", "rich.console", "numpy", "torch", "torcharm.study"])
def test_ctrl_c_while_all_is_imported_ends_quietly(module):
    """As if it came when a module begins to load; whatever torcharm itself loads before `main` is its own name only."""
    command = [sys.executable, "-c", INTERRUPTED_IMPORT, module]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (answer.returncode, answer.stdout, answer.stderr) == (130, "", "torcharm: interrupted\n")
