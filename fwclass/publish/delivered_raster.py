"""The one way in which rasters that were delivered are opened again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fwclass.errors import InputError, first_line


@contextmanager
def delivered_raster(path: Path) -> Iterator[Any]:
    """An open GeoTIFF, as rasterio has it, and nothing that looks like another format; `InputError` for a damaged
    one."""
    import rasterio  # it takes its time

    try:
        with rasterio.open(path.absolute(), driver="GTiff") as file:
            yield file
    except rasterio.errors.RasterioError as fault:
        raise InputError(
            "this raster cannot be read any more",
            where=path,
            got=first_line(fault),
            do="run the survey again with --verify: what is damaged is made anew",
        ) from fault
