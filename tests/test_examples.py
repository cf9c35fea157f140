"""Every public name shows by an example what it is for, and the examples run."""

import doctest
import math

import pytest
import torch

import torcharm as ta

NEEDS = {"SweepResult": "pyarrow", "open_sweep": "pyarrow", "qp_distance": "qpth", "sweep": "pyarrow"}
"""Packages that are optional, and without which an example cannot run."""
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL
"""Of an error its class counts: the numbers in its message are rounding."""


@pytest.mark.parametrize("name", ta.__all__)
def test_the_example_runs(name, tmp_path):
    """Beside the package an example knows torch, math, and `folder`, the path of an empty directory of its own."""
    known = {"ta": ta, "torch": torch, "math": math, "folder": tmp_path}
    (found,) = doctest.DocTestFinder(recurse=False).find(getattr(ta, name), name, module=False, globs=known)
    assert found.examples, f"{name}: has no example"
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    told = []
    doctest.DocTestRunner(verbose=False, optionflags=FLAGS).run(found, out=told.append)
    assert not told, "".join(told)


def test_an_example_that_says_something_else_is_told():
    known = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3", {}, "sum", None, 0)
    assert doctest.DocTestRunner(verbose=False).run(known, out=[].append).failed == 1
