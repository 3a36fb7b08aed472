"""Records of one length whose digitiser stopped earlier, and wrote zeros from there on."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass
from rawmaker import scene, write_parquet

from fwclass.read.stage import PADDED, without_padding
from fwclass.schema import Table
from fwclass.waveforms import RETURN_COLUMNS, Waveforms

HEAD = {"crs": "EPSG:32632", "spacing_ns": "1.0"}


def test_zeros_behind_the_last_sample_change_nothing(tmp_path: Path) -> None:
    """They were taken for a receiver whose level was cut off: 66 % false echoes, exit code 4."""
    columns, made = scene(pulses=600, n=80).columns(at="sensor"), []
    ends = np.random.default_rng(1).integers(45, 60, 600)
    short = [s[:n] for s, n in zip(columns["samples"], ends, strict=True)]
    for samples in (short, [np.pad(s, (0, 80 - len(s))) for s in short]):
        write_parquet(tmp_path / "a.parquet", columns | {"samples": samples}, HEAD)
        ended = fwclass("decompose", tmp_path / "a.parquet", tmp_path / "a.laz", "--overwrite")
        assert ended.returncode == 0, ended.stderr
        made.append(laspy.read(tmp_path / "a.laz").points.array)
        assert (f"{PADDED}: 600" in ended.stderr) == (len(made) == 2), ended.stderr
    for name in made[0].dtype.names:
        np.testing.assert_array_equal(made[0][name], made[1][name], err_msg=name)


@pytest.mark.parametrize(
    ("samples", "kept"),
    [
        ([20, 21, 80, 20, 0, 0, 0, 0, 0], 4),
        ([20, 21, 80, 20, 0, 0, 0], 7),
        ([1, 3, 80, 20, 0, 0, 0, 0, 0], 9),
        ([20, 0, 80, 20, 0, 0, 0, 0, 0], 9),
        ([0] * 9, 9),
    ],
)
def test_what_is_padding(samples: list[int], kept: int) -> None:
    values = np.array([*samples, 7, 8, 9, 10, 11], np.uint8)
    rows = Table({"pulse": np.arange(2)})
    waves = Waveforms(rows, Table.empty(RETURN_COLUMNS), values, np.array([0, len(samples), len(values)]))
    cut = without_padding(waves)
    assert cut.samples.tolist() == [*samples[:kept], 7, 8, 9, 10, 11] and cut.offsets.tolist() == [0, kept, kept + 5]
    assert cut.faults == ({PADDED: 1} if kept < len(samples) else {})
