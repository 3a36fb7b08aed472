"""Training and test areas that a survey names by files or polygons, as boxes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.conf import Config
from fwclass.conf.sections import AreaFilesSection
from fwclass.errors import ConfigError, InputError
from fwclass.grid import Box
from fwclass.read.polygons import open_polygons, read_polygons, reproject, source_crs
from fwclass.store.remote_file import local
from fwclass.store.url import Url
from fwclass.survey.area_of_interest import edges
from fwclass.survey.bounds import flat_bounds
from fwclass.survey.files import find_files
from fwclass.survey.gather import directory_of, open_all
from fwclass.survey.systems import given_crs, system_of

CELL = 1.0
"""m, polygons are taken by squares of this edge whose middle lies in them, by larger ones where these are too many."""

MOST_BOXES = 1000
"""Boxes of one file of polygons: an echo is held against those that meet its tile."""

MOST_ROWS = 100_000
"""Rows of squares, of a polygon's height."""

UPPER = 0.001
"""m, added to a file's bounds: its last points lie on them, and a box ends before its edge."""


def with_areas(config: Config) -> Config:
    """`config` with boxes in the place of files and polygons that ``areas.train`` and ``areas.test`` name.

    Raises
    ------
    ConfigError : of a survey that is still to be simulated.
    InputError : no such files, or polygons that cannot be used.
    """
    asked: dict[Literal["train", "test"], AreaFilesSection | None] = {
        "train": config.areas.train_by,
        "test": config.areas.test_by,
    }
    changes: dict[str, object] = {}
    for kind, by in asked.items():
        if by is not None:
            changes |= {kind: tuple(b.bounds for b in _boxes(config, kind, by)), f"{kind}_by": None}
    return replace(config, areas=config.areas.model_copy(update=changes)) if changes else config


def _boxes(config: Config, kind: str, by: AreaFilesSection) -> list[Box]:
    name = f"areas.{kind}"
    if config.simulated:
        raise ConfigError(
            "a survey that is simulated has no files yet",
            where=f"{config.path}: {name}",
            expected="boxes [xmin, ymin, xmax, ymax]",
            do="give boxes, or simulate first (fwclass simulate) and set survey.directory",
        )
    directory = directory_of(config, Path())
    if by.polygons is None:
        places = find_files(by.files, directory, f"{name}.files", config.path, config.store)
        bounds = [flat_bounds(source) for source in open_all(places, config) if source.n_records]
        return [Box(b[0], b[1], b[3] + UPPER, b[4] + UPPER) for b in bounds]
    return _of_polygons(config, directory, f"{name}.polygons", by)


def _of_polygons(config: Config, directory: Path | Url, name: str, by: AreaFilesSection) -> list[Box]:
    (place, *more) = find_files([by.polygons or ""], directory, name, config.path, config.store)
    if more:
        raise InputError(f"{name} is one file", where=config.path, got=f"{1 + len(more)} files match", do="name one")
    path, survey = local(place), _system(config, directory)
    opened = open_polygons(path, by.layer, name.replace("polygons", "layer"))
    own = source_crs(opened, given_crs(by.crs, name.replace("polygons", "crs")), survey, f"{name[:-8]}crs: EPSG:<code>")
    _, shapes = read_polygons(opened, None)
    if own is not None and survey is not None:
        shapes, _ = reproject(shapes, own, survey, path)
    if not shapes.parts:
        raise InputError(
            "the file has no polygon", where=path, got=f"{opened.features} features", do="check its export"
        )
    a, b = edges(shapes.x, shapes.y, shapes.ring_start)
    cell = CELL
    while True:
        boxes = None if (b[:, 1].max() - b[:, 1].min()) / cell > MOST_ROWS else list(boxes_of(a, b, cell))
        if boxes is not None and len(boxes) <= MOST_BOXES:
            break
        cell *= 2.0
    if not boxes:
        raise InputError(
            "the polygons are too small to be an area",
            where=path,
            expected=f"squares of {cell:g} m whose middle lies in one",
            got="none",
            do="check their coordinate system",
        )
    return boxes


def _system(config: Config, directory: Path | Url) -> CRS | None:
    """The survey's system: what the configuration names, or its first file."""
    if config.survey.crs is not None:
        return given_crs(config.survey.crs, "survey.crs")
    first = find_files(config.survey.sources, directory, "survey.sources", config.path, config.store)[:1]
    return system_of(open_all(first, config)[0])


def boxes_of(a: NDArray[np.float64], b: NDArray[np.float64], cell: float) -> Iterator[Box]:
    """Boxes of the squares of edge `cell` [m] of the global grid whose middles lie in polygons with edges `a` to `b`,
    (n, 2) each [m]; holes are left out. No two share area."""
    low, high = (math.floor(f(b[:, 1]) / cell) for f in (np.min, np.max))
    growing: dict[tuple[int, int], int] = {}
    for row in range(low, high + 2):
        runs = set(_runs(a, b, row, cell)) if row <= high else set()
        for run in [r for r in growing if r not in runs]:
            yield Box(run[0] * cell, growing.pop(run) * cell, run[1] * cell, row * cell)
        growing |= {run: row for run in sorted(runs) if run not in growing}


def _runs(a: NDArray[np.float64], b: NDArray[np.float64], row: int, cell: float) -> Iterator[tuple[int, int]]:
    """First column, and the one behind the last, of the squares of a row whose middles lie inside."""
    y = (row + 0.5) * cell
    over = (a[:, 1] > y) != (b[:, 1] > y)
    p, q = a[over], b[over]
    x = np.sort(p[:, 0] + (y - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0]))
    for first, last in np.ceil(x / cell - 0.5).astype(np.int64).reshape(-1, 2).tolist():
        if first < last:
            yield first, last
