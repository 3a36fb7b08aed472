"""Variance of a pulse's echoes: numpy's, within a reach in plan."""

from __future__ import annotations

import numpy as np
from tolerances import FLOAT32_RTOL

from fwclass import conf
from fwclass.features.pulses import pulse_variances
from fwclass.grid import Tile
from fwclass.schema import Table
from fwclass.stage import Chunk

PARAMS = conf.section("features")
BOTH = ("pulse_intensity_variance", "pulse_amplitude_variance")


def table_of(**columns):
    n = len(columns["pulse"])
    rest = {
        "strip": np.zeros(n),
        "x": np.zeros(n),
        "y": np.zeros(n),
        "intensity": np.zeros(n),
        "amplitude": np.ones(n),
        "gps_time": np.full(n, np.nan),
        "echo_number": np.ones(n, int),
        "number_of_echoes": np.ones(n, int),
    }
    return Table({**rest, **columns})


def variances(table, core=None, params=PARAMS):
    return pulse_variances(
        Chunk(table, np.arange(table.rows) if core is None else core, Tile(0, 0, 1e6)), BOTH, params.pulse_reach
    )


def test_variance_of_the_echoes_of_one_strip_and_pulse():
    rng = np.random.default_rng(1)
    n = 400
    strip, pulse = rng.integers(0, 2, n), rng.integers(0, 90, n)
    order = np.lexsort((pulse, strip))
    strip, pulse = strip[order], pulse[order]
    intensity, amplitude = rng.integers(0, 65536, n), rng.uniform(0, 200, n).astype(np.float32)
    got = variances(table_of(strip=strip, pulse=pulse, intensity=intensity, amplitude=amplitude))
    for name, values in zip(BOTH, (intensity, amplitude), strict=True):
        expected = [values[(strip == s) & (pulse == p)].astype(float).var() for s, p in zip(strip, pulse, strict=True)]
        np.testing.assert_allclose(got[name], expected, rtol=FLOAT32_RTOL, atol=1e-6)


def test_rows_in_any_order_and_a_core():
    table = table_of(pulse=[3, 1, 3, 1, 2], intensity=[10, 1, 20, 3, 9], amplitude=[1, 2, 3, 4, 5])
    got = variances(table, np.array([4, 0, 3]))
    np.testing.assert_array_equal(got[BOTH[0]], [0, 25, 1])
    np.testing.assert_array_equal(got[BOTH[1]], [0, 1, 1])


def test_one_echo_has_no_variance_and_nan_is_left_out():
    table = table_of(pulse=[0, 1, 1, 1, 2], amplitude=[7, 1, np.nan, 5, np.nan])
    np.testing.assert_array_equal(variances(table)[BOTH[1]], [0, 4, 4, 4, np.nan])


def test_echoes_beyond_the_reach_are_left_out_each_for_itself():
    """Three echoes in a row: the middle one sees both others, those at the ends only the middle."""
    reach = PARAMS.pulse_reach
    table = table_of(pulse=[0, 0, 0], x=[0, reach, 2 * reach], intensity=[0, 6, 12])
    np.testing.assert_array_equal(variances(table)[BOTH[0]], [9, 24, 9])
    further = table_of(pulse=[0, 0], y=[0, reach + 0.001], intensity=[0, 100])
    np.testing.assert_array_equal(variances(further)[BOTH[0]], 0)


def test_no_rows():
    got = variances(table_of(pulse=[]))
    assert all(len(v) == 0 for v in got.values())


def test_without_waveforms_returns_of_one_time_are_a_pulse():
    """Points of a discrete source: each is told as its own pulse, and what belongs together has one time."""
    rng = np.random.default_rng(8)
    of = rng.integers(1, 5, 300)
    time = np.repeat(rng.uniform(0, 1e6, 300), of)
    number = np.concatenate([np.arange(1, k + 1) for k in of])
    mixed = rng.permutation(len(time))
    intensity = rng.integers(0, 65536, len(time))
    place = np.repeat(rng.uniform(0, 200, 300), of)
    table = table_of(
        pulse=np.arange(len(time)),
        gps_time=time[mixed],
        echo_number=number[mixed],
        x=place[mixed],
        number_of_echoes=np.repeat(of, of)[mixed],
        intensity=intensity[mixed],
    )
    expected = [intensity[time == t].astype(float).var() for t in time[mixed]]
    np.testing.assert_allclose(variances(table)[BOTH[0]], expected, rtol=FLOAT32_RTOL)


def test_a_time_that_tells_no_pulse_gives_no_value():
    """Two second returns at one time within reach; a pulse of the same time further away is not touched by them."""
    table = table_of(
        pulse=np.arange(6),
        gps_time=np.full(6, 7.0),
        number_of_echoes=np.full(6, 3),
        echo_number=[1, 2, 2, 1, 2, 3],
        x=[0, 0, 0.5, 100, 100, 100],
        intensity=[5, 6, 7, 0, 3, 6],
    )
    np.testing.assert_array_equal(variances(table)[BOTH[0]], [np.nan, np.nan, np.nan, 6, 6, 6])


def test_a_file_of_one_time_throughout_ends_quickly():
    n = 20_000
    table = table_of(
        pulse=np.arange(n),
        gps_time=np.zeros(n),
        number_of_echoes=np.full(n, 2),
        x=np.linspace(0, 50, n),
        echo_number=np.arange(n) % 2 + 1,
    )
    assert np.isnan(variances(table)[BOTH[0]]).all()
