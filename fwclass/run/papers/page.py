"""The page of a paper: facts as JSON, tables, plots and map as one HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fwclass.conf import Config
from fwclass.grid import TileGrid, Window
from fwclass.publish.papers.page import render_paper
from fwclass.run.desk import Desk
from fwclass.run.plan.layout import Layout
from fwclass.run.report import drawable
from fwclass.run.road import Road
from fwclass.run.work.rasters import Mosaic
from fwclass.store.atomic import write_json


def deliver(
    config: Config, road: Road, layout: Layout, report: Mapping[str, Any], facts: Mapping[str, Any]
) -> dict[str, Any]:
    """Write ``<paper>.json`` and ``<paper>.html`` beside the report; the report's dict, with them as outputs."""
    name = str(facts["paper"])
    write_json(road.pending / f"{name}.json", dict(facts))
    render_paper(facts, class_picture(config, road, layout, report), road.pending / f"{name}.html")
    made = {f"{name}.html": [f"{name}.html"]}
    return {**report, "outputs": {**report["outputs"], **made}}


def class_picture(config: Config, road: Road, layout: Layout, report: Mapping[str, Any]) -> bytes:
    """The map of all classes."""
    from fwclass.publish.figures import class_map  # matplotlib is slow to load, and only a page needs it

    window = Window.covering(layout.box, config.publish.class_cell)
    grid = TileGrid(config.terrain.block)
    blocks = sorted(
        grid.tile(part) for stage, part in road.outcomes if stage == "class-block" and road.made(stage, part)
    )
    mosaic = Mosaic(Desk(road.store), "class-block", blocks, window.cell, {"classes": np.uint8(0)})
    return class_map(*drawable(mosaic, window, config), report["classes"], config.publish, None, report["areas"])
