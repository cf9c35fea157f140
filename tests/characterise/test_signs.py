"""Which way forces act, told from samples: of shipped models, whatever way they are written down; and what is asked."""

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.characterise.signs import ASSUMED, NAMED, SAID, Signs, positive_forces, settled

MODELS = [ta.Bellows(), ta.McKibben()]


def samples(model, count=300, noise=0.0):
    random = np.random.default_rng(4)
    strain = random.uniform(*model.strain_range, count)
    pressure = random.uniform(0, model.max_pressure, count)
    force = model.force(torch.from_numpy(strain), torch.from_numpy(pressure)).numpy()
    return strain, pressure, force + noise * np.abs(force).max() * random.normal(size=count)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_models_resist_being_moved(model, noise):
    strain, pressure, force = samples(model, noise=noise)
    assert positive_forces(strain, pressure, force) == "push"
    assert positive_forces(strain, pressure, -force) == "pull"


def test_what_is_not_clear_is_not_told():
    strain, pressure, force = samples(ta.Bellows())
    random = np.random.default_rng(1)
    assert positive_forces(strain, pressure, random.normal(size=len(force))) == ""
    assert positive_forces(strain, pressure, pressure + 0 * strain) == ""  # no stiffness at all
    assert positive_forces(0 * strain, pressure, force) == ""
    assert positive_forces(strain[:8], pressure[:8], force[:8]) == ""
    assert positive_forces(strain, pressure, 100 * (strain - 0.25) ** 2) == ""  # rises and falls
    together = strain + 2e-4 * random.normal(size=len(strain))  # pressure, too
    assert positive_forces(strain, 100 * together, 0.9 * 100 * strain - 60 * strain + random.normal(size=300)) == ""
    either = random.random(300) < 0.5  # what both do at once is left open, and not what strain does
    force = ta.Bellows().force(*(torch.from_numpy(values) for values in (strain * either, pressure * ~either))).numpy()
    off = 1e-3 * random.normal(size=(2, 300))
    assert positive_forces(strain * either + off[0], pressure * ~either + 50 * off[1], -force) == "pull"


@pytest.mark.parametrize("way", ["pull", "push"])
def test_an_assumption_gives_way_to_the_samples(way):
    strain, pressure, force = samples(ta.Bellows())
    turned = -force if way == "pull" else force
    for assumed in ("pull", "push"):
        x, f, ((name, words),) = settled(Signs(assumed, ASSUMED), strain, pressure, turned, "t")
        np.testing.assert_array_equal(f, force)
        np.testing.assert_array_equal(x, strain)
        other = {"pull": "push", "push": "pull"}[way]
        assert name == "positive forces"
        assert words == f"{way}, as what is stretched pulls back (--positive {other} takes them the other way)"


def test_where_samples_do_not_tell_the_assumption_stands_and_is_said():
    strain, pressure, _ = samples(ta.Bellows())
    *_, words = settled(Signs("pull", ASSUMED), strain, pressure, pressure, "t")
    assert words == (("positive forces", "pull, assumed (--positive push takes them the other way)"),)


@pytest.mark.parametrize("known", [SAID, NAMED])
def test_samples_that_contradict_what_is_said_or_named_are_a_warning(known):
    strain, pressure, force = samples(ta.Bellows())
    with pytest.warns(UserWarning, match=rf"t.csv: positive forces pull, {known}, but then it pulls less the"):
        _, found, _ = settled(Signs("pull", known), strain, pressure, force, "t.csv")
    np.testing.assert_array_equal(found, -force)  # all the same


def test_strains_above_0_are_those_of_a_muscle_or_of_a_bellows_as_is_said():
    strain, pressure, force = samples(ta.McKibben())
    strain, pressure, force = (values[strain < 0] for values in (strain, pressure, force))
    file = -strain, pressure, -force
    with pytest.raises(ValueError, match=r"^t: must be told what it is of, .*--positive pull.*--positive push"):
        settled(Signs("push", ASSUMED, longer=False), *file, "t")
    x, f, words = settled(Signs("pull", SAID, longer=False), *file, "t")
    np.testing.assert_array_equal((x, f), (strain, force))
    assert ("positive strains", "shorter, as forces fall with them") in words
    x, f, words = settled(Signs("push", SAID, longer=False), *file, "t")
    np.testing.assert_array_equal((x, f), (-strain, -force))
    assert ("positive strains", "longer, assumed") in words
