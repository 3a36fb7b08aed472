"""The file of a survey's check points: found, and checked before anything is computed."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from fwclass.conf import Config
from fwclass.errors import InputError
from fwclass.formats.projected import height_unit
from fwclass.grid import Box
from fwclass.read.text import read_text
from fwclass.store.remote_file import local
from fwclass.store.url import Url
from fwclass.survey.file_digests import Digests
from fwclass.survey.files import box_text
from fwclass.survey.layout import PolygonFile
from fwclass.survey.systems import given_crs

SETTING = "quality.check_points"
MOST = 100_000
"""Points of a file; a survey has some hundreds."""

FAR = 1e9
"""m; larger numbers are no coordinates."""

NAMES = ("name", "id", "point", "point_id", "point_name", "pt", "nr", "no", "number", "punkt", "punktnr", "punktnummer")
"""What the column of points' names is called."""


class CheckPoints(NamedTuple):
    """Points of a file: x, y, z float64 (n,) [m]; code int64 (n,), of the class, -1 for none; names, None without."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    code: NDArray[np.int64]
    names: tuple[str, ...] | None


def check_point_file(
    config: Config, directory: Path | Url, digests: Digests, crs: str | None, box: Box
) -> PolygonFile | None:
    """The file of check points; `InputError` where none of them lies in the survey's `box` [m]."""
    params = config.quality.check_points
    user_crs = given_crs(params.crs, f"{SETTING}.crs")
    if params.file is None:
        return None
    places = digests.find([params.file], directory, f"{SETTING}.file", config)
    if len(places) > 1:
        raise InputError(
            f"{SETTING}.file is one file", where=config.path, got=f"{len(places)} files match", do="name one"
        )
    path, own = local(places[0]), user_crs.to_wkt() if user_crs is not None else None
    x, y = read_check_points(path, own, crs)[:2]
    if not box.contains(x, y).any():
        turned = box.contains(y, x).any()
        raise InputError(
            "no check point lies in the survey",
            where=path,
            expected=f"points in {box_text(box)}",
            got=box_text(Box(float(x.min()), float(y.min()), float(x.max()), float(y.max()))),
            do="name the columns easting and northing: x and y are exchanged"
            if turned
            else f"check the file, the order of its columns, and its coordinate system ({SETTING}.crs)",
        )
    return PolygonFile(places[0], digests.of([path], places[0]), "", own)


def read_check_points(path: Path, own_crs: str | None, crs: str | None) -> CheckPoints:
    """Check points in the survey's system `crs` (WKT), from a text file in `own_crs`, or in the survey's. Heights
    become metres, of the zero that they have.

    `InputError`: no text of x, y, z, a point without one of them, or more than `MOST` points.
    """
    cloud = read_text(path, ignored=("code",), named=NAMES)  # in a surveyor's file: what the point is, no class
    if len(cloud.x) > MOST:
        raise InputError("too many check points", where=path, expected=f"at most {MOST:,}", got=f"{len(cloud.x):,}")
    unknown = np.flatnonzero(~(np.abs(np.stack(cloud.xyz)) <= FAR).all(axis=0))
    if len(unknown):
        raise InputError(
            "a check point lacks a coordinate",
            where=f"{path}: point {unknown[0] + 1}",
            expected=f"x, y and z, at most {FAR:.0e}",
            do="complete it, or remove it",
        )
    x, y, z = cloud.xyz
    if own_crs is not None and crs is not None:
        own = CRS.from_wkt(own_crs)
        z = z * height_unit(own)
        move = Transformer.from_crs(own.to_2d(), CRS.from_wkt(crs).to_2d(), always_xy=True)
        x, y = move.transform(x, y)
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise InputError(
                "check points lie outside of their coordinate system",
                where=path,
                do=f"check {SETTING}.crs, and the order of the columns",
            )
    code = np.full(len(x), -1) if cloud.label is None else cloud.label.astype(np.int64)
    return CheckPoints(x, y, z, code, cloud.names)
