import dataclasses
import math
import pickle

import numpy as np
import pytest
import torch

import torcharm as ta

ROWS = ("tip_pose", "pressure", "twists", "code", "strain_excess", "payload_factor")


@pytest.fixture(scope="module")
def found():
    return ta.workspace(ta.antagonistic_arm(), [0.0, -2.0, 0.0], states=1500, nodes=4)


def test_cells_hold_the_best_of_their_states(found):
    cells = found.cells(0.02)
    reached = found.reached
    index = (found.position[reached] / 0.02).floor()
    assert int(cells.count.sum()) == int(reached.sum())
    for centre, factor, low, high in zip(
        cells.centre, cells.payload_factor, cells.angle_min, cells.angle_max, strict=True
    ):
        own = (index == (centre / 0.02).floor()).all(-1)
        assert factor == found.payload_factor[reached][own].max()
        angles = found.angle[reached][own]
        assert (low, high) == (angles.min(), angles.max())
    assert len(found.cells(0.02, extrapolated=True).centre) > len(cells.centre)


def test_extents(found):
    place = found.position[found.reached]
    assert found.reach == pytest.approx(float(place.norm(dim=-1).max()))
    assert found.heights == (float(place[:, 1].min()), float(place[:, 1].max()))
    assert found.contains(torch.zeros(2)).item() is False
    with pytest.raises(ValueError, match=r"points: must have shape \(..., 2\)"):
        found.contains([0.0, 0.0, 0.0])


def test_a_region_that_still_grows_says_so(found):
    assert found.unsettled == ""
    assert "settled" not in repr(found)
    few = ta.workspace(ta.antagonistic_arm(), [0.0, -2.0, 0.0], states=200, nodes=4)
    assert few.extrapolated_region.size < found.extrapolated_region.size
    assert few.unsettled.startswith("not settled: the last quarter of 200 states still counts")
    assert "ask for more states" in repr(few)


def test_how_far_a_region_grows_is_told_of_the_region_that_does(found):
    """Of states that come to the right of the region last."""
    order = found.position[:, 0].where(found.reached, -math.inf).argsort()
    columns = {name: value[order] for name, value in vars(found).items() if name in ROWS}
    sorted_ = dataclasses.replace(found, **columns)
    early = dataclasses.replace(found, **{name: value[: int(0.75 * 1500)] for name, value in columns.items()})
    assert sorted_.size == pytest.approx(found.size)
    less = 100 * (1 - early.size / found.size)
    assert less > 3
    assert f"the region reached was {less:.0f} % smaller without them" in sorted_.unsettled


def test_columns(found):
    columns = found.to_dict()
    assert {len(values) for values in columns.values()} == {1500}
    assert list(columns)[:3] == ["tip_x", "tip_y", "tip_angle"]
    assert {"status", "payload_factor", "pressure_4"} <= set(columns)
    assert "payload_factor" not in ta.workspace(ta.antagonistic_arm(), states=100, nodes=2).to_dict()


def test_frame(found):
    pytest.importorskip("pandas")
    assert found.to_frame()["tip_y"].min() == pytest.approx(float(found.position[:, 1].min()))


def test_it_survives_pickle_and_moves_to_another_dtype(found):
    assert found.size > 0  # the region is worked out, and goes along
    again = pickle.loads(pickle.dumps(found))
    assert again.size == found.size
    single = found.to(torch.float32)
    assert single.position.dtype == torch.float32
    assert single.size == pytest.approx(found.size, rel=0.01)
    assert repr(found).startswith("Workspace(1500 states: ")


def test_nothing_is_reached_in_range():
    arm = ta.ArmDesign(
        [-0.03, 0.03], 0.2, [ta.PolynomialActuator(((0, 1, 2.0), (1, 0, -100.0)), (0.5, 0.6), (0, 50), 5.0, 0.0)] * 2
    )
    found = ta.workspace(arm, states=200, nodes=2)
    assert found.shares["excluded by range"] == 1
    assert found.size == 0
    assert found.extrapolated_region.size > 0
    assert math.isnan(found.reach)
    assert np.isnan(found.heights).all()
    assert len(found.cells().centre) == 0
