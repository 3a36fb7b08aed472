"""ROS bags: ROS 1, and ROS 2 as sqlite3 or MCAP, with `sensor_msgs/LaserScan`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import ConfigError, InputError, set_words
from fwclass.street.bag_limits import WORK, BagPath, check_chunks, check_files, forget_chunks, limit_library, open_first
from fwclass.street.frames import Frame, Scan
from fwclass.street.recording_columns import MOST_BEAMS, frame_of

SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"

STALE = 1_000_000_000
"""ns after which a speed is none any more: its source has fallen silent."""

LARGEST = 64 << 30
"""Bytes of a bag."""

MESSAGE = 64 + 8 * MOST_BEAMS + 4096
"""Bytes of a scan at most."""


def _is_ros1(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(7) == b"#ROSBAG"


def _storages(reader: Any) -> list[Any]:
    """The files of a ROS 2 bag, as the library reads them."""
    storage = getattr(reader, "storage", None)
    return list(getattr(storage, "storages", [storage]))


class BagRecording:
    """Scans of a topic; the vehicle's speed from `nav_msgs/Odometry`, the last one within `STALE` before a scan, if the
    bag has it."""

    def __init__(self, path: Path, scan: Scan, topic: str | None, odometry: str | None = None) -> None:
        self.path, self._scan = path, scan
        self._ros2 = path.suffix != ".bag" and not _is_ros1(path)
        self._size = sum(p.stat().st_size for p in ([path] if path.is_file() else path.iterdir()) if p.is_file())
        if self._size > LARGEST:
            raise InputError("the bag is too large", where=path, expected=f"at most {LARGEST} bytes", got=self._size)
        with self._open() as reader:
            kinds: dict[tuple[str, str], int] = {}
            for c in reader.connections:
                kind = str(c.topic), str(c.msgtype)
                kinds[kind] = kinds.get(kind, 0) + (c.msgcount if isinstance(c.msgcount, int) else 0)
        scans, speeds = (sorted({t for t, kind in kinds if kind == wanted}) for wanted in (SCAN, ODOMETRY))
        self.topic = self._choose("laser scans", "street.topic", scans, topic, kinds)
        several = speeds or odometry is not None
        self._odometry = self._choose("odometry", "street.odometry", speeds, odometry, kinds) if several else None
        self.about: Mapping[str, Any] = {
            "kind": "ROS bag",
            "topic": self.topic,
            "rows": kinds[self.topic, SCAN],
            "odometry": self._odometry,
            "topics": {f"{t} ({kind})": n for (t, kind), n in sorted(kinds.items())},
        }

    def _choose(
        self, what: str, setting: str, topics: list[str], asked: str | None, kinds: Mapping[tuple[str, str], int]
    ) -> str:
        if asked is None and len(topics) == 1:
            return topics[0]
        if asked in topics:
            return str(asked)
        if not topics:
            raise InputError(
                f"the bag has no {what}",
                where=self.path,
                expected=SCAN if asked is None else asked,
                got=", ".join(f"{t} ({kind})" for t, kind in sorted(kinds)) or "nothing",
                do="record the scanner's topic" if asked is None else f"leave {setting} out",
            )
        if asked is None:
            raise InputError(
                f"the bag has {what} of several topics",
                where=self.path,
                expected="one, or its name",
                got=", ".join(topics),
                do=f"choose one: {set_words(setting, topics[0])}",
            )
        raise ConfigError(f"the bag has no {what} of this topic", where=setting, expected=", ".join(topics), got=asked)

    @contextmanager
    def _open(self) -> Iterator[Any]:
        try:
            from rosbags.rosbag2 import Reader as Two
        except ImportError as fault:
            raise ConfigError(
                "ROS bags are read by the library rosbags", where=self.path, do="pip install 'fwclass[street]'"
            ) from fault
        try:
            limit_library()
            WORK.allow(self._size)
            path = BagPath(self.path)
            if self._ros2:
                check_files(self.path)
            reader = Two(path) if self._ros2 else open_first(path)
            reader.open()
            for storage in _storages(reader):
                check_chunks(getattr(storage, "chunks", ()))
        except Exception as fault:  # the library lets through whatever its parsers raise
            raise self._damaged(fault) from None
        try:
            yield reader
        finally:
            reader.close()
            forget_chunks()

    def frames(self) -> Iterator[Frame]:
        """As `Recording.frames`."""
        from rosbags.typesys import Stores, get_typestore

        speed, speed_at = math.nan, 0
        store = get_typestore(Stores.ROS2_HUMBLE if self._ros2 else Stores.ROS1_NOETIC)  # a bag's own might be anything
        read = store.deserialize_cdr if self._ros2 else store.deserialize_ros1
        with self._open() as reader:
            wanted = [c for c in reader.connections if c.topic in (self.topic, self._odometry)]
            coming = iter(reader.messages(connections=wanted))
            at = 0
            while True:
                try:
                    connection, when, raw = next(coming)
                    if len(raw) > MESSAGE:
                        raise ValueError(f"a message of {len(raw)} bytes")
                    WORK.take(len(raw))
                    message = read(raw, connection.msgtype)
                except StopIteration:
                    break
                except Exception as fault:
                    raise self._damaged(fault, at) from None
                if connection.msgtype == ODOMETRY:
                    speed, speed_at = float(message.twist.twist.linear.x), when
                    continue
                yield self._frame(message, at, speed if when - speed_at <= STALE else math.nan)
                at += 1
        if at < self.about["rows"]:
            raise self._damaged(ValueError(f"its metadata counts {self.about['rows']} messages of {self.topic}"), at)

    def _frame(self, message: Any, at: int, speed: float) -> Frame:
        stamp = message.header.stamp
        numbers = {
            "frame": float(getattr(message.header, "seq", at)),
            "time": stamp.sec + 1e-9 * stamp.nanosec,
            "speed": speed,
            "angle_min": float(message.angle_min),
            "angle_increment": float(message.angle_increment),
            "range_min": float(message.range_min),
            "range_max": float(message.range_max),
        }
        ranges, light = (np.asarray(v, np.float32) for v in (message.ranges, message.intensities))
        lit = light if len(light) == len(ranges) else None  # many drivers leave them out
        return frame_of(at, numbers, ranges, None, self._scan, self.path, lit)

    def _damaged(self, fault: Exception, at: int = -1) -> InputError:
        return InputError(
            "the bag cannot be read" + (f" further than frame {at}" if at >= 0 else ""),
            where=self.path,
            expected="a whole ROS 1 bag, or a ROS 2 bag's directory",
            got=f"{type(fault).__name__}: {fault}"[:300],
            do="it is cut short or damaged: `rosbag reindex`, `ros2 bag reindex`, or copy it again",
        )
