import ast
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pytest

NOTEBOOKS = sorted(Path(__file__).parents[1].joinpath("notebooks").glob("*.ipynb"))
ALLOWED = {"torcharm", "torch", "numpy", "matplotlib", "dataclasses", "math", "time"}


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_there_are_notebooks():
    assert NOTEBOOKS


def draw_all():
    """What a notebook does where its code shows figures."""
    for number in plt.get_fignums():
        plt.figure(number).canvas.draw()
    plt.close("all")


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs_top_to_bottom(path, tmp_path, monkeypatch):
    """In this process, in which all is imported; there is nothing in the cells but Python."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", draw_all)
    names = {"__name__": "__main__"}
    for cell in code(nbformat.read(path, 4)):
        source = cell.source.replace("starts=8", "starts=2")  # of an optimisation: each of them does the same
        exec(compile(source, path.name, "exec"), names)
    assert not plt.get_fignums()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_is_committed_with_its_outputs(path):
    cells = code(nbformat.read(path, 4))
    assert any("image/png" in output.get("data", {}) for cell in cells for output in cell.outputs)
    assert not [output for cell in cells for output in cell.outputs if output.output_type == "error"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_imports_torcharm_and_little_else(path):
    imported = set()
    for cell in code(nbformat.read(path, 4)):
        for node in ast.walk(ast.parse(cell.source)):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(str(node.module).split(".")[0])
    assert "torcharm" in imported
    assert imported <= ALLOWED
