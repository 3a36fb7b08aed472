"""Two digitisers in turn whose gains differ: measured, told and taken off."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from rawmaker import scene, write_parquet

from fwclass.single_file.decompose import decompose_file

PULSES, LEVEL = 1500, 12.0


def decomposed(tmp_path, change):
    """Distances of the echoes from the truth, how many are too many, parity and words."""
    truth = scene(pulses=PULSES, noise=0.7, seed=5)
    truth.samples = np.rint(change(truth.samples.astype(float))).clip(0, 255).astype(np.uint16)
    path = write_parquet(tmp_path / "a.parquet", truth.columns(), {"crs": "EPSG:25832", "spacing_ns": "1"})
    words, judged = decompose_file(path, tmp_path / "a.laz", (), True)
    las = laspy.read(tmp_path / "a.laz")
    at = np.rint((np.asarray(las.gps_time) - 1000.0) / 1e-5).astype(int)
    off = np.linalg.norm(np.c_[las.x, las.y, las.z] - truth.place[at], axis=1)
    return off, len(at) - PULSES, judged["plausibility"]["channels"][0]["parity"], words


@pytest.mark.parametrize("gain", [1.0, 1.05, pytest.param(0.9, marks=pytest.mark.slow)])
def test_gains_of_two_digitisers_in_turn_are_taken_off(tmp_path, gain):
    def change(samples):
        samples[:, 1::2] = LEVEL + gain * (samples[:, 1::2] - LEVEL)
        return samples

    off, more, parity, words = decomposed(tmp_path, change)
    assert more <= 0.005 * PULSES and np.median(off) < 0.01
    assert ("digitisers in turn" in words) == (gain != 1.0), words
    assert parity == pytest.approx((1.0 - gain) / (1.0 + gain), abs=0.004)


@pytest.mark.parametrize(("first", "second"), [pytest.param(1.1, 0.9, marks=pytest.mark.slow), (1.1, 1.0), (1.0, 1.0)])
def test_gains_that_change_along_the_strip_are_told(tmp_path, first, second):
    """As in a file joined of two receivers': one ratio for all of it is none, and makes false echoes."""

    def change(samples):
        gain = np.repeat([first, second], [PULSES // 2, PULSES - PULSES // 2])[:, None]
        samples[:, 1::2] = LEVEL + gain * (samples[:, 1::2] - LEVEL)
        return samples

    *_, words = decomposed(tmp_path, change)
    assert ("joined of two receivers'" in words) == (first != second), words


def test_pulses_that_the_record_cuts_are_no_gain(tmp_path):
    """Records that begin two samples before the peak, or end as long behind it, as of receivers that save memory."""
    for cut in (slice(23, None), slice(None, 28)):
        *_, parity, words = decomposed(tmp_path, lambda samples, cut=cut: samples[:, cut])
        assert parity == 0.0 and "digitisers in turn" not in words, (cut, parity)


def test_gains_that_change_sides_from_pulse_to_pulse_are_not(tmp_path):
    """Nothing tells then which sample is whose: they stay as they are."""

    def change(samples):
        side = np.random.default_rng(2).integers(0, 2, len(samples))
        odd = (np.arange(samples.shape[1]) + side[:, None]) % 2 == 1
        return np.where(odd, LEVEL + 1.05 * (samples - LEVEL), samples)

    assert decomposed(tmp_path, change)[2] == 0.0


def test_waveforms_of_one_sample_among_others_are_passed_over(tmp_path):
    truth = scene(pulses=PULSES, noise=0.7, seed=5)
    columns = truth.columns()
    columns["samples"] = [s[:1] if k % 10 == 0 else s for k, s in enumerate(columns["samples"])]
    path = write_parquet(tmp_path / "a.parquet", columns, {"crs": "EPSG:25832", "spacing_ns": "1"})
    _, judged = decompose_file(path, tmp_path / "a.laz", (), True)
    assert judged["plausibility"]["channels"][0]["parity"] == 0.0
