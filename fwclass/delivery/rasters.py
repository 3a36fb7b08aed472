"""Rasters of a delivery as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from fwclass.errors import InputError, nearest
from fwclass.publish.delivered_raster import delivered_raster


@dataclass(frozen=True)
class Raster:
    """One raster.

    Attributes
    ----------
    values : row 0 in the **north**, as the file has it.
    transform : `affine.Affine`, from (column, row) to coordinates of a cell's north-west corner.
    crs : WKT, "" for an unknown one.
    nodata : value of a cell without data; NaN for heights and densities.
    names : of classes by code, of the class raster alone.
    """

    name: str
    values: NDArray[Any]
    transform: Any
    crs: str
    nodata: float
    names: dict[int, str]


def read_raster(directory: Path, name: str) -> Raster:
    """A raster below `directory` by its name there, without ending; `InputError` for one that is not there,
    or is damaged."""
    rasters = {p.relative_to(directory).with_suffix("").as_posix(): p for p in sorted(directory.rglob("*.tif"))}
    if name not in rasters:
        raise InputError("there is no such raster", where=directory, got=name, do=nearest(name, rasters))
    with delivered_raster(rasters[name]) as file:
        tags = file.tags(1)
        names = {int(k.removeprefix("CLASS_")): v for k, v in tags.items() if k.startswith("CLASS_")}
        crs = file.crs.to_wkt() if file.crs is not None else ""
        return Raster(name, file.read(1), file.transform, crs, float(file.nodata), names)
