"""What a sweep finds, against what is found of its designs one by one, and against its whole table."""

import numpy as np
import pyarrow.parquet
import pytest
import torch
from sweep_cases import SPACE, arm, contents, small_sweep, task

import torcharm as ta
from torcharm.sweeps import SweepProgress


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    return small_sweep(tmp_path_factory.mktemp("sweep") / "run", count=400)


def whole(result):
    """All rows of a sweep, as arrays by column."""
    blocks = list(result.blocks())
    return {name: np.concatenate([block[name] for block in blocks]) for name in result.columns}


def ranked(table, *keys):
    """Indices of the feasible designs, in the order of some arrays."""
    order = np.lexsort((table["design"], *reversed(keys)))
    return table["design"][order][table["feasible"][order]].tolist()


@pytest.fixture(scope="module")
def table(swept):
    return whole(swept)


def test_every_design_is_there_once_in_order(swept, table):
    assert table["design"].tolist() == list(range(400))
    assert swept.complete
    assert (swept.count, swept.finished, swept.feasible) == (400, 400, table["feasible"].sum())
    assert 0 < swept.feasible < 400


def test_what_is_found_is_what_evaluate_finds(swept, table):
    chosen = np.flatnonzero(table["feasible"])[::7]
    some = {name: values[chosen] for name, values in table.items()}
    designs = swept.designs(some["design"])
    found = ta.evaluate(designs, task(), ("absolute", "relative"))
    assert np.allclose(some["absolute_N"], found.absolute.mean(-1), rtol=1e-6)
    assert np.allclose(some["relative_N"], found.relative.mean(-1), rtol=1e-6)
    assert np.allclose(some["size_mm"], 1e3 * designs.radii.abs().amax(-1), rtol=1e-6)
    assert some["not_excluded"].tolist() == found.not_excluded.sum(-1).tolist()


def test_designs_that_are_not_allowed_have_no_numbers(swept, table):
    left_out = ~table["feasible"]
    assert all(np.isnan(table[name][left_out]).all() for name in ("absolute_N", "relative_N", "size_mm"))
    assert (table["not_excluded"][left_out] == 0).all()
    file = pyarrow.parquet.read_table(next((swept.folder / "shards").iterdir()))
    assert file["absolute_N"].null_count == file["not_excluded"].null_count > 0
    assert file["design"].null_count == file["feasible"].null_count == 0


@pytest.mark.parametrize(
    ("reduce", "expected"),
    [
        ("worst", lambda x: x.amax(-1)),
        (0.5, lambda x: x.sort(-1).values[:, 1]),
        (0.33, lambda x: x.amin(-1)),
    ],
)
def test_metrics_are_reduced_over_all_tasks(tmp_path, reduce, expected):
    tasks = [task(), ta.Task(ta.affine_curvature(-1.0, 0.5, nodes=3))]
    found = ta.sweep(arm(), SPACE, tasks, 60, out=tmp_path, metrics="absolute", reduce={"absolute": reduce}, workers=1)
    best = found.best(5, "absolute")
    whole = [ta.evaluate(found.designs(best), one, ("absolute",)).absolute.reshape(len(best), -1) for one in tasks]
    assert np.allclose(best["absolute_N"], expected(torch.cat(whole, -1)), rtol=1e-6)


def test_predicted_errors_and_verdicts(tmp_path):
    found = ta.sweep(arm(), SPACE, task(), 40, out=tmp_path, metrics="predicted_error", workers=1, tolerance=0.05)
    best = found.best(8)
    expected = ta.evaluate(found.designs(best), task(), ("predicted_error",), tolerance=0.05)
    assert bool(expected.prediction.stable.all())
    assert np.allclose(best["tip_error_mm"], 1e3 * expected.tip_error.mean(-1), rtol=1e-5)
    assert np.allclose(best["shape_error_mm"], 1e3 * expected.shape_error.mean(-1), rtol=1e-5)
    assert best["held"].tolist() == (expected.verdict == "held").sum(-1).tolist()
    assert sum(found.verdicts.values()) == 2 * found.feasible
    most = found.best(3, "held")["held"]
    assert most.max() == most[0] == whole(found)["held"].max()


@pytest.mark.parametrize("by", ["absolute", "relative_N", "not_excluded", "size"])
def test_the_best_are_those_of_the_whole_table(swept, table, by):
    values = table[swept.column(by)]
    keys = (-values, table["absolute_N"]) if by == "not_excluded" else (values,)
    assert swept.best(25, by)["design"].tolist() == ranked(table, *keys)[:25]


@pytest.mark.parametrize("pair", [("absolute", "size"), ("relative", "size"), ("relative", "absolute")])
def test_the_pareto_set_is_that_of_the_whole_table(swept, table, pair):
    known = table["feasible"]
    x, y = (table[swept.column(name)][known] for name in pair)
    beaten = [((x <= a) & (y <= b) & ((x < a) | (y < b))).any() for a, b in zip(x, y, strict=True)]
    found = swept.pareto(*pair)
    assert set(found["design"].tolist()) == set(table["design"][known][~np.array(beaten)])
    assert found[swept.column(pair[1])].tolist() == sorted(found[swept.column(pair[1])])


def test_columns_of_free_values_are_those_of_the_designs(tmp_path):
    mirrored = ta.DesignSpace(tied="mirror", spacing=0.01, in_range=False)
    found = ta.sweep(arm(), mirrored, task(), 50, out=tmp_path, metrics="absolute", workers=1, shard_size=50)
    assert found.free_values == ("radii_1_4_mm", "radii_2_3_mm", "length_1_4_mm", "length_2_3_mm")
    (block,) = found.blocks(("radii_1_4", "length_2_3_mm"))
    designs = found.designs(np.arange(50))
    assert np.allclose(block["radii_1_4_mm"], 1e3 * designs.radii[:, 0])
    assert np.allclose(block["length_2_3_mm"], 1e3 * designs.length[:, 1])


def test_large_shards_carry_what_summaries_need(tmp_path, monkeypatch):
    from torcharm.sweeps import ranking
    from torcharm.sweeps.shards import BEST

    monkeypatch.setattr(ranking, "KEPT", 5)
    found = small_sweep(tmp_path, 200, shard_size=100)
    texts = [pyarrow.parquet.read_metadata(path).metadata for path in (tmp_path / "shards").iterdir()]
    assert all(BEST in text for text in texts)
    expected = ranked(whole(found), whole(found)["absolute_N"])[:5]
    assert found.best(5, "absolute")["design"].tolist() == expected
    assert len(found.summary.rows["design"]) < 60


def test_a_sweep_is_opened_again(swept):
    again = ta.open_sweep(swept.folder)
    assert again.complete
    assert again.best(9, "absolute")["design"].tolist() == swept.best(9, "absolute")["design"].tolist()
    assert (again.designs([4, 2]).radii == swept.designs([4, 2]).radii).all()
    assert np.allclose(again.best(9, "absolute")["radii"], swept.designs(swept.best(9, "absolute")).radii)


def test_a_summary_is_what_its_shards_say(swept):
    path = swept.folder / "summary.parquet"
    before = path.read_bytes()
    path.unlink()
    again = ta.open_sweep(swept.folder)
    assert path.read_bytes() == before
    assert again.summary.counts == swept.summary.counts


def test_tables_of_pandas_hold_what_is_asked_for(swept, table):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    some = swept.to_frame(["design", "relative", "radii_2"], [("relative_N", "<", 5.0)])
    assert list(some.columns) == ["design", "relative_N", "radii_2_mm"]
    assert some["design"].tolist() == table["design"][table["relative_N"] < 5.0].tolist()
    assert np.allclose(some["radii_2_mm"], 1e3 * swept.designs(some["design"].to_numpy()).radii[:, 1])
    assert isinstance(some, pandas.DataFrame)
    assert tuple(swept.to_frame().columns) == swept.columns
    assert swept.best(3, "absolute").to_frame()["design"].tolist() == swept.best(3, "absolute").indices.tolist()


def test_a_grid(tmp_path):
    found = ta.sweep(
        arm(), SPACE, task(), out=tmp_path, sampling="grid", levels=[2, 3, 3, 2], metrics="absolute", workers=1
    )
    assert found.count == 36
    radii = found.designs(np.arange(36)).radii
    assert torch.allclose(radii[:, 0].unique(), torch.tensor([-0.1, 0.1], dtype=torch.float64))


@pytest.mark.parametrize("kind", ["series", "space"])
def test_arms_in_series_and_in_space(tmp_path, kind):
    if kind == "series":
        own = ta.series([ta.antagonistic_arm(), ta.RigidLink(length=0.02), ta.bellows_arm()])
        what = ta.Task([[0.5, 0.0, 0.5]] * 4, [1.0, -1.0, 0.0], segment_nodes=(2, 2))
        space = ta.DesignSpace(free=("radii", "length"), spacing=0.01, in_range=False)
    else:
        own = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.4, actuators=ta.Bellows())
        what = ta.Task(ta.constant_curvature(0.5, 0.4, nodes=3, direction=0.4), [0.0, -1.0, 0.2, 0.0, 0.0, 0.0])
        space = ta.DesignSpace(free=("radii", "angles", "length"), tied="none")
    found = ta.sweep(own, space, what, 300, out=tmp_path, metrics="absolute", workers=1)
    best = ta.open_sweep(tmp_path).best(4, "absolute")
    designs = found.designs(best)
    assert len(best) == 4
    assert np.allclose(best["absolute_N"], ta.evaluate(designs, what, ("absolute",)).absolute, rtol=1e-5)
    assert best["radii"].shape == (4, own.actuator_count)


def test_a_space_without_a_feasible_design_drawn(tmp_path):
    narrow = ta.DesignSpace(free="radii", spacing=0.066, in_range=False)
    found = ta.sweep(arm(), narrow, task(), 20, out=tmp_path, metrics="absolute", workers=1)
    assert (found.finished, found.feasible) == (20, 0)
    assert len(found.best(3, "absolute")) == len(found.pareto("absolute")) == 0
    with pytest.raises(ValueError, match="something finite"):
        found.plot("absolute")
    with pytest.raises(ValueError, match="got none: the space allows no design of this sweep"):
        found.designs(found.best(3, "absolute"))


def test_pictures_have_units_and_count_every_feasible_design(swept):
    figure = swept.plot("absolute", "size", bins=7)
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("absolute [N]", "size [mm]")
    assert axes.collections[0].get_array().sum() == swept.feasible
    marginals = swept.plot()
    assert [axes.get_xlabel() for axes in marginals.axes] == ["absolute [N]", "relative [N]", "size [mm]"]
    assert swept.plot("radii_1").axes[0].get_xlabel() == "radii 1 [mm]"
    assert len(swept.plot("not_excluded").axes) == 1, "a column of whole numbers"


def test_progress_is_told(tmp_path):
    told = []
    small_sweep(tmp_path, 100, callback=told.append)
    assert [one.finished for one in told] == [0, 32, 64, 96, 100]
    assert told[0].best == np.inf
    assert told[-1].by == "absolute_N"
    assert told[-1].best == ta.open_sweep(tmp_path).best(1, "absolute")["absolute_N"][0]


def test_what_is_best_is_kept_on_the_way(tmp_path, monkeypatch):
    monkeypatch.setattr("torcharm.sweeps.running.KEEP_SECONDS", 0.0)
    kept = []
    small_sweep(tmp_path, 100, callback=lambda _: kept.append((tmp_path / "summary.parquet").exists()))
    assert kept == [False, True, True, True, True]


def test_a_bar_is_shown_where_it_is_asked_for(tmp_path, capfd):
    small_sweep(tmp_path / "a", 100)
    assert "sweeping" not in capfd.readouterr().err  # no terminal
    small_sweep(tmp_path / "b", 100, progress=True)
    assert "sweeping" in capfd.readouterr().err


def test_progress_in_words():
    told = SweepProgress(10, 100, 2e3, 400.0, 1.25, "absolute_N", 7)
    assert str(told) == "2,000 designs/s, 0:06:40 left, best absolute [N] 1.25"
    assert str(SweepProgress(0, 100, 0.0, np.inf, np.inf, "absolute_N", -1)) == "the first shards"


def test_a_callback_stops_and_the_sweep_goes_on(tmp_path):
    told = []

    def stop(progress):
        told.append(progress)
        return progress.finished >= 64

    part = small_sweep(tmp_path / "a", 200, callback=stop)
    assert (part.complete, part.interrupted, part.finished) == (False, True, 64)
    assert small_sweep(tmp_path / "a", 200).complete
    small_sweep(tmp_path / "b", 200)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_what_is_stopped_at_its_end_is_not_interrupted(tmp_path):
    found = small_sweep(tmp_path, 100, callback=lambda progress: progress.finished == progress.count)
    assert (found.complete, found.interrupted) == (True, False)


def test_parts_make_a_whole(tmp_path):
    small_sweep(tmp_path / "whole", 200)
    for part in (3, 1, 2):
        found = small_sweep(tmp_path / "parts", 200, shard=(part, 3))
        assert (found.complete, found.interrupted) == (part == 2, False)
    opened = ta.open_sweep(tmp_path / "parts")
    assert opened.finished == 200
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"count": 0}, "count"),
        ({"count": 2**31}, "count"),
        ({"metrics": "speed"}, "metrics"),
        ({"metrics": ()}, "metrics"),
        ({"reduce": "median"}, "reduce"),
        ({"reduce": {"speed": "mean"}}, "reduce"),
        ({"reduce": 1.5}, "reduce"),
        ({"sampling": "random"}, "sampling"),
        ({"sampling": "grid"}, "levels"),
        ({"sampling": "grid", "levels": [2, 2]}, "levels"),
        ({"levels": 3}, "levels"),
        ({"seed": -1}, "seed"),
        ({"shard": (4, 3)}, "shard"),
        ({"shard": (0, 3)}, "shard"),
        ({"shard_size": 0}, "shard_size"),
        ({"workers": 0}, "workers"),
        ({"executor": 7, "workers": None}, "executor"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"weights": (1.0, 0.0)}, "weights"),
        ({"power": 3}, "power"),
    ],
)
def test_mistakes_name_the_field(tmp_path, options, field):
    with pytest.raises(ValueError, match=rf"^{field}: "):
        small_sweep(tmp_path / "run", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["tip_error", "speed"])
def test_columns_that_are_not_there_are_refused(swept, name):
    with pytest.raises(ValueError, match=r"^column: must be one of absolute, relative, size"):
        swept.best(3, name)


def test_another_arm_is_refused(swept):
    with pytest.raises(ValueError, match="arm: must have the sweep's 4 actuators, got 8"):
        ta.open_sweep(swept.folder, arm=ta.silicone_arm())


def test_indices_that_are_not_there_are_refused(swept):
    with pytest.raises(ValueError, match="indices: must be integers from 0 to 399"):
        swept.designs([400])
    with pytest.raises(ValueError, match=r"^indices: must name at least one design, got none$"):
        swept.designs([])
