import pytest
from typer.testing import CliRunner

from torcharm.cli.app import app

STUDY = """
name = "small"
[[arm]]
name = "arm"
kind = "antagonistic"
outer_radius = 0.05
[[task]]
name = "bend"
shape = { kind = "affine", slope = 0.0, intercept = 1.0, length = 0.5, nodes = 4 }
loads = [[0, 0, 0]]
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def run(*arguments):
    return CliRunner().invoke(app, ["report", *map(str, arguments)], env={"COLUMNS": "200"})


def test_it_writes_one_file(study, tmp_path):
    out = tmp_path / "report.html"
    answer = run(study, "--out", out)
    assert answer.exit_code == 0, answer.output
    assert answer.stdout.startswith(f"Wrote {out} (1 arm, ")
    assert out.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "study.toml"]


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("report.pdf", "--out: {}: must end in .html or .htm, got .pdf"),
        ("report", "--out: {}: must end in .html or .htm, got no ending"),
        ("study.toml", "--out: {}: is the study itself, must be another file"),
        ("nowhere/report.html", "--out: {}: the directory {}/nowhere does not exist"),
    ],
)
def test_mistakes_are_told_before_any_work(study, tmp_path, out, message):
    answer = run(study, "--out", tmp_path / out)
    assert answer.exit_code == 2
    assert answer.stderr == f"torcharm: {message.format(tmp_path / out, tmp_path)}\n"


def test_a_study_that_is_none_writes_nothing(tmp_path):
    answer = run(tmp_path / "none.toml", "--out", tmp_path / "report.html")
    assert answer.exit_code == 2
    assert "none.toml: cannot be read" in answer.stderr
    assert list(tmp_path.iterdir()) == []


def test_it_needs_a_file_to_write_to(study):
    answer = run(study)
    assert answer.exit_code == 2
