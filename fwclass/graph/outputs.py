"""Parts that deliver: tiles, strips, rasters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from fwclass.classify.stage import probability_columns
from fwclass.conf import Config
from fwclass.graph.ground import terrain_blocks
from fwclass.graph.layout import Layout, Strip, Survey, has_range, needs_of, plain_classes
from fwclass.graph.sites import WHOLE, Site, sites
from fwclass.graph.work import outputs
from fwclass.grid import Tile, Window
from fwclass.ground.stage import TERRAIN
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.run.part import Task
from fwclass.run.tasks import Tasks

DELIVERED = (
    "x",
    "y",
    "z",
    "strip",
    "pulse",
    "echo_number",
    "number_of_echoes",
    "gps_time",
    "intensity",
    "amplitude",
    "amplitude_sigma",
    "amplitude_db",
    "width",
    "width_sigma",
    "energy",
    "range_sigma",
    "deviation",
    "fit_flags",
    "height_above_ground",
    "ground",
    "noise",
    "classification",
    "confidence",
    "entropy",
)
"""Columns of the delivered tiles, besides the forest's features and radiometry."""

NO_BYTE = {"raster_cache", "figure_pixels"}
"""Settings that change no byte of what these parts write."""


def output_tasks(
    layout: Layout,
    names: tuple[str, ...],
    survey: Survey,
    chunks: Mapping[int, tuple[str, ...]],
    in_strip: Mapping[int, tuple[str, ...]],
) -> Tasks:
    """Tiles (LAZ, GeoParquet), strips (LAZ), class blocks and rasters."""
    config = layout.config
    params = {
        **config.publish.model_dump(mode="json", exclude=NO_BYTE),
        "crs": survey.crs,
        "classes": plain_classes(config),
    }
    measured = RADIOMETRY.writes if has_range(config) else ()
    shares = probability_columns(c.code for c in config.classes) if config.classify.probabilities else ()
    wanted = tuple(dict.fromkeys((*DELIVERED, *shares, *measured, *names, *config.features.also)))
    columns = layout.columns(wanted)
    of_tile = {**params, "columns": list(wanted), "standard_time": survey.standard_time}

    def delivered(tile: Tile) -> Task:
        return Task(
            "publish-tile",
            tile.key,
            2,
            of_tile,
            partial(outputs.delivered_tile, tile, columns, survey.crs, survey.standard_time, config.publish),
            needs=needs_of(columns, (tile.key,)),
            place="deliver",
        )

    def classes(block: Tile) -> Task:
        present = layout.around(Window.covering(block.box, config.publish.class_cell).box, here)
        return Task(
            "class-block",
            block.key,
            1,
            params,
            partial(outputs.class_block, block, config.tile.size, present, config.publish),
            needs=needs_of({"a": "classify"}, present),
        )

    owned, here = terrain_blocks(layout), layout.keys
    made = Tasks.of("publish-tile", layout.tiles, delivered)
    made += _strip_tasks(config, params, survey.strips, chunks, in_strip)
    made += Tasks.of("class-block", owned, classes)
    cell = config.terrain.cell
    codes = {c.code: c.name for c in config.survey.classes}

    def rasters(site: Site) -> Task:
        folder = "rasters" if site.name == WHOLE else f"rasters/{site.name}"
        return Task(
            "publish-rasters",
            site.name,
            3,
            {**params, "box": list(site.box.bounds), "cell": cell},
            partial(outputs.delivered_rasters, site.box, cell, site.blocks, codes, survey.crs, config.publish, folder),
            needs=tuple((stage, b.key) for stage in (TERRAIN.name, "class-block") for b in site.blocks),
            place="deliver",
        )

    return made + Tasks.of("publish-rasters", sites(layout), rasters)


def _strip_tasks(
    config: Config,
    params: Any,
    strips: Iterable[Strip],
    chunks: Mapping[int, tuple[str, ...]],
    in_strip: Mapping[int, tuple[str, ...]],
) -> list[Task]:
    made = []
    for strip in strips:
        if strip.number not in chunks or strip.point_format < 0:  # a file without points, or one of pulses only
            continue
        legacy = strip.point_format <= 5
        codes = {c.code: c.legacy_code for c in config.survey.classes if legacy and c.legacy_code is not None}
        mine, here = chunks[strip.number], in_strip[strip.number]
        made.append(
            Task(
                "publish-strip",
                strip.path.stem,
                1,
                params,
                partial(outputs.delivered_strip, strip.path, strip.number, mine, here, codes, config.publish),
                needs=(*(("decompose", c) for c in mine), *needs_of({"a": "classify"}, here)),
                external=strip.digests,
                place="deliver",
            )
        )
    return made
