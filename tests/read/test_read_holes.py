"""Holes of zeros, as a copy that broke off leaves them, are refused or said; sound files with many zeros are not."""

from __future__ import annotations

import lasmaker
import laspy
import numpy as np
import pytest
from commandline import fwclass

from fwclass.errors import InputError
from fwclass.formats.checks import SECTOR, first_hole
from fwclass.read.info import info
from fwclass.read.points import PointReader
from fwclass.read.source import open_source


def laz(path, n=40_000, point_format=6, kind="varied", extra=0, seed=0, backend=laspy.LazBackend.Lazrs):
    """A LAZ file whose points are `varied`, or all the `same`, or hold `few` changes."""
    rng = np.random.default_rng(seed)
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales = [0.001] * 3
    header.add_extra_dims([laspy.ExtraBytesParams(f"e{k}", "f4") for k in range(extra)])
    las = laspy.LasData(header)
    values = {
        "varied": rng.uniform(0, 100, n),
        "same": np.full(n, 5e5),
        "few": np.repeat(rng.uniform(0, 9, n // 100), 100),
    }
    las.x, las.y, las.z = values[kind], np.zeros(n), values[kind] % 7
    las.intensity = rng.integers(1, 900, n) if kind == "varied" else np.zeros(n)
    las.write(path, laz_backend=backend)
    return path


def read_all(path):
    source = open_source(path)
    with PointReader(source) as reader:
        return sum(len(points) for _, points in reader.blocks())


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("point_format", [0, 3, 6, 7])
def test_a_hole_of_a_page_in_a_laz_is_refused(tmp_path, point_format, share):
    """LAZ has no checksum: in a layer of format 6 it decompresses to heights of thousands of kilometres."""
    path = laz(tmp_path / "a.laz", point_format=point_format)
    whole = bytearray(path.read_bytes())
    begin = int(share * len(whole)) - 2048
    whole[begin : begin + 4096] = bytes(4096)
    path.write_bytes(whole)
    with pytest.raises(InputError):
        read_all(path)


@pytest.mark.parametrize("backend", [laspy.LazBackend.Lazrs, laspy.LazBackend.Laszip])
@pytest.mark.parametrize("extra", [0, 30])
@pytest.mark.parametrize("kind", ["varied", "same", "few"])
@pytest.mark.parametrize("point_format", [0, 3, 6, 7])
def test_points_that_hardly_change_are_no_hole(tmp_path, point_format, kind, extra, backend):
    assert read_all(laz(tmp_path / "a.laz", 20_000, point_format, kind, extra, backend=backend)) == 20_000


def test_commands_say_it(tmp_path):
    path = laz(tmp_path / "a.laz")
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 3 : len(whole) // 3 + 4096] = bytes(4096)
    path.write_bytes(whole)
    for words in (("ground", path, tmp_path / "o.laz"), ("info", path)):
        ended = fwclass(*words)
        assert ended.returncode == 1 and "a part of the file was never written" in ended.stderr


def test_info_looks_for_holes_in_packets(tmp_path):
    truth = lasmaker.survey(tmp_path / "a.las", pulses=900)
    assert truth is not None and info(tmp_path / "a.las")["faults"] == []
    packets = bytearray((tmp_path / "a.wdp").read_bytes())
    packets[9000:14000] = bytes(5000)
    (tmp_path / "a.wdp").write_bytes(packets)
    assert any("a hole of zeros in a.wdp" in fault for fault in info(tmp_path / "a.las")["faults"])


@pytest.mark.parametrize("seed", range(20))
def test_holes_are_where_they_are(tmp_path, monkeypatch, seed):
    """Against a plain search, whatever the blocks are that are read at a time."""
    rng = np.random.default_rng(seed)
    data = rng.integers(1, 255, 40_000, dtype=np.uint8)
    begin, length = int(rng.integers(0, 39_000)), int(rng.integers(1, 9000))
    data[begin : begin + length] = 0
    (tmp_path / "a").write_bytes(data.tobytes())
    start = int(rng.integers(0, 700))
    monkeypatch.setattr("fwclass.formats.checks._BLOCK", SECTOR * int(rng.integers(1, 20)))
    found = first_hole(tmp_path / "a", start, len(data))
    sectors = (data[start : start + (len(data) - start) // SECTOR * SECTOR].reshape(-1, SECTOR) == 0).all(axis=1)
    expected = next((start + SECTOR * k for k in range(len(sectors)) if sectors[k : k + 7].sum() == 7), None)
    assert found == expected
