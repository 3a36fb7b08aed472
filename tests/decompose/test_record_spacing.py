"""How far apart samples are, asked of ground under records that begin earlier or later: told, and never made up."""

from __future__ import annotations

import re

import laspy
import numpy as np
import pytest
from rawmaker import HALF_LIGHT, scene, write_parquet

from fwclass.single_file.decompose import decompose_file

PULSES, LEVEL = 1500, 12.0


def words_of(tmp_path, begins, spacing=1.0, rough=0.03, named=None):
    """What is told of ground that is `rough` [m] under records that begin, by `begins` of the ways to it [ns], so long
    before; and how far the echoes lie off (median) [m]."""
    truth, rng = scene(pulses=PULSES, seed=7), np.random.default_rng(8)
    place = truth.place + rng.normal(0.0, rough, PULSES)[:, None] * truth.away
    way = ((place - truth.origin) * truth.away).sum(axis=1) / HALF_LIGHT
    begin = begins(way, rng)
    t = np.arange(100) * spacing
    height = rng.uniform(60.0, 120.0, PULSES)[:, None]
    pulse = height * np.exp(-0.5 * ((t + begin[:, None] - way[:, None]) / 2.0) ** 2)
    samples = np.rint(LEVEL + pulse + rng.normal(0.0, 1.0, pulse.shape)).clip(0, 255).astype(np.uint16)
    columns = {**truth.columns(), "samples": list(samples), "begin_ns": begin, "range_m": np.zeros(PULSES)}
    columns |= dict(zip("xyz", truth.origin.T, strict=True))
    names = {"crs": "EPSG:25832", "spacing_ns": str(spacing if named is None else named)}
    words, _ = decompose_file(write_parquet(tmp_path / "a.parquet", columns, names), tmp_path / "a.laz", (), True)
    las = laspy.read(tmp_path / "a.laz")
    at = np.rint((np.asarray(las.gps_time) - 1000.0) / 1e-5).astype(int)
    return words, float(np.median(np.linalg.norm(np.c_[las.x, las.y, las.z] - place[at], axis=1)))


def gate(way, rng):
    return np.floor((way - 25.0) / 16.0) * 16.0


def jitter(way, rng):
    return way - 30.0 - rng.uniform(0.0, 2.0, len(way))


def before(way, rng):
    """As long before the echo of the pulse before as ever."""
    return np.roll(way, 1).clip(way - 40.0, way - 20.0) - 10.0


def four_before(way, rng):
    return np.convolve(np.concatenate([way[:4], way])[:-1], np.full(4, 0.25), "valid")[: len(way)] - 25.0


@pytest.mark.parametrize("begins", [gate, jitter])
@pytest.mark.parametrize("share", [0.5, 2.0])
def test_another_spacing_than_the_true_one_is_told(tmp_path, begins, share):
    words, off = words_of(tmp_path, begins, rough=0.015, named=share)
    ratio = re.search(r"samples are ([0-9.]+) times as far apart as the file says", words)
    assert ratio and float(ratio[1]) == pytest.approx(1.0 / share, rel=0.05), words
    assert off > 1.0


@pytest.mark.parametrize(
    "begins", [gate, jitter, before, four_before, lambda way, rng: np.full(PULSES, way.min() - 20.0)]
)
@pytest.mark.parametrize("rough", [0.0, 0.03, 0.5])
def test_the_true_one_is_not(tmp_path, begins, rough):
    """Records may begin as the ground of pulses before them has it, too."""
    words, off = words_of(tmp_path, begins, rough=rough)
    assert "times as far apart" not in words and off < 0.02
