"""Pulses that point to the waves of others, and times of the way there alone: what pulses and header state tells."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from plsmaker import survey

from fwclass.errors import InputError
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
