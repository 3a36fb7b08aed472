"""Large footprints in HDF5: LVIS L1B and GEDI L1B, a shot a row, by `h5py` where it is installed.

Places are longitude, latitude [degrees] and height [m] of a shot's first and last samples. They are brought into the
UTM zone of the median shot; heights stay those above the ellipsoid. The sample spacing is what the two places tell.

Sources: LVIS Data Structures 1.04 to 2.0.4 (lon0, lat0, z0 and, for samples 0 to N, lonN, latN, zN; rxwave, txwave);
GEDI L1B product data dictionary, versions 1 and 2 (groups BEAMxxxx; indices of samples count from 1).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.errors import InputError
from fwclass.formats.projected import project, utm_of
from fwclass.read.beam_source import LONGEST, BeamRows, Floats, Layout, Ragged
from fwclass.read.hdf5_arrays import array_in, open_hdf5, overstated, reach, rows_of
from fwclass.units import METRES_PER_NS

SIGNATURE = b"\x89HDF\r\n\x1a\n"
BLOCK = 5_000
WIDEST = 10.0
"""Degrees of longitude on either side of the middle, and of latitude, that one plane can hold to 1 %."""

FEWEST_BYTES = 16
"""A shot has at least so many of a file, its places alone have 48; `SHOTS` need not."""
SHOTS = 10_000

GAP = 1_000_000
"""Samples between two shots that are read rather than passed over."""

GEOGRAPHIC = CRS.from_epsg(4979)
NEAR = 0.02
"""A spacing is the round number (half a nanosecond) that it is so near to, as a share; near to none it is wrong."""

RADIANS = (np.pi, 0.5 * np.pi)
"""Longitude and latitude up to which numbers are radians: as degrees they lie in the sea off Africa."""


@dataclass(frozen=True)
class Beam:
    """Shots of one beam: names of the data sets below `group`; `first` is the number of its first shot in the file."""

    group: str
    number: int
    first: int
    shots: int


@dataclass(frozen=True)
class FootprintLayout(Layout):
    """`last` is the number N of the last sample of LVIS, 0 of GEDI; `names` of data sets, in small letters."""

    path: Path
    beams: tuple[Beam, ...]
    last: int
    names: tuple[tuple[str, str], ...]
    spacing: float
    system: str

    @property
    def n_rows(self) -> int:
        return sum(b.shots for b in self.beams)

    def blocks(self) -> Iterator[BeamRows]:
        for first in range(0, self.n_rows, BLOCK):
            yield self.read(first, min(first + BLOCK, self.n_rows))

    def read(self, first: int, last: int) -> BeamRows:
        names, parts = dict(self.names), []
        with open_hdf5(self.path) as file:
            for beam in self.beams:
                a, b = max(first - beam.first, 0), min(last - beam.first, beam.shots)
                if a < b or not self.n_rows:
                    shots = _Shots(self.path, file[beam.group], names, a, max(a, b))
                    parts.append(self._rows(shots, beam))
        return BeamRows.joined(parts)

    def _rows(self, shots: _Shots, beam: Beam) -> BeamRows:
        n = shots.last - shots.first
        ends = np.concatenate([shots.place("first"), shots.place("end")])
        flat = project(GEOGRAPHIC, CRS.from_wkt(self.system), ends, self.path)
        begin, end = flat[:n], flat[n:]
        if self.last:
            samples, outgoing = Ragged.of_table(shots.table("rx")), shots.table_or_none("tx", n)
            count = np.full(n, self.last)
        else:
            samples, outgoing = shots.lists("rx"), shots.lists("tx")
            count = samples.lengths - 1
        with np.errstate(all="ignore"):
            step = (begin - end) / (count * self.spacing)[:, None]
        return BeamRows(
            pulse=np.arange(beam.first + shots.first, beam.first + shots.last),
            anchor=begin,
            step=step,
            begin=np.zeros(n),
            anchor_range=np.full(n, np.nan),
            spacing=np.full(n, self.spacing),
            time=shots.column("time", np.nan),
            channel=np.full(n, beam.number),
            samples=samples,
            outgoing=outgoing,
            outgoing_begin=np.full(n, np.nan),
            unusable=shots.column("stale", 0.0) != 0.0,
        )


@dataclass(frozen=True)
class _Shots:
    """Shots [first, last) of a group."""

    path: Path
    group: Any
    names: Mapping[str, str]
    first: int
    last: int

    def column(self, name: str, otherwise: float) -> Floats:
        if name not in self.names:
            return np.full(self.last - self.first, otherwise)
        data = array_in(self.path, self.group, self.names[name])
        with np.errstate(invalid="ignore"):
            return np.asarray(rows_of(self.path, data, self.first, self.last), np.float64)

    def place(self, which: str) -> Floats:
        """Longitude, latitude, height (n, 3); NaN for what cannot be one."""
        place = np.stack([self.column(f"{axis} {which}", np.nan) for axis in ("lon", "lat", "z")], axis=1)
        with np.errstate(invalid="ignore"):
            sane = (np.abs(place[:, 0]) <= 360.0) & (np.abs(place[:, 1]) <= 90.0) & (np.abs(place[:, 2]) < 1e5)
        place[~sane] = np.nan
        return place

    def table(self, name: str) -> NDArray[Any]:
        return rows_of(self.path, array_in(self.path, self.group, self.names[name]), self.first, self.last)

    def table_or_none(self, name: str, rows: int) -> Ragged:
        return Ragged.of_table(self.table(name)) if name in self.names else Ragged.none(rows)

    def lists(self, name: str) -> Ragged:
        """Samples of every shot; of one whose index lies outside none."""
        n = self.last - self.first
        if name not in self.names:
            return Ragged.none(n)
        data = array_in(self.path, self.group, self.names[name])
        start, count = self.column(f"{name} start", 1.0) - 1.0, self.column(f"{name} count", 0.0)
        sound = (start >= 0) & (count >= 0) & (count <= LONGEST) & (start + count <= data.shape[0])
        at, size = (np.where(sound, v, 0.0).astype(np.int64) for v in (start, count))
        ends = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
        if ends[-1] > data.shape[0]:
            raise InputError(
                "the waveforms of the shots overlap",
                where=f"{self.path}: {data.name}",
                expected=f"at most {data.shape[0]} samples",
                got=int(ends[-1]),
                do="the file is damaged; download it again",
            )
        values = np.empty(int(ends[-1]))
        full = np.flatnonzero(size)
        begin, end = at[full], (at + size)[full]
        if (np.diff(begin) < 0).any():  # every block of shots would read all of the file
            raise InputError(
                "the waveforms of the shots are in another order than the shots",
                where=f"{self.path}: {data.name}",
                expected="start indices that grow",
                do="the file is damaged; download it again",
            )
        gap = max(GAP, data.chunks[0] if data.chunks else 0)
        for run in np.split(np.arange(len(full)), np.flatnonzero(begin[1:] - end[:-1] > gap) + 1):
            if len(run):
                low, rows = int(begin[run[0]]), full[run]
                first, last = ends[rows[0]], ends[rows[-1] + 1]
                places = np.arange(first, last) + np.repeat(at[rows] - low - ends[rows], size[rows])
                with np.errstate(invalid="ignore"):  # signalling NaN of a damaged file
                    values[first:last] = rows_of(self.path, data, low, int(end[run].max()))[places]
        return Ragged(values, ends)


def is_footprints(path: Path) -> bool:
    """It begins as HDF5 does."""
    try:
        with path.open("rb") as stream:
            return stream.read(len(SIGNATURE)) == SIGNATURE
    except OSError:
        return False


def open_footprints(path: Path) -> tuple[FootprintLayout, str, CRS, list[tuple[str, str]]]:
    """The layout, its format, the system that its places are brought into, and what is to be told of it.

    `InputError`: `h5py` is not installed; no HDF5, neither LVIS L1B nor GEDI L1B, a data set is missing or does not fit
    the others; shots too far apart for one plane.
    """
    with open_hdf5(path) as file:
        groups = sorted(k for k in file if re.fullmatch(r"BEAM\d{4}", k) and reach(path, file, f"{k}/rxwaveform"))
        kind = "GEDI L1B" if groups else "LVIS L1B"
        names, last, beams = _gedi(path, file, groups) if groups else _lvis(path, file)
        total, size = sum(b.shots for b in beams), path.stat().st_size
        if total > max(SHOTS, size / FEWEST_BYTES):
            raise overstated(path, f"{total} shots", "shots of some bytes each")
        every = [_Shots(path, file[b.group], names, 0, b.shots) for b in beams]
        first, end = (np.concatenate([shots.place(which) for shots in every]) for which in ("first", "end"))
        samples = np.concatenate([shots.column("rx count", last + 1.0) for shots in every]) - 1.0
        noise = np.concatenate([shots.column("noise", np.nan) for shots in every])
    known = np.isfinite(first).all(axis=1) & np.isfinite(end).all(axis=1) & (samples > 0)
    if not known.any():
        nowhere = utm_of(np.zeros(1), np.zeros(1))
        return FootprintLayout(path, beams, last, tuple(names.items()), 1.0, nowhere.to_wkt()), kind, nowhere, []
    lon, lat = first[known, 0], first[known, 1]
    if np.abs(lon).max() <= RADIANS[0] and np.abs(lat).max() <= RADIANS[1]:
        raise InputError(
            "longitude and latitude look like radians",
            where=path,
            expected="degrees",
            got=f"{lon.min():.6g} to {lon.max():.6g}, {lat.min():.6g} to {lat.max():.6g}: as degrees in the sea",
            do="bring them into degrees first",
        )
    system = utm_of(lon, lat)
    middle = float(np.median(lon % 360.0))
    wide = float(np.abs((lon - middle + 180.0) % 360.0 - 180.0).max())
    if wide > WIDEST or float(np.ptp(lat)) > WIDEST:
        raise InputError(
            "the shots lie too far apart for one plane",
            where=path,
            expected=f"at most {WIDEST:g} degrees",
            got=f"{wide:.1f} degrees of longitude from the middle, {float(np.ptp(lat)):.1f} of latitude",
            do="cut the file to the area of interest first (a subsetting service of its archive)",
        )
    some = np.flatnonzero(known)[:: max(1, int(known.sum()) // 2000)]
    flat = project(GEOGRAPHIC, system, np.concatenate([first[some], end[some]]), path)
    long = np.linalg.norm(flat[: len(some)] - flat[len(some) :], axis=1) / samples[some] / METRES_PER_NS
    spacing = float(np.median(long))
    near = max(0.5, round(2.0 * spacing) / 2.0)
    if abs(spacing / near - 1.0) > NEAR:
        raise InputError(
            "the places of first and last samples do not fit their number",
            where=path,
            expected="half nanoseconds of 0.15 m there and back between samples, to 2 %",
            got=f"{spacing:.4g} ns, {spacing * METRES_PER_NS:.4g} m (median)",
            do="are heights in metres, longitude and latitude in degrees?",
        )
    spacing = near
    notes = [("projected", f"degrees into {system.name}, the zone of the median shot; heights above the ellipsoid")]
    if np.isfinite(noise).any():
        notes.append(("noise", f"{float(np.nanmedian(noise)):.3g} as the file has it (median)"))
    return FootprintLayout(path, beams, last, tuple(names.items()), spacing, system.to_wkt()), kind, system, notes


def _lvis(path: Path, file: Any) -> tuple[dict[str, str], int, tuple[Beam, ...]]:
    there = {name.lower(): name for name in file}
    numbers = [int(m[1]) for name in there if (m := re.fullmatch(r"lon(\d{1,6})", name)) and int(m[1]) > 0]
    last = max(numbers, default=0)
    arrays = {
        **{f"{axis} first": f"{axis}0" for axis in ("lon", "lat", "z")},
        **{f"{axis} end": f"{axis}{last or 'N'}" for axis in ("lon", "lat", "z")},
        "rx": "rxwave",
    }
    names = _named(path, there, arrays, {"tx": "txwave", "time": "time"}, "LVIS L1B")
    shape = array_in(path, file, names["rx"], 2).shape
    if shape[1] != last + 1:
        raise InputError(
            "the last sample's place is not that of the waveforms' last sample",
            where=f"{path}: {names['lon end']}",
            expected=f"waveforms of {last + 1} samples",
            got=f"{shape[1]} in {names['rx']}",
            do="the file is damaged, or of an unknown version",
        )
    if "tx" in names:
        array_in(path, file, names["tx"], 2)
    _same_length(path, file, names, shape[0])
    return names, last, (Beam("/", 0, 0, int(shape[0])),)


def _gedi(path: Path, file: Any, groups: list[str]) -> tuple[dict[str, str], int, tuple[Beam, ...]]:
    arrays = {"rx": "rxwaveform", "rx start": "rx_sample_start_index", "rx count": "rx_sample_count"}
    for axis, long in (("lon", "longitude"), ("lat", "latitude"), ("z", "elevation")):
        arrays |= {f"{axis} first": f"geolocation/{long}_bin0", f"{axis} end": f"geolocation/{long}_lastbin"}
    more = {
        "tx": "txwaveform",
        "tx start": "tx_sample_start_index",
        "tx count": "tx_sample_count",
        "time": "delta_time",
        "stale": "stale_return_flag",
        "noise": "noise_stddev_corrected",
    }
    beams, at = [], 0
    names: dict[str, str] = {}
    for name in groups:
        there = {n: n for n in (*arrays.values(), *more.values()) if reach(path, file[name], n)}
        here = _named(path, there, arrays, more, f"GEDI L1B, {name}")
        names = here if not names else {k: v for k, v in names.items() if k in here}
        shots = int(array_in(path, file[name], here["rx start"]).shape[0])
        _same_length(path, file[name], here, shots)
        beams.append(Beam(name, int(name[4:], 2) if set(name[4:]) <= {"0", "1"} else int(name[4:]), at, shots))
        at += shots
    if not {"tx", "tx start", "tx count"} <= set(names):
        names.pop("tx", None)
    return names, 0, tuple(beams)


def _named(
    path: Path, there: Mapping[str, str], wanted: Mapping[str, str], more: Mapping[str, str], kind: str
) -> dict[str, str]:
    missing = [name for name in wanted.values() if name not in there]
    if missing:
        raise InputError(
            "data sets are missing",
            where=path,
            expected=f"those of {kind}: {', '.join(wanted.values())}",
            got=f"no {', '.join(missing)}",
            do="of LVIS and GEDI the waveforms are in the L1B files; keep all of these data sets when a file is cut",
        )
    return {key: there[name] for key, name in {**wanted, **more}.items() if name in there}


def _same_length(path: Path, group: Any, names: Mapping[str, str], shots: int) -> None:
    for key, name in names.items():
        data = array_in(path, group, name)
        if data.shape[0] != shots and not (key in ("rx", "tx") and len(data.shape) == 1):
            raise InputError(
                "data sets are not equally long", where=f"{path}: {name}", expected=f"{shots} shots", got=data.shape[0]
            )
