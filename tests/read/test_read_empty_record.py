"""A record of extra bytes that is empty ends a process inside LASzip: readers and writers hide it from it."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pytest

CODE = "from fwclass.cli import main; main()"
EXTRA_BYTES = struct.pack("<H16sHH32s", 0, b"LASF_Spec", 4, 0, b"")


def with_empty_record(path: Path) -> Path:
    """The file with such a record behind its header."""
    data = bytearray(path.read_bytes())
    (size,), (start, records) = struct.unpack_from("<H", data, 94), struct.unpack_from("<II", data, 96)
    struct.pack_into("<II", data, 96, start + len(EXTRA_BYTES), records + 1)
    path.write_bytes(data[:size] + EXTRA_BYTES + data[size:])
    return path


@pytest.mark.parametrize("point_format", [9, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 4, 6))])
def test_is_copied_and_read_with_all_else(tmp_path: Path, point_format: int) -> None:
    r = np.random.default_rng(0)
    xyz = np.c_[500_000 + r.uniform(0, 10, (40, 2)), 100 + r.random(40)]
    source = tmp_path / "a.las"
    lasmaker.write_las(source, xyz, point_format=point_format)
    with_empty_record(source)
    before = source.read_bytes()
    for name, again in (("a.las", "b.laz"), ("b.laz", "c.laz")):
        for words in (["info", name], ["normalize", name, again, "--method", "slope"]):
            ended = subprocess.run([sys.executable, "-c", CODE, *words], cwd=tmp_path, capture_output=True, text=True)
            assert ended.returncode == 0, ended.stderr
        assert EXTRA_BYTES in (tmp_path / again).read_bytes()
        assert len(laspy.read(tmp_path / again).points) == 40
    assert source.read_bytes() == before
