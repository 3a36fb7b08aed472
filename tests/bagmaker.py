"""ROS bags of frames by the library's own writers."""

from pathlib import Path

import numpy as np


def _messages(frames, store, ros2):
    types = store.types
    Time, Header, Laser = (
        types[n] for n in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/LaserScan")
    )
    write = store.serialize_cdr if ros2 else store.serialize_ros1
    for f in frames:
        at = 10_000_000_000 + round(1e9 * f.time)
        stamp = Time(sec=at // 10**9, nanosec=at % 10**9)
        head = Header(stamp=stamp, frame_id="") if ros2 else Header(seq=f.number, stamp=stamp, frame_id="")
        scan, none = f.scan, np.zeros(0, np.float32)
        last = scan.first + scan.step * (scan.beams - 1)
        laser = Laser(
            head, scan.first, last, scan.step, 0.0, 0.025, scan.range_min, scan.range_max, np.asarray(f.ranges), none
        )
        yield at, bytes(write(laser, "sensor_msgs/msg/LaserScan"))


def write_bag(path: Path, frames, compression=None) -> None:
    """A ROS 1 bag with one topic of scans; `compression`: bz2, lz4 or None."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if compression:
        writer.set_compression(writer.CompressionFormat[compression.upper()])
    with writer:
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
        for at, raw in _messages(frames, store, False):
            writer.write(connection, at, raw)


def write_bag2(path: Path, frames, storage="sqlite3", compression=None) -> None:
    """A ROS 2 bag; `storage`: sqlite3 or mcap; `compression`: message, file, storage or None."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
        for at, raw in _messages(frames, store, True):
            writer.write(connection, at, raw)
