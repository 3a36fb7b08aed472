"""A mobile LAS cut into frames: the simulator's drive, written as points of a road, comes back as frames."""

import numpy as np
import pytest
from lasmaker import write_las
from streetmaker import config, directory, drive

from fwclass.cli.runner import open_runner
from fwclass.errors import ConfigError, InputError
from fwclass.graph.street_recordings import LasRecording, TrajectoryFiles, open_on_trajectory
from fwclass.single_file.street import batch, online
from fwclass.single_file.street.info import describe, info
from fwclass.single_file.street.output import OURS, SUMMARY
from fwclass.street.track import Track

FRAMES = 60
NORTH = np.radians(30.0)
"""Course of the drive, from x towards y."""
ORIGIN = np.array([500_000.0, 5_400_000.0, 251.8])


def points(frames=FRAMES, dead_time=True, begins=None, yaw=0.0):
    """Times, coordinates and codes of the drive's returns, beam by beam, and the scanner's fixes (time, x, y, z)."""
    forward = np.array([np.cos(NORTH), np.sin(NORTH), 0.0])
    right = np.array([np.sin(NORTH), -np.cos(NORTH), 0.0])
    rows, fixes = [], []
    for k, frame in enumerate(drive()[:frames]):
        begin = 1000.0 + (0.025 * k if begins is None else begins[k])
        place = 1.5 * (begin - 1000.0)
        fixes.append((begin, *(ORIGIN + place * forward)))
        for j in np.flatnonzero(np.isfinite(frame.ranges) & (frame.ranges >= 0.1)):
            angle = frame.scan.first + frame.scan.step * j
            late = 0.025 * j / 1440 if dead_time else 0.0
            here = ORIGIN + (place + 1.5 * late) * forward
            aside = np.sin(yaw) * forward + np.cos(yaw) * right
            way = np.cos(angle) * aside + np.sin(angle) * np.array([0.0, 0.0, 1.0])
            rows.append((begin + late, *(here + frame.ranges[j] * way), frame.labels[j]))
    fixes.append((begin + 0.05, *(ORIGIN + (place + 0.075) * forward)))
    return np.array(rows), np.array(fixes)


@pytest.fixture(scope="module")
def made():
    return points()


def written(folder, rows, fixes, **more):
    write_las(
        folder / "a.las",
        rows[:, 1:4],
        point_format=more.pop("point_format", 6),
        gps_time=rows[:, 0],
        classification=rows[:, 4].astype(int),
        **more,
    )
    text = "\n".join(",".join(f"{v:.6f}" for v in row) for row in fixes)
    (folder / "way.csv").write_text("time,x,y,z\n" + text + "\n")
    return folder / "a.las", TrajectoryFiles((folder / "way.csv",))


def test_frames_are_the_simulators(tmp_path, made):
    path, way = written(tmp_path, *made)
    recording = LasRecording(path, config().street, way)
    frames = list(recording.frames())
    turning = recording.turning
    assert turning.period == pytest.approx(0.025, rel=1e-4)
    assert np.degrees(turning.step) == pytest.approx(0.25, rel=1e-3)
    assert len(frames) == FRAMES
    assert recording.about["measured"]["times"] == "one a beam"
    assert np.diff([f.time for f in frames]) == pytest.approx(0.025, abs=2e-5)
    first = round((turning.first - drive()[0].scan.first) / drive()[0].scan.step)
    for mine, true in zip(frames, drive(), strict=False):
        wanted = np.where(true.ranges >= 0.1, true.ranges, np.nan)[first : first + turning.beams]
        wanted[~np.isfinite(wanted)] = np.nan
        both = np.isfinite(mine.ranges) & np.isfinite(wanted)
        assert both.sum() > 0.99 * np.isfinite(wanted).sum()
        assert np.abs(mine.ranges[both] - wanted[both]).max() < 0.03  # m; a beam's neighbour where noise rounds over
        assert np.median(np.abs(mine.ranges[both] - wanted[both])) < 0.001
        assert (mine.labels[both] == true.labels[first : first + turning.beams][both]).mean() > 0.99
    assert frames[-1].place - frames[0].place == pytest.approx(0.0375 * (FRAMES - 1), abs=0.003)


@pytest.mark.parametrize("laz", [False, True])
def test_one_time_a_frame_and_what_info_tells(tmp_path, laz):
    rows, fixes = points(dead_time=False)
    path, way = written(tmp_path, rows, fixes)
    if laz:
        import laspy

        laspy.read(path).write(tmp_path / "a.laz")
        path = tmp_path / "a.laz"
    told = info(path, config("street.speed=null").street, way)
    assert (told["frames"], told["used"]) == (FRAMES, FRAMES)
    assert told["kind"] == ("LAZ" if laz else "LAS")
    assert told["measured"]["times"] == "one a frame"
    assert told["period_ms"] == pytest.approx([25.0] * 3, abs=0.01)
    assert told["speed"][1] == pytest.approx(1.5, abs=0.05)
    assert "beams every 0.25" in describe(told)


def test_a_scanner_that_is_turned_on_its_mast(tmp_path):
    path, way = written(tmp_path, *points(frames=30, yaw=np.radians(20)))
    frames = list(LasRecording(path, config("street.mounting.yaw=20").street, way).frames())
    assert len(frames) == 30
    first = round((frames[0].scan.first - drive()[0].scan.first) / drive()[0].scan.step)
    for mine, true in zip(frames, drive(), strict=False):
        wanted = true.ranges[first : first + frames[0].scan.beams]
        both = np.isfinite(mine.ranges) & np.isfinite(wanted)
        assert np.median(np.abs(mine.ranges[both] - wanted[both])) < 0.001
    with pytest.raises(InputError, match="do not lie in the plane"):
        list(LasRecording(path, config().street, way).frames())


def test_online_and_whole_give_the_same_bytes(tmp_path, made):
    path, way = written(tmp_path, *made)
    model, params = directory() / "model", config("street.speed=null").street
    summary = online.run(online.Run(str(path), model, tmp_path / "on", False, False, way), params, print)
    (tmp_path / "off").mkdir()
    with open_runner(tmp_path / "store", 0, None, config().run) as runner:
        work = batch.Work(path, model, params.model_copy(update={"chunk": 23}), way)
        batch.classify(work, tmp_path / "off", runner, config())
    assert summary["used"] == FRAMES
    for name in OURS:
        if name != SUMMARY:
            assert (tmp_path / "on" / name).read_bytes() == (tmp_path / "off" / name).read_bytes()


def test_later_returns_are_left_out(tmp_path, made):
    rows, fixes = made
    path, way = written(tmp_path, np.repeat(rows, 2, axis=0), fixes, return_number=np.tile([1, 2], len(rows)))
    recording = LasRecording(path, config().street, way)
    assert len(list(recording.frames())) == FRAMES
    assert recording.about["left_out"]["later returns"] == len(rows)


def test_missing_frames_are_counted_as_dropped(tmp_path, made):
    rows, fixes = made
    number = np.floor((rows[:, 0] - 1000) / 0.025 + 1e-6)
    path, way = written(tmp_path, rows[(number < 20) | (number >= 26)], fixes)
    track = Track(config().street)
    assert sum(track.take(f) is not None for f in open_on_trajectory(path, config().street, way).frames()) == FRAMES - 6
    assert track.counts()["faults"]["dropped before"] == 6


def test_what_is_no_recording_of_a_2d_scanner_is_refused_in_words(tmp_path, made):
    rows, fixes = made
    rng = np.random.default_rng(1)

    def refused(match, changed=rows, way=fixes, kind=InputError, **more):
        path, trajectory = written(tmp_path, changed, way, **more)
        with pytest.raises(kind, match=match):
            list(open_on_trajectory(path, config().street, trajectory).frames())

    refused("no GPS time", point_format=0)
    refused("have one time", np.column_stack([np.full(len(rows), 1000.5), rows[:, 1:]]))
    refused("no order of time", rows[rng.permutation(len(rows))])
    refused("too few points", rows[:100])
    refused("not those of a 2-D scanner", *points(begins=np.cumsum(rng.uniform(0.025, 0.2, FRAMES))))
    everywhere = rows.copy()
    everywhere[:, 1:4] = ORIGIN + rng.uniform(-20, 20, (len(rows), 3))
    refused("do not lie in the plane", everywhere)
    far = fixes.copy()
    far[:, 0] += 1e5
    refused("times|time", rows, far)
    path, _ = written(tmp_path, rows, fixes)
    with pytest.raises(ConfigError, match="where the scanner was"):
        open_on_trajectory(path, config().street)


@pytest.mark.parametrize("digits", [3, 2])
def test_times_that_were_rounded_are_no_frames(tmp_path, made, digits):
    rows, fixes = made
    rows = rows.copy()
    rows[:, 0] = rows[:, 0].round(digits)
    path, way = written(tmp_path, rows, fixes)
    with pytest.raises(InputError, match="too coarse to tell frames"):
        info(path, config("street.speed=null").street, way)


def test_seconds_of_the_week_that_begin_anew_are_told(tmp_path, made):
    rows, fixes = ((part - [1000.75, *np.zeros(part.shape[1] - 1)]) for part in made)
    rows[:, 0] %= 604_800
    fixes[:, 0] %= 604_800
    path, way = written(tmp_path, rows, fixes)
    with pytest.raises(InputError, match=r"the times go back(.|\n)*after 6047"):
        list(LasRecording(path, config().street, way).frames())


def test_times_that_go_back_further_on_are_told(tmp_path, made, monkeypatch):
    rows, fixes = made
    path, way = written(tmp_path, np.concatenate([rows, rows]), fixes)
    monkeypatch.setattr("fwclass.read.points.BLOCK", len(rows))
    recording = LasRecording(path, config().street, way)
    with pytest.raises(InputError, match="the times go back"):
        list(recording.frames())
