"""The quick test of a shape says what the search for the first place that does not fit says."""

from __future__ import annotations

import copy
from collections import UserDict

import numpy as np
import pytest

from fwclass.store import shapes
from fwclass.store.shapes import CODE, COUNT, NUMBER, TEXT, Maybe, first_misfit, misfit, square

SHAPE = {
    "rows": COUNT,
    "name?": TEXT,
    "by_code?": {CODE: [NUMBER]},
    "texts?": {TEXT: TEXT},
    "pair?": (NUMBER, Maybe(COUNT)),
    "matrix?": square(),
    "any?": shapes.ANY,
}
SOUND = {
    "rows": 3,
    "name": "a",
    "by_code": {"2": [1.0, 2], "255": []},
    "texts": {"a": "b"},
    "pair": [0.5, None],
    "matrix": [[1, 2], [3, 4]],
    "any": {"x": 1},
    "more": object(),
}
ODD = (
    None,
    True,
    -1,
    1.5,
    float("nan"),
    float("inf"),
    1e200,
    2**60,
    "",
    "256",
    [],
    [1],
    {},
    {"a": 1},
    {"300": [1]},
    (),
)


@pytest.mark.parametrize("name", SOUND)
@pytest.mark.parametrize("inner", [False, True])
def test_quick_and_slow_agree_on_whatever_stands_there(name, inner):
    assert misfit(SOUND, SHAPE, "meta") is None is first_misfit(SOUND, SHAPE, "meta")
    assert misfit(UserDict(SOUND), SHAPE) is None
    for odd in ODD:
        value = copy.copy(SOUND)
        if inner and isinstance(value[name], list):
            value[name] = [odd, *value[name][1:]]
        elif inner and isinstance(value[name], dict):
            value[name] = {**value[name], next(iter(value[name])): odd, 7: odd}
        else:
            value[name] = odd
        assert misfit(value, SHAPE, "meta") == first_misfit(value, SHAPE, "meta"), (name, odd)
    del value[name]
    assert misfit(value, SHAPE, "meta") == first_misfit(value, SHAPE, "meta")


@pytest.mark.parametrize("value", [np.float64(1.0), np.int64(1), float("nan"), "1", None])
def test_a_kind_alone(value):
    for kind in (COUNT, NUMBER, TEXT, shapes.ANY, Maybe(NUMBER)):
        assert misfit(value, kind) == first_misfit(value, kind, "")
