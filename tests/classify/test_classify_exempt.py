"""Echoes that do not get the class that the model says."""

import numpy as np
import pytest

from fwclass import conf
from fwclass.classify.exempt import Exempt
from fwclass.schema import Table


def exempt(**given):
    return Exempt.of(conf.section("classify", tuple(f"classify.{n}={v}" for n, v in given.items())))


ANSWERED = Table(
    {
        "classification": np.array([2, 5, 6, 5, 2], np.uint8),
        "confidence": np.array([0.9, 0.4, 0.8, 0.7, 0.3], np.float32),
        "entropy": np.zeros(5, np.float32),
    }
)
OWN = Table(
    {
        "source_class": np.array([2, 1, 9, 1, 9], np.uint8),
        "noise": np.array([False, True, True, True, False]),
        "height_above_ground": np.array([0.0, -30.0, 80.0, np.nan, 1.0], np.float32),
    }
)


def test_without_settings_every_echo_has_its_class():
    assert exempt() is None


@pytest.mark.parametrize(
    ("given", "codes", "unknown"),
    [
        ({"noise": "true"}, [2, 7, 18, 7, 2], [1, 2, 3]),
        ({"keep": "[9]"}, [2, 5, 9, 5, 9], [2, 4]),
        ({"leave": "1", "leave_below": "0.5"}, [2, 1, 6, 5, 1], []),
        ({"noise": "true", "keep": "[9]", "leave": "1", "leave_below": "0.5"}, [2, 7, 9, 7, 9], [1, 2, 3, 4]),
    ],
)
def test_codes_and_confidences(given, codes, unknown):
    way = exempt(**given)
    got = way.written(ANSWERED, OWN.select(way.columns))
    assert got["classification"].tolist() == codes
    assert np.flatnonzero(np.isnan(got["confidence"])).tolist() == unknown


def test_unsure_echoes_are_no_noise():
    with pytest.raises(Exception, match="which noise is written as"):
        exempt(noise="true", leave="7")
