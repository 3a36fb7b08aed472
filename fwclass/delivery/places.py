"""Places of a file on a delivery: the echoes in them, the tiles that they touch, and the work list that they are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery, open_run
from fwclass.errors import InputError, several
from fwclass.grid import Box, joint_box, millimetres
from fwclass.label.polygons import NONE, Polygons, owners
from fwclass.read.polygons import open_polygons, read_polygons, reproject, source_crs
from fwclass.schema import IDENTITY, PLACE
from fwclass.store.run_location import RunLocation
from fwclass.survey.files import box_text
from fwclass.view.worklist import UnsureCluster, WorkList

COLUMNS = (*IDENTITY, *PLACE, "classification", "confidence")
MOST, MOST_LISTED = 100_000, 200
"""Places of a file that is read, and those that the viewer lists."""


def read_places(path: Path, delivery: Delivery) -> Polygons:
    """The polygons of a file, as `suggest` writes it or drawn by hand, in the coordinates of a delivery.

    `InputError`: it is no file of polygons, it has none or too many, or its coordinate system is unknown.
    """
    opened = open_polygons(path, None, "--places")
    if not 0 < opened.features <= MOST:
        raise InputError(
            "this file has too many places" if opened.features else "this file has no place",
            where=path,
            expected=f"1 to {MOST:,} polygons",
            got=opened.features,
            do="write one with `fwclass suggest`",
        )
    do = "give the file the system that its coordinates are in"
    own = source_crs(opened, None, delivery.crs, do)
    _, shapes = read_polygons(opened, None)
    if own is not None and delivery.crs is not None:
        shapes, _ = reproject(shapes, own, delivery.crs, path, do)
    one = np.zeros(opened.features, np.int16)
    return Polygons.of(shapes, one, one, path)


def echoes_in(delivery: Delivery, places: Polygons) -> dict[str, NDArray[Any]]:
    """Columns of the echoes in places, each once."""
    parts = []
    for tile in delivery.tiles:
        here = places.within(_area(tile))
        if here.parts:
            columns = table_columns(delivery.table(str(tile["tile"])), COLUMNS)
            inside = owners(millimetres(columns["x"]), millimetres(columns["y"]), here)[1] != NONE
            parts.append({n: v[inside] for n, v in columns.items()})
    return {n: np.concatenate([p[n] for p in parts]) if parts else np.empty(0) for n in COLUMNS}


def count_places_away(delivery: Delivery, places: Polygons) -> int:
    """How many places lie where no tile has echoes, by their extents."""
    low_x, low_y, high_x, high_y = (v / 1000 for v in places.bounds)
    near = np.zeros(places.parts, bool)
    for area in map(_area, delivery.tiles):
        near |= (low_x <= area.xmax) & (high_x >= area.xmin) & (low_y <= area.ymax) & (high_y >= area.ymin)
    return int((~near).sum())


def listed_places(delivery: Delivery, path: Path) -> WorkList:
    """The places of a file as a work list, in its order; those without an echo are left out.

    `InputError`: it is no file of polygons, or no echo lies in any of them.
    """
    places = read_places(path, delivery)
    total = places.parts
    if total > MOST_LISTED:
        places = places.take(np.arange(MOST_LISTED))
    clusters: list[UnsureCluster] = []
    low_x, low_y, high_x, high_y = (v / 1000 for v in places.bounds)
    for k in range(places.parts):
        box = Box(float(low_x[k]), float(low_y[k]), float(high_x[k]), float(high_y[k]))
        rows = echoes_in(delivery, places.take(np.array([k])))
        if len(rows["x"]):
            codes, counts = np.unique(rows["classification"], return_counts=True)
            order = np.argsort(-counts, kind="stable")
            classes = tuple((int(codes[i]), int(counts[i])) for i in order)
            middle = (box.xmin + box.xmax) / 2, (box.ymin + box.ymax) / 2, float(np.median(rows["z"]))
            size = max(box.xmax - box.xmin, box.ymax - box.ymin)
            confidence = rows["confidence"][np.isfinite(rows["confidence"])]
            sure = float(confidence.mean()) if len(confidence) else 0.0
            clusters.append(UnsureCluster(len(rows["x"]), *middle, size, box.bounds, sure, classes))
    if not clusters:
        raise no_echo(path, places, delivery)
    none = np.empty(0, np.int64)
    return WorkList(tuple(clusters), 1.0, none.reshape(0, 2), none, len(clusters) + max(0, total - MOST_LISTED))


def tiles_with_places(run: RunLocation, path: Path) -> frozenset[str]:
    """The tiles of a run whose echoes the places of a file may hold; `InputError` where none has any."""
    delivery = open_run(run)
    places = read_places(path, delivery)
    touched = frozenset(str(t["tile"]) for t in delivery.tiles if places.within(_area(t)).parts)
    if not touched:
        raise no_echo(path, places, delivery)
    return touched


def no_echo(path: Path, places: Polygons, delivery: Delivery) -> InputError:
    """What to say where none is, with where places and tiles lie."""
    low_x, low_y, high_x, high_y = (v / 1000 for v in places.bounds)
    reach = places.parts and joint_box(
        Box(*map(float, ends)) for ends in zip(low_x, low_y, high_x, high_y, strict=True)
    )
    survey = joint_box(map(_area, delivery.tiles))
    return InputError(
        "no echo of this delivery lies in any of these places",
        where=path,
        expected=f"places that meet {box_text(survey)}, in the survey's coordinates",
        got=several(places.parts, "place") + (f" in {box_text(reach)}" if reach else ""),
        do="take the file that `fwclass suggest` wrote for this run",
    )


def _area(tile: Mapping[str, Any]) -> Box:
    """Where a tile has echoes [m]."""
    low_x, low_y, _, high_x, high_y, _ = tile["bounds"]
    return Box(low_x, low_y, high_x, high_y)
