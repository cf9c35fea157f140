"""Commands that tests run in their own process, and what these print and write."""

import math
import sys
from functools import partial

import pytest
import torch
from standard_error import without_notice
from typer.testing import CliRunner

from torcharm import cli
from torcharm.cli.app import app
from torcharm.cli.plan import TWISTS
from torcharm.design import shape_planning


def invoke(*args: object, code: int = 0) -> str:
    """Standard output of a command that ends with a code, run in this process."""
    result = CliRunner().invoke(app, [str(arg) for arg in args], env={"COLUMNS": "80"})
    assert result.exit_code == code, result.output
    return result.stdout


def mistake(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *args: object) -> str:
    """The one line, less its start, on which `main` ends."""
    monkeypatch.setattr(sys, "argv", ["torcharm", *map(str, args)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    output = capsys.readouterr()
    assert caught.value.code == 2
    assert output.out == ""
    said = without_notice(output.err)
    assert said.startswith("torcharm: ")
    assert said.count("\n") == 1
    return said.removeprefix("torcharm: ").strip()


def one_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let plans be found from one start: each of the command's four does the same work."""
    monkeypatch.setattr(shape_planning, "plan_shape", partial(shape_planning.plan_shape, starts=1))


def twists_of(rows: list[dict[str, str]]) -> torch.Tensor:
    """The shape in the rows that torcharm plan writes [m, rad]."""
    names = TWISTS[3] if rows[0].get("twist_shear_mm") else TWISTS[6]
    scale = torch.tensor([1e-3 if name.endswith("_mm") else math.pi / 180 for name in names]).double()
    return scale * torch.tensor([[float(row[name]) for name in names] for row in rows]).double()
