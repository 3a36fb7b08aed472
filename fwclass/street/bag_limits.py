"""Bounds on what the library rosbags takes from a bag: it decompresses all that a chunk holds, and reads any length."""

from __future__ import annotations

import io
import shutil
import sqlite3
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path, PurePath
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

from fwclass.formats.sqlite_files import SIGNATURE, open_sqlite, page_fault, schema_fault
from fwclass.paths import strange_kind
from fwclass.temporary import temporary_directory

CHUNK = 64 << 20
"""Bytes of a chunk; recorders close one at 768 kB, and begin another with the next message."""

RECORD = 256 << 20
"""Bytes that are read at a time."""

TOGETHER = 4 * CHUNK
"""Bytes of chunks that overlap in time, which the library holds together."""

SWOLLEN = 64
"""Times that a bag may grow while it is decompressed and read, besides a chunk; ranges grow three- to fivefold."""

RECORDS = 1_000_000
"""Records that are walked over at most, and one more for every byte of a bag."""

METADATA = 1 << 19
"""Bytes of a metadata.yaml, of which the library reads 40 000 a second; recorders write 600 for a topic or a file."""

TOPICS = 2000
"""Topics of a bag, which are held against each other one by one."""


class BoundedFile(io.BufferedReader):
    """A file that sets memory aside for what it still has, not for what it is asked for; `RECORD` at most."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """At most what the file still has; `ValueError` for more than `RECORD`."""
        left = max(0, self._size - self.tell())
        wanted = left if size is None or size < 0 else min(size, left)
        if wanted > RECORD:
            raise ValueError(f"a record of {wanted} bytes, where at most {RECORD} are read")
        return super().read(wanted)


class BagPath(type(Path())):  # type: ignore[misc]
    """A path whose files are read within bounds."""

    def open(self, mode: str = "r", *more: Any, **named: Any) -> Any:
        """As `Path.open`; bytes are read within bounds."""
        return BoundedFile(Path(self)) if mode == "rb" else super().open(mode, *more, **named)

    def __format__(self, _: str) -> str:
        """As a part of an address: so the library tells SQLite what to open."""
        return quote(str(self))


class _Work:
    """What the bags of this process may still take: bytes that come of them, and records that are walked over.

    What a bag says once can be read as often as its indices name it.
    """

    def __init__(self) -> None:
        self.bytes = self.records = 0

    def allow(self, size: int) -> None:
        """Another bag of `size` bytes is opened."""
        self.bytes += CHUNK + SWOLLEN * size
        self.records += RECORDS + size

    def take(self, size: int) -> None:
        """`ValueError` where `size` bytes are too many."""
        self.bytes -= size
        if self.bytes < 0:
            raise ValueError(f"a bag that grows more than {SWOLLEN}-fold while it is read")

    def count(self, read: Callable[..., Any]) -> Callable[..., Any]:
        """`read`, which counts the records that it is called for, and ends in a `ValueError`."""

        def counted(*given: Any) -> Any:
            self.records -= 1
            if self.records < 0:
                raise ValueError("records that are walked over again and again")
            return read(*given)

        return counted


WORK = _Work()


def _limit_output(opened: Callable[[], Any], most: Callable[[bytes], int]) -> Callable[..., bytes]:
    """A decompressor of no more than `most` bytes; `opened` gives one that takes `max_length`."""

    def decompress(data: bytes, size: int = CHUNK) -> bytes:
        room = min(size, most(data))
        one = opened()
        raw = bytes(one.decompress(data, max_length=room + 1))
        if len(raw) > room:
            raise ValueError(f"a chunk holds more than {room} bytes, which it says or may")
        if not one.eof:
            raise ValueError("a chunk is cut short")
        WORK.take(len(raw))
        return raw

    return decompress


def _as_it_is(data: bytes, _: int = 0) -> bytes:
    WORK.take(len(data))
    return data


def limit_library() -> None:
    """Put bounded decompressors in the place of the library's."""
    from bz2 import BZ2Decompressor

    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1 import reader as one
    from rosbags.rosbag2 import reader as two
    from rosbags.rosbag2 import storage_mcap as mcap
    from rosbags.rosbag2 import storage_sqlite3 as sqlite

    def chunk(_: bytes) -> int:
        return CHUNK

    if isinstance(two.zstd, SimpleNamespace):
        return
    zstd = two.zstd
    bz2, lz4 = _limit_output(BZ2Decompressor, chunk), _limit_output(LZ4FrameDecompressor, chunk)
    frame = _limit_output(zstd.ZstdDecompressor, chunk)
    # messages by time may go to and fro between chunks
    one.decompressors.update(
        {k: lru_cache(maxsize=4)(v) for k, v in {"bz2": bz2, "lz4": lz4, "none": _as_it_is}.items()}
    )
    mcap.DECOMPRESSORS.update({"": _as_it_is, "lz4": lz4, "zstd": frame})
    one.read_uint32, mcap.read_exact = WORK.count(one.read_uint32), WORK.count(mcap.read_exact)
    for module in (two, mcap, sqlite):  # the terms on which messages were sent, which are YAML and decide nothing here
        module.parse_qos = _nothing

    def whole(file: Any, mode: str) -> Any:
        """A database that is compressed as a whole, which is looked at before the library opens it."""
        most = CHUNK + SWOLLEN * file.seek(0, io.SEEK_END)
        with temporary_directory("bag") as directory:
            unpacked = directory / "unpacked"
            with _Swelling(zstd.open(file, mode), most, file.seek(0)) as packed, unpacked.open("wb") as out:
                shutil.copyfileobj(packed, out)
            if _is_database(unpacked):
                _check_database(unpacked)
            return unpacked.open("rb")  # which outlives its name

    two.zstd = SimpleNamespace(decompress=frame, open=whole)
    two.TemporaryDirectory = _BagDirectory

    class Metadata(two.YAML):  # type: ignore[misc]
        """`ValueError` for one that names a file twice, or more topics than there are."""

        def load(self, text: str) -> Any:
            metadata = super().load(text)
            about = metadata["rosbag2_bagfile_information"]
            names = [PurePath(name).name for name in about["relative_file_paths"]]
            if len(set(names)) < len(names):
                raise ValueError("a metadata.yaml that names a file twice")
            if len(about["topics_with_message_count"]) > TOPICS:
                raise ValueError(f"a metadata.yaml of more than {TOPICS} topics")
            return metadata

    two.YAML = Metadata


def _nothing(_: Any) -> list[Any]:
    return []


def forget_chunks() -> None:
    """Let go of the chunks of a ROS 1 bag that was read."""
    from rosbags.rosbag1 import reader as one

    for decompress in one.decompressors.values():
        decompress.cache_clear()


def open_first(path: BagPath) -> Any:
    """The library's reader of a ROS 1 bag, not opened, which takes each connection, chunk and index once."""
    from rosbags.rosbag1 import Reader

    class Once(Reader):  # type: ignore[misc]
        def read_connection(self) -> Any:
            connection = super().read_connection()
            _once(connection.id, self._seen, "a connection")
            return connection

        def read_chunk(self) -> Any:
            chunk = super().read_chunk()
            _once(chunk.datapos, self._seen_chunks, "a chunk")
            return chunk

        def read_index_data(self, pos: int, indexes: Any) -> None:
            before = self.bio.tell()
            super().read_index_data(pos, indexes)
            self._indexed += self.bio.tell() - before
            if self._indexed > self._size:
                raise ValueError("an index that is read again and again")

        _size = path.stat().st_size
        _indexed = 0

    opened = Once(path)
    opened._seen, opened._seen_chunks = set(), set()
    return opened


def _once(key: int, seen: set[int], what: str) -> None:
    if key in seen:
        raise ValueError(f"{what} that is there twice")
    seen.add(key)


class _BagDirectory:
    """In the place of the library's own directory for databases that it decompresses: what a killed process leaves of
    it goes with the next."""

    def __init__(self) -> None:
        self._directory = temporary_directory("bag")

    def __enter__(self) -> str:
        self.name = str(self._directory.__enter__())
        return self.name

    def __exit__(self, *fault: Any) -> None:
        self._directory.__exit__(*fault)


class _Swelling:
    """A decompressed file that ends in a `ValueError` where it is longer than `most` bytes."""

    def __init__(self, file: Any, most: int, _: int) -> None:
        self._file, self._left = file, most

    def __enter__(self) -> _Swelling:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, size: int = -1, /) -> bytes:
        data = bytes(self._file.read(size))
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(f"a compressed database grows more than {SWOLLEN}-fold")
        return data


def check_files(path: Path) -> None:
    """`ValueError` for files of a ROS 2 bag that would work while they are read, or take any memory."""
    inside = [path] if path.is_file() else sorted(path.iterdir())
    for one in inside:
        if kind := strange_kind(one):
            raise ValueError(f"{kind}, {one.name}")
        if path.is_dir() and set(one.name) & set("%?#"):  # the library makes addresses of them
            raise ValueError(f"a file whose name would lead elsewhere, {one.name}")
    files = [p for p in inside if p.is_file()]
    for file in files:
        if file.name == "metadata.yaml":
            if file.stat().st_size > METADATA:
                raise ValueError(f"a metadata.yaml of {file.stat().st_size} bytes")
            if b"<<" in file.read_bytes():
                raise ValueError("a metadata.yaml that merges mappings, which may double at every level")
        elif file.suffix == ".db3" or _is_database(file):
            _check_database(file)


def _is_database(path: Path) -> bool:
    """Under whatever name."""
    with path.open("rb") as stream:
        return stream.read(16) == SIGNATURE


def _check_database(path: Path) -> None:
    """`ValueError` for views, triggers and generated columns, which compute for as long as their maker likes, and for
    what else takes more than its bytes."""
    if not _is_database(path):
        raise ValueError(f"{path.name} is no SQLite database")
    opened = open_sqlite(path)
    try:
        for kind, name in opened.execute("SELECT type, name FROM sqlite_master").fetchmany(10_000):
            if kind not in ("table", "index"):
                raise ValueError(f"a {kind} ({name}) in the database, which computes while it is read")
        if fault := schema_fault(opened) or page_fault(opened):
            raise ValueError(fault)
        topics, numbers = opened.execute("SELECT count(*), count(DISTINCT id) FROM topics").fetchone()
        if topics > numbers:
            raise ValueError(f"{topics} topics of {numbers} numbers: each message would be read for every one of them")
        if topics > TOPICS:
            raise ValueError(f"more than {TOPICS} topics")
    except sqlite3.Error as error:
        raise ValueError(f"SQLite: {error}") from None
    finally:
        opened.close()


def check_chunks(chunks: Sequence[Any]) -> None:
    """`ValueError` where more than `TOGETHER` bytes of an MCAP's chunks overlap in time, or chunks in the file."""
    ends = [(c.message_start_time, 1, c.uncompressed_size) for c in chunks]
    ends += [(c.message_end_time, 2, -c.uncompressed_size) for c in chunks]
    total = 0
    for _, _, size in sorted(ends):
        total += size
        if total > TOGETHER:
            raise ValueError(f"chunks of more than {TOGETHER} bytes overlap in time")
    places = sorted((c.chunk_start_offset, c.compressed_size) for c in chunks)
    if any(at + size > after for (at, size), (after, _) in pairwise(places)):
        raise ValueError("chunks that lie in each other")
