"""A strip with new classes: everything else is the source's, byte for byte, packets included."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import lazrs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fwclass.errors import ConfigError, FwclassError, InputError, StoreError
from fwclass.formats.las_bytes import extended_records, point_chunks, read_head
from fwclass.formats.laz_writer import LazWriter
from fwclass.publish import packets as packets_room
from fwclass.publish.params import PublishParams
from fwclass.publish.strips import write_strip_laz

PACKET_AT = {4: 28, 5: 34, 9: 30, 10: 38}
CLASS_AT = {fmt: 15 if fmt < 6 else 16 for fmt in range(11)}
Make = Callable[..., Any]


def record(user: bytes, number: int, data: bytes, long: bool = False) -> bytes:
    return struct.pack("<H16sHQ32s" if long else "<H16sHH32s", 7, user, number, len(data), b"made") + data


def raw_points(path: Path, backend: laspy.LazBackend = laspy.LazBackend.Laszip) -> np.ndarray:
    las = laspy.read(path, laz_backend=backend)
    return np.frombuffer(las.points.array.tobytes(), np.uint8).reshape(len(las.points), -1)


def decoded(las_path: Path, points: np.ndarray, fmt: int) -> list[np.ndarray | None]:
    """Samples of every point, by the packet block's bytes and the sidecar's; independent of the package."""
    wdp, head = las_path.with_suffix(".wdp").read_bytes(), las_path.read_bytes()[:400]
    assert struct.unpack_from("<H", head, 6)[0] & 6 == 4, "external bit alone"
    assert struct.unpack_from("<Q", head, 227)[0] == 0
    out: list[np.ndarray | None] = []
    for row in points:
        index, offset, size = struct.unpack_from("<BQI", row.tobytes(), PACKET_AT[fmt])
        if index == 0:
            out.append(None)
        else:
            assert offset >= 60 and offset + size <= len(wdp)
            out.append(np.frombuffer(wdp, "u1" if index == 1 else "<u2", size // index, offset))
    return out


def chunked_laz(source: Path, path: Path, points: np.ndarray, vlrs: bytes, evlrs: bytes) -> None:
    """As COPC is stored: LAZ in chunks of different sizes, one per octree node."""
    laz = lazrs.LazVlr.new_for_compression(6, 0, True)
    vlrs += record(b"laszip encoded", 22204, bytes(laz.record_data()))
    head = bytearray(source.read_bytes()[:375])
    struct.pack_into("<II", head, 96, 375 + len(vlrs), 2)
    head[104] |= 0x80
    with path.open("w+b") as file:
        file.write(bytes(head) + vlrs)
        compressor = lazrs.LasZipCompressor(file, laz)
        for part in (points[:20], points[20:23]):
            compressor.compress_many(np.ascontiguousarray(part).reshape(-1))
            compressor.finish_current_chunk()
        compressor.compress_many(np.ascontiguousarray(points[23:]).reshape(-1))
        compressor.done()
        end = file.seek(0, 2)
        file.write(evlrs)
        file.seek(235)
        file.write(struct.pack("<QI", end, 2))


def new_classes(n: int, top: int = 31) -> np.ndarray:
    return (np.arange(n) % (top + 1)).astype(np.uint8)


@pytest.mark.parametrize("fmt", range(11))
@pytest.mark.parametrize("chunk", [7, 1000])
def test_only_the_class_differs(fmt: int, chunk: int, make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(fmt, extra=3)
    classes = new_classes(50, 31 if fmt < 6 else 255)
    small = params.model_copy(update={"chunk_points": chunk})
    said = write_strip_laz(made.path, tmp_path / "out" / "strip.laz", classes, None, small)
    got = raw_points(tmp_path / "out" / "strip.laz")
    at, mask = CLASS_AT[fmt], 0x1F if fmt < 6 else 0xFF
    assert np.array_equal(got[:, at] & mask, classes)
    assert np.array_equal(got[:, at] & ~np.uint8(mask), made.points[:, at] & ~np.uint8(mask)), "legacy flags"
    others = np.arange(got.shape[1]) != at
    assert np.array_equal(got[:, others], made.points[:, others])
    assert said["changed"] == np.count_nonzero((made.points[:, at] & mask) != classes)
    assert said["points"] == 50 and said["point_format"] == fmt


@pytest.mark.parametrize("fmt", [4, 5, 9, 10])
@pytest.mark.parametrize("storage", ["internal", "external"])
def test_packets_decode_to_the_same_samples(
    fmt: int, storage: str, make_las: Make, params: PublishParams, tmp_path: Path
) -> None:
    made = make_las(fmt, storage=storage)
    output = tmp_path / "out" / "other_name.laz"
    said = write_strip_laz(made.path, output, new_classes(50), {"confidence": np.ones(50, "f4")}, params)
    got = raw_points(output)
    at = PACKET_AT[fmt]
    assert np.array_equal(got[:, at : at + 29], made.points[:, at : at + 29])
    for wanted, found in zip(made.samples, decoded(output, got, fmt), strict=True):
        assert (wanted is None) == (found is None)
        assert wanted is None or (np.array_equal(wanted, found) and wanted.dtype == found.dtype)
    assert said["waveforms"] == ("extracted" if storage == "internal" else "copied")
    assert said["wdp"] == str(output.with_suffix(".wdp"))


@pytest.mark.parametrize("listed", [True, False])
@pytest.mark.parametrize("storage", ["internal", "external", "none"])
def test_head_and_records_stay(
    storage: str, listed: bool, make_las: Make, params: PublishParams, tmp_path: Path
) -> None:
    own = record(b"A VENDOR", 77, bytes(range(256)) * 9) + record(b"LASF_Projection", 2112, b"not a CRS\0\1\2")
    evlrs = (record(b"A VENDOR", 9, b"x" * 1234, long=True), record(b"LASF_Spec", 2, b"", long=True))
    made = make_las(
        9, storage=storage, vlrs=own, n_vlrs=2, evlrs=evlrs, gap=b"\xdd\xdd", user=b"user bytes", listed=listed
    )
    write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)
    source, copy = made.path.read_bytes(), (tmp_path / "o.laz").read_bytes()
    head = read_head(tmp_path / "o.laz")
    kept = [*range(6), *range(8, 96), *range(105, 227), *range(247, 385)]
    assert bytes(source[k] for k in kept) == bytes(copy[k] for k in kept)
    assert b"".join(r.raw for r in head.records if r.user != "laszip encoded") == made.vlrs
    assert head.gap == b"\xdd\xdd"
    start, number = struct.unpack_from("<QI", copy, 235)
    assert number == 2 and copy[start:] == made.evlrs
    assert [e.record_id for e in laspy.open(tmp_path / "o.laz").evlrs] == [9, 2]


def test_extra_columns_stand_behind_the_source_s_own_bytes(
    make_las: Make, params: PublishParams, tmp_path: Path
) -> None:
    described = struct.pack("<2xBB32s124x32s", 3, 0, b"Deviation", b"a vendor's own")
    made = make_las(6, extra=2 + 4, described=described)  # four more bytes that nothing describes
    extra = {"confidence": np.linspace(0, 1, 50, dtype="f4"), "amplitude": np.full(50, np.nan, "f4")}
    said = write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), extra, params)
    assert said["extra_bytes"] == ["confidence", "amplitude DN"]
    las = laspy.read(tmp_path / "o.laz")
    names = list(las.point_format.extra_dimension_names)
    assert names == ["Deviation", "unknown", "confidence", "amplitude DN"]
    assert np.array_equal(las["Deviation"], made.points[:, 30:32].copy().view("<u2")[:, 0])
    assert np.abs(las["confidence"] - extra["confidence"]).max() <= 0.0025001
    assert (las.points.array["amplitude DN"] == 2**32 - 1).all(), "no value"
    assert np.array_equal(np.asarray(las["unknown"]), made.points[:, 32:36])


def test_a_legacy_format_refuses_a_code_above_31(make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(3)
    classes = np.full(50, 2, np.uint8)
    classes[7] = 64
    with pytest.raises(ConfigError, match="class code 64 does not fit point format 3") as fault:
        write_strip_laz(made.path, tmp_path / "o.laz", classes, None, params)
    assert "legacy_code" in fault.value.do
    assert not (tmp_path / "o.laz").exists()


@pytest.mark.parametrize("compressed", [False, True])
def test_copc_comes_out_as_plain_laz(compressed: bool, make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    info, octree = record(b"copc", 1, bytes(160)), record(b"copc", 1000, bytes(64), long=True)
    other = record(b"LASF_Spec", 2, b"kept", long=True)
    made = make_las(6, vlrs=info, n_vlrs=1, evlrs=(octree, other), name="strip.copc.laz")
    path = made.path
    if compressed:
        path = tmp_path / "in.copc.laz"
        chunked_laz(made.path, path, made.points, info, octree + other)
    said = write_strip_laz(path, tmp_path / "o.laz", new_classes(50), None, params)
    head = read_head(tmp_path / "o.laz")
    assert said["copc"] and "COPC" in said["notes"][0]
    assert not [r for r in head.records if r.user == "copc"] and head.evlrs == 1
    others = np.arange(30) != 16
    assert np.array_equal(raw_points(tmp_path / "o.laz")[:, others], made.points[:, others])


def test_a_stale_start_of_packets_is_not_followed(make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(9, storage="external")
    raw = bytearray(made.path.read_bytes())
    struct.pack_into("<Q", raw, 227, 700)
    made.path.write_bytes(raw)
    said = write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)
    assert said["waveforms"] == "copied"
    assert decoded(tmp_path / "o.laz", raw_points(tmp_path / "o.laz"), 9)


def test_an_open_record_length_reaches_to_the_end(make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(4, storage="internal")
    raw = bytearray(made.path.read_bytes())
    start = struct.unpack_from("<Q", raw, 227)[0]
    struct.pack_into("<Q", raw, start + 20, 0)
    made.path.write_bytes(raw)
    said = write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)
    assert said["waveforms"] == "extracted" and (tmp_path / "o.wdp").read_bytes() == raw[start:]


def test_a_missing_sidecar_is_noted_not_raised(make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(9, storage="external")
    made.path.with_suffix(".wdp").unlink()
    said = write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)
    assert said["waveforms"] == "missing" and "strip.wdp" in said["notes"][0] and said["wdp"] is None


def test_editing_the_delivered_packets_does_not_touch_the_source(
    make_las: Make, params: PublishParams, tmp_path: Path
) -> None:
    made = make_las(4, storage="external")
    sidecar = made.path.with_suffix(".wdp")
    before = sidecar.read_bytes()
    write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)
    assert (tmp_path / "o.wdp").read_bytes() == before
    with (tmp_path / "o.wdp").open("ab") as file:
        file.write(b"x")
    assert sidecar.read_bytes() == before


def test_a_truncated_packet_record_is_said(make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(4, storage="internal")
    made.path.write_bytes(made.path.read_bytes()[:-30])
    said = write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)
    assert said["waveforms"] == "truncated" and "30 bytes past the file" in said["notes"][0]


@pytest.mark.parametrize("at", [0, 14, 29])
def test_a_writer_that_corrupts_a_byte_is_caught(
    at: int, make_las: Make, params: PublishParams, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make_las(6)
    honest = LazWriter.write

    def corrupt(self: LazWriter, points: np.ndarray) -> None:
        points = points.copy()
        points[20, at] ^= 1
        honest(self, points)

    monkeypatch.setattr(LazWriter, "write", corrupt)
    with pytest.raises(StoreError, match=f"byte {at} of point 20"):
        write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)
    assert [p.name for p in tmp_path.iterdir()] == ["strip.las"], "nothing is published"


def test_a_corrupt_copy_of_the_packets_is_caught(
    make_las: Make, params: PublishParams, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make_las(9, storage="internal")
    honest = packets_room.copy_bytes
    monkeypatch.setattr(packets_room, "copy_bytes", lambda s, f, start, n: honest(s, f, start + 1, n))
    with pytest.raises(StoreError, match="packet"):
        write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)
    assert [p.name for p in tmp_path.iterdir()] == ["strip.las"]


def test_a_header_that_laszip_changed_is_caught(
    make_las: Make, params: PublishParams, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make_las(9, storage="external")

    def leave(self: LazWriter, block: bytes | None = None) -> int:
        self.zipper.done()
        return self.file.seek(0, 2)

    monkeypatch.setattr(LazWriter, "finish", leave)
    with pytest.raises(StoreError, match="byte 58 of the header"):
        write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)


def test_a_wrong_class_is_caught(
    make_las: Make, params: PublishParams, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make_las(9)
    honest = LazWriter.write

    def corrupt(self: LazWriter, points: np.ndarray) -> None:
        points[3, 16] += 1
        honest(self, points)

    monkeypatch.setattr(LazWriter, "write", corrupt)
    with pytest.raises(StoreError, match="class of point 3"):
        write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), None, params)


def test_lengths_and_targets_are_checked(make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(6)
    with pytest.raises(InputError, match="another length"):
        write_strip_laz(made.path, tmp_path / "o.laz", new_classes(49), None, params)
    with pytest.raises(InputError, match="confidence has another length"):
        write_strip_laz(made.path, tmp_path / "o.laz", new_classes(50), {"confidence": np.ones(3)}, params)
    with pytest.raises(ConfigError, match="onto itself"):
        write_strip_laz(made.path, made.path, new_classes(50), None, params)


@pytest.mark.parametrize("fmt", [3, 4, 6, 9])
def test_an_empty_strip(fmt: int, make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(fmt, n=0)
    said = write_strip_laz(made.path, tmp_path / "o.laz", np.zeros(0, np.uint8), None, params)
    assert said["points"] == 0 and laspy.open(tmp_path / "o.laz").header.point_count == 0


def test_same_input_same_bytes(make_las: Make, params: PublishParams, tmp_path: Path) -> None:
    made = make_las(9, storage="internal")
    for name, chunk in (("a", 7), ("b", 1000)):
        small = params.model_copy(update={"chunk_points": chunk})
        write_strip_laz(made.path, tmp_path / f"{name}.laz", new_classes(50), None, small)
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()
    assert (tmp_path / "a.wdp").read_bytes() == (tmp_path / "b.wdp").read_bytes()


@pytest.mark.parametrize("storage", ["internal", "external"])
def test_a_published_strip_can_be_published_again(
    storage: str, make_las: Make, params: PublishParams, tmp_path: Path
) -> None:
    made = make_las(9, storage=storage)
    write_strip_laz(made.path, tmp_path / "a.laz", new_classes(50), None, params)
    write_strip_laz(tmp_path / "a.laz", tmp_path / "b.laz", made.points[:, 16], None, params)
    assert np.array_equal(raw_points(tmp_path / "b.laz"), made.points)
    assert (tmp_path / "b.wdp").read_bytes() == (tmp_path / "a.wdp").read_bytes()


@pytest.mark.statistics
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_heads_end_in_a_message(data: st.DataObject, make_las: Make) -> None:
    made = make_las(9, n=5, storage="internal", evlrs=(record(b"A", 1, b"12", long=True),))
    raw = bytearray(made.path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, min(len(raw) - 1, 500)))
        raw[at] = data.draw(st.integers(0, 255))
    made.path.write_bytes(raw[: data.draw(st.integers(0, len(raw)))])
    try:
        head = read_head(made.path)
        with made.path.open("rb") as file:
            extended_records(file, head)
        packets_room.find_packets(head)
        if head.points < 10_000:
            for part in point_chunks(head, 1000):
                assert part.shape[1] == head.point_size
    except FwclassError as fault:
        assert fault.do and fault.where


def test_the_riegl_strip(shared_data: Path, params: PublishParams, tmp_path: Path) -> None:
    source = shared_data / "waveform" / "riegl_q680i.las"
    before = laspy.read(source)
    classes = new_classes(len(before.points), 6)
    said = write_strip_laz(source, tmp_path / "riegl.laz", classes, None, params)
    old, new = raw_points(source), raw_points(tmp_path / "riegl.laz", laspy.LazBackend.Lazrs)
    others = np.arange(old.shape[1]) != 16
    assert np.array_equal(old[:, others], new[:, others]) and np.array_equal(new[:, 16], classes)
    assert said["waveforms"] in ("linked", "copied")
    wdp = source.with_suffix(".wdp").read_bytes()
    assert (tmp_path / "riegl.wdp").read_bytes() == wdp
    las = laspy.read(tmp_path / "riegl.laz")
    ends = las["wavepacket_offset"] + las["wavepacket_size"]
    assert int(ends.max()) <= len(wdp) and np.array_equal(las["Pulse width"], before["Pulse width"])


def test_faulty_real_files(shared_data: Path, params: PublishParams, tmp_path: Path) -> None:
    for name, said in (
        ("leica_truncated_internal.las", ("extracted", "truncated")),
        ("yellowscan_missing_wdp.laz", ("missing",)),
    ):
        source = shared_data / "waveform" / name
        n = laspy.open(source).header.point_count
        made = write_strip_laz(source, tmp_path / f"{source.stem}.laz", new_classes(n), None, params)
        assert made["waveforms"] in said and made["points"] == n


def test_counts_that_contradict_each_other_are_no_matter_to_the_writer(tmp_path: Path) -> None:
    """LASzip refuses to begin with such a header."""
    las = laspy.LasData(laspy.LasHeader(point_format=1, version="1.4"))
    las.x = las.y = las.z = np.arange(9.0)
    las.write(tmp_path / "a.las")
    data = bytearray((tmp_path / "a.las").read_bytes())
    struct.pack_into("<5I", data, 111, 60, 1, 2, 3, 4)
    struct.pack_into("<15Q", data, 255, *[0] * 15)
    (tmp_path / "a.las").write_bytes(data)
    (start,) = struct.unpack_from("<I", data, 96)
    with (tmp_path / "b.laz").open("w+b") as file:
        writer = LazWriter(file, bytes(data[:start]))
        writer.write(np.frombuffer(data[start:], np.uint8))
        writer.finish()
    written = (tmp_path / "b.laz").read_bytes()
    assert written[107:227] == bytes(data[107:227])
    assert np.array_equal(laspy.read(tmp_path / "b.laz").X, las.X)
