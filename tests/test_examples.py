"""Every public name shows by an example what it is for, and the examples run."""

import doctest
import inspect
import math

import pytest
import torch

import torcharm as ta

NEEDS = {"SweepResult": "pyarrow", "open_sweep": "pyarrow", "qp_distance": "qpth", "sweep": "pyarrow"}
"""Packages that are optional, and without which an example cannot run."""
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL
"""Of an error its class counts: the numbers in its message are rounding."""


def faults(examples):
    """What is said of examples that do not do what they show."""
    told = []
    doctest.DocTestRunner(verbose=False, optionflags=FLAGS).run(examples, out=told.append)
    return "".join(told)


@pytest.mark.parametrize("name", [name for name in ta.__all__ if not inspect.ismodule(getattr(ta, name))])
def test_the_example_runs(name, tmp_path):
    """Beside the package an example knows torch, math, and `folder`, the path of an empty directory of its own."""
    known = {"ta": ta, "torch": torch, "math": math, "folder": tmp_path}
    (found,) = doctest.DocTestFinder(recurse=False).find(getattr(ta, name), name, module=False, globs=known)
    assert found.examples, f"{name}: has no example"
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    assert faults(found) == ""


@pytest.mark.parametrize(
    "text", [">>> 1 + 1\n3", ">>> 1 / 0", ">>> 1 / 0\nTraceback (most recent call last):\nKeyError:"]
)
def test_the_test_sees_examples_that_are_wrong(text):
    assert faults(doctest.DocTestParser().get_doctest(text, {}, "wrong", None, 0))
