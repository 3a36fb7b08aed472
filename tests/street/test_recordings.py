"""Doors: Parquet, CSV, bags; frames that cannot be used are counted, files that cannot be read are told."""

import math
import os
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from bagmaker import write_bag
from streetmaker import config, drive

from fwclass.errors import ConfigError, InputError
from fwclass.graph.street_recordings import open_recording
from fwclass.single_file.street.info import info
from fwclass.street.frames import Frame, Scan
from fwclass.street.recording_parquet import ParquetRecording, write_recording
from fwclass.street.soundness import recording_faults
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track

SCAN = Scan(1081, -2.356, 0.00436, 0.1, 30.0)


def taken(frames, **changed):
    track = Track(config().street.model_copy(update=changed))
    return [p for f in frames if (p := track.take(f)) is not None], track


def test_the_public_bag(shared_data):
    made = info(shared_data / "street" / "sick_lms1xx.bag", config("street.speed=null").street)
    assert (made["frames"], made["used"], made["scan"]["beams"]) == (89, 89, 541)
    assert made["missing"]["below range_min"] == 6220
    assert made["returns"] == 48149 - 6220
    assert made["topic"] == "/sick_lms_1xx/scan"
    assert made["period_ms"] == pytest.approx([19.806, 20.005, 20.533], abs=0.01)
    assert any("12.9 %" in text for text in made["remarks"])


@pytest.mark.parametrize("share", [0.05, 0.3, 0.7, 0.98])
def test_a_bag_that_was_cut_is_told(tmp_path, shared_data, share):
    data = (shared_data / "street" / "sick_lms1xx.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match="bag"):
        list(open_recording(tmp_path / "cut.bag", SCAN).frames())


def laser_bag(path, topics, ros2=False):
    """A bag by the library's own writer, with two scans of three beams on every topic."""
    from rosbags.rosbag1 import Writer as One
    from rosbags.rosbag2 import Writer as Two
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE if ros2 else Stores.ROS1_NOETIC)
    types = store.types
    Time, Header, Laser = (
        types[n] for n in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/LaserScan")
    )
    with Two(path, version=9) if ros2 else One(path) as writer:
        for topic, kind in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for k in range(2):
                stamp = Time(sec=10, nanosec=k * 25_000_000)
                head = Header(stamp=stamp, frame_id="") if ros2 else Header(seq=k, stamp=stamp, frame_id="")
                ranges = np.array([1.0, np.inf, 0.01], np.float32)
                scan = Laser(head, -0.1, 0.1, 0.1, 0.0, 0.025, 0.1, 30.0, ranges, np.zeros(0, np.float32))
                message = scan if kind.endswith("LaserScan") else head
                raw = store.serialize_cdr(message, kind) if ros2 else store.serialize_ros1(message, kind)
                writer.write(connection, 10_000_000_000 + k, raw)


@pytest.mark.parametrize("ros2", [False, True])
def test_bags_of_both_kinds(tmp_path, ros2):
    bag = tmp_path / ("directory" if ros2 else "one.bag")
    laser_bag(bag, {"/scan": "sensor_msgs/msg/LaserScan"}, ros2)
    frames = list(open_recording(bag, SCAN).frames())
    assert [f.time for f in frames] == pytest.approx([10.0, 10.025])
    assert frames[0].scan.beams == 3
    if not ros2:
        bag.rename(tmp_path / "copy.orig")
        assert len(list(open_recording(tmp_path / "copy.orig", SCAN).frames())) == 2
    placed, track = taken(frames)
    assert len(placed) == 2
    assert track.counts()["missing"] == {"below range_min": 2, "above range_max": 0, "NaN": 0, "infinite": 2}


def test_odometry_that_falls_silent_tells_no_speed(tmp_path):
    """The last speed was held to the end of the drive, and nobody was told."""
    for name, told in (("whole", len(drive())), ("silent", 20)):
        write_bag(tmp_path / f"{name}.bag", drive(), speeds=[f.speed for f in drive()[:told]])
        facts = info(tmp_path / f"{name}.bag", config("street.speed=null").street)
        without = facts["faults"].get("no speed", 0)
        assert without == 0 if name == "whole" else len(drive()) - 70 < without < len(drive()) - 50
        assert any("speed" in remark for remark in facts["remarks"]) == (name == "silent"), facts["remarks"]


def test_a_bag_with_two_topics_of_odometry_asks_for_one(tmp_path):
    """The first by the alphabet was taken, without a word."""
    write_bag(tmp_path / "two.bag", drive(), speeds=[1.0, 1.0], odometry=("/a", "/odom"))
    with pytest.raises(InputError, match=r"(?s)odometry of several topics.*street.odometry=/a"):
        open_recording(tmp_path / "two.bag", SCAN)
    assert open_recording(tmp_path / "two.bag", SCAN, None, "/odom").about["odometry"] == "/odom"
    with pytest.raises(ConfigError, match="no odometry of this topic"):
        open_recording(tmp_path / "two.bag", SCAN, None, "/b")
    write_bag(tmp_path / "none.bag", drive())
    with pytest.raises(InputError, match="no odometry"):
        open_recording(tmp_path / "none.bag", SCAN, None, "/b")


def test_a_bag_with_no_or_two_topics_of_scans(tmp_path):
    scan = "sensor_msgs/msg/LaserScan"
    laser_bag(tmp_path / "two.bag", {"/a": scan, "/b": scan})
    with pytest.raises(InputError, match=r"(?s)several topics.*street.topic=/a"):
        open_recording(tmp_path / "two.bag", SCAN)
    assert len(list(open_recording(tmp_path / "two.bag", SCAN, "/b").frames())) == 2
    laser_bag(tmp_path / "none.bag", {"/h": "std_msgs/msg/Header"})
    with pytest.raises(InputError, match="no laser scans"):
        open_recording(tmp_path / "none.bag", SCAN)


def test_parquet_gives_back_what_was_written(tmp_path):
    write_recording(tmp_path / "r.parquet", drive()[:40])
    back = list(open_recording(tmp_path / "r.parquet", SCAN).frames())
    for a, b in zip(drive()[:40], back, strict=True):
        assert (a.number, a.time, a.scan) == (b.number, b.time, b.scan)
        assert np.array_equal(a.ranges, b.ranges, equal_nan=True)
        assert np.array_equal(a.labels, b.labels)


def test_beams_that_turn_downwards_are_turned_round(tmp_path):
    """As drivers say that a scanner hangs the other way up; a bag's user could not reverse its ranges."""
    frames = [replace(f, intensities=np.arange(1081, dtype=np.float32)) for f in drive()[:3]]
    write_recording(tmp_path / "up.parquet", frames)
    table = pq.read_table(tmp_path / "up.parquet")
    for name in ("ranges", "labels", "intensities"):
        turned = pa.array([row[::-1] for row in table[name].to_pylist()], table.schema.field(name).type)
        table = table.set_column(table.schema.get_field_index(name), name, turned)
    scan = frames[0].scan
    for name, value in (("angle_min", scan.first + 1080 * scan.step), ("angle_increment", -scan.step)):
        table = table.append_column(name, pa.array([value] * len(table)))
    pq.write_table(table, tmp_path / "down.parquet")
    for one, other in zip(frames, ParquetRecording(tmp_path / "down.parquet", scan).frames(), strict=True):
        assert one.scan.like(other.scan) and np.array_equal(one.ranges, other.ranges, equal_nan=True)
        assert np.array_equal(one.labels, other.labels) and np.array_equal(one.intensities, other.intensities)


def test_csv(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("time,speed,angle_min,angle_increment,ranges\n0,1.5,-0.1,0.1,1,nan,2\n0.1,,-0.1,0.1,1,,inf\n")
    frames = list(open_recording(path, SCAN).frames())
    assert [f.time for f in frames] == [0.0, 0.1]
    assert frames[0].speed == 1.5
    assert math.isnan(frames[1].speed)
    assert frames[0].scan.beams == 3
    for text, match in (
        ("time,velocity,ranges\n0,1,1\n", "a column is unknown"),
        ("time,ranges\n0,1,x\n", "a line cannot be read"),
        ("time,ranges\n0\n", "a line cannot be read"),
        ("speed,ranges\n0,1\n", "a column is missing"),
        ("time,ranges,speed\n0,1\n", "does not end with ranges"),
        ("time,ranges,intensities\n0,1,2,3\n", "a line cannot be read"),
        ("time,ranges,labels\n0,1,5.5\n", "a label is no class code"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=match):
            list(open_recording(path, SCAN).frames())


def test_csv_with_labels_and_intensities(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("time;labels;ranges;intensities\n0;5;;1;inf;200;\n1;5;1;2;3;4\n")
    read = open_recording(path, SCAN).frames()
    frame = next(read)
    assert frame.ranges.tolist() == [1.0, math.inf] and frame.labels.tolist() == [5, 0]
    assert frame.intensities[0] == 200.0 and math.isnan(frame.intensities[1])
    with pytest.raises(InputError, match=r"line 3(.|\n)*1 to 30000 labels and as many ranges and as many intensities"):
        next(read)


def test_damaged_parquet_is_told(tmp_path):
    write_recording(tmp_path / "r.parquet", drive()[:10])
    data = (tmp_path / "r.parquet").read_bytes()
    rng = np.random.default_rng(3)
    for k in range(60):
        broken = bytearray(data)
        for at in rng.integers(0, len(data), 4):
            broken[at] = rng.integers(0, 256)
        (tmp_path / "b.parquet").write_bytes(broken[: len(data) - 50 * (k % 3)])
        try:
            for frame in open_recording(tmp_path / "b.parquet", SCAN).frames():
                assert len(frame.ranges) <= 30_000
        except InputError:
            pass


def test_frames_that_cannot_be_used_are_counted():
    frames = list(drive()[:30])
    frames[5] = replace(frames[5], time=frames[3].time)  # out of order
    frames[8] = replace(frames[8], time=frames[7].time)  # doubled
    frames[10] = replace(frames[10], ranges=frames[10].ranges[:500])
    frames[12] = replace(frames[12], scan=replace(frames[12].scan, first=0.0))
    frames[15] = replace(frames[15], ranges=np.full(1081, np.inf, np.float32))  # blind
    del frames[20:23]
    placed, track = taken(frames)
    told = track.counts()
    assert told["faults"] == {"out of order": 1, "doubled": 1, "other beams": 2, "dropped before": 3 + 4}
    assert len(placed) == told["used"] == 23
    assert told["blind"] == 1


@pytest.mark.parametrize(("kept", "dropped"), [([0, 1], 9), ([0, 2], 9), ([0], 0)])
def test_frames_that_are_missing_again_and_again_are_counted(kept, dropped):
    frames = [f for k, f in enumerate(drive()[:30]) if k % 3 in kept]
    counted = taken(frames)[1].counts()["faults"].get("dropped before", 0)
    assert dropped - 1 <= counted <= dropped  # the first step alone tells of none; of each third nothing tells
    noise = np.random.default_rng(1).uniform(-0.4, 0.4, len(frames))
    late = [replace(f, time=f.time + 0.025 * e) for f, e in zip(frames, noise, strict=True)]
    assert taken(late)[1].counts()["faults"].get("dropped before", 0) <= dropped + 3


def test_a_clock_that_leaps_and_a_vehicle_that_goes_back():
    frames = [replace(f, speed=2.0 if k < 6 else -2.0) for k, f in enumerate(drive()[:12])]
    frames = [replace(f, time=f.time + (1e6 if k >= 9 else 0.0) * (-1)) for k, f in enumerate(frames)]
    placed, track = taken(frames)
    assert len(placed) == 12
    assert track.counts()["faults"] == {"clock leaps": 1, "reversing": 6}
    assert placed[5].place > placed[11].place


@pytest.mark.parametrize("placed", ["every other", "all but three seconds", "from the second on"])
def test_places_and_speeds_that_take_turns_count_the_road_once(placed):
    """The way by speed was added, and then the way between places again: 41.5 m of road for 27.75."""
    scan = Scan(2, 0.0, 0.1, 0.1, 30.0)
    chosen = {
        "every other": lambda k: k % 2 == 0,
        "all but three seconds": lambda k: not 100 < k < 220,
        "from the second on": lambda k: k > 40,
    }[placed]
    track = Track(config("street.speed=null").street)
    ways = []
    for k in range(400):
        speed, place = (math.nan, 7.0 + 0.025 * k) if chosen(k) else (1.0, math.nan)
        ways.append(track.take(Frame(k, 0.025 * k, scan, np.full(2, 5.0, np.float32), speed, place)).place * UNIT)
    assert ways[-1] - ways[0] == pytest.approx(0.025 * 399, abs=0.002)
    assert np.ptp(np.diff(ways)) < 0.003
    assert track.counts()["faults"] == {}


@pytest.mark.parametrize("limits", [(0.1, 5.0), (2.0, 30.0), (0.1, math.inf)])
def test_frames_with_other_limits_are_left_out(limits):
    """Ranges beyond a frame's own `range_max` were returns, where the first frame's was greater."""
    frames = [replace(f, scan=replace(f.scan, range_max=30.0, range_min=0.1)) for f in drive()[:40]]
    mixed = [replace(f, scan=Scan(f.scan.beams, f.scan.first, f.scan.step, *limits)) for f in frames]
    placed, track = taken([a if k % 2 == 0 else b for k, (a, b) in enumerate(zip(frames, mixed, strict=True))])
    assert len(placed) == 20 and track.counts()["faults"]["other limits"] == 20
    faults = recording_faults(track.counts(), track.params, {}, (40, "frames"), {})
    assert any("20 other limits" in text for text in faults), faults


def test_a_speed_between_places_is_held_against_them():
    """In km/h, every other frame: the vehicle would go back and forth."""
    scan, track = Scan(2, 0.0, 0.1, 0.1, 30.0), Track(config("street.speed=null").street)
    for k in range(400):
        speed, place = (math.nan, 0.025 * k) if k % 2 == 0 else (3.6, math.nan)
        track.take(Frame(k, 0.025 * k, scan, np.full(2, 5.0, np.float32), speed, place))
    assert track.counts()["sound"]["place_over_speed"] == pytest.approx(1 / 3.6, rel=0.01)


def test_speed_that_is_nowhere():
    bare = [replace(f, speed=math.nan) for f in drive()[:5]]
    with pytest.raises(InputError, match="nothing tells how the vehicle moved"):
        taken(bare, speed=None)
    placed, _ = taken(bare, speed=2.0)
    assert placed[4].place == pytest.approx(4 * 0.025 * 2.0 * 1024, abs=1)
    given = [replace(f, place=10.0 + 0.1 * k) for k, f in enumerate(bare)]
    placed, _ = taken(given, speed=None)
    assert placed[0].place == 10240
    assert placed[4].place == pytest.approx(10.4 * 1024, abs=1)


def test_the_height_of_the_road_is_found():
    placed, _ = taken(drive()[:40], features="height")
    assert np.median([p.road for p in placed]) == pytest.approx(-1.8, abs=0.05)


def chunked(path, ros2, compression, ranges=300):
    """A bag of one chunk whose scans are all alike, so that it is compressed a thousandfold."""
    from rosbags.rosbag1 import Writer as One
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Two
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE if ros2 else Stores.ROS1_NOETIC)
    types = store.types
    Time, Header, Laser = (
        types[n] for n in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/LaserScan")
    )
    writer = Two(path, version=9, storage_plugin=StoragePlugin.MCAP) if ros2 else One(path)
    if ros2:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    else:
        writer.set_compression(getattr(writer.CompressionFormat, compression))
        writer.chunk_threshold = 1 << 30
    with writer:
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
        for k in range(ranges):
            stamp = Time(sec=10, nanosec=k * 25_000)
            head = Header(stamp=stamp, frame_id="") if ros2 else Header(seq=k, stamp=stamp, frame_id="")
            values = np.full(10_000, np.inf, np.float32)
            scan = Laser(head, -0.1, 0.0001, 0.0001, 0.0, 0.025, 0.1, 30.0, values, np.zeros(0, np.float32))
            write = store.serialize_cdr if ros2 else store.serialize_ros1
            writer.write(connection, 10_000_000_000 + k, write(scan, "sensor_msgs/msg/LaserScan"))


@pytest.mark.parametrize(("ros2", "compression"), [(False, "BZ2"), (False, "LZ4"), (True, "ZSTD")])
def test_a_decompression_bomb_is_refused_before_memory_is_taken(tmp_path, monkeypatch, ros2, compression):
    import tracemalloc

    from fwclass.street import bag_limits

    monkeypatch.setattr(bag_limits, "CHUNK", 1 << 19)  # below the 1 MB of an MCAP writer
    bag = tmp_path / ("directory" if ros2 else "one.bag")
    chunked(bag, ros2, compression)
    size = sum(p.stat().st_size for p in ([bag] if bag.is_file() else bag.iterdir()))
    assert size < 1 << 20  # of 12 MB
    tracemalloc.start()
    with pytest.raises(InputError, match=r"more than|overlap"):
        list(open_recording(bag, SCAN).frames())
    assert tracemalloc.get_traced_memory()[1] < 6 << 20
    tracemalloc.stop()
    monkeypatch.undo()
    assert len(list(open_recording(bag, SCAN).frames())) == 300


def test_a_bag_that_holds_fewer_frames_than_it_counts_is_told(tmp_path):
    """A database that was cut between two writes is a whole one: what its metadata counts tells."""
    import sqlite3

    from bagmaker import write_bag2

    write_bag2(tmp_path / "bag", drive()[:6], "sqlite3", None)
    assert list(open_recording(tmp_path / "bag", SCAN).frames())
    (database,) = (tmp_path / "bag").glob("*.db3")
    with sqlite3.connect(database) as opened:
        opened.execute("DELETE FROM messages WHERE id > (SELECT max(id) - 2 FROM messages)")
    opened.close()
    with pytest.raises(InputError, match="metadata counts"):
        list(open_recording(tmp_path / "bag", SCAN).frames())


def test_a_database_that_computes_is_refused(tmp_path):
    import sqlite3

    laser_bag(tmp_path / "bag", {"/scan": "sensor_msgs/msg/LaserScan"}, True)
    (database,) = (tmp_path / "bag").glob("*.db3")
    opened = sqlite3.connect(database)
    opened.execute("ALTER TABLE messages RENAME TO held")
    opened.execute("CREATE VIEW messages AS SELECT * FROM held")
    opened.commit()
    opened.close()
    with pytest.raises(InputError, match="view"):
        open_recording(tmp_path / "bag", SCAN)


@pytest.mark.parametrize("hidden", ["name", "compressed"])
def test_a_database_that_computes_is_refused_under_any_name(tmp_path, hidden):
    import sqlite3

    from bagmaker import write_bag2

    write_bag2(tmp_path / "bag", drive()[:3], "sqlite3", None)
    (database,) = (tmp_path / "bag").glob("*.db3")
    about = tmp_path / "bag" / "metadata.yaml"
    with sqlite3.connect(database) as opened:
        opened.execute("ALTER TABLE messages ADD COLUMN more AS (zeroblob(900000000))")
    opened.close()
    text = about.read_text()
    if hidden == "name":
        name = "x.sqlite"
        database.rename(database.with_name(name))
    else:
        from backports import zstd

        name = database.name + ".zstd"
        database.with_name(name).write_bytes(zstd.compress(database.read_bytes()))
        text = text.replace("compression_format: ''", "compression_format: zstd")
        text = text.replace("compression_mode: ''", "compression_mode: FILE")
    about.write_text(text.replace(database.name, name))
    database.unlink(missing_ok=True)
    with pytest.raises(InputError, match="generated columns"):
        list(open_recording(tmp_path / "bag", SCAN).frames())


@pytest.mark.parametrize(
    ("statement", "words"), [("twice", "topics of"), ("<<", "merges mappings"), ("pipe", "a pipe")]
)
def test_a_bag_that_is_read_many_times_over_is_refused(tmp_path, statement, words):
    import sqlite3

    from bagmaker import write_bag2

    write_bag2(tmp_path / "bag", drive()[:3], "sqlite3", None)
    (database,) = (tmp_path / "bag").glob("*.db3")
    if statement == "pipe":
        os.mkfifo(tmp_path / "bag" / "x.mcap")
    elif statement == "<<":
        with (tmp_path / "bag" / "metadata.yaml").open("a") as about:
            about.write("a: &a {b: 1}\nc: {<<: [*a, *a]}\n")
    else:
        with sqlite3.connect(database) as opened:
            columns = [row[1] for row in opened.execute("PRAGMA table_info(topics)")]
            opened.execute(f"CREATE TABLE other({', '.join(columns)})")
            for _ in range(2):
                opened.execute("INSERT INTO other SELECT * FROM topics")
            opened.execute("DROP TABLE topics")
            opened.execute("ALTER TABLE other RENAME TO topics")
        opened.close()
    with pytest.raises(InputError, match=words):
        list(open_recording(tmp_path / "bag", SCAN).frames())


def test_a_column_that_is_there_twice_is_refused(tmp_path):
    table = pa.Table.from_arrays([pa.array([0.0]), pa.array([1.0]), pa.array([[1.0, 2.0]])], ["time", "time", "ranges"])
    pq.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(InputError, match="there twice"):
        open_recording(tmp_path / "a.parquet", SCAN)


def test_a_bag_with_types_that_nobody_knows_is_read(tmp_path, shared_data):
    """The definitions of its other topics are not needed."""
    data = (shared_data / "street" / "sick_lms1xx.bag").read_bytes()
    (tmp_path / "a.bag").write_bytes(data.replace(b"float32", b"flaot32"))
    assert len(list(open_recording(tmp_path / "a.bag", SCAN).frames())) == 89


@pytest.mark.parametrize(
    ("storage", "compression"),
    [("sqlite3", None), ("sqlite3", "message"), ("sqlite3", "file"), ("mcap", None), ("mcap", "storage")],
)
def test_ros2_bags_of_every_storage(tmp_path, storage, compression):
    from bagmaker import write_bag2

    write_bag2(tmp_path / "bag", drive()[:5], storage, compression)
    back = list(open_recording(tmp_path / "bag", SCAN).frames())
    assert len(back) == 5
    for one, true in zip(back, drive(), strict=False):
        assert np.array_equal(one.ranges, true.ranges, equal_nan=True)
    if storage == "mcap":
        (file,) = (tmp_path / "bag").glob("*.mcap")
        assert len(list(open_recording(file, SCAN).frames())) == 5


@pytest.mark.parametrize(
    ("column", "values", "words"),
    [
        ("labels", pa.array([[261, 0]]), "a label is no class code(.|\n)*261"),  # was 5
        ("labels", pa.array([[-251, 0]]), "a label is no class code"),
        ("labels", pa.array([[5.7, 0.0]]), "a label is no class code"),
        ("labels", pa.array([[math.nan, 0.0]]), "a label is no class code"),
        ("frame", pa.array([1e300]), "a frame has a number that none has"),  # an overflow where it was written
        ("frame", pa.array([2**64 - 1], pa.uint64()), "a frame has a number that none has"),
    ],
)
def test_numbers_that_would_become_others_are_refused(tmp_path, column, values, words):
    columns = {"time": pa.array([0.0]), "ranges": pa.array([[1.0, 2.0]]), column: values}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    with pytest.raises(InputError, match=words):
        list(open_recording(tmp_path / "a.parquet", SCAN).frames())


def test_labels_of_a_wider_type_are_read(tmp_path):
    columns = {"time": pa.array([0.0]), "ranges": pa.array([[1.0, 2.0]]), "labels": pa.array([[5.0, None]])}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    (frame,) = open_recording(tmp_path / "a.parquet", SCAN).frames()
    assert frame.labels.tolist() == [5, 0]
