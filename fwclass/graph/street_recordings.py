"""Recordings as commands open them: placed along a trajectory; a mobile LAS or LAZ cut into frames."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.conf.street import scanner
from fwclass.errors import ConfigError, InputError
from fwclass.formats.linear_units import linear_units
from fwclass.read.las import LasSource, open_las
from fwclass.read.points import PointReader, coordinates, gps_times
from fwclass.read.trajectory import in_survey_time, read_trajectory
from fwclass.schema import Table
from fwclass.street.frames import Frame, Recording, Scan, rotation
from fwclass.street.line_scans import Cutter, Turning, check_falls, check_times, measure_scanner
from fwclass.street.params import StreetParams
from fwclass.street.recording_bag import BagRecording
from fwclass.street.recording_columns import MOST_BEAMS
from fwclass.street.recording_csv import CsvRecording
from fwclass.street.recording_parquet import ParquetRecording
from fwclass.street.soundness import OUTSIDE, SECOND, recording_faults
from fwclass.street.way import LONG

LAS_SUFFIXES = (".las", ".laz")

COURSE = 0.5
"""m of road to each side that the vehicle's course is taken over: a fix's centimetres turn it by a degree."""

KNOT = 0.5
"""m between the fixes that the length of the way is counted by: 2 cm of noise across add a thousandth."""

FLAT = 5.0
"""deg off the scan plane; a course that is a second late in a bend of 20 m at 1 m/s is as far off."""

IN_PLANE = 0.8
"""Share of the points that must lie within `FLAT` of the scan plane."""

NEAR = 1.0
"""m, nearer points tell nothing of the plane."""

UNCLASSIFIED = (0, 1)
"""Codes of LAS for what nobody classified."""


KINDS = "Parquet or CSV of frames, a ROS 1 bag, a ROS 2 bag's directory (sqlite3 or MCAP), a mobile LAS or LAZ"


def open_recording(path: Path, scan: Scan, topic: str | None = None, odometry: str | None = None) -> Recording:
    """The recording at `path`; `scan` holds where it does not say itself, `topic` and `odometry` choose in a bag."""
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return BagRecording(path, scan, topic, odometry)
        raise InputError("this directory is no recording", where=path, expected=KINDS, do="check the path")
    if not path.exists():
        raise InputError("no such recording", where=path, expected=KINDS, do="check the path")
    with path.open("rb") as stream:
        head = stream.read(16)
    if head.startswith(b"#ROSBAG") or path.suffix in (".bag", ".mcap", ".db3"):
        return BagRecording(path, scan, topic, odometry)
    if head.startswith(b"PAR1"):
        return ParquetRecording(path, scan)
    if path.suffix.lower() in (".csv", ".txt"):
        return CsvRecording(path, scan)
    raise InputError(
        "this is no recording that can be read", where=path, expected=KINDS, got=repr(head), do="check the path"
    )


@dataclass(frozen=True)
class TrajectoryFiles:
    """`survey.trajectory`: its files, the system that degrees are brought into, and what is taken from heights [m]."""

    files: tuple[Path, ...] = ()
    crs: str | None = None
    undulation: float = 0.0

    @classmethod
    def of(cls, config: Config) -> TrajectoryFiles:
        """Files relative to survey.directory; `ConfigError` for one that is not there."""
        survey = config.survey
        base = config.path.parent / (survey.directory or ".")
        files = tuple(base / name for name in survey.trajectory.files)
        for path in files:
            if not path.is_file():
                raise ConfigError("no such trajectory", where=f"{config.path}: survey.trajectory.files", got=path)
        return cls(files, survey.crs, survey.trajectory.undulation)

    def way(self, crs: Any = None, times: tuple[float, float] | None = None) -> Way:
        """The way of all files; `times`: first and last of a recording, whose time scale they are brought to."""
        fixes = [read_trajectory(path, crs if crs is not None else self.crs, self.undulation) for path in self.files]
        if times is not None:
            fixes = [in_survey_time(t, *times, where=p) for t, p in zip(fixes, self.files, strict=True)]
        return Way.of(Table.concat(fixes))


NO_TRAJECTORY = TrajectoryFiles()


def _length_along(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """(fixes,) length of the way at each fix (fixes, 2) [m]: between knots `KNOT` apart straight, each fix where it is
    nearest to that line, so that the noise of a hundred fixes a second adds nothing, and who stands stays."""
    knots, last = [0], xy[0]
    for row, place in enumerate(xy):
        if math.hypot(place[0] - last[0], place[1] - last[1]) >= KNOT:
            knots.append(row)
            last = place
    if len(knots) == 1:
        return np.zeros(len(xy))
    step = np.diff(xy[knots], axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    line = np.clip(np.searchsorted(knots, np.arange(len(xy)), "right") - 1, 0, len(step) - 1)
    by = ((xy - xy[knots][line]) * step[line]).sum(axis=1) / length[line]
    by[: knots[-1]] = np.clip(by[: knots[-1]], 0.0, length[line[: knots[-1]]])
    return np.maximum.accumulate(np.concatenate([[0.0], np.cumsum(length)])[line] + by)


@dataclass(frozen=True)
class Way:
    """Where the scanner was: fixes in order of time [s], their coordinates [m], and the length of the way [m]."""

    time: NDArray[np.float64]
    xyz: NDArray[np.float64]
    along: NDArray[np.float64]

    @classmethod
    def of(cls, fixes: Table) -> Way:
        """`fixes`: `gps_time`, `x`, `y`, `z`, in any order."""
        order = np.argsort(fixes["gps_time"], kind="stable")
        xyz = np.stack([fixes[n][order] for n in "xyz"], axis=1)
        return cls(fixes["gps_time"][order], xyz, _length_along(xyz[:, :2]))

    def place(self, time: Any) -> Any:
        """Along the way at some times, straight between fixes; NaN outside the trajectory's time."""
        return np.interp(time, self.time, self.along, math.nan, math.nan)

    def position(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) coordinates at some times; NaN outside the trajectory's time."""
        return np.stack([np.interp(time, self.time, v, math.nan, math.nan) for v in self.xyz.T], axis=1)

    def course(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) unit vectors of the way in plan, over `COURSE` metres to each side; NaN of a way of no length."""
        along, rows = np.unique(self.along, return_index=True)
        place = self.place(time)
        ends = [
            np.stack([np.interp(place + by, along, self.xyz[rows, k]) for k in (0, 1)], axis=1)
            for by in (-COURSE, COURSE)
        ]
        way = ends[1] - ends[0]
        with np.errstate(invalid="ignore", divide="ignore"):
            return way / np.hypot(*way.T)[:, None]


@dataclass(frozen=True)
class OnTrajectory:
    """A recording whose frames are placed along the way of a trajectory: by its length in plan, straight between fixes.

    The trajectory's clock is the frames'. Frames outside its time have no place, and are counted.
    """

    recording: Recording
    trajectory: TrajectoryFiles
    left_out: Counter[str] = field(default_factory=Counter)

    @property
    def about(self) -> Mapping[str, Any]:
        """As `Recording.about`."""
        return self.recording.about

    def frames(self) -> Iterator[Frame]:
        """As `Recording.frames`."""
        way = self.trajectory.way()
        self.left_out.clear()
        for frame in self.recording.frames():
            place = float(way.place(frame.time))
            self.left_out[OUTSIDE] += math.isnan(place)
            yield replace(frame, place=place)


def implausible(
    recording: Recording | None,
    counts: Mapping[str, Any],
    params: StreetParams,
    stream: Mapping[str, int] | None = None,
) -> list[str]:
    """What no sound recording shows (`recording_faults`), after its frames were taken; `counts` of `Track.counts`,
    `stream`: frames of a stream that were lost, by cause."""
    left_out = getattr(recording, "left_out", {})
    rows = recording.source.n_points if isinstance(recording, LasRecording) else counts["frames"]
    what = "points" if isinstance(recording, LasRecording) else "frames"
    return recording_faults(counts, params, left_out, (rows, what), stream or {})


def untested_words(recording: Recording | None, counts: Mapping[str, Any]) -> list[str]:
    """That nothing tells whether a trajectory's places are metres, a sentence; none where something does. `counts` of
    `Track.counts`."""
    facts = counts["sound"]
    if not isinstance(recording, OnTrajectory) or not (facts["place_over_speed"] is facts["stretch"] is None):
        return []
    return [
        f"nothing tells whether the {facts['metres']:,.1f} m of road by the trajectory are metres: the recording has "
        f"no speed, and what stands beside it tells only over {LONG:g} m and more"
    ]


def open_on_trajectory(path: Path, params: StreetParams, trajectory: TrajectoryFiles = NO_TRAJECTORY) -> Recording:
    """The recording at `path`, placed along a trajectory where there is one."""
    if path.suffix.lower() in LAS_SUFFIXES and path.is_file():
        return LasRecording(path, params, trajectory)
    recording = open_recording(path, Scan.of(scanner(params.scanner)), params.topic, params.odometry)
    return OnTrajectory(recording, trajectory) if trajectory.files else recording


@dataclass
class LasRecording:
    """A mobile LAS or LAZ of one 2-D scanner, in order of GPS time, whose scanner drove along a trajectory.

    Ranges and angles follow from where the scanner was at each point's own time, and how the mounting has it on the
    vehicle, whose course is the way's. Later returns of a beam are left out. Classes other than 0 and 1 make labels.
    """

    path: Path
    params: StreetParams
    trajectory: TrajectoryFiles
    left_out: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.source: LasSource = open_las(self.path)
        if not self.source.header.has_gps_time:
            raise self._refused(
                "the points have no GPS time",
                "a point format with times: 1, 3 to 10",
                f"format {self.source.point_format}",
                "export them with times: frames are cut by them",
            )
        if not self.source.n_points:
            raise self._refused("the file has no points", "points", "none", "check the export")
        if not self.trajectory.files:
            raise ConfigError(
                "nothing tells where the scanner was",
                where=self.path,
                expected="survey.trajectory.files: time, x, y, z of the scanner, or SBET",
                got="none",
                do="name them in a configuration and give it: --conf my-street.yaml",
            )
        units = linear_units(self.source.crs, self.source.header, self.path)
        if not units.metres:
            raise self._refused("the coordinates are not metres", "metres", units.source, "reproject the file")

    @cached_property
    def _way(self) -> Way:
        with PointReader(self.source) as reader:
            count = self.source.n_points
            ends = np.concatenate([gps_times(self.source, reader.read(k, k + 1)) for k in {0, count - 1}])
        return self.trajectory.way(self.source.crs, (float(ends.min()), float(ends.max())))

    @cached_property
    def turning(self) -> Turning:
        """How the scanner turns, measured on the first points."""
        with PointReader(self.source) as reader:
            points = next(reader.blocks())[1]
        time, plane, *_ = self._seen(points)
        check_times(time, self.path)
        distance = np.linalg.norm(plane, axis=1)
        far = distance > NEAR
        off = np.degrees(np.arcsin(np.clip(np.abs(plane[far, 0]) / distance[far], 0, 1)))
        share = float(np.mean(off < FLAT)) if far.any() else 0.0
        if share < IN_PLANE:
            raise self._refused(
                "the points do not lie in the plane of a 2-D scanner at the vehicle",
                f"{100 * IN_PLANE:g} % within {FLAT:g}° of it",
                f"{100 * share:.0f} %, half of them within {float(np.median(off)) if len(off) else math.nan:.1f}°",
                "check street.mounting (side, yaw, pitch) and the trajectory's clock; a scanner of many lines is none",
            )
        return measure_scanner(time, self._angle(plane), MOST_BEAMS, self.path)

    @property
    def about(self) -> Mapping[str, Any]:
        """As `Recording.about`."""
        return {
            "kind": "LAZ" if self.source.compressed else "LAS",
            "rows": self.source.n_points,
            "measured": self.turning.summary(),
            "left_out": {name: n for name, n in self.left_out.items() if n},
        }

    def frames(self) -> Iterator[Frame]:
        """As `Recording.frames`."""
        turning, sheet = self.turning, Scan.of(scanner(self.params.scanner))
        self.left_out.clear()
        cutter = Cutter(turning)
        scan = replace(sheet, beams=turning.beams, first=turning.first, step=turning.step)
        number, last = 0, np.empty(0)
        with PointReader(self.source) as reader:
            for _, points in reader.blocks():
                time, plane, codes, light = self._seen(points)
                check_falls(np.concatenate([last, time]), self.path)
                last = time[-1:] if len(time) else last
                of_block = time, self._angle(plane), np.linalg.norm(plane, axis=1), codes, light
                for one in cutter.take(*of_block):
                    yield self._frame(number, cutter, one, scan)
                    number += 1
        for one in cutter.rest():
            yield self._frame(number, cutter, one, scan)
        self.left_out.update({SECOND: cutter.doubled, "beyond the field": cutter.outside})

    def _frame(self, number: int, cutter: Cutter, scan_points: tuple[NDArray[Any], ...], scan: Scan) -> Frame:
        time, ranges, labels, light = cutter.beams(*scan_points)
        labelled = None if np.isin(labels, UNCLASSIFIED).all() else labels
        fixes = self._way.time
        place = float(self._way.place(min(max(time, fixes[0]), fixes[-1])))  # a frame may begin before its first point
        return Frame(number, time, scan, ranges, place=place, labels=labelled, intensities=light)

    def _seen(
        self, points: Any
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8], NDArray[np.uint16]]:
        """Times, coordinates (n, 3) across, along and above the scan plane's zero, codes and intensities of the first
        returns."""
        time = gps_times(self.source, points)
        first = np.asarray(points["return_number"]) <= 1
        timed = np.isfinite(time) & first
        here = np.zeros(len(time), bool)
        here[timed] = np.isfinite(self._way.place(time[timed]))
        self.left_out["later returns"] += int((~first).sum())
        self.left_out[OUTSIDE] += int((first & ~here).sum())
        time, codes = time[here], np.asarray(points["classification"], np.uint8)[here]
        light = np.asarray(points["intensity"], np.uint16)[here]
        away = np.stack(coordinates(self.source, points), axis=1)[here] - self._way.position(time)
        course = self._way.course(time)
        ahead = away[:, 0] * course[:, 0] + away[:, 1] * course[:, 1]
        aside = away[:, 1] * course[:, 0] - away[:, 0] * course[:, 1]
        return time, np.stack([ahead, aside, away[:, 2]], axis=1) @ rotation(self.params.mounting), codes, light

    def _angle(self, plane: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of each point from where the scanner looks, upwards, roll taken off [rad]."""
        side = 1.0 if self.params.mounting.side == "left" else -1.0
        angle = np.arctan2(plane[:, 2], side * plane[:, 1]) - self.params.mounting.rise
        return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)

    def _refused(self, what: str, expected: str, got: str, do: str) -> InputError:
        return InputError(what, where=self.path, expected=expected, got=got, do=do)
