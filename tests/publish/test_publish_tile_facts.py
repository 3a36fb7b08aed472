"""Which tiles a work list begins with."""

from __future__ import annotations

from fwclass.publish.tile_facts import WORTH, least_sure_first


def test_a_sliver_is_no_place_to_look_at_first():
    tiles = {
        "a": {"confidence": 0.9, "points": 5000},
        "b": {"confidence": 0.4, "points": WORTH - 1},
        "c": {"confidence": 0.6, "points": WORTH},
        "d": {"confidence": None, "points": 9000},
        "e": {"confidence": 0.6, "points": 400},
        "f": {"confidence": 0.0, "points": 700},
    }
    assert least_sure_first(tiles) == ["f", "c", "e", "a", "b", "d"]
