"""Damaged files: one line on the standard error, exit 2, the file named, and the line where there is one."""

import re
import sys

import layouts
import numpy as np
import pytest

from torcharm import cli

NAMES, UNITS, *ROWS = layouts.REFERENCE.splitlines()
HEAD, *STAMPS, END = layouts.REFERENCE_LOG.splitlines()
RANDOM = np.random.default_rng(0)


def shuffled(rows):
    return [rows[i] for i in RANDOM.permutation(len(rows))]


def some(rows, change, every=10):
    return [change(row) if k % every == every // 2 else row for k, row in enumerate(rows)]


def run_file(rows=ROWS, names=NAMES, units=UNITS):
    return layouts.text(names, units, rows)


def log_file(rows=STAMPS, head=HEAD, end=(END,)):
    return layouts.text(head, rows, list(end))


TESTERS = {
    "empty": b"",
    "blank": b"\n \n\n",
    "a header alone": run_file([]),
    "names alone": NAMES + "\n",
    "cut in a line": layouts.REFERENCE[: len(layouts.REFERENCE) // 2],
    "cut in a number": layouts.REFERENCE[:-4],
    "cut without quotes": layouts.REFERENCE.replace('"', "")[:-3],
    "in random order": run_file(shuffled(ROWS)),
    "backwards": run_file(ROWS[::-1]),
    "two runs": run_file([*ROWS, NAMES, UNITS, *ROWS]),
    "no numbers": run_file(some(ROWS, lambda row: row.replace(row.split(",")[3], '"1.2.3"'))),
    "words for all forces": run_file(some(ROWS, lambda row: ",".join([*row.split(",")[:3], '"over"']), 1)),
    "infinite": run_file(some(ROWS, lambda row: row.replace(row.split(",")[2], '"inf"'))),
    "half of it with decimal commas": run_file([*ROWS[:200], *(row.replace(".", ",") for row in ROWS[200:])]),
    "cells lost": run_file(some(ROWS, lambda row: row.rpartition(",")[0], 3)),
    "lines joined": run_file([a + b for a, b in zip(ROWS[::2], ROWS[1::2], strict=True)][:150] + ROWS[300:]),
    "columns swapped half way": run_file([*ROWS[:200], *(",".join(row.split(",")[::-1]) for row in ROWS[200:])]),
    "one huge line": layouts.REFERENCE.replace("\n", ","),
    "huge lines among others": run_file(some(ROWS, lambda row: row + "0" * 200_000, 40)),
    "binary": layouts.REFERENCE.encode()[:200] + b"\0\1\2" * 40,
    "prose": "It was a dark and stormy night.\nNothing was measured.\n",
    "a picture": b"\x89PNG\r\n\x1a\n" + RANDOM.integers(1, 255, 4000, dtype=np.uint8).tobytes(),
    "no names of columns": run_file(names="A,B,C,D"),
    "no force": run_file(names=NAMES.replace("Force", "Energy"), units=UNITS.replace("(N)", "(J)")),
    "a unit that is none": run_file(units=UNITS.replace("(N)", "(furlong)")),
    "no units": layouts.text(NAMES, ROWS),
    "two strains": run_file(names=NAMES.replace("Displacement,", "Strain,", 1), units=UNITS.replace("(mm)", "(%)")),
    "a log": layouts.REFERENCE_LOG,
    "a clock that stands still": run_file([row.replace(row.split(",")[0], '"5.0"', 1) for row in ROWS]),
}  # fmt: skip

LOGS = {
    "empty": b"",
    "a closing line alone": END + "\n",
    "nothing logged": log_file([]),
    "cut in a line": "\n".join([HEAD, *STAMPS[:-1], STAMPS[-1].split(",")[0]]),
    "cut in a number": log_file(end=()).rstrip("\n")[:-2],
    "in random order": log_file(shuffled(STAMPS)),
    "no numbers": log_file(some(STAMPS, lambda row: row.split(",")[0] + ",1.2.3")),
    "two units": log_file(head="Time,Pressure (kPa) (psi)"),
    "a unit that is none": log_file(head="Time (ms),Pressure (furlong)"),
    "no pressure": log_file(head="Time (ms),Temperature (K)"),
    "a tester's file": layouts.REFERENCE,
    "started again": log_file([*STAMPS, *STAMPS]),
    "another hour": log_file([f"{float(row.split(',')[0]) + 3.6e6},{row.split(',')[1]}" for row in STAMPS]),
}  # fmt: skip
NO_LINE = ("empty", "blank", "another hour")


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Runs the command, which must refuse, and gives the line that says why."""
    monkeypatch.chdir(tmp_path)

    def run(**texts):
        for name, text in {"tester": layouts.REFERENCE, "log": layouts.REFERENCE_LOG, **texts}.items():
            if text is not None:
                (tmp_path / f"{name}.txt").write_bytes(text if isinstance(text, bytes) else text.encode())
        arguments = ["fit", "--tester", "tester.txt", "--pressure", "log.txt", "--smoothing", "0", "--out", "m.toml"]
        monkeypatch.setattr(sys, "argv", ["torcharm", *arguments])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        said = capsys.readouterr()
        assert caught.value.code == 2
        assert said.out == ""
        assert said.err.count("\n") == 1
        assert len(said.err) < 500
        assert not (tmp_path / "m.toml").exists()
        return said.err

    return run


@pytest.mark.parametrize("name", TESTERS)
def test_damaged_testers_files(refused, name):
    line = r"" if name in NO_LINE else r"line \d+: "
    assert re.search(f"tester.txt: {line}", refused(tester=TESTERS[name]))


@pytest.mark.parametrize("name", LOGS)
def test_damaged_logs(refused, name):
    line = r"" if name in NO_LINE else r"line \d+: "
    assert re.search(f"log.txt: {line}", refused(log=LOGS[name]))


def test_what_is_no_file(refused, tmp_path):
    (tmp_path / "log.txt").mkdir()
    assert "log.txt: cannot be read: is a folder, must be a regular file" in refused(log=None)
    (tmp_path / "log.txt").rmdir()
    assert "log.txt: cannot be read: No such file" in refused(log=None)


def test_the_line_that_is_named_is_the_first_that_is_wrong(refused):
    assert "tester.txt: line 8: must be 4 cells with finite numbers in columns 1, 3, 4, got '500.0" in refused(
        tester=TESTERS["no numbers"]
    )
    assert "tester.txt: line 403: time must increase" in refused(tester=run_file([*ROWS, *ROWS]))
