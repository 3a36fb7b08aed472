"""A tile's LAZ, read by two other programs."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest
from tolerances import COORDINATE

from fwclass.errors import InputError
from fwclass.formats.extra_bytes import description
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.params import PublishParams
from fwclass.schema import COLUMNS, Table, column

BACKENDS = [laspy.LazBackend.Lazrs, laspy.LazBackend.Laszip]


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_field_comes_back(
    backend: laspy.LazBackend, echoes: Callable[..., Table], params: PublishParams, tmp_path: Path
) -> None:
    table = echoes()
    made = write_tile_laz(table, tmp_path / "t.laz", pyproj.CRS(2154), params)
    las = laspy.read(made["path"], laz_backend=backend)
    for name in ("x", "y", "z"):
        assert np.array_equal(np.rint(las[name] * 1000), np.rint(table[name] * 1000))
    assert np.array_equal(las.return_number, table["echo_number"])
    assert np.array_equal(las.number_of_returns, table["number_of_echoes"])
    assert np.array_equal(las.classification, table["classification"])
    assert np.array_equal(las.intensity, table["intensity"])
    assert np.array_equal(las.point_source_id, table["strip"])
    assert np.array_equal(las.gps_time, np.nan_to_num(table["gps_time"]))
    names = {
        "pulse": "pulse",
        "amplitude DN": "amplitude",
        "echo ratio r100": "echo_ratio_r100",
        "HeightAboveGround": "height_above_ground",
        "confidence": "confidence",
    }
    assert list(las.point_format.extra_dimension_names) == list(names)
    for las_name, name in names.items():
        col, got = column(name), np.asarray(las[las_name], np.float64)
        known = np.isfinite(table[name])
        step = col.las_scale / 2 if col.las_dtype else 0.0
        assert (np.abs(got[known] - table[name][known]) <= step * 1.0001).all(), name
    assert made["without_time"] == np.isnan(table["gps_time"]).sum() > 0


def test_header_says_what_the_points_say(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    table = echoes()
    write_tile_laz(table, tmp_path / "t.laz", pyproj.CRS(2154), params)
    raw = (tmp_path / "t.laz").read_bytes()
    assert raw[24:26] == b"\x01\x04" and raw[104] == 6 | 0x80
    assert struct.unpack_from("<HH", raw, 90) == (0, 0), "no creation date: it would be a wall clock"
    assert raw[26:90] == b"fwclass".ljust(32, b"\0") * 2
    head = laspy.open(tmp_path / "t.laz").header
    assert head.parse_crs().to_epsg() == 2154 and head.global_encoding.wkt
    assert head.point_count == table.rows
    assert np.array_equal(head.number_of_points_by_return, np.bincount(table["echo_number"], minlength=16)[1:])
    for k, name in enumerate("xyz"):
        assert head.mins[k] == pytest.approx(table[name].min(), abs=COORDINATE)
        assert head.maxs[k] == pytest.approx(table[name].max(), abs=COORDINATE)
    extra = {d.name: d.description for d in head.point_format.extra_dimensions}
    assert extra["amplitude DN"].startswith("[DN] ")


def test_same_rows_give_same_bytes(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    table = echoes()
    small = params.model_copy(update={"chunk_points": 37})
    for name, p in (("a", params), ("b", params), ("c", small)):
        write_tile_laz(table, tmp_path / f"{name}.laz", None, p)
    a, b, c = ((tmp_path / f"{n}.laz").read_bytes() for n in "abc")
    assert a == b == c
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.laz", "b.laz", "c.laz"], "nothing is left beside"


def test_more_than_fifteen_echoes_are_clipped_and_counted(
    echoes: Callable[..., Table], params: PublishParams, tmp_path: Path
) -> None:
    table = echoes(3).with_columns({"echo_number": [1, 15, 17], "number_of_echoes": [1, 20, 20]})
    assert write_tile_laz(table, tmp_path / "t.laz", None, params)["clipped"] == 2
    las = laspy.read(tmp_path / "t.laz")
    assert list(las.return_number) == [1, 15, 15] and list(las.number_of_returns) == [1, 15, 15]


def test_an_empty_tile_is_a_readable_file(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    table = echoes(1).take(np.zeros(0, np.int64))
    assert write_tile_laz(table, tmp_path / "t.laz", None, params)["points"] == 0
    las = laspy.read(tmp_path / "t.laz")
    assert len(las.points) == 0 and "confidence" in las.point_format.extra_dimension_names
    assert las.header.parse_crs() is None


def test_what_does_not_fit_is_said(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    table = echoes(2).with_columns({"z": [0.0, 3e6]})
    with pytest.raises(InputError, match="coordinate z does not fit"):
        write_tile_laz(table, tmp_path / "t.laz", None, params)
    with pytest.raises(InputError, match="'echo_number' is missing"):
        write_tile_laz(echoes(2).select(["strip", "x"]), tmp_path / "t.laz", None, params)
    assert not list(tmp_path.iterdir())


def test_every_published_column_fits_the_descriptor() -> None:
    for col in COLUMNS.values():
        if col.las:
            assert len(f"{col.las} r1000".encode()) <= 32
            assert len(description(col).encode()) <= 32
            assert description(col).endswith(col.las_about), "the short text fits whole"
            assert not col.unit or description(col).startswith(f"[{col.unit}]")
