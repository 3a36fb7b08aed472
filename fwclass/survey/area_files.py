"""Training and test areas that a survey names by files or polygons, as boxes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.conf import Config
from fwclass.conf.sections import AreaFilesSection
from fwclass.errors import ConfigError, InputError
from fwclass.grid import Box
from fwclass.label.polygons import check_reach
from fwclass.read.polygons import open_polygons, read_polygons, reproject, source_crs
from fwclass.store.remote_file import local
from fwclass.store.url import Url
from fwclass.survey.area_of_interest import edges
from fwclass.survey.bounds import flat_bounds
from fwclass.survey.files import find_files, without_excluded
from fwclass.survey.gather import directory_of, open_all
from fwclass.survey.systems import given_crs, system_of

CELL = 1.0
"""m, polygons are taken by squares of this edge whose middle lies in them, by larger ones where these are too many."""

MOST_BOXES = 1000
"""Boxes of one file of polygons: an echo is held against those that meet its tile."""

MOST_ROWS, MOST_CROSSED = 100_000, 1_000_000
"""Rows of squares, of a polygon's height, and how many of them its edges cross, all together."""

UPPER = 0.001
"""m, added to a file's bounds: its last points lie on them, and a box ends before its edge."""


def with_areas(config: Config) -> Config:
    """`config` with boxes in the place of files and polygons that ``areas.train`` and ``areas.test`` name.

    `ConfigError`: of a survey that is still to be simulated. `InputError`: no such files, or polygons that cannot be
    used.
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
        matching = find_files(by.files, directory, f"{name}.files", config.path, config.store)
        places, _ = without_excluded(matching, config.survey.exclude, directory, config.path, config.store)
        bounds = [flat_bounds(source) for source in open_all(places, config) if source.n_records]
        return [Box(b[0], b[1], b[3] + UPPER, b[4] + UPPER) for b in bounds]
    return _of_polygons(config, directory, f"{name}.polygons", by)


def _of_polygons(config: Config, directory: Path | Url, name: str, by: AreaFilesSection) -> list[Box]:
    (place, *more) = find_files([by.polygons or ""], directory, name, config.path, config.store)
    if more:
        raise InputError(f"{name} is one file", where=config.path, got=f"{1 + len(more)} files match", do="name one")
    path, survey = local(place), _system(config, directory)
    opened = open_polygons(path, by.layer, name.replace("polygons", "layer"))
    setting = name.replace("polygons", "crs")
    own = source_crs(opened, given_crs(by.crs, setting), survey, f"{setting}: EPSG:<code>")
    _, shapes = read_polygons(opened, None)
    if own is not None and survey is not None:
        shapes, _ = reproject(shapes, own, survey, path, f"{setting}: EPSG:<code>")
    if not shapes.parts:
        raise InputError(
            "the file has no polygon", where=path, got=f"{opened.features} features", do="check its export"
        )
    a, b = edges(shapes.x, shapes.y, shapes.ring_start)
    check_reach(float(np.abs(b).max()), path)
    cell = CELL
    while (boxes := _few_boxes(a, b, cell)) is None:
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
    matching = find_files(config.survey.sources, directory, "survey.sources", config.path, config.store)
    places, _ = without_excluded(matching, config.survey.exclude, directory, config.path, config.store)
    return system_of(open_all(places[:1], config)[0])


def _few_boxes(a: NDArray[np.float64], b: NDArray[np.float64], cell: float) -> list[Box] | None:
    """As `boxes_of`; None where these, or the work for them, are too much."""
    low, high = np.minimum(a[:, 1], b[:, 1]), np.maximum(a[:, 1], b[:, 1])
    if (high.max() - low.min()) / cell > MOST_ROWS or ((high - low) / cell).sum() > MOST_CROSSED:
        return None
    boxes = list(islice(boxes_of(a, b, cell), MOST_BOXES + 1))
    return boxes if len(boxes) <= MOST_BOXES else None


def boxes_of(a: NDArray[np.float64], b: NDArray[np.float64], cell: float) -> Iterator[Box]:
    """Boxes of the squares of edge `cell` [m] of the global grid whose middles lie in polygons with edges `a` to `b`,
    (n, 2) each [m]; holes are left out. No two share area."""
    growing: dict[tuple[int, int], int] = {}
    for row, in_row in _runs(a, b, cell):
        runs = set(in_row)
        for run in [r for r in growing if r not in runs]:
            yield Box(run[0] * cell, growing.pop(run) * cell, run[1] * cell, row * cell)
        growing |= {run: row for run in sorted(runs) if run not in growing}


def _runs(a: NDArray[np.float64], b: NDArray[np.float64], cell: float) -> Iterator[tuple[int, list[tuple[int, int]]]]:
    """Row by row, and one row more, the first column, and the one behind the last, of the squares whose middles lie
    inside. Each edge is looked at in the rows that it crosses alone."""
    low, high = (np.floor(f(a[:, 1], b[:, 1]) / cell).astype(np.int64) for f in (np.minimum, np.maximum))
    count = high - low + 3  # a row more on either side, whatever the rounding
    edge = np.repeat(np.arange(len(a)), count)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count - (low - 1), count)
    y = (row + 0.5) * cell
    over = (a[edge, 1] > y) != (b[edge, 1] > y)
    p, q, y, row = a[edge[over]], b[edge[over]], y[over], row[over]
    x = p[:, 0] + (y - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0])
    order = np.lexsort((x, row))
    columns = np.ceil(x[order] / cell - 0.5).astype(np.int64)
    first, last = int(low.min()), int(high.max())
    start = np.searchsorted(row[order], np.arange(first, last + 3))
    for k, (i, j) in enumerate(pairwise(start.tolist())):
        pairs = columns[i:j].reshape(-1, 2)
        yield first + k, [(m, n) for m, n in pairs[pairs[:, 0] < pairs[:, 1]].tolist()]
