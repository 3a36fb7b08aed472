"""Opening a source file: which format it is, and what it says of itself."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from fwclass.errors import InputError
from fwclass.formats.epsg import epsg_of
from fwclass.read.base import Source as Source
from fwclass.read.beam_formats import PARQUET, open_beam_file
from fwclass.read.beam_formats import is_beam_file as is_beam_file
from fwclass.read.beam_source import BeamSource as BeamSource
from fwclass.read.footprints import FootprintLayout
from fwclass.read.las import LasSource as LasSource
from fwclass.read.las import open_las
from fwclass.read.pulsewaves import PulseSource as PulseSource
from fwclass.read.pulsewaves import is_pulse_file, open_pls

RDB = ".rdbx"
"""Ending of RIEGL's databases of points, which none but the vendor's library reads."""


def open_source(path: str | Path) -> Source:
    """Look at a file without reading its points or pulses.

    `InputError`: no file of a known format, empty, cut short, or a header that contradicts the file.
    """
    path = Path(path)
    if path.suffix.lower() == RDB:
        raise InputError(
            "RIEGL's database of points (RDB) is not read",
            where=path,
            expected="LAS 1.4 with waveform packets, PulseWaves, or RIEGL's .sdf",
            got=path.name,
            do="export LAS 1.4 with waveforms from RIEGL's software, or give the recordings (.sdf; docs/waveforms.md)",
        )
    if path.suffix.lower() in PARQUET or is_beam_file(path):
        return open_beam_file(path)
    return open_pls(path) if is_pulse_file(path) else open_las(path)


def las_of(source: Source) -> LasSource:
    """`source` as a file of points; `InputError` if it is none."""
    if isinstance(source, LasSource):
        return source
    raise InputError(
        "the file holds pulses, not points",
        where=source.path,
        expected="a LAS, LAZ or COPC file",
        got=source.path.name,
        do=f"decompose it first: fwclass decompose {shlex.quote(source.path.name)} OUT.laz",
    )


def refuse_other_system(source: Source, crs: Any) -> None:
    """`InputError` where a user names another system than the one that `source`, in degrees, was brought into."""
    if crs is None or not isinstance(source, BeamSource) or not isinstance(source.layout, FootprintLayout):
        return
    if not crs.equals(source.crs, ignore_axis_order=True) and epsg_of(crs.to_2d()) != epsg_of(source.crs):
        raise InputError(
            "the file is in degrees, and is brought into the zone of its shots",
            where=source.path,
            expected=source.crs.name,
            got=crs.name,
            do="leave --crs (survey.crs) out, or name that system",
        )
