"""Pulses that point to the waves of others, and times of the way there alone: what pulses and header state tells."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from lasmaker import METRES_PER_NS
from plsmaker import Pulse, survey, write_pls

from fwclass.errors import InputError
from fwclass.read.beams import check_beams
from fwclass.read.pls_info import pulse_info
from fwclass.read.pls_read import check_pls
from fwclass.read.pulsewaves import PulseSource, open_pls


def file(folder: Path, pulses: int = 120) -> Path:
    return survey(folder / "a.pls", pulses, two_segments=0.3).path


def records(path: Path) -> tuple[bytearray, int]:
    raw = bytearray(path.read_bytes())
    return raw, struct.unpack_from("<q", raw, 176)[0]


def rewrite(path: Path, change) -> PulseSource:
    """The file with its pulses, as rows of 48 bytes, changed."""
    raw, start = records(path)
    rows = np.frombuffer(bytes(raw[start:]), np.uint8).reshape(-1, 48).copy()
    change(rows)
    path.write_bytes(bytes(raw[:start]) + rows.tobytes())
    return open_pls(path)


def of_neighbours(rows) -> None:
    rows[:, 8:16] = np.roll(rows[:, 8:16], 40, axis=0)


def shuffled(rows) -> None:
    rows[:, 8:16] = rows[np.random.default_rng(3).permutation(len(rows)), 8:16]


def unstated(rows) -> None:
    rows[:, 40:44] = 0


def shuffled_and_unstated(rows) -> None:
    shuffled(rows)
    unstated(rows)


@pytest.mark.parametrize("change", [of_neighbours, shuffled])
def test_waves_of_other_pulses_are_refused(tmp_path: Path, change) -> None:
    source = rewrite(file(tmp_path), change)
    with pytest.raises(InputError, match="do not fit each other") as refused:
        check_pls(source)
    assert "those of other pulses" in str(refused.value)
    assert any("those of other pulses" in fault for fault in pulse_info(source)["faults"])


@pytest.mark.parametrize("change", [lambda rows: None, unstated, shuffled_and_unstated])
def test_sound_files_and_those_that_state_nothing_are_read(tmp_path: Path, change) -> None:
    check_pls(rewrite(file(tmp_path), change))


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("stated", [True, False])
def test_times_of_the_way_there_alone_are_refused(tmp_path: Path, factor: float, stated: bool) -> None:
    """The scale of the durations is `factor` of what it was; what the pulses state, or else the header, stays."""
    path = file(tmp_path)
    raw, start = records(path)
    old, new = struct.pack("<ff", 1.0, 0.0), struct.pack("<ff", factor, 0.0)
    at = raw.rfind(old, 0, raw.rfind(old, 0, start))  # behind it in the last record: the spacing, no compression
    raw[at : at + 8] = new
    path.write_bytes(raw)
    source = rewrite(path, (lambda rows: None) if stated else unstated)
    with pytest.raises(InputError, match="do not fit each other") as refused:
        check_pls(source)
    assert "one way, or another unit" in str(refused.value)


def oblong(folder: Path, pulses: int = 120) -> Path:
    """Beams that look ahead, along x, and a little to both sides."""
    rng = np.random.default_rng(5)
    wave = np.clip(10.0 + 90.0 * np.exp(-0.5 * ((np.arange(60) - 20.0) / 2.0) ** 2), 0, 255).astype(np.uint8)
    made = []
    for p in range(pulses):
        away = np.array([0.3, rng.uniform(-0.05, 0.05), -1.0])
        begin = float(np.floor(600.0 * np.linalg.norm(away) / METRES_PER_NS - 20.0))
        made.append(Pulse([500000.0 + 0.5 * p, 5400000.0, 800.0], away, [[(begin, wave)]], time=1000.0 + 1e-5 * p))
    return write_pls(folder / "o.pls", made)


def columns(rows) -> np.ndarray:
    """Anchors and targets of the pulses, int32 (n, 6), to be changed in place."""
    return rows[:, 16:40].view("<i4")


def exchanged(rows) -> None:
    xyz = columns(rows)
    xyz[:] = xyz[:, [1, 0, 2, 4, 3, 5]]


def beams_exchanged(rows) -> None:
    xyz = columns(rows)
    away = xyz[:, 3:] - xyz[:, :3]
    xyz[:, 3:] = xyz[:, :3] + away[:, [1, 0, 2]]


def beams_of_another_sign(rows) -> None:
    xyz = columns(rows)
    xyz[:, 3] = 2 * xyz[:, 0] - xyz[:, 3]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (exchanged, "x and y of the pulses are exchanged"),
        (beams_exchanged, "x and y of the beams are exchanged"),
        (beams_of_another_sign, "the sign of the beams' x is wrong"),
    ],
)
@pytest.mark.parametrize("stated", [True, False])
def test_axes_that_the_header_contradicts_are_refused(tmp_path: Path, change, words: str, stated: bool) -> None:
    """Anchors at the sensor: beams meet there whatever their axes."""
    path = oblong(tmp_path)
    if change is exchanged:  # of whole coordinates, not of those less the header's offsets
        raw, _ = records(path)
        raw[280:296] = raw[288:296] + raw[280:288]
        path.write_bytes(raw)
    source = rewrite(path, lambda rows: (change(rows), None if stated else unstated(rows)))
    with pytest.raises(InputError, match="do not fit each other") as refused:
        check_pls(source)
    assert words in str(refused.value) and any(words in fault for fault in pulse_info(source)["faults"])


def test_a_header_that_no_axes_fit_says_nothing(tmp_path: Path) -> None:
    path = oblong(tmp_path)
    raw, _ = records(path)
    raw[304:352] = struct.pack("<6d", *(0.0, 1.0) * 3)
    path.write_bytes(raw)
    check_pls(rewrite(path, unstated))


@pytest.mark.parametrize(("spacing", "words"), [(2.0, "last 2 times as long"), (0.5, "last 0.5 times as long")])
def test_a_sample_spacing_that_stated_times_contradict_is_refused(tmp_path: Path, spacing: float, words: str) -> None:
    path = survey(tmp_path / "a.pls", 120, two_segments=0.0).path
    raw, start = records(path)
    at = raw.rfind(struct.pack("<f", 1.0), 0, start)
    raw[at : at + 4] = struct.pack("<f", spacing)
    path.write_bytes(raw)
    with pytest.raises(InputError, match="do not fit each other") as refused:
        check_pls(open_pls(path))
    assert words in str(refused.value)
    check_pls(rewrite(path, unstated))  # nothing tells


@pytest.mark.parametrize("speed", [0.8, 1.02, 1.3])
def test_beams_that_are_not_as_fast_as_light_are_refused(tmp_path: Path, speed: float) -> None:
    """Anchors at the sensor: all places were off by as much of the flying height, in silence."""
    path = oblong(tmp_path)

    def stretch(rows) -> None:
        xyz = columns(rows)
        xyz[:, 3:] = xyz[:, :3] + np.rint((xyz[:, 3:] - xyz[:, :3]) * speed).astype(np.int32)

    with pytest.raises(InputError, match=f"{speed:g} times light's way"):
        check_beams(rewrite(path, stretch))
    check_beams(rewrite(oblong(tmp_path), lambda rows: None))
