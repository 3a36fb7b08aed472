"""A file whose two records of a coordinate system contradict each other: its header says which counts; it is told."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import lasmaker
import numpy as np
import pytest
from commandline import fwclass
from pyproj import CRS

KEYS, WKT = 32633, 32632
"""UTM zones 33 and 32: the middle of both is at 500 km."""


@pytest.mark.parametrize(("bit", "keys", "code"), [(16, KEYS, WKT), (0, KEYS, KEYS), (16, WKT, WKT), (16, None, WKT)])
def test_two_systems_are_told(tmp_path: Path, bit: int, keys: int | None, code: int) -> None:
    rng, n = np.random.default_rng(1), 2000
    xyz = np.c_[500_000 + rng.uniform(0, 40, n), 5_400_000 + rng.uniform(0, 40, n), rng.uniform(200, 201, n)]
    wkt = CRS.from_epsg(WKT).to_wkt("WKT1_GDAL")
    codes = {3072: keys} if keys else None
    path = lasmaker.write_las(tmp_path / "a.las", xyz, point_format=6, wkt=wkt, keys=codes, classification=2)
    data = bytearray(path.read_bytes())
    struct.pack_into("<H", data, 6, struct.unpack_from("<H", data, 6)[0] & ~16 | bit)
    path.write_bytes(data)
    info = json.loads(fwclass("info", path, "--json").stdout)
    assert info["crs"]["epsg"] == code
    told = "the file names two coordinate systems, "
    assert any(told in f for f in info["faults"]) == (keys == KEYS)
    (tmp_path / "s.yaml").write_text('survey: {name: z, sources: ["*.las"], reference: {kind: none}}\n')
    ended = fwclass("run", tmp_path / "s.yaml", "--workflow", "ground", "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 0 and (told in ended.stderr) == (keys == KEYS), ended.stderr
    for command in ("ground", "normalize", "features", "decompose") if bit and keys == KEYS else ():
        output = tmp_path / f"{command}.{'parquet' if command == 'features' else 'laz'}"
        ended = fwclass(command, path, output)
        assert told in ended.stdout + ended.stderr, (command, ended.stdout, ended.stderr)
    ended = fwclass("ground", path, tmp_path / "named.laz", "--crs", f"EPSG:{code}")
    assert ended.returncode == 0 and told not in ended.stdout + ended.stderr
