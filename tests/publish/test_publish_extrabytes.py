"""Extra bytes: scaled whole types, no-data numbers, extremes and unique names, read back by another program."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from fwclass.columns import COLUMNS, PER_CODE
from fwclass.formats.extra_bytes import descriptor, extra_bytes, free_name, pack_columns, published_columns
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.params import PublishParams
from fwclass.publish.strips import write_strip_laz
from fwclass.schema import Table, column

BACKENDS = [laspy.LazBackend.Lazrs, laspy.LazBackend.Laszip]
INT16_NONE, UINT16_NONE = -32768, 65535


def radiometric(echoes: Callable[..., Table], n: int = 400, seed: int = 5) -> Table:
    """Echoes with the columns that are stored as scaled whole numbers, some without a value."""
    rng = np.random.default_rng(seed)
    gap = rng.random((3, n)) < 0.15
    return echoes(n).with_columns(
        {
            "amplitude_db": np.where(gap[0], np.nan, rng.uniform(-10, 50, n)),
            "reflectance": np.where(gap[1], np.nan, rng.uniform(-30, 5, n)),
            "deviation": np.where(gap[2], np.nan, rng.uniform(0, 900, n)),
            "width": rng.uniform(3, 9, n),
            "cross_section": rng.uniform(0, 2, n),
            "radiometry_flags": rng.integers(0, 64, n),
        }
    )


@pytest.mark.parametrize("backend", BACKENDS)
def test_another_reader_sees_the_values(
    backend: laspy.LazBackend, echoes: Callable[..., Table], params: PublishParams, tmp_path: Path
) -> None:
    table = radiometric(echoes)
    write_tile_laz(table, tmp_path / "t.laz", None, params)
    las = laspy.read(tmp_path / "t.laz", laz_backend=backend)
    whole = {"Amplitude": ("amplitude_db", 0.01), "Reflectance": ("reflectance", 0.01), "Deviation": ("deviation", 1.0)}
    for las_name, (name, scale) in whole.items():
        known = np.isfinite(table[name])
        assert 0 < known.sum() < table.rows
        got = np.asarray(las[las_name], float)
        half = scale / 2 + 4e-6 * np.abs(table[name][known])  # half a step, and float32's own rounding
        assert (np.abs(got[known] - table[name][known].astype(float)) <= half).all(), (
            "nearest step, as the reader scales"
        )
        none = UINT16_NONE if las_name == "Deviation" else INT16_NONE * scale
        assert np.allclose(got[~known], none), "the no-data number, never 0"
    assert np.abs(las["echo width"] - table["width"]).max() <= 0.005001
    assert las["echo ratio r100"].dtype == np.float32 and np.array_equal(
        las["echo ratio r100"], table["echo_ratio_r100"]
    )
    assert np.array_equal(las["radiometry flags"], table["radiometry_flags"])


def test_the_descriptors_say_how_it_is_stored(
    echoes: Callable[..., Table], params: PublishParams, tmp_path: Path
) -> None:
    table = radiometric(echoes)
    write_tile_laz(table, tmp_path / "t.laz", None, params)
    las = laspy.read(tmp_path / "t.laz")
    raw = {d.name: d for d in las.point_format.extra_dimensions}
    assert raw["Amplitude"].dtype == np.int16 and raw["Amplitude"].scales == pytest.approx(0.01)
    assert raw["Deviation"].dtype == np.uint16 and raw["Deviation"].scales is None
    none = {s.format_name(): s.no_data for s in las.header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs}
    assert none["Amplitude"] == [INT16_NONE] and none["Deviation"] == [UINT16_NONE]
    assert none["echo ratio r100"] is None and none["radiometry flags"] is None
    items = items_of(tmp_path / "t.laz")
    for name, col, scale in (("Amplitude", "amplitude_db", 0.01), ("Reflectance", "reflectance", 0.01)):
        low, high = struct.unpack_from("<q", items[name], 64)[0], struct.unpack_from("<q", items[name], 88)[0]
        assert items[name][3] == 1 | 2 | 4 | 8
        assert (low, high) == (round(float(np.nanmin(table[col])) / scale), round(float(np.nanmax(table[col])) / scale))
    low, high = struct.unpack_from("<d16xd", items["echo ratio r100"], 64)
    ratio = table["echo_ratio_r100"]
    assert items["echo ratio r100"][3] == 2 | 4 and (low, high) == (ratio.min(), ratio.max())
    assert items["Amplitude"][160:].rstrip(b"\0").decode().startswith("[dB] ")


def items_of(path: Path) -> dict[str, bytes]:
    """Descriptors of a file by name, by the bytes of its record alone."""
    raw = path.read_bytes()
    at, count = struct.unpack_from("<H", raw, 94)[0], struct.unpack_from("<I", raw, 100)[0]
    for _ in range(count):
        user, number, length = struct.unpack_from("<2x16sHH", raw, at)
        if (user.rstrip(b"\0"), number) == (b"LASF_Spec", 4):
            body = raw[at + 54 : at + 54 + length]
            return {body[k + 4 : k + 36].rstrip(b"\0").decode(): body[k : k + 192] for k in range(0, length, 192)}
        at += 54 + length
    return {}


def stored_as(name: str, values: Any, kind: str) -> np.ndarray:
    table = Table({name: values})
    return pack_columns(extra_bytes(published_columns(table), table), table).reshape(-1).view(kind)


def test_values_are_rounded_and_held_to_the_range() -> None:
    big = np.array([0.004, 0.006, -0.006, 327.67, 327.68, 1e9, -327.67, -327.68, -1e9, np.inf, -np.inf, np.nan])
    wanted = [0, 1, -1, 32767, 32767, 32767, -32767, -32767, -32767, 32767, -32767, INT16_NONE]
    assert stored_as("amplitude_db", big, "<i2").tolist() == wanted
    assert stored_as("deviation", [0.4, 0.6, 65534, 65535, 7e8, -3, np.nan], "<u2").tolist() == [
        0,
        1,
        65534,
        65534,
        65534,
        0,
        UINT16_NONE,
    ]


def test_values_beyond_the_range_are_counted(
    echoes: Callable[..., Table], params: PublishParams, tmp_path: Path
) -> None:
    table = echoes(6).with_columns({"reflectance": [0, 400, -400, 327.67, np.nan, np.inf], "deviation": np.ones(6)})
    assert write_tile_laz(table, tmp_path / "t.laz", None, params)["beyond"] == {"Reflectance": 3}


def test_a_column_without_any_value_has_no_extremes() -> None:
    table = Table({"reflectance": [np.nan, np.nan]})
    (extra,) = extra_bytes(published_columns(table), table)
    assert (extra.low, extra.high, extra.beyond) == (None, None, 0)
    assert descriptor(extra)[3] == 1 | 8
    empty = Table.empty(["reflectance", "confidence", "radiometry_flags"])
    assert [descriptor(e)[3] for e in extra_bytes(published_columns(empty), empty)] == [1 | 8, 1 | 8, 0]


def test_every_published_column_can_be_stored() -> None:
    for declared in COLUMNS.values():
        if not declared.las:
            continue
        scale = {"": "", PER_CODE: "_6"}.get(declared.scales, "_r100")
        col = column(declared.name + scale)
        edge = [0.0, 1.0] if col.null is None else [0.0, 1.0, np.nan]
        table = Table({col.name: edge})
        (extra,) = extra_bytes(published_columns(table), table)
        back = pack_columns((extra,), table).reshape(-1).view(extra.dtype).astype(float)
        if extra.no_data is not None:
            back[back == extra.no_data] = np.nan
        assert np.allclose(back * extra.scale, edge, equal_nan=True), col.name
        assert len(descriptor(extra)) == 192


def test_a_name_stands_once_whatever_its_case() -> None:
    assert free_name("Amplitude", []) == "Amplitude"
    assert free_name("Amplitude", ["amplitude "]) == "fw Amplitude"
    assert free_name("Amplitude", ["AMPLITUDE", "FW amplitude"]) == "fw2 Amplitude"
    assert free_name("Amplitude", ["Amplitude", "fw Amplitude", "fw2 Amplitude"]) == "fw3 Amplitude"
    for col in COLUMNS.values():
        if col.las:
            assert len(free_name(f"{col.las} r1000", [f"{col.las} r1000"]).encode()) <= 32
    names = [c.las.lower() for c in COLUMNS.values() if c.las]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_vendor_s_extra_byte_stays_and_ours_stands_beside_it(
    backend: laspy.LazBackend, make_las: Callable[..., Any], params: PublishParams, tmp_path: Path
) -> None:
    vendor = struct.pack("<2xBB32s76xd16x24x32s", 3, 8, b"Amplitude", 0.01, b"a vendor's own")
    made = make_las(6, extra=2, described=vendor)
    ours = {"amplitude_db": np.linspace(-5, 40, 50, dtype="f4"), "confidence": np.ones(50, "f4")}
    ours["amplitude_db"][::7] = np.nan
    said = write_strip_laz(made.path, tmp_path / "a.laz", np.zeros(50, np.uint8), ours, params)
    assert said["extra_bytes"] == ["fw Amplitude", "confidence"] and said["beyond"] == {}
    las = laspy.read(tmp_path / "a.laz", laz_backend=backend)
    raw = made.points[:, 30:32].copy().view("<u2")[:, 0]
    assert np.allclose(las["Amplitude"], raw * 0.01)
    known = np.isfinite(ours["amplitude_db"])
    assert np.abs(np.asarray(las["fw Amplitude"])[known] - ours["amplitude_db"][known]).max() <= 0.005 + 1e-5
    assert np.allclose(np.asarray(las["fw Amplitude"])[~known], INT16_NONE * 0.01)
    again = write_strip_laz(tmp_path / "a.laz", tmp_path / "b.laz", np.zeros(50, np.uint8), ours, params)
    assert again["extra_bytes"] == ["fw2 Amplitude", "fw confidence"]
    names = list(laspy.read(tmp_path / "b.laz").point_format.extra_dimension_names)
    assert names == ["Amplitude", "fw Amplitude", "confidence", "fw2 Amplitude", "fw confidence"]


def test_a_real_strip_keeps_its_amplitudes(shared_data: Path, params: PublishParams, tmp_path: Path) -> None:
    source = shared_data / "waveform" / "riegl_q680i.las"
    before = laspy.read(source)
    n = len(before.points)
    ours = {"amplitude_db": np.linspace(0, 40, n, dtype="f4"), "deviation": np.full(n, np.nan, "f4")}
    write_strip_laz(source, tmp_path / "r.laz", np.ones(n, np.uint8), ours, params)
    las = laspy.read(tmp_path / "r.laz")
    names = list(las.point_format.extra_dimension_names)
    assert names == ["Amplitude", "Pulse width", "fw Amplitude", "Deviation"]
    assert np.array_equal(las["Amplitude"], before["Amplitude"])
    assert np.abs(np.asarray(las["fw Amplitude"]) - ours["amplitude_db"]).max() <= 0.005 + 1e-5
    assert (np.asarray(las["Deviation"]) == UINT16_NONE).all()


@pytest.mark.parametrize("length", [1, 10, 24, 255 + 10])
def test_undescribed_bytes_get_names_of_their_own(
    length: int, make_las: Callable[..., Any], params: PublishParams, tmp_path: Path
) -> None:
    made = make_las(6, extra=length)
    write_strip_laz(made.path, tmp_path / "o.laz", np.zeros(50, np.uint8), {"confidence": np.ones(50, "f4")}, params)
    las = laspy.read(tmp_path / "o.laz")
    names = list(las.point_format.extra_dimension_names)
    assert len(names) == len(set(names)) and names[0] == "unknown" and names[-1] == "confidence"
    pieces = [np.asarray(las[name]).reshape(50, -1) for name in names[:-1]]
    assert np.array_equal(np.concatenate(pieces, axis=1), made.points[:, 30:])
    assert (np.asarray(las["confidence"]) == 1).all()
