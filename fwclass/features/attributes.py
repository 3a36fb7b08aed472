"""What the echoes of a neighbourhood are and measured, added up for one neighbourhood at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.features.measures import Needs
from fwclass.features.moments import (
    AMPLITUDE,
    EXACT,
    HIGH,
    INTENSITY,
    LOW,
    STEP,
    WIDTH,
    ZZ,
    ZZZ,
    ZZZZ,
    N,
    add_kinds,
    add_powers,
    add_values,
    packed_kinds,
    steps,
    wide_heights,
    wide_squares,
    widen_range,
)
from fwclass.kernel import kernel
from fwclass.schema import Table


class Attributes(NamedTuple):
    """Whole numbers to add up, by row of a table; of length 0 where none are needed.

    Attributes
    ----------
    kinds : int64, see `packed_kinds`.
    amplitude, width, intensity : float64, see `steps`.
    """

    kinds: NDArray[np.int64]
    amplitude: NDArray[np.float64]
    width: NDArray[np.float64]
    intensity: NDArray[np.float64]

    @classmethod
    def of(cls, table: Table, needed: Needs) -> Attributes:
        """Attributes of the echoes of `table` as far as they are `needed`, whole numbers (echoes,); empty arrays for
        others."""
        kinds = packed_kinds(table["echo_number"], table["number_of_echoes"]) if needed.kinds else np.empty(0, np.int64)
        return cls(
            kinds,
            _steps(table, "amplitude", STEP, needed.amplitude),
            _steps(table, "width", STEP, needed.width),
            _steps(table, "intensity", 1.0, needed.intensity),
        )

    def take(self, rows: NDArray[np.integer]) -> Attributes:
        """Those of `rows`, (rows,) each; empty arrays stay empty."""
        return Attributes._make(values[rows] if len(values) else values for values in self)

    def room(self, size: int) -> Attributes:
        """New arrays (size,) for what is there, not filled; empty ones stay empty."""
        return Attributes._make(np.empty(size if len(values) else 0, values.dtype) for values in self)


def _steps(table: Table, name: str, step: float, needed: bool) -> NDArray[np.float64]:
    return np.asarray(steps(table[name], step), np.float64) if needed else np.empty(0)


@kernel
def add_attributes(kinds, amplitude, width, intensity, at, m):  # type: ignore[no-untyped-def]
    """Add what there is of `Attributes` of the echoes `at` to `m` (MOMENTS,); `at` is the whole neighbourhood."""
    if len(kinds) > 0:
        add_kinds(kinds, at, m)
    if len(amplitude) > 0:
        _add_attribute(amplitude, at, m, AMPLITUDE)
    if len(width) > 0:
        _add_attribute(width, at, m, WIDTH)
    if len(intensity) > 0:
        _add_attribute(intensity, at, m, INTENSITY)


@kernel
def _add_attribute(values, at, m, row):  # type: ignore[no-untyped-def]
    most = 0.0
    for j in at:
        size = abs(values[j])
        most = size if size > most else most
    add_values(values, at, m, row)
    if most * most * len(at) >= EXACT:
        wide_squares(values[at], m, row)


@kernel
def add_spread(z, powers, m):  # type: ignore[no-untyped-def]
    """LOW, HIGH and, with `powers`, ZZZ and ZZZZ of the relative heights `z` [mm] of a whole neighbourhood to `m`.

    N and ZZ stand already; where a sum is no longer exact it is set anew.
    """
    widen_range(z, m)
    size = max(-m[LOW], m[HIGH])
    if m[N] * size * size >= EXACT or (powers and m[N] * (size * size) * (size * size) >= EXACT):
        m[ZZ], m[ZZZ], m[ZZZZ] = 0.0, 0.0, 0.0
        wide_heights(z, m)
    elif powers:
        add_powers(z, m)
