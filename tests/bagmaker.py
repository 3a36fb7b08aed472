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


def _odometry(speed, at, store):
    """`nav_msgs/Odometry` that tells a speed along x, in the bytes of ROS 1."""
    t = store.types
    point, turn, vector = (t[f"geometry_msgs/msg/{n}"] for n in ("Point", "Quaternion", "Vector3"))
    pose = t["geometry_msgs/msg/Pose"](point(0.0, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
    twist = t["geometry_msgs/msg/Twist"](vector(speed, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    stamp = t["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
    head = t["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="odom")
    place = t["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
    moves = t["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36))
    message = t["nav_msgs/msg/Odometry"](head, "base", place, moves)
    return bytes(store.serialize_ros1(message, "nav_msgs/msg/Odometry"))


def write_bag(path: Path, frames, compression=None, speeds=(), odometry=("/odom",)) -> None:
    """A ROS 1 bag with one topic of scans; `compression`: bz2, lz4 or None; `speeds` that odometry tells before the
    first frames, on each of the topics `odometry`."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if compression:
        writer.set_compression(writer.CompressionFormat[compression.upper()])
    with writer:
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
        told = odometry if len(speeds) else ()
        wheels = [writer.add_connection(name, "nav_msgs/msg/Odometry", typestore=store) for name in told]
        for k, (at, raw) in enumerate(_messages(frames, store, False)):
            for wheel in wheels if k < len(speeds) else ():
                writer.write(wheel, at - 1, _odometry(float(speeds[k]), at - 1, store))
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
