"""Damaged chunks of a run's Zarr arrays: told, whoever asks, and never a number."""

from __future__ import annotations

import random
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from child import laid
from mutate import Files, applied, recipe
from run_cases import LINKS, _ran, is_chunk

import fwclass
from fwclass.errors import DamagedError, StoreError
from fwclass.operate.status.verify import verify
from fwclass.run.inputs import PartInputs
from fwclass.store.run_store import Store

pytestmark = pytest.mark.slow

EACH = 4
"""Kinds of damage that every chunk is tried with."""


@pytest.fixture(scope="module")
def files() -> Files:
    return _ran("grouped")


def values(root: Path, name: str) -> dict[str, np.ndarray]:
    """The arrays of the part that a chunk belongs to."""
    _, _, stage, part, _, group, *_ = name.split("/")
    return PartInputs(Store(root, read_only=True)).arrays(stage, part, group.removesuffix(".zarr"))[0]


def test_every_damaged_chunk_is_told_to_whoever_reads_it(files: Files, tmp_path: Path) -> None:
    """Bits, lengths, other chunks, nothing: one sentence with the file's name, and `status --verify` lists the part."""
    root = tmp_path / "r"
    laid(tmp_path, files, LINKS)
    chunks, rng = sorted(n for n in files if is_chunk(n)), random.Random(1)  # noqa: S311 - the same every time
    assert len(chunks) > 50 and {"read", "pulse", "terrain", "trees"} <= {n.split("/")[2] for n in chunks}
    for name in chunks:
        path, sound = tmp_path / name, files[name]
        other = files[rng.choice(chunks)]
        damaged = [applied({name: sound}, recipe({name: sound}, (), (), rng))[name] for _ in range(EACH)]
        for data in [*damaged, other, b""]:
            if data == sound:
                continue
            path.chmod(0o644)
            path.write_bytes(data)
            with pytest.raises(DamagedError, match="is not what was written") as fault:
                values(root, name)
            assert str(path) in str(fault.value)
        assert name.split("/")[2:4] in [list(d.name) for d in verify(Store(root, read_only=True)).parts]
        path.unlink()
        with pytest.raises(StoreError, match="is gone") as gone:
            values(root, name)
        assert str(path) in str(gone.value)
        path.write_bytes(sound)
    assert verify(Store(root)).sound


def test_no_waveform_of_a_damaged_chunk_is_shown(files: Files, tmp_path: Path) -> None:
    """`fwclass.open` and the viewer: the samples that were there, or words."""
    laid(tmp_path, files, LINKS)
    run = fwclass.open(tmp_path / "r")
    who = run.echoes(columns=("strip", "pulse")).to_arrow().slice(7, 1).to_pylist()[0].values()
    samples = run.waveform(*who)
    chunks = sorted(n for n in files if is_chunk(n) and n.split("/")[2] == "read")
    assert chunks
    refused = 0
    for name in chunks:
        shutil.rmtree(tmp_path)
        laid(tmp_path, files, LINKS)
        data = bytearray(files[name])
        data[-1] ^= 1
        (tmp_path / name).write_bytes(data)
        refused += same_or_refused(lambda: fwclass.open(tmp_path / "r").waveform(*who), samples)
    assert refused > 0


def same_or_refused(ask: Callable[[], object], sound: object) -> bool:
    try:
        assert repr(ask()) == repr(sound)
    except (DamagedError, StoreError) as fault:
        assert "is not what was written" in str(fault)
        return True
    return False
