"""Reading: a source file to spans of pulses with their returns and waveforms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.crs import units_of
from fwclass.read.beam_read import check_beam_rows, index_beam_rows, read_beam_rows
from fwclass.read.beams import check_beams
from fwclass.read.las_read import check_las, index_las, read_las
from fwclass.read.params import ReadParams as ReadParams
from fwclass.read.pls_read import check_pls, index_pls, read_pls
from fwclass.read.points import PointReader, coordinates, gps_times
from fwclass.read.projection import is_brought, project_places, project_waveforms
from fwclass.read.source import BeamSource, PulseSource, Source, las_of
from fwclass.read.source import open_source as open_source
from fwclass.read.spans import Span
from fwclass.schema import Table
from fwclass.stage import Computation
from fwclass.waveforms import Waveforms

FEWEST_ZEROS, LEVEL = 4, 4
"""Zeros on end that are padding, where no other sample of the waveform is below so many DN: noise reaches 0 in a record
whose level lies there, and a receiver that swings down to 0 behind an echo loses nothing that counts."""

PADDED = "waveform padded with zeros at its end (left out)"


def with_settings(source: Source, params: ReadParams) -> Source:
    """`source` as the settings have it read: with its beams turned round where `params.mirror_beams`, without its
    distances from the sensor unless `params.sensor_ranges`, brought into `params.project_to` where it is in degrees, in
    feet, or geocentric."""
    target = params.project_to if is_brought(source.crs) else None
    return replace(source, mirrored=params.mirror_beams, ranged=params.sensor_ranges, target=target)


def check_source(source: Source, params: ReadParams) -> None:
    """`InputError` if `source` declares waveforms and none can be read, or its beams come from below.

    In a LAS file `params.missing_packets` ``keep`` takes its returns instead; a Pulse file has nothing but waveforms.
    """
    source = with_settings(source, params)
    if source.target is not None and source.crs.is_projected and isinstance(source, BeamSource):
        raise InputError(
            "beams in another unit than metres are brought into metres of LAS and PulseWaves files alone",
            where=source.path,
            expected="metres, or a LAS or PulseWaves file",
            got=f"{source.crs.name}, in {', '.join(units_of(source.crs))}: distances along its beams are too",
            do="export the file in metres, or as LAS with waveforms",
        )
    if isinstance(source, PulseSource):
        check_pls(source)
    elif isinstance(source, BeamSource):
        check_beam_rows(source)
    else:
        check_las(las_of(source), params)
    check_beams(source)


def index_source(source: Source, params: ReadParams) -> list[Span]:
    """Cut `source` into spans of about `params.chunk_pulses` pulses without cutting a pulse.

    `InputError`: points that cannot be read, or a file sorted so that it cannot be cut.
    """
    source = with_settings(source, params)
    if isinstance(source, PulseSource):
        return index_pls(source, params.chunk_pulses)
    if isinstance(source, BeamSource):
        return index_beam_rows(source, params.chunk_pulses)
    return index_las(las_of(source), params)


def read_span(source: Source, span: Span, params: ReadParams, waves: bool = True) -> Waveforms:
    """Returns of `span` in file order, and the waveforms of its pulses that have usable samples; of a LAS file on
    request without `waves`, as if its point format had none.

    See `las_read.read_las`, `pls_read.read_pls` and `beam_read.read_beam_rows`.
    """
    source = with_settings(source, params)
    if isinstance(source, PulseSource):
        read = read_pls(source, span)
    elif isinstance(source, BeamSource):
        read = read_beam_rows(source, span)
    else:
        read = read_las(las_of(source), span, params.use_flagged, waves)
    read = without_padding(read)
    return read if source.target is None else project_waveforms(read, source, source.target)


def read_cloud(path: str | Path, first: int = 0, last: int | None = None, project_to: str | None = None) -> Table:
    """Points [first, last) of a reference cloud: x, y, z [m], gps_time [s], source_class.

    `project_to` is the system that places are brought into where the file's is none of metres on a plane.
    `gps_time` is NaN where the format has none.
    `last` None is the end of the file; a reach beyond the file is cut to it. `InputError` if the file holds no points.
    """
    source = las_of(open_source(path))
    last = source.n_points if last is None else min(last, source.n_points)
    with PointReader(source) as reader:
        points = reader.read(min(first, last), last)
    placed = replace(source, target=project_to if is_brought(source.crs) else None)
    x, y, z = project_places(placed, coordinates(source, points))
    return Table(
        {
            "x": x,
            "y": y,
            "z": z,
            "gps_time": gps_times(source, points),
            "source_class": np.asarray(points["classification"], np.uint8),
        }
    )


READ = Computation("read", 15)


def without_padding(waves: Waveforms) -> Waveforms:
    """`waves` without zeros behind the last sample, as in records of one length whose digitiser stopped earlier; those
    that were padded are counted in `faults`."""
    length = np.diff(waves.offsets)
    rows = np.flatnonzero(length > FEWEST_ZEROS)
    tails = waves.samples[waves.offsets[1:][rows, None] - 1 - np.arange(FEWEST_ZEROS)]
    kept = length.copy()
    for row in rows[~tails.any(axis=1)]:
        kept[row] = _samples_recorded(waves.samples[waves.offsets[row] : waves.offsets[row + 1]])
    padded = int((kept < length).sum())
    if padded == 0:
        return waves
    offsets = np.concatenate([[0], np.cumsum(kept)]).astype(np.int64)
    at = np.arange(offsets[-1]) + np.repeat(waves.offsets[:-1] - offsets[:-1], kept)
    return replace(waves, samples=waves.samples[at], offsets=offsets, faults={**waves.faults, PADDED: padded})


def _samples_recorded(samples: NDArray) -> int:
    """How many of `samples`, whose last ones are 0, are no padding."""
    some = np.flatnonzero(samples)
    n = int(some[-1]) + 1 if len(some) else 0
    return n if n and samples[:n].min() >= LEVEL else len(samples)
