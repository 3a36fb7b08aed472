"""Files whose rows are waveforms with a beam each: which format they are, and what they say of themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fwclass.errors import InputError
from fwclass.read.base import WaveStore
from fwclass.read.beam_source import TOP, BeamSource, Census, bounds_of, census_of
from fwclass.read.footprints import is_footprints, open_footprints
from fwclass.read.helios import LEVEL, LEVELS, is_helios, open_helios
from fwclass.read.raw_csv import is_raw_csv, open_raw_csv
from fwclass.read.raw_parquet import is_raw_parquet, open_raw_parquet
from fwclass.read.riegl_sdf import is_sdf, open_sdf
from fwclass.units import QUANTUM

PARQUET, TEXTS = (".parquet", ".geoparquet"), (".csv", ".txt", ".tsv")
"""Names of such files end so."""

NO_CRS = "no usable CRS: name one in the configuration"

FOOTPRINT_STEP = 1.0 / 16.0
"""Of samples of GEDI, which are digitiser counts with a part after the point: 4096 of them are the most."""


@dataclass(frozen=True)
class OpenedTable:
    """A format's own part of a source: how its rows are read, and what it says for all of them.

    `levels` : counts that the range of samples which are no whole numbers is laid out in, at most.
    `step` : of such samples, one for all files, or None; a range that has no room in it is refused where `firm`.
    `level` : counts that are put below the lowest sample.
    `census` : where opening it went over all rows already.
    """

    kind: str
    layout: Any
    crs: Any
    saturation: float | None
    standard: bool
    notes: tuple[tuple[str, str], ...]
    faults: tuple[str, ...]
    levels: float = TOP - 1.0
    step: float | None = None
    firm: bool = False
    level: float = 0.0
    census: Census | None = None


def is_beam_file(path: str | Path) -> bool:
    """A file of waveforms with a beam each, by its ending and what it holds."""
    path = Path(path)
    ending = path.suffix.lower()
    if not path.is_file():
        return False
    if is_helios(path) or is_footprints(path) or is_sdf(path):
        return True
    return (ending in PARQUET and is_raw_parquet(path)) or (ending in TEXTS and is_raw_csv(path))


def _open(path: Path) -> OpenedTable:
    if is_helios(path):
        layout = open_helios(path)
        bins = f"{layout.bin_ns:g} ns of one way, as the numbers of samples tell: {2 * layout.bin_ns:g} there and back"
        lines = (("bins", bins),)
        return OpenedTable("HELIOS++ full waveforms", layout, None, None, False, lines, (NO_CRS,), LEVELS, level=LEVEL)
    if is_footprints(path):
        shots, kind, system, about = open_footprints(path)
        return OpenedTable(kind, shots, system, None, False, tuple(about), (), step=FOOTPRINT_STEP)
    if is_sdf(path):
        sdf, about, census = open_sdf(path)
        return OpenedTable("RIEGL sample data", sdf, None, None, False, tuple(about), (NO_CRS,), census=census)
    raw, settings = open_raw_parquet(path) if path.suffix.lower() in PARQUET else open_raw_csv(path)
    faults: list[str] = []
    crs = settings.system(path, faults)
    kind = "raw waveforms, " + ("Parquet" if path.suffix.lower() in PARQUET else "text")
    notes = (("direction", raw.direction),)
    return OpenedTable(
        kind, raw, crs, settings.saturation, settings.standard, notes, tuple(faults), step=settings.step, firm=True
    )


def open_beam_file(path: Path) -> BeamSource:
    """Look at such a file, in one pass over all of it.

    `InputError`: damaged, without the columns that are needed, or with a row that is none.
    """
    opened = _open(path)
    census = opened.census or census_of(path, opened.layout)
    if census.rows != opened.layout.n_rows:
        raise InputError(
            "the file changed, or counts wrongly", where=path, expected=f"{opened.layout.n_rows} rows", got=census.rows
        )
    scaling = census.scaling(opened.saturation, opened.levels, opened.step)
    scaling = replace(scaling, low=scaling.low - opened.level * scaling.step)
    if opened.firm and opened.step is not None and scaling.step not in (opened.step, 1.0):
        raise InputError(
            "the samples have no room in 16 bits of these steps",
            where=f"{path}: metadata step",
            expected=f"at least {(census.values[1] - census.values[0]) / TOP:.3g}",
            got=f"{opened.step:g}, for samples from {census.values[0]:g} to {census.values[1]:g}",
            do="take a larger step, the same in all files of a survey",
        )
    steps = () if scaling.exact else (("samples", f"counted in steps of {scaling.step:.6g} from {scaling.low:.6g} on"),)
    size = path.stat().st_size
    return BeamSource(
        path=path,
        size=size,
        version=(1, 0),
        compressed=False,
        n_points=0,
        n_records=census.rows,
        point_format=-1,
        bounds=bounds_of(census),
        scales=(QUANTUM, QUANTUM, QUANTUM),
        offsets=(0.0, 0.0, 0.0),
        crs=opened.crs,
        waves=WaveStore("internal", path, 0, size),
        standard_gps_time=opened.standard,
        faults=(*opened.faults, *(() if census.rows else ("the file has no rows",))),
        kind=opened.kind,
        notes=(*(opened.notes if census.rows else ()), *steps),
        census=census,
        scaling=scaling,
        layout=opened.layout,
    )
