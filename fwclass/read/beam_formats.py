"""Files whose rows are waveforms with a beam each: which format they are, and what they say of themselves."""

from __future__ import annotations

from pathlib import Path

from fwclass.errors import InputError
from fwclass.read.base import WaveStore
from fwclass.read.beam_source import BeamSource, bounds_of, census_of
from fwclass.read.raw_csv import is_raw_csv, open_raw_csv
from fwclass.read.raw_parquet import is_raw_parquet, open_raw_parquet
from fwclass.units import QUANTUM

PARQUET, TEXTS = (".parquet", ".geoparquet"), (".csv", ".txt", ".tsv")
"""Names of such files end so."""


def is_beam_file(path: str | Path) -> bool:
    """A table of waveforms, by its ending and what it holds."""
    path = Path(path)
    ending = path.suffix.lower()
    if not path.is_file():
        return False
    return (ending in PARQUET and is_raw_parquet(path)) or (ending in TEXTS and is_raw_csv(path))


def open_beam_file(path: Path) -> BeamSource:
    """Look at such a file, in one pass over all of it.

    Raises
    ------
    InputError
        Damaged, without the columns that are needed, or with a row that is none.
    """
    opened = open_raw_parquet(path) if path.suffix.lower() in PARQUET else open_raw_csv(path)
    layout, settings = opened
    faults: list[str] = []
    crs = settings.system(path, faults)
    census = census_of(path, layout)
    if census.rows != layout.n_rows:
        raise InputError(
            "the file changed, or counts wrongly", where=path, expected=f"{layout.n_rows} rows", got=census.rows
        )
    if census.rows == 0:
        faults.append("the file has no rows")
    scaling = census.scaling(settings.saturation)
    size = path.stat().st_size
    notes = [("direction", layout.direction)] if census.rows else []
    if not scaling.exact:
        notes.append(("samples", f"counted in steps of {scaling.step:.6g} from {scaling.low:.6g} on"))
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
        crs=crs,
        waves=WaveStore("internal", path, 0, size),
        standard_gps_time=settings.standard,
        faults=tuple(faults),
        kind="raw waveforms, " + ("Parquet" if path.suffix.lower() in PARQUET else "text"),
        notes=tuple(notes),
        census=census,
        scaling=scaling,
        layout=layout,
    )
