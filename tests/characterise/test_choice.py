"""Kinds of models are compared by samples that they were not fitted to."""

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.characterise.choice import MCKIBBEN

TRUTH = ta.Bellows()


def made(strain, pressure, run=None, noise=0.3):
    force = TRUTH.force(torch.from_numpy(strain), torch.from_numpy(pressure)).numpy()
    force = force + noise * np.random.default_rng(1).normal(size=len(force))
    runs = np.zeros(len(force), np.int64) if run is None else run
    return ta.Recording(strain, pressure, force, runs, ("made",))


def table():
    grid = np.meshgrid(np.linspace(-0.1, 0.6, 6), np.linspace(0, 80, 5), indexing="ij")
    return made(*(axis.ravel() for axis in grid))


def test_the_error_is_that_of_lines_left_out_one_after_the_other():
    """Against least squares by numpy, with strains and pressures between the first and the last left out in turn."""
    recording, squares = table(), []
    columns = np.stack([recording.strain**i * recording.pressure**j for i, j in MCKIBBEN], -1)
    for values in (recording.strain, recording.pressure):
        for level in np.unique(values)[1:-1]:
            out = values == level
            found, *_ = np.linalg.lstsq(columns[~out], recording.force[~out], rcond=None)
            squares += ((recording.force[out] - columns[out] @ found) ** 2).tolist()
    compared, model = ta.best_fit(recording)
    errors = {one.kind: one.rmse for one in compared}
    assert errors["mckibben"] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6)
    assert compared[0].kind == "polynomial"  # which the truth is
    assert errors["polynomial"] < 0.5 * errors["mckibben"]
    assert dict(model.provenance)["kind, by samples left out"] == "polynomial"
    assert dict(model.provenance)["RMSE of gridded on samples left out, N"] == errors["gridded"]
    assert model.coefficients == ta.fit_recording(recording, correlated=1).coefficients


def test_runs_are_left_out_whole():
    random = np.random.default_rng(2)
    recording = made(random.uniform(-0.1, 0.6, 600), random.uniform(0, 80, 600), np.repeat([0, 1, 2], 200))
    compared, model = ta.best_fit(recording, 3)
    held = model.quality.hold_out
    expected = np.sqrt(sum(one.samples * one.rmse**2 for one in held) / 600)
    assert next(one.rmse for one in compared if one.kind == "polynomial") == pytest.approx(expected, rel=1e-9)


def test_alike_kinds_give_way_to_fewer_numbers():
    recording = table()
    force = -0.6 * recording.pressure * (1 + 3 * recording.strain)
    alike = ta.Recording(recording.strain, recording.pressure, force, recording.run, ("made",))
    compared, _ = ta.best_fit(alike)
    assert [one.kind for one in compared] == ["mckibben", "polynomial", "gridded"]
    assert [one.numbers for one in compared] == [6, 9, 30]


def test_a_grid_is_neither_robust_nor_held_monotonic():
    compared, model = ta.best_fit(table(), monotonic=True)
    assert {one.kind for one in compared} == {"mckibben", "polynomial"}
    assert model.quality.constrained


def test_a_kind_that_cannot_be_fitted_says_why():
    grid = np.meshgrid([0.0, 0.1, 0.2], [0.0, 20.0, 40.0], indexing="ij")
    compared, _ = ta.best_fit(made(*(axis.ravel() for axis in grid)))
    reasons = {one.kind: one.reason for one in compared}
    assert reasons["polynomial"].startswith("strain, pressure: must vary enough to determine 9 coefficients")
    assert reasons["gridded"] == ""
    short = np.array([0.0, 0.1, 0.0, 0.1]), np.array([0.0, 0.0, 30.0, 30.0])
    with pytest.raises(ValueError, match=r"^strain, pressure: must take three values each for any to be left out"):
        ta.best_fit(made(*short))
