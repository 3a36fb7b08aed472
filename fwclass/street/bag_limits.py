"""Bounds on what the library rosbags takes from a bag: it decompresses all that a chunk holds, and reads any length."""

from __future__ import annotations

import io
import shutil
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from fwclass.paths import strange_kind
from fwclass.temporary import temporary_directory

CHUNK = 64 << 20
"""Bytes of a chunk; recorders close one at 768 kB, and begin another with the next message."""

RECORD = 256 << 20
"""Bytes that are read at a time."""

TOGETHER = 4 * CHUNK
"""Bytes of chunks that overlap in time, which the library holds together."""

SWOLLEN = 64
"""Times that a compressed database may grow, besides a chunk; ranges grow three- to fivefold."""

METADATA = 4 << 20
"""Bytes of a metadata.yaml."""


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
        return raw

    return decompress


def limit_library() -> None:
    """Put bounded decompressors in the place of the library's."""
    from bz2 import BZ2Decompressor

    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1 import reader as one
    from rosbags.rosbag2 import reader as two
    from rosbags.rosbag2 import storage_mcap as mcap

    def chunk(_: bytes) -> int:
        return CHUNK

    if isinstance(two.zstd, SimpleNamespace):
        return
    zstd = two.zstd
    one.decompressors.update(bz2=_limit_output(BZ2Decompressor, chunk), lz4=_limit_output(LZ4FrameDecompressor, chunk))
    frame = _limit_output(zstd.ZstdDecompressor, chunk)
    mcap.DECOMPRESSORS.update(lz4=_limit_output(LZ4FrameDecompressor, chunk), zstd=frame)

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


class _BagDirectory:
    """In the place of the library's own directory for databases that it decompresses: what a killed process leaves of
    it goes with the next."""

    def __init__(self) -> None:
        self._made = temporary_directory("bag")

    def __enter__(self) -> str:
        self.name = str(self._made.__enter__())
        return self.name

    def __exit__(self, *fault: Any) -> None:
        self._made.__exit__(*fault)


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
        return stream.read(16) == b"SQLite format 3\0"


def _check_database(path: Path) -> None:
    """`ValueError` for views, triggers and generated columns: they compute for as long as their maker likes."""
    with path.open("rb") as stream:
        if stream.read(16) != b"SQLite format 3\0":
            raise ValueError(f"{path.name} is no SQLite database")
    opened = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)
    try:
        opened.execute("PRAGMA trusted_schema = OFF")
        for (said,) in opened.execute("PRAGMA quick_check(1)"):
            if said != "ok":  # pages that are there twice would be walked without end
                raise ValueError(f"a damaged database: {' '.join(str(said).split())[:80]}")
        for kind, name in opened.execute("SELECT type, name FROM sqlite_master").fetchmany(10_000):
            if kind not in ("table", "index"):
                raise ValueError(f"a {kind} ({name}) in the database, which computes while it is read")
        topics, numbers = opened.execute("SELECT count(*), count(DISTINCT id) FROM topics").fetchone()
        if topics > numbers:
            raise ValueError(f"{topics} topics of {numbers} numbers: each message would be read for every one of them")
        for name in ("messages", "topics", "schema", "message_definitions"):
            if any(row[6] for row in opened.execute(f"PRAGMA table_xinfo({name})")):
                raise ValueError(f"generated columns in {name}, which are computed while it is read")
    except sqlite3.Error as fault:
        raise ValueError(f"SQLite: {fault}") from None
    finally:
        opened.close()


def check_chunks(chunks: Sequence[Any]) -> None:
    """`ValueError` where more than `TOGETHER` bytes of an MCAP's chunks overlap in time."""
    ends = [(c.message_start_time, 1, c.uncompressed_size) for c in chunks]
    ends += [(c.message_end_time, 2, -c.uncompressed_size) for c in chunks]
    total = 0
    for _, _, size in sorted(ends):
        total += size
        if total > TOGETHER:
            raise ValueError(f"chunks of more than {TOGETHER} bytes overlap in time")
