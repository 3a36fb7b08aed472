"""Shapes of plain data: which names a piece of JSON has, and of which kind and size what stands under them is.

A shape is a `Kind`; ``{"name": shape, "name?": shape}``, where names with a question mark may lack and others may stand
beside; ``{kind: shape}``, any names of a kind; ``[shape]``, a list of any length; ``(shape, shape)``, a list of these;
a `Maybe`, or a `Related`.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Shape = Any

LARGEST_WHOLE = 2**53
"""Larger counts are none that a computer has made."""

LARGEST = 1e100
"""Of what is computed: more than the square of any 32-bit float, and its own square and cube are numbers still."""

SHOWN = 80
"""Characters of a value that are told."""


@dataclass(frozen=True)
class Kind:
    """One value: what it is called, and what tells it."""

    called: str
    fits: Callable[[Any], bool]


@dataclass(frozen=True)
class Maybe:
    """A shape, or null."""

    shape: Shape


@dataclass(frozen=True)
class Related:
    """A shape whose parts belong to each other, as `called` says."""

    shape: Shape
    called: str
    holds: Callable[[Any], bool]


@dataclass(frozen=True)
class Misfit:
    """The place of a value that does not fit, as names and numbers with dots between; what fits there; what it is."""

    at: str
    expected: str
    got: str


def _is_whole(value: Any) -> bool:
    return type(value) is int and abs(value) <= LARGEST_WHOLE


def _is_finite(value: Any) -> bool:
    return isinstance(value, (int, float)) and type(value) is not bool and abs(value) <= sys.float_info.max


def _is_number(value: Any) -> bool:
    return _is_finite(value) and abs(value) <= LARGEST


def pattern(called: str, expression: str) -> Kind:
    """Text that all of a regular expression matches."""
    compiled = re.compile(expression)
    return Kind(called, lambda value: isinstance(value, str) and compiled.fullmatch(value) is not None)


COUNT = Kind("a count", lambda value: type(value) is int and 0 <= value <= LARGEST_WHOLE)
KEY = Kind("a whole number of 64 bits", lambda value: type(value) is int and 0 <= value < 2**64)
WHOLE = Kind("a whole number", _is_whole)
NUMBER = Kind("a number", _is_number)
FINITE = Kind("a finite number", _is_finite)
POSITIVE = Kind("a number above 0", lambda value: _is_number(value) and value > 0)
FLAG = Kind("true or false", lambda value: isinstance(value, bool))
TEXT = Kind("text", lambda value: isinstance(value, str))
ANY = Kind("anything", lambda value: True)
NUMERAL = pattern("a whole number as text", r"\d{1,15}")
CODE = Kind("a class code as text", lambda value: NUMERAL.fits(value) and int(value) <= 255)
DECIMAL = pattern("a number above 0 as text", r"(?=.*[1-9])\d{1,9}(\.\d{1,9})?")
TILE = pattern("the key of a tile, as 12_34", r"-?\d{1,15}_-?\d{1,15}")
FIGURE = Maybe(NUMBER)
PAIR = (NUMBER, NUMBER)
PLANE = (NUMBER,) * 4
REMARKS = [TEXT]
TIMES = (FINITE, FINITE)
"""First and last, as files have them, whatever they are."""


def square(shape: Shape = COUNT) -> Related:
    """A square matrix."""
    return Related([[shape]], "a square matrix", lambda rows: all(len(row) == len(rows) for row in rows))


def misfit(value: Any, shape: Shape, at: str = "") -> Misfit | None:
    """The first place where plain data are not of a shape; None where they are. NaN and infinity fit nothing."""
    return None if _test_of(shape)(value) else first_misfit(value, shape, at)


_Test = Callable[[Any], bool]
_tests: dict[int, tuple[Shape, _Test]] = {}
"""What tells whether a shape fits, by the shape's identity: most receipts are sound, and are asked for no place."""


def _test_of(shape: Shape) -> _Test:
    test = _tests.get(id(shape))
    if test is None:
        test = _tests[id(shape)] = shape, _make_test(shape)
    return test[1]


def _make_test(shape: Shape) -> _Test:
    if isinstance(shape, Maybe):
        present = _test_of(shape.shape)
        return lambda value: value is None or present(value)
    if isinstance(shape, Related):
        parts, holds = _test_of(shape.shape), shape.holds
        return lambda value: parts(value) and holds(value)
    if isinstance(shape, Kind):
        fits = shape.fits
        return (lambda value: fits(value) and not _is_nan(value)) if fits(math.nan) else fits
    if isinstance(shape, dict):
        return _test_of_object(shape)
    tests = [_test_of(one) for one in shape]
    if isinstance(shape, tuple):
        return lambda value: (
            _is_list(value) and len(value) == len(tests) and all(fits(v) for fits, v in zip(tests, value, strict=True))
        )
    (each,) = tests
    return lambda value: _is_list(value) and all(map(each, value))


def _test_of_object(shape: Mapping[Any, Shape]) -> _Test:
    names = [(n.removesuffix("?"), n.endswith("?"), _test_of(one)) for n, one in shape.items() if isinstance(n, str)]
    kinds = [(None if n is TEXT else n.fits, _test_of(one)) for n, one in shape.items() if isinstance(n, Kind)]

    def test(value: Any) -> bool:
        if type(value) is not dict and not isinstance(value, Mapping):
            return False
        for name, may_lack, fits in names:
            if name not in value:
                if not may_lack:
                    return False
            elif not fits(value[name]):
                return False
        return all(
            (is_key is None or all(is_key(str(key)) for key in value)) and all(map(fits, value.values()))
            for is_key, fits in kinds
        )

    return test


def _is_list(value: Any) -> bool:
    return type(value) is list or (isinstance(value, Sequence) and not isinstance(value, str))


def first_misfit(value: Any, shape: Shape, at: str) -> Misfit | None:
    """As `misfit`, place by place."""
    if isinstance(shape, Maybe):
        return None if value is None else first_misfit(value, shape.shape, at)
    if isinstance(shape, Related):
        wrong = first_misfit(value, shape.shape, at)
        return wrong or (None if shape.holds(value) else _wrong(value, shape.called, at))
    if isinstance(shape, Kind):
        return None if shape.fits(value) and not _is_nan(value) else _wrong(value, shape.called, at)
    if isinstance(shape, dict):
        return _in_object(value, shape, at) if isinstance(value, Mapping) else _wrong(value, "an object", at)
    if not _is_list(value):
        return _wrong(value, "a list", at)
    if isinstance(shape, tuple) and len(value) != len(shape):
        return _wrong(value, f"a list of {len(shape)}", at)
    each = shape if isinstance(shape, tuple) else shape * len(value)
    inside = (first_misfit(v, s, f"{at}.{k}") for k, (v, s) in enumerate(zip(value, each, strict=True)))
    return next((wrong for wrong in inside if wrong), None)


def _in_object(value: Mapping[Any, Any], shape: Mapping[Any, Shape], at: str) -> Misfit | None:
    for name, one in shape.items():
        if isinstance(name, Kind):
            for key, own in value.items():
                wrong = first_misfit(str(key), name, f"{at}.{key}") or first_misfit(own, one, f"{at}.{key}")
                if wrong:
                    return wrong
        elif name.removesuffix("?") in value:
            wrong = first_misfit(value[name.removesuffix("?")], one, f"{at}.{name.removesuffix('?')}")
            if wrong:
                return wrong
        elif not name.endswith("?"):
            return Misfit(f"{at}.{name}", "to be there", f"only {', '.join(map(str, value))[:SHOWN] or 'nothing'}")
    return None


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _wrong(value: Any, expected: str, at: str) -> Misfit:
    shown = repr(value)
    return Misfit(at, expected, shown if len(shown) <= SHOWN else f"{shown[:SHOWN]}…")
