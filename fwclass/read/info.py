"""What a file holds and what is wrong with it: one streaming pass over its points, and a look for holes in the file of
its packets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError, visible
from fwclass.formats import vector
from fwclass.formats.area_of_use import kind_faults, place_faults, time_faults
from fwclass.formats.checks import first_hole
from fwclass.formats.crs import describe_crs
from fwclass.formats.echo_labels import is_echo_labels
from fwclass.formats.flat import flat_faults
from fwclass.formats.header_counts import MOST, count_faults
from fwclass.formats.linear_units import linear_units
from fwclass.paths import WAVEFORM_ENDINGS
from fwclass.read.beam_info import beam_rows_info, describe_beam_rows
from fwclass.read.beams import beam_fault
from fwclass.read.cloud import first_beams
from fwclass.read.echo_labels_info import describe_echo_labels, echo_labels_info
from fwclass.read.las import LasSource
from fwclass.read.packet_references import References
from fwclass.read.packets import FAULTS, LONGER, REPEATED, longer, looked_into
from fwclass.read.pls_info import describe_pulses, pulse_info
from fwclass.read.points import PointReader, coordinates, gps_times
from fwclass.read.polygons import PARQUET, is_polygon_file
from fwclass.read.polygons_info import describe_polygons, polygon_info
from fwclass.read.projection import at_its_word
from fwclass.read.quantities import quantities_of, words_of
from fwclass.read.return_counts import (
    backward_fault,
    coarse_steps,
    join_lattices,
    lattice_of,
    missing_returns,
    thinned_fault,
    unit_fault,
)
from fwclass.read.segments import Rows, count_repeats
from fwclass.read.source import BeamSource, PulseSource, is_beam_file, las_of, open_source
from fwclass.read.text import is_text
from fwclass.units import finite_or_none

MANY = 100
"""Points from which on it is no accident that all have one intensity or one GPS time, or that their coordinates are
coarser than the file's steps."""

Z_MARGIN = 100.0
"""A point is a z outlier this far [m], plus the spread of the middle 98 %, beyond that middle."""


_ENDINGS = {*WAVEFORM_ENDINGS, *PARQUET, *vector.FORMATS} - {".json"}


@dataclass
class _Tally:
    """What the pass over the points adds up."""

    pairs: NDArray[np.int64] = field(default_factory=lambda: np.zeros((MOST, MOST), np.int64))
    classes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(256, np.int64))
    packets: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(FAULTS), np.int64))
    descriptors: NDArray[np.int64] = field(default_factory=lambda: np.zeros(256, np.int64))
    low: NDArray[np.float64] = field(default_factory=lambda: np.full(3, np.inf))
    high: NDArray[np.float64] = field(default_factory=lambda: np.full(3, -np.inf))
    gps: tuple[float, float] = (np.inf, -np.inf)
    beams: Mapping[str, list[int]] = field(default_factory=dict)
    lattice: list[list[int]] = field(default_factory=lambda: [[], [], []])
    intensity: tuple[int, int] = (65535, 0)
    zero_intensity: int = 0
    flags: dict[str, int] = field(default_factory=lambda: {"withheld": 0, "synthetic": 0})
    heights: dict[int, int] = field(default_factory=dict)
    repeated: int = 0
    longer: int = 0
    before: Rows | None = None

    def add(self, source: LasSource, points: Any, step: float) -> None:
        number = np.minimum(np.asarray(points["return_number"], np.int64), MOST - 1)
        of = np.minimum(np.asarray(points["number_of_returns"], np.int64), MOST - 1)
        pair = np.bincount(number * MOST + of, minlength=MOST**2)
        self.pairs += pair.reshape(MOST, MOST)
        self.classes += np.bincount(np.asarray(points["classification"], np.uint8), minlength=256)
        xyz = coordinates(source, points)
        self.low = np.minimum(self.low, [v.min() for v in xyz])
        self.high = np.maximum(self.high, [v.max() for v in xyz])
        self.lattice = [
            join_lattices([*([old] if old else []), lattice_of(v)]) for old, v in zip(self.lattice, xyz, strict=True)
        ]
        time = gps_times(source, points)
        known = time[np.isfinite(time)]
        if len(known):
            self.gps = min(self.gps[0], float(known.min())), max(self.gps[1], float(known.max()))
        for name in self.flags:
            self.flags[name] += int(np.count_nonzero(points[name]))
        intensity = np.asarray(points["intensity"])
        self.intensity = (min(self.intensity[0], int(intensity.min())), max(self.intensity[1], int(intensity.max())))
        self.zero_intensity += int((intensity == 0).sum())
        for bin_, n in zip(*np.unique(np.floor(xyz[2] / step), return_counts=True), strict=True):
            self.heights[int(bin_)] = self.heights.get(int(bin_), 0) + int(n)
        if source.has_waves:
            refs = References.of(points)
            fault = looked_into(source, refs)
            self.packets += np.bincount(fault, minlength=len(FAULTS))
            self.longer += int(((fault == 0) & longer(source, refs)).sum())
            self.descriptors += np.bincount(refs.descriptor, minlength=256)
            rows = Rows.of_points(source, points)
            self.repeated += count_repeats(source, rows, self.before)
            self.before = rows.take(slice(-1, None))


def files_in(directory: Path) -> tuple[Path, ...]:
    """Files of a directory, not of those below, that `info` knows by their endings; `InputError` where there is none.

    `.json` is not taken for polygons here: most such files are something else.
    """
    files = tuple(sorted(p for p in directory.iterdir() if p.suffix.lower() in _ENDINGS and p.is_file()))
    if not files:
        text = next((p.name for p in sorted(directory.iterdir()) if is_text(p)), None)
        advice = f"; of a text `fwclass ground {text} OUT.laz` makes a file of points" if text else ""
        raise InputError(
            "a directory without files of points, pulses or polygons",
            where=directory,
            expected=f"names that end in {', '.join(sorted(_ENDINGS))}",
            do=f"name the files, or the directory that they lie in{advice}",
        )
    return files


def info(path: str | Path) -> dict[str, Any]:
    """Contents and faults of a file as plain data for JSON.

    One pass over the points (or pulses); memory does not grow with their number. Of a file of polygons its layers,
    fields and their values; of labels by echo their rows and classes.

    `InputError`: the file cannot be read.
    """
    if is_polygon_file(path) and not is_beam_file(path):
        return echo_labels_info(Path(path)) if is_echo_labels(Path(path)) else polygon_info(Path(path))
    opened = at_its_word(open_source(path))
    if isinstance(opened, BeamSource):
        return beam_rows_info(opened)
    return pulse_info(opened) if isinstance(opened, PulseSource) else _las_info(las_of(opened))


def _las_info(source: LasSource) -> dict[str, Any]:
    tally = _Tally()
    step = max(1.0, abs(source.scales[2]) * 1000.0)
    with PointReader(source) as reader:
        extra_names = reader.extra_names
        for _, points in reader.blocks():
            tally.add(source, points, step)
    has_points = source.n_points > 0
    crs = source.crs
    if has_points and (crs is None or crs.is_projected):
        tally.beams = first_beams(source, linear_units(crs, source.header, source.path))
    return {
        "path": str(source.path),
        "size": source.size,
        "version": "{}.{}".format(*source.version),
        "point_format": source.point_format,
        "compressed": source.compressed,
        "copc": source.is_copc,
        "system": source.header.system,
        "software": source.header.software,
        "points": source.n_points,
        "scales": list(source.scales),
        "offsets": list(source.offsets),
        "crs": describe_crs(crs),
        "bounds": [*tally.low.tolist(), *tally.high.tolist()] if has_points else None,
        "header_bounds": [finite_or_none(v) for v in source.bounds],
        "gps_time": list(tally.gps) if np.isfinite(tally.gps[0]) else None,
        "returns": _counts(tally.pairs.sum(axis=1)),
        "numbers_of_returns": _counts(tally.pairs.sum(axis=0)),
        "classes": _counts(tally.classes),
        "flags": {name: n for name, n in tally.flags.items() if n},
        "intensity": {"min": tally.intensity[0], "max": tally.intensity[1], "zero": tally.zero_intensity}
        if has_points
        else None,
        "extra_bytes": extra_names,
        "quantities": quantities_of(source)._asdict(),
        "waveforms": _waveforms(source, tally) if source.has_waves else None,
        "faults": [
            *source.faults,
            *flat_faults(source, tally.low.tolist(), tally.high.tolist()),
            *(place_faults(crs, tally.low.tolist(), tally.high.tolist(), source.header) if has_points else []),
            *(time_faults(*tally.gps) or kind_faults(*tally.gps, source.standard_gps_time)),
            *(count_faults(source.header.stated, tally.pairs.sum(axis=1).tolist()) if has_points else []),
            *_faults(source, tally, step),
            *filter(None, [beam_fault(source), _packet_hole(source)]),
        ],
    }


def _packet_hole(source: LasSource) -> str:
    """The fault of waveform packets that were never written; "" without one."""
    waves = source.waves
    if waves.path is None:
        return ""
    hole = first_hole(waves.path, waves.base, waves.base + waves.available)
    return "" if hole is None else f"a hole of zeros in {waves.path.name}, from byte {hole}: waveforms never written"


def _counts(values: NDArray[np.int64]) -> dict[str, int]:
    return {str(i): int(n) for i, n in enumerate(values) if n}


def _waveforms(source: LasSource, tally: _Tally) -> dict[str, Any]:
    waves = source.waves
    return {
        "where": waves.kind,
        "path": str(waves.path) if waves.path else None,
        "bytes": waves.available,
        "why_not": waves.why_not,
        "usable": int(tally.packets[0]),
        "unusable": {FAULTS[i]: int(n) for i, n in enumerate(tally.packets) if n and i},
        "descriptors": [
            {
                "index": i,
                "bits": d.bits,
                "compression": d.compression,
                "samples": d.n_samples,
                "spacing_ns": finite_or_none(d.spacing_ns),
                "points": int(tally.descriptors[i]),
            }
            for i, d in sorted(source.descriptors.items())
            if not d.empty or tally.descriptors[i]
        ],
        "empty_descriptors": sum(d.empty for d in source.descriptors.values()),
    }


def _faults(source: LasSource, tally: _Tally, step: float) -> list[str]:
    n = source.n_points
    if n == 0:
        return []
    faults = [*_bounds_faults(source, tally)]
    outliers = _z_outliers(tally.heights, step)
    if outliers:
        faults.append(f"{outliers:,} z outliers: points far above or below all others")
    if n >= MANY and (steps := coarse_steps(tally.lattice)):
        faults.append(f"places lie on a lattice, as if they were rounded: {steps} m")
    if fault := unit_fault(tally.beams.get("slants", ())):
        faults.append(f"returns below others of their pulse {fault}")
    if fault := backward_fault(tally.beams.get("following", (0, 0))):
        faults.append(f"{fault}: they are numbered from the ground up")
    if fault := thinned_fault(tally.beams.get("kept", (0, 0))):
        faults.append(f"{fault}: points were thinned one by one, not pulse by pulse")
    if n >= MANY and tally.gps[0] == tally.gps[1]:
        faults.append(f"all GPS times are {_time_text(tally.gps[0])} s: lines and pulses cannot be told by them")
    if tally.zero_intensity:
        share = "all" if tally.zero_intensity == n else f"{tally.zero_intensity:,} of {n:,}"
        faults.append(f"{share} intensities are zero")
    low, high = tally.intensity
    if low == high > 0 and n >= MANY:
        faults.append(f"all {n:,} intensities are {low}: they were not measured; leave features of intensity out")
    if tally.pairs[0].sum():
        faults.append(f"{tally.pairs[0].sum():,} points have return number 0")
    above = int(np.tril(tally.pairs, -1).sum())
    if above:
        faults.append(f"{above:,} points have a return number above their number of returns")
    missing = missing_returns(tally.pairs)
    if missing:
        faults.append(f"at least {missing:,} returns of pulses with several are missing (a cropped or filtered file)")
    if tally.repeated:
        faults.append(f"{tally.repeated:,} of {n:,} returns: {REPEATED}")
    if tally.longer:
        faults.append(f"{tally.longer:,} of {n:,} returns: {LONGER}")
    if source.has_waves and tally.packets[0] < n:
        if tally.packets[0] == 0:
            faults.append("NO WAVEFORM CAN BE READ: the returns alone can be used (read.missing_packets=keep)")
        faults += [f"{c:,} of {n:,} returns: {FAULTS[i]}" for i, c in enumerate(tally.packets) if c and i]
    return faults


def _bounds_faults(source: LasSource, tally: _Tally) -> list[str]:
    low, high = np.array(source.bounds[:3]), np.array(source.bounds[3:])
    slack = 2 * np.abs(source.scales)
    wide = 1.0 + 0.01 * (tally.high - tally.low)
    with np.errstate(invalid="ignore"):
        inside = (tally.low >= low - slack).all() and (tally.high <= high + slack).all()
        tight = (tally.low <= low + wide).all() and (tally.high >= high - wide).all()
    if inside and tight:
        return []
    return ["the header's bounds disagree with the points"]


def _z_outliers(heights: dict[int, int], step: float) -> int:
    """Points beyond the middle 98 % of heights by more than its spread and `Z_MARGIN`."""
    bins = np.array(sorted(heights), np.float64)
    counts = np.array([heights[int(b)] for b in bins])
    share = np.cumsum(counts) / counts.sum()
    low, high = bins[np.searchsorted(share, 0.01)] * step, bins[np.searchsorted(share, 0.99)] * step
    margin = (high - low) + Z_MARGIN
    far = (bins * step < low - margin) | (bins * step > high + margin)
    return int(counts[far].sum())


def describe(info_: dict[str, Any]) -> str:
    """`info` for a terminal."""
    if "layers" in info_:
        return describe_polygons(info_)
    if "labels" in info_:
        return describe_echo_labels(info_)
    crs = info_["crs"]
    rows = [
        ("file", f"{info_['path']}  ({info_['size']:,} bytes)"),
        ("format", format_text(info_)),
        ("written by", " / ".join(t for t in (info_["system"], info_["software"]) if t)),
        ("CRS", f"{crs['name']}" + (f" (EPSG:{crs['epsg']})" if crs["epsg"] else "") if crs else "none"),
        ("bounds", bounds_text(info_["bounds"])),
        ("GPS time", " to ".join(map(_time_text, info_["gps_time"])) + " s" if info_["gps_time"] else "none"),
        *_describe_rest(info_),
    ]
    lines = [f"{name:<12} {visible(text)}" for name, text in rows]
    lines += [f"  ! {visible(fault)}" for fault in info_["faults"]] or ["  no faults found"]
    return "\n".join(lines)


def _time_text(seconds: float) -> str:
    """To the millisecond; a number that is no time at all in short."""
    return f"{seconds:.3f}" if abs(seconds) < 1e12 else f"{seconds:.3g}"


def _describe_rest(info_: dict[str, Any]) -> list[tuple[str, str]]:
    if "rows" in info_:
        return describe_beam_rows(info_)
    return describe_pulses(info_) if "pulses" in info_ else _describe_points(info_)


def format_text(info_: Mapping[str, Any]) -> str:
    """Format, version and point format of what a file holds."""
    if "format" in info_:
        return str(info_["format"])
    if "pulses" in info_:
        return f"PulseWaves {info_['version']}{', compressed' * info_['compressed']}"
    kind = "COPC" if info_["copc"] else "LAZ" if info_["compressed"] else "LAS"
    return f"{kind} {info_['version']}, point format {info_['point_format']}"


def _flags_text(flags: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {n:,}" for name, n in flags.items()) + ": no ground is made of them (read.use_flagged)"


def _describe_points(info_: dict[str, Any]) -> list[tuple[str, str]]:
    waves = info_["waveforms"]
    rows = [
        ("points", f"{info_['points']:,}"),
        ("returns", counts_text(info_["returns"])),
        ("classes", counts_text(info_["classes"])),
        *([("flags", _flags_text(info_["flags"]))] if info_["flags"] else []),
        ("extra bytes", ", ".join(info_["extra_bytes"]) or "none"),
        ("amplitudes", words_of(info_["quantities"]["amplitude"])),
        ("echo widths", words_of(info_["quantities"]["width"])),
    ]
    if waves:
        where = f"{waves['where']}, {waves['bytes']:,} bytes" if waves["where"] != "none" else waves["why_not"]
        rows.append(("waveforms", where))
        rows.append(("packets", f"{waves['usable']:,} returns with a usable one"))
        for d in waves["descriptors"]:
            text = f"{d['index']}: {d['samples']} samples of {d['bits']} bits every {d['spacing_ns']} ns"
            rows.append(("descriptor", f"{text}, {d['points']:,} returns"))
        if waves["empty_descriptors"]:
            rows.append(("", f"and {waves['empty_descriptors']} empty ones"))
    return rows


def bounds_text(bounds: Sequence[float] | None) -> str:
    """``xmin, ymin, zmin, xmax, ymax, zmax`` in words."""
    if bounds is None:
        return "none"
    x0, y0, z0, x1, y1, z1 = bounds
    return f"x {x0:.2f} to {x1:.2f}, y {y0:.2f} to {y1:.2f}, z {z0:.2f} to {z1:.2f}"


def counts_text(counts: Mapping[str, int]) -> str:
    """Counts by what they are of."""
    return ", ".join(f"{key}: {n:,}" for key, n in counts.items()) or "none"
