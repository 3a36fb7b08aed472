"""A file whose two records of a coordinate system contradict each other: its header says which counts; it is told."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import lasmaker
import numpy as np
import pytest
import rasterio
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


FALSE = CRS.from_epsg(WKT).to_wkt("WKT1_GDAL").replace(f'"{WKT}"', f'"{KEYS}"')


@pytest.mark.parametrize(
    ("named", "told"),
    [
        ({"wkt": FALSE, "keys": None}, "zone 33N by EPSG:32633"),
        ({"wkt": CRS.from_epsg(WKT).to_wkt("WKT1_GDAL"), "keys": None}, ""),
        ({"keys": {3072: WKT, 3076: 9003}}, "one in US survey foot by its key of units"),
        ({"keys": {3072: WKT, 3076: 9001}}, ""),
        ({"keys": {3072: WKT}, "citations": "WGS 84 / UTM zone 33N|"}, "zone 33N by its citation"),
        ({"keys": {3072: WKT}, "citations": "WGS 84 / UTM zone 32N|WGS 84|"}, ""),
    ],
)
def test_a_code_that_is_another_systems_is_told(tmp_path: Path, named: dict, told: str) -> None:
    """GDAL went by the code, and laid the rasters into the next zone, in silence."""
    rng, n = np.random.default_rng(1), 2000
    xyz = np.c_[500_000 + rng.uniform(0, 40, n), 5_400_000 + rng.uniform(0, 40, n), rng.uniform(200, 201, n)]
    path = lasmaker.write_las(tmp_path / "a.las", xyz, point_format=6, classification=2, **named)
    info = json.loads(fwclass("info", path, "--json").stdout)
    assert info["crs"]["epsg"] == WKT and told in " ".join(info["faults"])
    assert any("two coordinate systems" in fault for fault in info["faults"]) == bool(told)
    (tmp_path / "s.yaml").write_text('survey: {name: z, sources: ["*.las"], reference: {kind: none}}\n')
    run = tmp_path / "r"
    ended = fwclass("run", tmp_path / "s.yaml", "--workflow", "ground", "--out", run, "--workers", 0)
    assert ended.returncode == 0 and told in ended.stderr, ended.stderr
    assert ("two coordinate systems" in ended.stderr) == bool(told)
    with rasterio.open(run / "rasters" / "dtm.tif") as file:
        assert CRS.from_wkt(file.crs.to_wkt()).to_epsg() == WKT
    fwclass("ground", path, tmp_path / "g.laz", "--dtm", tmp_path / "g.tif")
    with rasterio.open(tmp_path / "g.tif") as file:
        assert CRS.from_wkt(file.crs.to_wkt()).to_epsg() == WKT


def test_words_of_the_users_own(tmp_path: Path) -> None:
    xyz = np.c_[np.full(9, 5e5), np.full(9, 5.4e6), np.arange(9.0)]
    path = lasmaker.write_las(tmp_path / "a.las", xyz, point_format=6, keys=None)
    ended = fwclass("ground", path, tmp_path / "g.laz", "--crs", FALSE)
    assert ended.returncode == 2 and "the text names two coordinate systems" in ended.stderr, ended.stderr
