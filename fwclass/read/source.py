"""Opening a source file: which format it is, and what it says of itself."""

from __future__ import annotations

from pathlib import Path

from fwclass.errors import InputError
from fwclass.read.base import Source as Source
from fwclass.read.beam_formats import PARQUET, open_beam_file
from fwclass.read.beam_formats import is_beam_file as is_beam_file
from fwclass.read.beam_source import BeamSource as BeamSource
from fwclass.read.las import LasSource as LasSource
from fwclass.read.las import open_las
from fwclass.read.pulsewaves import PulseSource as PulseSource
from fwclass.read.pulsewaves import is_pulse_file, open_pls


def open_source(path: str | Path) -> Source:
    """Look at a file without reading its points or pulses.

    Raises
    ------
    InputError
        No file of a known format, empty, cut short, or a header that contradicts the file.
    """
    path = Path(path)
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
        do=f"decompose it first: fwclass decompose {source.path.name} OUT.laz",
    )
