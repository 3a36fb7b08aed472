"""The pictures of a report: layers of one map, the system's pulse, the training areas."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.graph.assess import COUNTS
from fwclass.graph.rasters import Mosaic
from fwclass.graph.sources import pulse_of
from fwclass.grid import TileGrid, Window
from fwclass.publish.class_raster import NO_CONFIDENCE
from fwclass.report.facts import receipts_of_run
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner
from fwclass.survey.layout import Layout

MAP_CELLS = 4_000_000
"""A map is drawn from all cells up to this many; of a larger survey's only those that it shows are taken."""


def report_figures(
    config: Config, runner: Runner, layout: Layout, report: Mapping[str, Any]
) -> tuple[dict[str, bytes], tuple[float, float] | None]:
    """Maps of classes and terrain, none of what failed; heights of the terrain's lowest and highest tint [m]."""
    # matplotlib is slow to load, and only a report needs it
    from fwclass.publish.figures import SURE, WRONG, class_map, relief, share_map, tint_range
    from fwclass.publish.sampling_map import sampling_map

    others = _pulse_figure(runner, report)
    if report["sampling"]:
        others["sampling"] = sampling_map(report["sampling"])
    inputs, areas, params = PartInputs(runner.store), report["areas"], config.publish
    terrain = Window.of_points(layout.box, config.terrain.cell)
    window = Window.of_points(layout.box, params.class_cell)
    grid = TileGrid(config.terrain.block)
    surfaces, blocks = (
        [grid.tile(r.part) for r in receipts_of_run(runner, stage)] for stage in ("terrain", "class-block")
    )

    def cells(name: str, empty: np.generic) -> tuple[NDArray, Any]:
        return drawable(Mosaic(inputs, "class-block", blocks, window.cell, {name: empty}), window, config)

    if not blocks:  # nothing was classified
        return others, None
    surface = drawable(Mosaic(inputs, "terrain", surfaces, terrain.cell, {"dtm": np.float32(np.nan)}), terrain, config)
    percent, place = cells("confidence", np.uint8(NO_CONFIDENCE))
    sure = np.where(percent == NO_CONFIDENCE, np.nan, percent / 100).astype(np.float32)
    figures = {"map": class_map(*cells("classes", np.uint8(0)), report["classes"], params, surface, areas, aside=False)}
    if np.isfinite(sure).any():
        figures["confidence"] = share_map(sure, place, params, SURE, areas)
    wrong = _errors(runner, config, window)
    if wrong is not None:
        figures["errors"] = share_map(wrong, window, params, WRONG, areas)
    heights = tint_range(surface[0])
    return {**figures, "relief": relief(*surface, params, heights, aside=False), **others}, heights


def _errors(runner: Runner, config: Config, window: Window) -> NDArray[np.float32] | None:
    """Share of wrong test echoes in the blocks that accuracy is drawn from, as cells of `window`; None where there are
    none, or the map is too large to be drawn in full."""
    if not receipts_of_run(runner, "assess") or math.prod(window.shape) > MAP_CELLS:
        return None
    arrays, _ = PartInputs(runner.store).arrays("assess", "all", COUNTS)
    counts, edge = arrays["blocks"].astype(np.float64), config.assess.block / window.cell
    out = np.full(window.shape, np.nan, np.float32)
    for (ix, iy), matrix in zip(arrays["place"].tolist(), counts, strict=True):
        total = matrix.sum()
        if total:
            rows, columns = (
                (round(k * edge) - low, round((k + 1) * edge) - low) for k, low in ((iy, window.row), (ix, window.col))
            )
            out[max(0, rows[0]) : max(0, rows[1]), max(0, columns[0]) : max(0, columns[1])] = (
                1 - np.trace(matrix) / total
            )
    return out if np.isfinite(out).any() else None


def drawable(mosaic: Mosaic, window: Window, config: Config) -> tuple[NDArray, Any]:
    """A mosaic's one raster in `window`, thinned where it is too large to hold, and the place of its cells."""
    from fwclass.publish.drawing import View
    from fwclass.publish.figures import step_of

    step = step_of(window, config.publish.figure_pixels) if math.prod(window.shape) > MAP_CELLS else 1
    (raster,) = (mosaic.thinned(window, step) if step > 1 else mosaic.laid(window)).values()
    return raster, View.of(window, step)


def _pulse_figure(runner: Runner, report: Mapping[str, Any]) -> dict[str, bytes]:
    """The system's pulse of the first strip that has one."""
    from fwclass.report.pulse_picture import pulse_picture

    receipts = [r for r in receipts_of_run(runner, "pulse") if r.meta["sampled"]]
    if not receipts:
        return {}
    pulse = pulse_of(int(receipts[0].part), PartInputs(runner.store))
    return {"pulse": pulse_picture(pulse, report["waveforms"]["strips"][0]["name"])}
