"""GDAL for files of polygons: the drivers of three formats, and no network.

GDAL goes by what a file holds, and has drivers for texts that name other files, addresses and whole pipelines.
"""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import FwclassError, full_or, is_control, visible
from fwclass.isolation import away_from

DRIVERS = {"GPKG", "GeoJSON", "ESRI Shapefile", "MEM"}
"""``MEM`` reads no file; GeoTIFF's driver may need it."""

_NOWHERE = "refused://127.0.0.1:1"
"""A proxy of no scheme that curl knows: every request fails before anything is looked up or connected to."""

_OPTIONS = {
    "GDAL_HTTP_PROXY": _NOWHERE,
    "GDAL_HTTPS_PROXY": _NOWHERE,
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".none",
    "OGR_SQLITE_ALLOW_EXTERNAL_ACCESS": "NO",
    "ALLOW_OGR_SQL_FUNCTIONS_FROM_TRIGGER_AND_VIEW": "NO",
    "OGR_SQLITE_LOAD_EXTENSIONS": None,
}

_EXCEPTIONS = ("no_proxy", "NO_PROXY")
"""Hosts that curl reaches without the proxy, by the environment."""

_PROJ = ("proj.ini", "proj.db")
"""What PROJ looks for in the current directory, after its own places."""

_alone = threading.Lock()


@cache
def vector_gdal() -> Any:
    """The module `pyogrio`, its GDAL restricted for the rest of this process; `FwclassError` if it cannot be."""
    import pyogrio  # loads GDAL, which only a survey with polygons needs
    from pyogrio import _ogr, raw  # noqa: F401 - loads pyogrio.raw

    others = sorted(set(pyogrio.list_drivers()) - DRIVERS)
    pyogrio.set_gdal_config_options(_OPTIONS | {"GDAL_SKIP": ",".join(others)})
    _ogr._register_drivers()  # takes those away that are to be skipped
    drivers = sorted(set(pyogrio.list_drivers()) - DRIVERS)
    if drivers:
        raise FwclassError(
            "GDAL cannot be kept from opening files of other formats",
            where=f"pyogrio {pyogrio.__version__}",
            expected="drivers of GeoPackage, GeoJSON and Shapefile alone",
            got=", ".join(drivers),
            do="install the version of pyogrio that requirements.lock names, or convert the polygons to GeoParquet",
        )
    return pyogrio


@contextmanager
def offline() -> Iterator[Any]:
    """`vector_gdal` while it reaches no host and prints nothing: what is wrong with a file is told by who reads it.

    It may be elsewhere than in the current directory meanwhile: paths that it is given have to be absolute.
    """
    module = vector_gdal()
    with _alone, away_from(*_PROJ), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        saved = {name: os.environ.pop(name) for name in _EXCEPTIONS if name in os.environ}
        try:
            yield module
        finally:
            os.environ.update(saved)


@contextmanager
def writing(place: Path) -> Iterator[Any]:
    """`offline` while it writes the file `place`: a full disk is an `OSError`, other faults are a `FwclassError`."""
    if str(place).startswith("/vsi") or any(map(is_control, str(place))):
        raise FwclassError(
            "GDAL takes the name of this file for another",
            where=place,
            expected="a name without characters that cannot be seen, not below /vsi…",
            do="choose another name",
        )
    try:
        with offline() as module:
            yield module
    except RuntimeError as fault:  # of which pyogrio's are
        cause = full_or(fault, place.parent)
        if cause is not fault:
            raise cause from fault
        raise FwclassError(
            "the file cannot be written",
            where=place,
            got=visible(str(fault)),
            do="check the disk and its directory's permissions, then run the same command again",
        ) from fault


_LAST_CHANGE = "2000-01-01T00:00:00.000Z"
"""What GeoPackages that are written say of their day: nothing, or no two would be the same."""


def write_shapes(
    path: Path,
    layer: str,
    geometry: Sequence[bytes],
    fields: Mapping[str, Any],
    crs: str | None,
    kind: Literal["Polygon", "LineString", "Point"] = "Polygon",
) -> None:
    """Add polygons, lines or points (WKB) to a layer of a GeoPackage; both are made where they are not there. The same
    ones give the same bytes.

    `fields`: columns by name, arrays or lists of texts or of numbers; NaN is written as null. `crs`: WKT, or None
    for an unknown one.
    """
    place = path.absolute()
    with writing(place) as module:
        module.set_gdal_config_options({"OGR_CURRENT_DATE": _LAST_CHANGE})
        module.raw.write(
            str(place),
            np.array([*geometry, None], dtype=object)[:-1],
            [v if isinstance(v, np.ndarray) else _listed(v) for v in fields.values()],
            np.array(list(fields), dtype=object),
            layer=layer,
            driver="GPKG",
            geometry_type=kind,
            crs=crs,
            append=place.exists(),
            dataset_options={"VERSION": "1.3"},  # what QGIS of 2022 knows
            layer_options={"SPATIAL_INDEX": "YES"},
        )


def _listed(values: Sequence[Any]) -> NDArray:
    return np.array(values, object if not values or isinstance(values[0], str) else None)
