"""The run-time check of signatures: an integer may stand for a float, as everywhere in Python.

A check takes longer than most of what it checks. So in each test the first calls of every function are checked, and
its further ones, which are of the same lines again, are not.
"""

import sys
from collections import Counter

from beartype import BeartypeConf, beartype

FIRST = 10
"""So many calls of a function are checked in a test."""

_check = beartype(conf=BeartypeConf(is_pep484_tower=True))
_calls: Counter[object] = Counter()


def checked(signature):
    """What jaxtyping asks of a function's signature, which it has made a function of its own."""
    known = _check(signature)
    function = checked_function()

    def counted(*args, **kwargs):
        _calls[function] += 1
        if _calls[function] == 2 * FIRST:  # what goes in and what comes out count each
            function.__no_type_check__ = True
        return known(*args, **kwargs)

    return known if function is None else counted


def checked_function():
    """Whose signature jaxtyping has at hand, which it does not say; None where it makes out what is wrong with one."""
    frame = sys._getframe(1)
    while frame is not None and frame.f_code.co_name != "jaxtyped":
        frame = frame.f_back
    return None if frame is None else frame.f_locals.get("fn")


def check_again():
    """Forget what was called: a new test begins."""
    for function in _calls:
        vars(function).pop("__no_type_check__", None)
    _calls.clear()
