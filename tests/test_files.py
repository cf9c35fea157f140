"""Files are read whole or refused, and written whole or not at all; a failing save costs no result."""

import csv
import os
import re
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from characterise import layouts
from standard_error import without_notice

import torcharm as ta
from torcharm import cli, study
from torcharm.files import check_writable

STUDY = """
name = "files"
[[arm]]
name = "=2+3"
kind = "bellows"
[[arm]]
name = "@arm"
kind = "antagonistic"
[[task]]
name = "-bend"
shape = { kind = "affine", slope = -0.5, intercept = 0.5, nodes = 3 }
loads = [[-1.0, 0.5, 0.01], [0.5, -1.0, 0.0]]
[[plan]]
name = "+reach"
tip_pose = [0.0895523814, -0.4903971894, -1.3207963268]
tip_load = [0.0, 0.0, 0.0]
nodes = 3
length_weight = 10.0
reference_length = 0.5
"""
posix = pytest.mark.skipif(os.name != "posix", reason="pipes and devices are named otherwise there")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A study, and a run with its log, of which the folder is the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "run.csv").write_text(layouts.REFERENCE)
    (tmp_path / "log.txt").write_text(layouts.REFERENCE_LOG)
    return tmp_path


@pytest.fixture
def two_minutes():
    """What waits for a pipe fails rather than hangs."""

    def late(*_):
        raise AssertionError("it waits")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def command(monkeypatch, *args):
    """The exit code of torcharm with these arguments; None or 0 if all was well."""
    monkeypatch.setattr(sys, "argv", ["torcharm", *map(str, args)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return ended.value.code


def fitting(*more, run="run.csv", log="log.txt"):
    return ("fit", "--instron", run, "--pressure", log, "--smoothing", 0, "--degree", 2, "--out", "m.toml", *more)


def fitted(folder):
    recording = ta.align(ta.read_tester(folder / "run.csv"), ta.read_pressure(folder / "log.txt"), smoothing=0)
    return ta.fit_recording(recording, 2)


def no_room(monkeypatch, folder, times=None):
    """Nothing in the folder takes its name any more, but for temporary files; as on a disk that fills up."""
    replace, left = os.replace, [times]

    def refuse(source, target, **options):
        if folder not in type(folder)(target).parents or left[0] == 0:
            return replace(source, target, **options)
        left[0] = left[0] and left[0] - 1
        raise OSError(28, "No space left on device", os.fspath(source))

    monkeypatch.setattr(os, "replace", refuse)


def refused(monkeypatch, capsys, *args):
    """The one line with which a command refuses."""
    assert command(monkeypatch, *args) == 2
    shown = capsys.readouterr()
    (line,) = without_notice(shown.err).splitlines()
    assert line.startswith("torcharm: ")
    return line, shown.out


# Writing


COMMANDS = {
    "evaluate": (("evaluate", "study.toml", "--out", "o.csv"), ["o.csv"], "Task"),
    "search": (("search", "study.toml", "--starts", 1, "--out", "o.csv"), ["o.csv"], "Task"),
    "plan": (("plan", "study.toml", "--out", "o.csv"), ["o.csv"], "+reach"),
    "shape": (("shape", "--pressure", "20,20,20,20", "--figure", "f.png"), ["f.png"], "tip at x"),
    "fit": (fitting("--figure", "f.png"), ["m.toml", "f.png"], "R² "),
}


@pytest.mark.parametrize("case", COMMANDS)
def test_a_failing_save_costs_no_result_and_keeps_the_old_file(folder, monkeypatch, capsys, case):
    args, names, table = COMMANDS[case]
    for name in names:
        if name == "m.toml":  # only a model is replaced by one
            ta.save_actuator(folder / name, ta.Bellows())
        else:
            (folder / name).write_text("old")
    old = {name: (folder / name).read_bytes() for name in names}
    before = sorted(folder.iterdir())
    with monkeypatch.context() as patch:
        no_room(patch, folder)
        line, shown = refused(patch, capsys, *args)
    assert table in shown
    assert "Wrote" not in shown
    for name in names:
        assert f"{name}: cannot be written: No space left on device" in line
        assert (folder / name).read_bytes() == old[name]
    assert sorted(folder.iterdir()) == before
    assert not command(monkeypatch, *args)
    assert all((folder / name).stat().st_size > 100 for name in names)
    assert sorted(folder.iterdir()) == before


def test_one_failing_output_costs_no_other(folder, monkeypatch, capsys):
    no_room(monkeypatch, folder, times=1)
    line, shown = refused(monkeypatch, capsys, "evaluate", "study.toml", "--out", "o.csv", "--figure", "f.png")
    assert "o.csv: cannot be written" in line
    assert "Wrote f.png" in shown
    assert sorted(path.name for path in folder.iterdir()) == ["f.png", "log.txt", "run.csv", "study.toml"]


def test_an_interrupted_search_leaves_what_it_found(folder, monkeypatch, capsys):
    from torcharm.pressure import search

    whole, calls = search.search_pressure, []

    def interrupted(*args, **options):
        calls.append(args)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return whole(*args, **options)

    monkeypatch.setattr("torcharm.cli.search.BLOCKS", {"multistart": 1})
    monkeypatch.setattr(search, "search_pressure", interrupted)
    assert command(monkeypatch, "search", "study.toml", "--starts", 1, "--out", "o.csv") == 130
    assert capsys.readouterr().err == "torcharm: interrupted\n"
    with (folder / "o.csv").open(newline="") as file:
        assert [row["load"] for row in csv.DictReader(file)] == ["1", "2"]


@pytest.mark.parametrize("name", [".", "nowhere/o.csv", "run.csv/o.csv", "x" * 300 + ".csv", "f-2.png"])
def test_an_unwritable_target_is_found_before_the_work(folder, monkeypatch, capsys, name):
    monkeypatch.setattr(study, "evaluate_arm", lambda *_: pytest.fail("the work was done"))
    monkeypatch.setattr("torcharm.characterise.delimited.read_sheet", lambda *_, **__: pytest.fail("it was read"))
    monkeypatch.setattr("torcharm.design.shape_planning.plan_shape", lambda *_, **__: pytest.fail("it was planned"))
    monkeypatch.setattr("torcharm.pressure.search.search_pressure", lambda *_, **__: pytest.fail("it was searched"))
    if name == "f-2.png":  # the second task's
        (folder / name).mkdir()
        again = STUDY[STUDY.index("[[task]]") : STUDY.index("[[plan]]")].replace("-bend", "again")
        (folder / "study.toml").write_text(STUDY + again)
        assert refused(monkeypatch, capsys, "evaluate", "study.toml", "--figure", "f.png")[0].startswith(
            "torcharm: --figure: f-2.png: is a directory, must be a file"
        )
        return
    before = sorted(folder.iterdir())
    for verb in (("evaluate", "study.toml"), ("search", "study.toml"), ("plan", "study.toml"), fitting()):
        line, shown = refused(monkeypatch, capsys, *verb, "--out", name)
        assert line.startswith(f"torcharm: --out: {name}: ")
        assert shown == ""
    assert sorted(folder.iterdir()) == before


def test_a_reader_sees_the_old_file_or_the_new(tmp_path):
    path, models = tmp_path / "m.toml", [ta.Bellows(max_pressure=50.0), ta.McKibben(max_pressure=40.0)]
    ta.save_actuator(path, models[0])
    failures = []

    def write(model):
        try:
            for _ in range(60):
                ta.save_actuator(path, model)
        except OSError as error:
            failures.append(error)

    writers = [threading.Thread(target=write, args=(model,)) for model in models]
    for thread in writers:
        thread.start()
    seen = [ta.load_actuator(path)]
    while any(thread.is_alive() for thread in writers):
        seen.append(ta.load_actuator(path))
    assert not failures
    assert all(model in models for model in seen)
    assert [entry.name for entry in tmp_path.iterdir()] == ["m.toml"]


@posix
def test_a_link_is_followed_and_permissions_are_kept(tmp_path):
    target, link = tmp_path / "m.toml", tmp_path / "link.toml"
    ta.save_actuator(target, ta.Bellows())
    target.chmod(0o640)
    link.symlink_to(target)
    ta.save_actuator(link, ta.McKibben())
    assert link.is_symlink()
    assert ta.load_actuator(target) == ta.McKibben()
    assert target.stat().st_mode & 0o777 == 0o640


@posix
@pytest.mark.parametrize("name", ["plain", "x.json"])
def test_the_asked_ending_chooses_the_format_through_a_link(folder, monkeypatch, name):
    (folder / "link.csv").symlink_to(folder / name)
    assert not command(monkeypatch, "evaluate", "study.toml", "--out", "link.csv")
    assert (folder / name).read_text().startswith("arm,task,load,")


@posix
def test_names_with_a_nul_and_protected_pipes_are_refused(folder, monkeypatch):
    with pytest.raises(ValueError, match=r"--out: a\0b.csv: cannot be written, .*embedded null"):
        check_writable("a\0b.csv", "--out")
    os.mkfifo("pipe")
    check_writable("pipe")
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may do all
    with pytest.raises(ValueError, match="pipe: cannot be written, Permission denied"):
        check_writable("pipe")


@posix
def test_a_device_is_written_directly(folder, monkeypatch):
    assert not command(monkeypatch, "evaluate", "study.toml", "--out", "/dev/null")
    assert not os.path.isfile("/dev/null")
    line = [sys.executable, "-m", "torcharm.cli", "search", "study.toml", "--starts", "1", "--out", "/dev/stdout"]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, without_notice(done.stderr)) == (0, "")
    assert sum(row.startswith(("'=2+3,", "'@arm,")) for row in done.stdout.splitlines()) == 4  # and not again


def test_names_that_a_spreadsheet_takes_for_formulas(folder, monkeypatch):
    for verb in (("evaluate",), ("search", "--starts", 1), ("plan",)):
        assert not command(monkeypatch, *verb, "study.toml", "--out", "o.csv")
        with (folder / "o.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        assert {row["arm"] for row in rows} == {"'=2+3", "'@arm"}
        assert {row.get("task", "'-bend") for row in rows} == {"'-bend"}
        assert {row.get("plan", "'+reach") for row in rows} == {"'+reach"}
        assert "force_x_N" not in rows[0] or float(rows[0]["force_x_N"]) == -1.0


# Reading


def kinds(folder):
    """Something of each kind that is no file to read."""
    os.mkfifo(folder / "pipe")
    with (folder / "huge").open("wb") as file:
        file.truncate(250_000_000)
    return {
        "pipe": "is a pipe, must be a regular file",
        "/dev/zero": "is a device, must be a regular file",
        str(folder): "is a folder, must be a regular file",
        "huge": "must hold at most 200 MB, holds more",
        "none": "No such file or directory",
    }


@posix
@pytest.mark.usefixtures("two_minutes")
def test_pipes_devices_folders_and_huge_files_are_refused(folder, monkeypatch, capsys):
    for given, reason in kinds(folder).items():
        arm = f'[[arm]]\nname = "x"\nradii = [0.1]\nlength = 0.5\nactuators = [{{ kind = "file", path = "{given}" }}]'
        (folder / "by_file.toml").write_text(f"{STUDY}{arm}\n")
        for args in (
            ("evaluate", given),
            ("search", given),
            ("plan", given),
            ("shape", "--pressure", "0", "--study", given),
            ("evaluate", "by_file.toml"),
            fitting(run=given),
            fitting(log=given),
        ):
            line, _ = refused(monkeypatch, capsys, *args)
            assert f"{given}: cannot be read: {reason}" in line
        with pytest.raises(ValueError, match=rf"^{given}: cannot be read: {reason}$"):
            ta.load_actuator(given)


def damaged(data):
    """What goes wrong with files: name and bytes."""
    half = len(data) // 2
    random = np.random.default_rng(0)
    return {
        "nothing": b"",
        "blank": b"\n" * 20,
        "half": data[:half],
        "without its last two bytes": data[:-2],
        "without the last line's second half": data[:-8],
        "zeros at the end": data[:half] + bytes(len(data) - half),
        "zeros at the beginning": bytes(half) + data[half:],
        "zeros within": data[:half] + bytes(64) + data[half + 64 :],
        "other bytes within": data[:half] + random.bytes(64) + data[half + 64 :],
        "other bytes": random.bytes(2000),
        "UTF-16": data.decode().encode("utf-16"),
        "a picture": b"\x89PNG\r\n\x1a\n" + data,
        "a long line": b"x" * 100_000,
        "many brackets": b"[" * 100_000,
    }


DAMAGES = list(damaged(b"x" * 100))
HARMLESS = ("other bytes within", "UTF-16", "a picture")
"""To recordings: a line is left out, an encoding is one, and what stands above names of columns is passed over."""


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_files_are_refused_in_one_line(folder, monkeypatch, capsys, damage):
    ta.save_actuator(folder / "model.toml", fitted(folder))
    arm = '[[arm]]\nname = "x"\nradii = [0.1]\nlength = 0.5\nactuators = [{ kind = "file", path = "model.toml" }]\n'
    (folder / "by_file.toml").write_text(STUDY + arm)
    for name, args in (
        ("run.csv", fitting()),
        ("log.txt", fitting()),
        ("model.toml", ("evaluate", "by_file.toml", "--out", "o.csv")),
    ):
        whole = (folder / name).read_bytes()
        # A log without a part of its closing line lacks nothing.
        content = whole if name != "log.txt" else whole.replace(b"Logging end\n", b"")
        (folder / name).write_bytes(damaged(content)[damage])
        if damage in HARMLESS and name != "model.toml":
            assert not command(monkeypatch, *args)
            found, true = (ta.load_actuator(folder / file).coefficients for file in ("m.toml", "model.toml"))
            np.testing.assert_allclose(found, true, rtol=0.02, atol=1e-6)
            left_out = re.findall(
                rf"torcharm: warning: {name}: lines? [\d, ]+ damaged, left out", capsys.readouterr().err
            )
            assert len(left_out) == (damage == "other bytes within")
            (folder / "m.toml").unlink()
            (folder / name).write_bytes(whole)
            continue
        line, _ = refused(monkeypatch, capsys, *args)
        assert name in line
        assert not (folder / "m.toml").exists()
        assert not (folder / "o.csv").exists()
        (folder / name).write_bytes(whole)


def test_a_model_cut_anywhere_is_refused(folder):
    path = folder / "model.toml"
    ta.save_actuator(path, fitted(folder))
    text = path.read_text(encoding="utf-8")
    for end in [*range(0, len(text) - 60, 23), *range(len(text) - 60, len(text) - 1)]:
        path.write_text(text[:end], encoding="utf-8")
        with pytest.raises(ValueError, match=r"^.*model.toml: "):
            ta.load_actuator(path)
    path.write_text(text[:-1], encoding="utf-8")
    assert ta.load_actuator(path) == fitted(folder)


@pytest.mark.parametrize(
    ("text", "whole"),
    [
        ('kind = "bellows"\nmax_pressure = 40', False),
        ('kind = "bellows"\nmax_pressure = 4e1', False),
        ('kind = "bellows"\n[bending]\nkind = "linear"\nstiffness = -0.05', False),
        ('kind = "bellows"\nmax_pressure = 40\n', True),
        ('kind = "bellows"\nmax_pressure = 40 # kPa', True),
        ('kind = "bellows"\nstrain_range = [-0.2, 0.5]', True),
        ('max_pressure = 40\nkind = "bellows"', True),
    ],
)
def test_a_models_last_number_must_be_ended(tmp_path, text, whole):
    path = tmp_path / "m.toml"
    path.write_text(text)
    if whole:
        assert isinstance(ta.load_actuator(path), ta.Bellows)
    else:
        with pytest.raises(ValueError, match=r"m.toml: line \d: must end with an end of line, .* it is cut short$"):
            ta.load_actuator(path)


@pytest.mark.filterwarnings("ignore:.*pressures reach")
def test_a_recording_cut_anywhere_is_refused_or_read_up_to_there(folder):
    tester, log = ta.read_tester(folder / "run.csv"), ta.read_pressure(folder / "log.txt")
    for path, read, field, true in (
        (folder / "run.csv", ta.read_tester, "force", tester.force),
        (folder / "log.txt", ta.read_pressure, "pressure", log.pressure),
    ):
        data = path.read_bytes().replace(b"Logging end\n", b"")
        last = data.index(b"\n", 100) + 1
        for end in (*range(last + 1, last + 60), *range(len(data) - 30, len(data))):
            path.write_bytes(data[:end])
            start = data.rfind(b"\n", 0, end) + 1
            if data[start:end] in (b"", data[start : data.index(b"\n", start)] if end < len(data) else b""):
                found = getattr(read(path), field)
                np.testing.assert_array_equal(found, true[: len(found)])
            else:
                with pytest.raises(ValueError, match="it is cut short"):
                    read(path)
            found = getattr(read(path, truncated=True), field)
            np.testing.assert_array_equal(found, true[: len(found)])
            assert len(found) >= data[:end].count(b"\n") - 2
