import subprocess
import sys
from importlib import resources
from importlib.metadata import version

import pytest

import torcharm


def run(code):
    """Run code in a fresh process and return what it prints."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def loaded():
    return set(run("import sys, torcharm; print(*sys.modules)"))


@pytest.mark.parametrize("package", ["scipy", "matplotlib", "pydantic", "typer", "rich", "qpth", "numba"])
def test_import_does_not_load(loaded, package):
    assert "torcharm" in loaded
    assert package not in loaded


def test_import_leaves_torch_as_it_was():
    code = """
import torch
def state():
    settings = torch.get_default_dtype(), torch.get_num_threads(), torch.is_grad_enabled()
    return *settings, torch.get_rng_state().tolist()
before = state()
import torcharm
print(state() == before)
"""
    assert run(code) == ["True"]


@pytest.mark.parametrize("name", torcharm.__all__)
def test_public_names_exist_and_are_documented(name):
    assert getattr(torcharm, name).__doc__


def test_public_names_are_sorted_and_unique():
    assert torcharm.__all__ == sorted(set(torcharm.__all__))


def test_a_star_import_gives_the_public_names():
    names = run("from torcharm import *; print(*(name for name in dir() if not name.startswith('__')))")
    assert sorted(names) == torcharm.__all__


def test_dir_lists_all_public_names_and_modules():
    listed = run("import torcharm; print(*dir(torcharm))")
    assert {*torcharm.__all__, "evaluate", "plot", "study"} <= set(listed)


@pytest.mark.parametrize("module", ["plot", "study"])
def test_modules_load_when_they_are_first_used(loaded, module):
    assert f"torcharm.{module}" not in loaded
    assert run(f"import torcharm as ta; print(ta.{module}.__name__)") == [f"torcharm.{module}"]


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="No torcharm attribute nothing"):
        _ = torcharm.nothing


def test_the_package_says_that_it_is_typed():
    assert resources.files("torcharm").joinpath("py.typed").is_file()


def test_the_version_is_that_of_the_distribution():
    assert torcharm.__version__ == version("torcharm")
