"""The same samples in every format: the same echoes, to what the format rounds."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from lasmaker import Descriptor as OfLas
from lasmaker import write_las
from plsmaker import Descriptor, Pulse, Sampling, write_pls
from rawmaker import HALF_LIGHT, scene, write_csv, write_parquet

from fwclass.single_file.decompose import decompose_file

PULSES, TOLD = 400, {"crs": "EPSG:32633", "spacing_ns": "1"}
OF_TABLE, OF_LAS, OF_PULSEWAVES = 0.0, 0.002, 0.004
"""m: the millimetre of places of LAS and their echoes; of PulseWaves anchor and target, 600 m from the sensor."""


def _las(path, truth, **options):
    compressed = int(path.stem == "wdz")
    return write_las(
        path,
        truth.place,
        waveforms=list(truth.samples.astype(np.uint8)),
        pulse=np.arange(PULSES),
        location=np.linalg.norm(truth.place - truth.first, axis=1) / HALF_LIGHT,
        step=-HALF_LIGHT * truth.away,
        gps_time=truth.time,
        descriptors={1: OfLas(8, truth.samples.shape[1], 1000, compressed)},
        **options,
    )


def _pls(path, truth):
    begin = np.linalg.norm(truth.first - truth.origin, axis=1) / HALF_LIGHT
    pulses = [
        Pulse(origin, away, [[(t, samples)]], time)
        for origin, away, t, samples, time in zip(
            truth.origin, truth.away, begin, truth.samples, truth.time, strict=True
        )
    ]
    return write_pls(path, pulses, {1: Descriptor([Sampling(scale=1e-4)])})


WAYS = {
    "unit.parquet": (lambda p, t: write_parquet(p, t.columns("unit", "sensor"), TOLD), OF_TABLE),
    "table.csv": (lambda p, t: write_csv(p, t.columns("sample"), TOLD), OF_TABLE),
    "external.las": (_las, OF_LAS),
    "internal.las": (lambda p, t: _las(p, t, where="internal"), OF_LAS),
    "older.las": (lambda p, t: _las(p, t, where="internal", point_format=4), OF_LAS),
    "wdz.las": (_las, OF_LAS),
    "a.pls": (_pls, OF_PULSEWAVES),
}


def echoes(path):
    """Place and height of every echo, by time and height of the place."""
    out = path.with_suffix(".out.laz")
    decompose_file(path, out, (), True)
    las = laspy.read(out)
    order = np.lexsort((las.z, np.round(np.asarray(las.gps_time), 6)))
    return np.c_[las.x, las.y, las.z][order], np.asarray(las["amplitude DN"])[order]


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A scene, and the place and height of its echoes by way of a table."""
    truth = scene(pulses=PULSES, tilt=10.0)
    return truth, *echoes(write_parquet(tmp_path_factory.mktemp("first") / "first.parquet", truth.columns(), TOLD))


REPEATED = ("table.csv", "external.las", "older.las")
"""Ways whose parts others have: the samples of a wave table, and of packets."""


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in REPEATED else n for n in WAYS])
def test_the_same_samples_give_the_same_echoes(tmp_path, first, name):
    truth, place, height = first
    write, rounded = WAYS[name]
    there, high = echoes(write(tmp_path / name, truth))
    assert len(there) == len(place) >= PULSES
    np.testing.assert_allclose(high, height, rtol=1e-6)
    assert np.abs(there - place).max() <= 0.00101 + rounded, np.abs(there - place).max()
