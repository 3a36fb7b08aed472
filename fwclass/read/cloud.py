"""A whole file of points, LAS or text, as a ground filter wants it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from laspy import DecompressionSelection
from numpy.typing import NDArray

from fwclass.errors import ConfigError, InputError
from fwclass.formats.flat import refuse_unless_flat
from fwclass.formats.header_counts import MOST
from fwclass.formats.linear_units import LinearUnits, linear_units
from fwclass.grid import quantise
from fwclass.paths import WAVEFORM_ENDINGS
from fwclass.read.las import LasSource
from fwclass.read.packet_references import References
from fwclass.read.packets import FAULTS, judge
from fwclass.read.points import BLOCK, PointReader, coordinates, flags_of, gps_times, scan_angles
from fwclass.read.return_counts import count_kept, count_pairs, pairs_of, pulses_without_last
from fwclass.read.source import las_of, open_source
from fwclass.read.text import SUFFIXES, TextCloud, is_text, read_text

LAS_SUFFIXES = tuple(WAVEFORM_ENDINGS)

FAR, HIGH = 1e8, 1e5
"""No place on earth has larger coordinates [m], in the plane or in height."""

_FIELDS = (
    DecompressionSelection.XY_RETURNS_CHANNEL
    | DecompressionSelection.Z
    | DecompressionSelection.CLASSIFICATION
    | DecompressionSelection.FLAGS
)
_BEAM_FIELDS = DecompressionSelection.GPS_TIME | DecompressionSelection.SCAN_ANGLE


_CUT = [FAULTS.index(name) for name in ("packet past the end", "packet cut short")]


@dataclass(frozen=True)
class PointCloud:
    """The points of a file, in its order.

    Attributes
    ----------
    path : the file.
    source : the LAS file, or the text.
    crs : a `pyproj.CRS` or None.
    units : what the file counts in.
    x, y, z : (n,) coordinates [m], whole millimetres; NaN where the file has none that can be used.
    usable : bool (n,), it has.
    last : bool (n,), the point is the last, or only, return of its pulse; all are in a text.
    classes : uint8 (n,) class codes as they came, or None.
    flagged : bool (n,), withheld or synthetic.
    unfinished : points without a finite coordinate.
    absurd : points beyond any place on earth.
    beams : what `return_counts.count_pairs` and `count_kept` say of the first points of a LAS file; nothing for a text.
    several, lastless : pulses with several returns of a LAS file, at least, and those whose last one is not there.
    cut_packets : what to tell of waveform packets that reach past the end of the packets there are.
    """

    path: Path
    source: LasSource | TextCloud
    crs: Any
    units: LinearUnits
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    usable: NDArray[np.bool_]
    last: NDArray[np.bool_]
    classes: NDArray[np.uint8] | None
    flagged: NDArray[np.bool_]
    unfinished: int
    absurd: int
    cut_packets: tuple[str, ...] = ()
    beams: Mapping[str, list[int]] = field(default_factory=dict)
    several: int = 0
    lastless: int = 0

    @property
    def points(self) -> int:
        """Number of points, those without coordinates too."""
        return len(self.x)


def read_point_cloud(path: str | Path, crs: Any = None) -> PointCloud:
    """Every point of a LAS, LAZ, COPC or text file.

    `crs`: `pyproj.CRS` that replaces the file's own.

    `ConfigError`: no known kind of file. `InputError`: no such file, damaged, without points, in degrees, geocentric,
    or without a single usable coordinate.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", where=path, expected="a LAS, LAZ, COPC or text file", do="check the path")
    if is_text(path):
        return _of_text(read_text(path), crs)
    if path.suffix.lower() not in LAS_SUFFIXES and not _looks_like_las(path):
        raise ConfigError(
            "the kind of the file is unknown",
            where=path,
            expected=f"a name that ends in {', '.join((*LAS_SUFFIXES, *SUFFIXES))}",
            got=path.suffix or "no suffix",
            do="rename the file, or convert it",
        )
    return _of_las(las_of(open_source(path)), crs)


def _looks_like_las(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"LASF"


def _of_text(text: TextCloud, crs: Any) -> PointCloud:
    units = linear_units(crs, None, text.path)
    xyz = text.x * units.xy, text.y * units.xy, text.z * units.z
    n = len(text.x)
    return _cloud(text.path, text, crs, units, xyz, np.ones(n, bool), text.codes, np.zeros(n, bool))


def _of_las(source: LasSource, crs: Any) -> PointCloud:
    crs = crs if crs is not None else source.crs
    units = linear_units(crs, source.header, source.path)
    if source.n_points == 0:
        raise InputError("the file has no points", where=source.path, do="there is nothing to do; check the delivery")
    parts, cut, pairs = [], 0, np.zeros((MOST, MOST), np.int64)
    fields = _FIELDS | DecompressionSelection.WAVEPACKET if source.has_waves else _FIELDS
    with PointReader(source, fields) as reader:
        for _, points in reader.blocks():
            number, of = np.asarray(points["return_number"]), np.asarray(points["number_of_returns"])
            pairs += pairs_of(number, of)
            flags = flags_of(points)
            if source.has_waves:
                cut += int(np.isin(judge(source, References.of(points)), _CUT).sum())
            parts.append(
                (*coordinates(source, points), number >= of, np.asarray(points["classification"], np.uint8), flags)
            )
    x, y, z, last, classes, flagged = (np.concatenate(column) for column in zip(*parts, strict=True))
    xyz = x * units.xy, y * units.xy, z * units.z
    remarks = (f"{cut:,} of {len(z):,} waveform packets reach past the end of those there are",) if cut else ()
    cloud = _cloud(source.path, source, crs, units, xyz, last, classes, flagged)
    several, lastless = pulses_without_last(pairs)
    beams = first_beams(source, units)
    return replace(cloud, cut_packets=remarks, beams=beams, several=several, lastless=lastless)


def returns_of(cloud: PointCloud) -> dict[str, NDArray[Any]]:
    """Of every point of a LAS file its ``gps_time`` [s], NaN of those without, ``echo_number`` and
    ``number_of_echoes``, its return numbers; nothing of a text, or where there are no times. Reads the file anew."""
    if not isinstance(cloud.source, LasSource) or not cloud.source.header.has_gps_time:
        return {}
    with PointReader(cloud.source, _FIELDS | _BEAM_FIELDS) as reader:
        parts = [
            (gps_times(cloud.source, p), np.asarray(p["return_number"]), np.asarray(p["number_of_returns"]))
            for _, p in reader.blocks()
        ]
    names = ("gps_time", "echo_number", "number_of_echoes")
    return {name: np.concatenate(column) for name, column in zip(names, zip(*parts, strict=True), strict=True)}


def first_beams(source: LasSource, units: LinearUnits) -> dict[str, list[int]]:
    """`return_counts.count_pairs` and `count_kept` of the first points of a file that has some: times and angles are
    else not unpacked."""
    with PointReader(source, _FIELDS | _BEAM_FIELDS) as reader:
        points = reader.read(0, min(source.n_points, BLOCK))
    x, y, z = coordinates(source, points)
    returns = {"x": x * units.xy, "y": y * units.xy, "z": z * units.z, "gps_time": gps_times(source, points)}
    returns |= {name: np.asarray(points[name]) for name in ("return_number", "number_of_returns")}
    kept = {} if source.is_copc else {"kept": count_kept(returns)}
    return count_pairs(returns, scan_angles(source, points)) | kept


def _cloud(
    path: Path,
    source: LasSource | TextCloud,
    crs: Any,
    units: LinearUnits,
    xyz: tuple[NDArray[np.float64], ...],
    last: NDArray[np.bool_],
    classes: NDArray[np.uint8] | None,
    flagged: NDArray[np.bool_],
) -> PointCloud:
    finite = np.logical_and.reduce([np.isfinite(a) for a in xyz])
    usable = finite.copy()
    for values, limit in zip(xyz, (FAR, FAR, HIGH), strict=True):
        usable &= np.abs(values) <= limit
    judged = usable if usable.any() else finite
    if judged.any():
        ends = [[float(f(a[judged])) for a in xyz] for f in (np.min, np.max)]
        step = None if isinstance(source, TextCloud) else max(source.scales[:2])
        refuse_unless_flat(crs, ends[0], ends[1], path, step)
    if not usable.any():
        raise InputError(
            "no point has usable coordinates",
            where=path,
            expected=f"numbers up to {FAR:.0e} m in the plane and {HIGH:.0e} m in height",
            got=f"{int((~finite).sum())} of {len(finite)} are not finite, the others are larger",
            do="check the file's scale and offset (fwclass info), or its columns",
        )
    x, y, z = (np.where(usable, quantise(np.where(usable, a, 0.0)), np.nan) for a in xyz)
    return PointCloud(
        path,
        source,
        crs,
        units,
        x,
        y,
        z,
        usable,
        last,
        classes,
        flagged,
        int((~finite).sum()),
        int((finite & ~usable).sum()),
    )
