"""The page of a paper: facts as JSON, tables, plots and map as one HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fwclass.conf import Config
from fwclass.graph.rasters import Mosaic
from fwclass.grid import TileGrid, Window
from fwclass.publish.papers.page import render_paper
from fwclass.report.figures import drawable
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner
from fwclass.store.atomic import write_json
from fwclass.survey.layout import Layout


def write_paper(
    config: Config, runner: Runner, layout: Layout, report: Mapping[str, Any], facts: Mapping[str, Any], **shown: Any
) -> dict[str, Any]:
    """Write ``<paper>.json`` and ``<paper>.html`` beside the report; the report's dict, with the page as an output.

    `shown` is what the page draws and the JSON does not hold.
    """
    name = str(facts["paper"])
    write_json(runner.pending / f"{name}.json", dict(facts))
    render_paper({**facts, **shown}, class_picture(config, runner, layout, report), runner.pending / f"{name}.html")
    return {**report, "outputs": {**report["outputs"], "page": [f"{name}.html"]}}


def class_picture(config: Config, runner: Runner, layout: Layout, report: Mapping[str, Any]) -> bytes:
    """The map of all classes."""
    from fwclass.publish.figures import class_map  # matplotlib is slow to load, and only a page needs it

    window = Window.of_points(layout.box, config.publish.class_cell)
    grid = TileGrid(config.terrain.block)
    blocks = sorted(
        grid.tile(part) for stage, part in runner.outcomes if stage == "class-block" and runner.is_done(stage, part)
    )
    mosaic = Mosaic(PartInputs(runner.store), "class-block", blocks, window.cell, {"classes": np.uint8(0)})
    return class_map(*drawable(mosaic, window, config), report["classes"], config.publish, None, report["areas"])
