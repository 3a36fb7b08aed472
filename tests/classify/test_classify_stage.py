"""Columns of the classification: codes, confidence, entropy, shares."""

import numpy as np
import pytest
from tolerances import FLOAT32_RTOL, FLOAT32_UNIT

from fwclass.classify.stage import CLASSIFY, classify, count_filled, probability_columns
from fwclass.errors import InputError
from fwclass.model import FORMAT, LEAF, LinearMachine, assemble
from fwclass.schema import Table, column

NAMES = ("zc", "width")


def card(codes=(2, 5, 64)):
    ready = {"fill": [1.0, 4.0], "shift": [0.0, 0.0], "scale": [1.0, 1.0]}
    classes = [{"name": f"c{c}", "code": c, "codes": [c]} for c in codes]
    return {"format": FORMAT, "features": list(NAMES), "classes": classes, "preparation": ready}


def stumps(classes):
    """A forest of one leaf per tree."""
    made = [(np.array([LEAF], np.uint16), np.zeros(1, np.float32), np.array([c], np.uint32)) for c in classes]
    return assemble(made, card())


def machine():
    return LinearMachine(np.array([[1.0, 0], [0, 1], [-1, -1]]), np.zeros(3), card())


def test_shares_of_a_forest_are_its_votes():
    made = classify(np.zeros((2, 2), np.float32), stumps([0, 2, 2, 1]), probabilities=True)
    assert set(made) == {"classification", "confidence", "entropy", "probability_2", "probability_5", "probability_64"}
    np.testing.assert_array_equal(made["classification"], [64, 64])
    np.testing.assert_array_equal(made["confidence"], [0.5, 0.5])
    np.testing.assert_allclose([made[f"probability_{c}"][0] for c in (2, 5, 64)], [0.25, 0.25, 0.5])
    np.testing.assert_allclose(made["entropy"], 1.5 * np.log(2) / np.log(3), rtol=FLOAT32_RTOL)


def test_without_probabilities_only_the_stage_s_columns_come():
    assert tuple(classify(np.zeros((1, 2), np.float32), machine())) == CLASSIFY.writes


def test_confidence_is_the_share_of_the_class_and_shares_add_up():
    X = np.random.default_rng(1).normal(size=(200, 2)).astype(np.float32)
    made = classify(X, machine(), probabilities=True)
    shares = np.stack([made[n] for n in probability_columns((2, 5, 64))], axis=1)
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=FLOAT32_UNIT)
    np.testing.assert_array_equal(made["confidence"], shares.max(axis=1))
    np.testing.assert_array_equal(made["classification"], np.array([2, 5, 64])[shares.argmax(axis=1)])
    assert (made["entropy"] >= 0).all() and (made["entropy"] <= 1).all()


def test_a_machine_fills_gaps_and_counts_them_a_forest_does_not():
    gaps = np.array([[np.nan, 2], [3, np.nan]], np.float32)
    known = np.array([[1, 2], [3, 4]], np.float32)
    for name in ("classification", "confidence", "entropy"):
        np.testing.assert_array_equal(classify(gaps, machine())[name], classify(known, machine())[name])
    assert count_filled(gaps, machine()) == 2 and count_filled(gaps, stumps([0])) == 0


def test_a_feature_that_the_data_lacks_is_named():
    with pytest.raises(InputError, match="'width' is missing"):
        classify(Table({"zc": np.zeros(3)}), machine())


def test_the_column_of_a_class_is_declared_by_its_code():
    found = column("probability_6")
    assert (found.name, found.dtype, found.las, found.low, found.high) == ("probability_6", "f4", "probability 6", 0, 1)
    assert "class code 6" in found.meaning
    for wrong in (
        "probability",
        "probability_256",
        "probability_06",
        "probability_r100",
        "confidence_6",
        "probability_-1",
    ):
        with pytest.raises(KeyError):
            column(wrong)
