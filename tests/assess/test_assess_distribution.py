"""Histograms add up over tiles, and their quantiles are those of the values to the width of a bin."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.assess.distribution import BINS, QUANTILES, Histograms, distribution, pack, quantiles, summary
from fwclass.model import ClassDef
from fwclass.schema import Table

CLASSES = (ClassDef("ground", 2, (2,)), ClassDef("tree", 5, (4, 5)), ClassDef("building", 6, (6,)))
HALF_BIN = 2.0**-8
"""A bin is 1/128 of its power of two: its middle is right to 1/256 of the value."""


def survey(n=6000, seed=0):
    r = np.random.default_rng(seed)
    reference = r.choice(np.array([0, 2, 4, 5], np.uint8), n)
    features = Table(
        {
            "zc": np.where(r.random(n) < 0.3, 0.0, r.gamma(2, 3, n)),
            "amplitude": np.where(r.random(n) < 0.1, np.nan, r.lognormal(4, 2, n)),
            "z": r.normal(0, 200, n),
            "number_of_echoes": r.integers(1, 8, n),
        }
    )
    return features, reference


def by_rank(values, share):
    """The smallest value that at least this share does not exceed."""
    values = np.sort(values)
    return values[max(int(np.ceil(share * len(values))), 1) - 1]


@pytest.mark.parametrize("feature", ["zc", "amplitude", "z", "number_of_echoes"])
def test_quantiles_are_those_of_the_values(feature):
    features, reference = survey()
    made = quantiles(distribution(features, reference, CLASSES)[feature], whole=feature == "number_of_echoes")
    for c, codes in enumerate([(2,), (4, 5)]):
        values = features[feature][np.isin(reference, codes)].astype(float)
        values = values[~np.isnan(values)]
        expected = np.array([by_rank(values, q) for q in QUANTILES])
        if feature == "number_of_echoes":
            np.testing.assert_array_equal(made[c], expected)
        else:
            assert (np.abs(made[c] - expected) <= HALF_BIN * np.abs(expected) + 2.0**-12).all()
    assert np.isnan(made[2]).all()


def test_histograms_of_tiles_add_up():
    features, reference = survey()
    whole = distribution(features, reference, CLASSES)
    tile = np.random.default_rng(2).integers(0, 5, len(reference))
    parts = [distribution(features.take(tile == t), reference[tile == t], CLASSES) for t in range(6)]
    for name, histogram in whole.items():
        np.testing.assert_array_equal(sum(p[name] for p in parts), histogram)
        assert histogram.shape == (3, BINS)
        assert histogram.sum() == (reference > 0).sum()


@settings(max_examples=200, deadline=None)
@given(st.floats(width=32))
def test_any_number_falls_into_the_bin_that_stands_for_it(value):
    reference = np.array([2], np.uint8)
    histogram = distribution(Table({"z": [value]}), reference, CLASSES)["z"]
    assert histogram.sum() == 1
    made = quantiles(histogram, (0.5,))[0, 0]
    if not np.isfinite(value):
        assert np.isnan(made)
        assert histogram[0, -1] == 1
    elif abs(value) < 2.0**20:
        assert abs(made - value) <= HALF_BIN * abs(value) + 2.0**-12
    else:
        assert np.sign(made) == np.sign(value)
        assert abs(made) > 2.0**20 * (1 - 2 * HALF_BIN)


@pytest.mark.parametrize("value", [0, 1, 2, 7, 100, 255])
def test_whole_numbers_come_back_exactly(value):
    histogram = distribution(Table({"number_of_echoes": [value]}), np.array([2], np.uint8), CLASSES)
    assert quantiles(histogram["number_of_echoes"], (0.5,), whole=True)[0, 0] == value


def test_the_summary_is_plain_data():
    features, reference = survey(500)
    made = summary(distribution(features, reference, CLASSES), ("ground", "tree", "building"))
    json.dumps(made, allow_nan=False)
    ground = made["features"]["amplitude"]["ground"]
    assert ground["rows"] == (reference == 2).sum()
    assert ground["without_value"] == np.isnan(features["amplitude"][reference == 2]).sum()
    assert made["features"]["zc"]["building"] == {"rows": 0, "without_value": 0, "quantiles": [None] * 5}
    assert made["features"]["zc"]["ground"]["quantiles"][0] == 0


def test_no_rows():
    made = distribution(Table.empty(["zc"]), np.empty(0, np.uint8), CLASSES)
    assert made["zc"].sum() == 0


def test_packed_histograms_of_tiles_are_the_whole_one():
    features, reference = survey()
    tile = np.random.default_rng(2).integers(0, 5, len(reference))
    parts = [pack(features.take(tile == t), reference[tile == t], CLASSES) for t in range(6)]
    assert all((counts > 0).all() for _, counts in parts)
    histograms = Histograms(tuple(features), len(CLASSES))
    for part in parts:
        histograms.add(*part)
    whole, made = distribution(features, reference, CLASSES), histograms.by_column()
    assert list(made) == list(whole)
    for name, histogram in whole.items():
        np.testing.assert_array_equal(made[name], histogram)


@pytest.mark.statistics
@given(st.lists(st.floats(width=32), min_size=1, max_size=50))
@settings(max_examples=200, deadline=None)
def test_a_bin_is_an_exponent_and_seven_bits(values):
    """The bin of every float32, NaN, infinities and both noughts among them, by arithmetic."""
    table = Table({"zc": np.array(values, np.float32)})
    made = distribution(table, np.full(len(values), 2, np.uint8), CLASSES[:1])["zc"][0]
    expected = np.zeros(BINS, np.int64)
    side = (BINS - 2) // 2
    for v in values:
        if not np.isfinite(v):
            expected[-1] += 1
            continue
        mantissa, exponent = np.frexp(np.float64(abs(v)))
        step = 0 if v == 0 else int((exponent - 1 + 12) * 128 + np.floor((2 * mantissa - 1) * 128)) + 1
        expected[side + int(np.sign(v)) * min(max(step, 0), side)] += 1
    np.testing.assert_array_equal(made, expected)
