"""Stages that deliver the list of tiles, the tiles as polygons, and a QGIS project of the whole delivery."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fwclass.formats.crs import crs_of_wkt
from fwclass.formats.wkb import box_wkb
from fwclass.graph.assess import COUNT_CONFUSION
from fwclass.graph.outputs import DELIVER_TILE, TILE_ENDING, TILES, class_names
from fwclass.graph.overview import DELIVER_OVERVIEW, cloud_arguments, cloud_columns, overview_parts, overviews_of
from fwclass.graph.quality import DELIVER_QUALITY
from fwclass.graph.raster_outputs import DELIVER_RASTERS
from fwclass.graph.sites import WHOLE, sites
from fwclass.graph.stage import Names, Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.vectors import vector_layers
from fwclass.grid import Box, TileGrid
from fwclass.publish.files import written_whole
from fwclass.publish.gpkg import Layer, write_gpkg
from fwclass.publish.qgis import write_project
from fwclass.publish.qgis_layers import OVERVIEW, cloud_styles, layer_groups
from fwclass.publish.qgis_style import style_file
from fwclass.publish.tile_facts import least_sure_first, point_schema, sum_tiles
from fwclass.publish.vpc import write_vpc


def deliver_catalogue(
    here: StageInputs,
    crs: str | None,
    standard_time: bool,
    columns: Names,
    names: Mapping[str, str],
    title: str,
    polygons: Names,
    square: float,
    vectors: Names = (),
    contours: bool = False,
) -> Result:
    """The list of tiles for QGIS and PDAL, and a project that shows all of the delivery."""
    tiles = _facts(here)
    facts, system = sum_tiles(tiles), crs_of_wkt(crs)
    present = _present(facts, names)
    drawn = {key: here.inputs.meta(DELIVER_OVERVIEW.name, key)["rows"] for key in here.parts(DELIVER_OVERVIEW.name)}
    (here.directory / "laz").mkdir(parents=True)
    by_path = {f"{TILES.removeprefix('laz/')}/{key}{TILE_ENDING}": tile for key, tile in tiles.items()}
    listed = write_vpc(
        by_path,
        here.directory / "laz" / "survey.vpc",
        system,
        point_schema(columns),
        {path: overviews_of(tile["bounds"], square, drawn) for path, tile in by_path.items()},
        OVERVIEW.removeprefix("laz/") if drawn[WHOLE] else "",
        standard_time=standard_time,
    )
    ranges = {site: here.inputs.meta(DELIVER_RASTERS.name, site)["ranges"] for site in here.parts(DELIVER_RASTERS.name)}
    _write_style(here, present)
    bounds = facts["bounds"]
    quality = here.inputs.meta(DELIVER_QUALITY.name, "all")["layers"]
    groups = layer_groups(present, columns, ranges, polygons, WHOLE, vectors, contours, bool(drawn[WHOLE]), quality)
    write_project(title, groups, (bounds[0], bounds[1], bounds[3], bounds[4]), here.directory / "survey.qgz", system)
    return {"tiles": listed["items"], "points": facts["points"], "classes": facts["classes"], "bounds": bounds}


def deliver_polygons(
    here: StageInputs, crs: str | None, names: Mapping[str, str], size: float, areas: Mapping[str, list[list[float]]]
) -> Result:
    """The tiles as polygons with their figures, and the training and test areas."""
    tiles = _facts(here)
    layers = [_tile_layer(here, tiles, _present(sum_tiles(tiles), names), size), *_area_layers(areas)]
    write_gpkg(layers, here.directory / "tiles.gpkg", crs_of_wkt(crs))
    return {"tiles": len(tiles)}


def _facts(here: StageInputs) -> dict[str, Mapping[str, Any]]:
    return {tile: here.inputs.meta(DELIVER_TILE.name, tile)["facts"] for tile in here.parts(DELIVER_TILE.name)}


def _present(facts: Mapping[str, Any], names: Mapping[str, str]) -> dict[int, str]:
    """Names of the classes that there are, by code."""
    return {int(code): names.get(code, f"class {code}") for code in facts["classes"] if code != "0"}


def _write_style(here: StageInputs, names: Mapping[int, str]) -> None:
    """Classes in the house's colours, for who opens the list of tiles alone."""
    with written_whole(here.directory / "laz" / "survey.qml") as beside:
        beside.write_bytes(style_file(cloud_styles(names)["classes"], "pointcloud"))


def _tile_layer(
    here: StageInputs, tiles: Mapping[str, Mapping[str, Any]], names: Mapping[int, str], size: float
) -> Layer:
    """Every tile with counts by class, accuracy where it is known, mean confidence, and its rank: 1 is least sure of
    those worth a look."""
    keys, grid = sorted(tiles), TileGrid(size)
    confidence = np.array([np.nan if (c := tiles[k]["confidence"]) is None else c for k in keys])
    judged = set(here.parts(COUNT_CONFUSION.name))
    accuracy = np.array([_accuracy(here.inputs.meta(COUNT_CONFUSION.name, k)) if k in judged else np.nan for k in keys])
    ranks = {key: rank for rank, key in enumerate(least_sure_first(tiles), 1)}
    counts = {
        f"class_{code}": np.array([tiles[k]["classes"].get(str(code), 0) for k in keys], np.int64) for code in names
    }
    return Layer(
        "tiles",
        box_wkb([grid.tile(k).box for k in keys]),
        {
            "tile": keys,
            "file": [f"{TILES}/{k}{TILE_ENDING}" for k in keys],
            "echoes": np.array([tiles[k]["points"] for k in keys], np.int64),
            "confidence": confidence,
            "rank": np.array([ranks[k] for k in keys], np.int32),
            "accuracy": accuracy,
            "state": ["classified"] * len(keys),
            **counts,
        },
    )


def _accuracy(meta: Mapping[str, Any]) -> float:
    """Share of the tile's test echoes with the right class; NaN without any."""
    matrix = np.array(meta["matrix"], np.int64)
    total = int(matrix.sum()) + sum(meta["lost"])
    return float(np.trace(matrix) / total) if total else float("nan")


def _area_layers(areas: Mapping[str, list[list[float]]]) -> list[Layer]:
    rows = [(kind, Box(*box)) for kind, boxes in areas.items() for box in boxes]
    if not rows:
        return []
    return [Layer("areas", box_wkb([box for _, box in rows]), {"kind": [kind for kind, _ in rows]})]


def _cloud_columns(plan: Plan) -> Names:
    calibrated = plan.config.radiometry.calibrates
    return tuple(c for c in cloud_columns(plan) if calibrated or c != "reflectance")


def _areas(plan: Plan) -> dict[str, list[list[float]]]:
    return plan.config.areas.shown(plan.layout.box)


def _parts_listed(plan: Plan, part: object) -> list[tuple[str, str]]:
    tiles = [(DELIVER_TILE.name, t.key) for t in plan.layout.tiles]
    rasters = [(DELIVER_RASTERS.name, site.name) for site in sites(plan.layout)]
    return [
        *tiles,
        *rasters,
        (DELIVER_QUALITY.name, "all"),
        *((DELIVER_OVERVIEW.name, str(key)) for key in overview_parts(plan)),
    ]


def _parts_drawn(plan: Plan, part: object) -> list[tuple[str, str]]:
    stages = (DELIVER_TILE.name, *([COUNT_CONFUSION.name] if COUNT_CONFUSION.when(plan) else []))
    return [(stage, t.key) for stage in stages for t in plan.layout.tiles]


DELIVER_CATALOGUE = Stage(
    "publish-catalogue",
    9,
    "survey",
    "part",
    deliver_catalogue,
    arguments=lambda plan: {
        **cloud_arguments(plan),
        "columns": _cloud_columns(plan),
        "title": plan.config.survey.name,
        "polygons": ("tiles", "areas") if any(_areas(plan).values()) else ("tiles",),
        "square": plan.config.publish.overview_square,
        **({"vectors": vector_layers(plan)} if vector_layers(plan) else {}),
        "contours": plan.config.contours.enabled,
    },
    after=(DELIVER_TILE.name, DELIVER_RASTERS.name, DELIVER_QUALITY.name, DELIVER_OVERVIEW.name),
    needs=_parts_listed,
    place="deliver",
)
DELIVER_POLYGONS = Stage(
    "publish-polygons",
    2,
    "survey",
    "part",
    deliver_polygons,
    arguments=lambda plan: {
        "crs": plan.survey.crs,
        "names": class_names(plan),
        "size": plan.config.tile.size,
        "areas": _areas(plan),
    },
    after=(DELIVER_TILE.name, COUNT_CONFUSION.name),
    needs=_parts_drawn,
    check=True,  # it tells accuracy: where that cannot be made, the delivery is whole all the same
    place="deliver",
)
