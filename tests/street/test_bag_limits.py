"""Bags that say little and would be read often: what a bag takes is in proportion to its bytes."""

from __future__ import annotations

import sqlite3
import struct
import time
from pathlib import Path

import pytest
from bagmaker import _messages, write_bag2
from streetmaker import drive

from fwclass.conf.street import scanner
from fwclass.errors import InputError
from fwclass.graph.street_recordings import open_recording
from fwclass.street import bag_limits
from fwclass.street.frames import Scan

pytest.importorskip("rosbags")
SCAN = Scan.of(scanner("lms1xx"))
LASER, MD5 = b"sensor_msgs/LaserScan", b"90c7ef2dc6895d81024acba2ac42f369"


def record(data: bytes, **fields: bytes | int) -> bytes:
    """A record of a ROS 1 bag; numbers are of a byte for ``op``, else of four."""
    head = b""
    for name, value in fields.items():
        raw = value if isinstance(value, bytes) else value.to_bytes(1 if name == "op" else 4, "little")
        head += struct.pack("<I", len(name) + 1 + len(raw)) + name.encode() + b"=" + raw
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def connection(number: int = 0) -> bytes:
    about = record(b"", topic=b"/scan", type=LASER, md5sum=MD5, message_definition=b"float32 x")
    return record(about[4:-4], op=7, conn=number, topic=b"/scan")


def frames_as_messages(n: int) -> list[bytes]:
    from rosbags.typesys import Stores, get_typestore

    return [raw for _, raw in _messages(drive()[:n], get_typestore(Stores.ROS1_NOETIC), False)]


def first_bag(
    path: Path,
    chunks: list[bytes],
    indices: list[list[tuple[int, int]]],
    connections: int = 1,
    infos: int = 1,
    compression: str = "none",
) -> None:
    """A ROS 1 bag of chunks, each with (nanosecond, offset) for each message; all connections have number 0."""
    import bz2

    def header(at: int) -> bytes:
        place = at.to_bytes(8, "little")
        made = record(b"", op=3, index_pos=place, conn_count=connections, chunk_count=infos * len(chunks))
        return b"#ROSBAG V2.0\n" + made

    body, places, start = b"", [], len(header(0))
    for chunk, index in zip(chunks, indices, strict=True):
        places.append(start + len(body))
        data = chunk if compression == "none" else bz2.compress(chunk)
        body += record(data, op=5, compression=compression.encode(), size=len(chunk))
        entries = b"".join(struct.pack("<III", 1, t, at) for t, at in index)
        body += record(entries, op=4, ver=1, conn=0, count=len(index))
    tail = connection() * connections
    for place, index in zip(places, indices, strict=True):
        when = struct.pack("<II", 1, 0)
        one = record(
            struct.pack("<II", 0, len(index)),
            op=6,
            ver=1,
            chunk_pos=place.to_bytes(8, "little"),
            start_time=when,
            end_time=when,
            count=1,
        )
        tail += one * infos
    path.write_bytes(header(start + len(body)) + body + tail)


def message(raw: bytes, t: int) -> bytes:
    return record(raw, op=2, conn=0, time=struct.pack("<II", 1, t))


def test_a_bag_made_by_hand_is_read(tmp_path):
    made = [message(raw, t) for t, raw in enumerate(frames_as_messages(2))]
    index = [(0, 0), (1, len(made[0]))]
    for compression in ("none", "bz2"):
        first_bag(tmp_path / "a.bag", [b"".join(made)], [index], compression=compression)
        assert len(list(open_recording(tmp_path / "a.bag", SCAN).frames())) == 2


@pytest.mark.parametrize(
    ("changed", "words"), [({"infos": 50}, "chunk that is there twice"), ({"connections": 50}, "connection that is")]
)
def test_an_index_that_names_one_thing_many_times_is_refused(tmp_path, changed, words):
    """60 bytes each, they multiply the entries of the index, in memory."""
    (raw,) = frames_as_messages(1)
    first_bag(tmp_path / "a.bag", [message(raw, 0)], [[(0, 0)]], **changed)
    with pytest.raises(InputError, match=words):
        list(open_recording(tmp_path / "a.bag", SCAN).frames())


def test_chunks_in_each_other_do_not_share_an_index(tmp_path):
    """Chunks of 40 bytes, each the rest of the one before it: all are followed by the same index."""
    (raw,) = frames_as_messages(1)
    entries = [(k, 0) for k in range(20_000)]
    first_bag(tmp_path / "a.bag", [message(raw, 0)], [entries])
    data = (tmp_path / "a.bag").read_bytes()
    begin = data.index(b"op=\x05") - 8
    head = len(record(b"", op=5, compression=b"none", size=0))
    inner = len(message(raw, 0))
    nested, n = b"", 50
    for k in range(n):
        rest = head * (n - k - 1) + inner
        nested += record(b"", op=5, compression=b"none", size=rest)[:-4] + struct.pack("<I", rest)
    end = begin + head
    rows = data.index(b"op=\x06") - data.index(b"op=\x04")
    body = data[:begin] + nested + data[end:]
    at = body.rindex(connection())
    tail = body[at : at + len(connection())]
    for k in range(n):
        place, when = (begin + head * k).to_bytes(8, "little"), struct.pack("<II", 1, 0)
        named = {"chunk_pos": place, "start_time": when, "end_time": when, "count": 1}
        tail += record(struct.pack("<II", 0, 1), op=6, ver=1, **named)
    start = record(b"", op=3, index_pos=at.to_bytes(8, "little"), conn_count=1, chunk_count=n)
    assert rows > 0
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + start + body[13 + len(start) : at] + tail)
    with pytest.raises(InputError, match="index that is read again"):
        list(open_recording(tmp_path / "a.bag", SCAN).frames())


@pytest.fixture
def small(monkeypatch):
    """Limits that a small bag reaches."""
    monkeypatch.setattr(bag_limits, "CHUNK", 1 << 19)
    monkeypatch.setattr(bag_limits, "SWOLLEN", 2)
    monkeypatch.setattr(bag_limits, "RECORDS", 10_000, raising=False)
    monkeypatch.setattr(bag_limits.WORK, "bytes", 0)  # what sound bags before have left
    monkeypatch.setattr(bag_limits.WORK, "records", 0)


@pytest.mark.usefixtures("small")
def test_a_message_that_is_indexed_many_times_is_not_read_so_often(tmp_path):
    """Twelve bytes each give a frame of 4 kB, or of 240."""
    (raw,) = frames_as_messages(1)
    first_bag(tmp_path / "a.bag", [message(raw, 0)], [[(0, 0)] * 2000])
    with pytest.raises(InputError, match="grows more than"):
        list(open_recording(tmp_path / "a.bag", SCAN).frames())


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("compression", ["none", "bz2"])
def test_chunks_that_take_turns_are_not_read_for_every_message(tmp_path, compression):
    (raw,), size = frames_as_messages(1), len(message(frames_as_messages(1)[0], 0))
    chunks, indices = [], []
    for k in range(6):
        times = [6 * j + k for j in range(20)]
        chunks.append(b"".join(message(raw, t) for t in times) + bytes(100_000))
        indices.append([(t, size * j) for j, t in enumerate(times)])
    first_bag(tmp_path / "a.bag", chunks, indices, compression=compression)
    with pytest.raises(InputError, match="grows more than"):
        list(open_recording(tmp_path / "a.bag", SCAN).frames())


@pytest.mark.usefixtures("small")
def test_records_before_a_message_are_not_walked_for_every_message(tmp_path):
    """A walk of 20 000 records for each of 20 000 entries."""
    (raw,) = frames_as_messages(1)
    before = connection() * 2000
    first_bag(tmp_path / "a.bag", [before + message(raw, 0)], [[(0, 0)] * 2000])
    began = time.process_time()
    with pytest.raises(InputError, match=r"walked over|grows more"):
        list(open_recording(tmp_path / "a.bag", SCAN).frames())
    assert time.process_time() - began < 5


def test_an_mcap_that_names_a_chunk_many_times_is_refused(tmp_path):
    write_bag2(tmp_path / "bag", drive()[:5], "mcap")
    (file,) = (tmp_path / "bag").glob("*.mcap")
    data = file.read_bytes()
    summary = struct.unpack_from("<Q", data, len(data) - 28)[0]
    at = summary
    while data[at] != 0x08:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    end = at + 9 + struct.unpack_from("<Q", data, at + 1)[0]
    more = b""
    for k in range(1, 40):
        one = bytearray(data[at:end])
        _, last = struct.unpack_from("<QQ", one, 9)
        struct.pack_into("<QQ", one, 9, last + 2 * k, last + 2 * k + 1)
        more += bytes(one)
    file.write_bytes(data[:end] + more + data[end:])
    with pytest.raises(InputError, match="lie in each other"):
        list(open_recording(tmp_path / "bag", SCAN).frames())


def changed_database(bag: Path, *statements: str, rows: tuple = ()) -> None:
    (database,) = bag.glob("*.db3")
    with sqlite3.connect(database) as opened:
        for statement in statements:
            opened.execute(statement, rows if "?" in statement else ())
    opened.close()


@pytest.mark.parametrize("where", ["sqlite3", "mcap"])
def test_terms_of_sending_are_not_read(tmp_path, where):
    """A text of 1 kB at a topic whose mappings double at every level: YAML, 2^40 keys."""
    text = "- &a0 {b: 1}\n" + "".join(f"- &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}\n" for k in range(1, 40))
    write_bag2(tmp_path / "bag", drive()[:3], where)
    if where == "sqlite3":
        changed_database(tmp_path / "bag", "UPDATE topics SET offered_qos_profiles = ?", rows=(text,))
    else:
        from rosbags.rosbag2 import storage_mcap

        said = storage_mcap.McapWriter.add_connection
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(storage_mcap.McapWriter, "add_connection", lambda self, c, _: said(self, c, text))
            write_bag2(tmp_path / "other", drive()[:3], where)
        (tmp_path / "other").rename(tmp_path / "bag2")
    bag = tmp_path / ("bag" if where == "sqlite3" else "bag2")
    (file,) = (p for p in bag.iterdir() if p.suffix in (".db3", ".mcap"))
    began = time.process_time()
    assert len(list(open_recording(file, SCAN).frames())) == 3
    assert time.process_time() - began < 5


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("ALTER TABLE messages ADD COLUMN more BLOB DEFAULT x'" + "00" * 100_000 + "'", "silent rows"),
        ("CREATE VIEW v AS SELECT 1", "a view"),
        (
            "INSERT INTO topics SELECT value + 10, '/t' || value, 'a', 'cdr', '', '' "
            "FROM (WITH RECURSIVE r(value) AS (SELECT 1 UNION ALL SELECT value + 1 FROM r LIMIT 3000) SELECT * FROM r)",
            "more than 2000 topics",
        ),
    ],
)
def test_a_database_that_gives_more_than_it_holds_is_refused(tmp_path, statement, words):
    write_bag2(tmp_path / "bag", drive()[:3], "sqlite3")
    changed_database(tmp_path / "bag", statement)
    with pytest.raises(InputError, match=words):
        list(open_recording(tmp_path / "bag", SCAN).frames())


def test_a_file_that_is_named_many_times_is_refused(tmp_path):
    write_bag2(tmp_path / "bag", drive()[:3], "sqlite3")
    about = tmp_path / "bag" / "metadata.yaml"
    about.write_text(about.read_text().replace("  - bag.db3\n", "  - bag.db3\n" * 100))
    assert "- bag.db3\n  - bag.db3" in about.read_text()
    with pytest.raises(InputError, match="names a file twice"):
        list(open_recording(tmp_path / "bag", SCAN).frames())


def test_a_name_that_is_an_address_leads_nowhere(tmp_path):
    """``..%2fother.db3`` in a bag is opened as ``../other.db3`` where SQLite is given an address."""
    for name in ("bag", "other"):
        write_bag2(tmp_path / name, drive()[: 3 if name == "bag" else 5], "sqlite3")
    (tmp_path / "bag" / "bag.db3").rename(tmp_path / "bag" / "..%2fother.db3")
    about = tmp_path / "bag" / "metadata.yaml"
    about.write_text(about.read_text().replace("bag.db3", "..%2fother.db3"))
    (tmp_path / "other" / "other.db3").rename(tmp_path / "other.db3")
    with pytest.raises(InputError, match="lead elsewhere"):
        list(open_recording(tmp_path / "bag", SCAN).frames())
    write_bag2(tmp_path / "plain", drive()[:3], "sqlite3")
    odd = (tmp_path / "plain").rename(tmp_path / "a?b%20c#d")
    assert len(list(open_recording(odd, SCAN).frames())) == 3
