"""Files of a converter of 2013 that took outgoing samples of 8 bits for such of 16: half of what it wrote for them are
the first returning samples, and what it wrote for these ends with the outgoing ones of the next pulse."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from plsmaker import OUTGOING, Descriptor, Sampling, Truth, run_together, survey
from plzmaker import compress

from fwclass.read import pls_read
from fwclass.read.pls_read import RUN_TOGETHER, index_pls, read_pls
from fwclass.read.pulsewaves import open_pls


def file(folder: Path, pulses: int = 50) -> Truth:
    return survey(folder / "a.pls", pulses, bits=16, two_segments=0.0)


@pytest.mark.parametrize("chunk", [50, 7])
def test_they_are_taken_apart_however_the_file_is_cut(tmp_path: Path, chunk: int) -> None:
    truth = file(tmp_path)
    run_together(truth.path)
    source = open_pls(truth.path)
    read = [read_pls(source, span) for span in index_pls(source, chunk)]
    wanted = [pulse.waves[1][0][1] for pulse in truth.pulses]
    assert np.array_equal(np.concatenate([w.samples for w in read]), np.concatenate(wanted))
    sent = [np.asarray(pulse.waves[0][0][1]) for pulse in truth.pulses]
    assert np.array_equal(np.concatenate([w.outgoing for w in read]), np.concatenate(sent))
    assert sum(w.faults[RUN_TOGETHER] for w in read) == len(truth.pulses)


def test_compressed_ones_too(tmp_path: Path) -> None:
    truth = file(tmp_path)
    run_together(truth.path)
    sent = Sampling(OUTGOING, bits=16, length_bits=0, samples=20, segment_bits=0, segments=1)
    packed = compress(truth.path, {1: Descriptor([sent, Sampling(bits=16)])})
    source = open_pls(packed)
    assert source.packed
    read = [read_pls(source, span) for span in index_pls(source, 20)]
    assert np.array_equal(
        np.concatenate([w.samples for w in read]), np.concatenate([p.waves[1][0][1] for p in truth.pulses])
    )


def test_a_file_is_asked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth, asked = file(tmp_path), []
    run_together(truth.path)
    known = pls_read._runs_on
    monkeypatch.setattr(pls_read, "_runs_on", lambda *words: asked.append(1) or known(*words))
    source = open_pls(truth.path)
    assert all(RUN_TOGETHER in read_pls(source, span).faults for span in index_pls(source, 7)) and len(asked) == 1
    time = truth.path.stat().st_mtime_ns
    survey(truth.path, 50, bits=16, two_segments=0.0)
    os.utime(truth.path, ns=(time + 1, time + 1))
    assert RUN_TOGETHER not in read_pls(open_pls(truth.path), index_pls(source, 50)[0]).faults


def test_sound_files_are_read_as_they_are(tmp_path: Path) -> None:
    truth = file(tmp_path)
    source = open_pls(truth.path)
    read = read_pls(source, index_pls(source, 50)[0])
    assert RUN_TOGETHER not in read.faults
    assert np.array_equal(read.samples, np.concatenate([pulse.waves[1][0][1] for pulse in truth.pulses]))
