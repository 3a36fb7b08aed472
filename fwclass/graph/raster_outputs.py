"""Stages that deliver rasters: terrain, surface, relief, classes, confidence and density, with a style beside each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from fwclass.errors import InputError
from fwclass.formats.crs import crs_of_wkt
from fwclass.graph.ground import terrain_blocks
from fwclass.graph.outputs import NO_BYTE, class_names
from fwclass.graph.rasters import Mosaic, stripes, write_rasters
from fwclass.graph.sites import WHOLE, sites
from fwclass.graph.stage import Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box, Tile, TileGrid, Window
from fwclass.ground.stage import TERRAIN
from fwclass.ground.terrain.terrain import NO_TERRAIN
from fwclass.publish.class_raster import NO_CONFIDENCE, class_rasters
from fwclass.publish.cog import STRIPE, cog, round_to_bits
from fwclass.publish.files import written_whole
from fwclass.publish.palette import colours
from fwclass.publish.params import PublishParams
from fwclass.publish.qgis_style import style_file
from fwclass.publish.raster_styles import MASK, STYLED, Spread, raster_style
from fwclass.publish.shade import hillshade, slope
from fwclass.quality.covered import CoveredArea
from fwclass.run.inputs import PartInputs

MAX_CELLS = 1 << 35
"""Cells of a survey-wide raster: 34 000 km² at 1 m. More are stray points, which would fill a disk with nothing."""


def map_classes(here: StageInputs, params: PublishParams) -> Result:
    """Class and confidence of the highest sound echo, and the echoes, of every cell of one block of the fixed grid."""
    window = Window.covering(here.tile.box, params.class_cell)
    points = here.inputs.inside(window.box, here.tile_size, here.columns, here.present)
    x, y, z = points["x"], points["y"], points["z"]
    rasters = class_rasters(x, y, z, points["classification"], points["confidence"], points["noise"], window)
    write_rasters(here.directory, rasters._asdict(), window)
    return {"cells": int((rasters.classes > 0).sum())}


def deliver_rasters(
    here: StageInputs,
    params: PublishParams,
    crs: str | None,
    names: Mapping[str, str],
    cell: float,
    block: float,
    bounds: tuple[float, float, float, float],
) -> Result:
    """Terrain and what it comes from, its slope and roughness, surface, their difference, relief, class, confidence and
    density of a box as COG.

    They are made in stripes from north to south: memory grows with the box's width alone. `names` of classes by code.
    """
    target = here.directory / ("rasters" if here.part == WHOLE else f"rasters/{here.part}")
    target.mkdir(parents=True)
    box, grid = Box(*bounds), TileGrid(block)
    windows = Window.of_points(box, cell), Window.of_points(box, params.class_cell)
    for window in windows:
        check_cells(window, box)
    system, blocks = crs_of_wkt(crs), tuple(grid.tile(key) for key in here.parts(TERRAIN.name))
    called = {int(code): name for code, name in names.items()}
    spreads: dict[str, Spread] = {}
    cell_counts = {
        "dtm_cells": _terrain_rasters(windows[0], blocks, system, params, here.inputs, target, spreads),
        "covered": _class_rasters(windows[1], blocks, called, system, params, here.inputs, target, spreads),
    }
    ranges = {name: spread.shown() for name, spread in spreads.items()}
    for name in STYLED:
        if not (target / f"{name}.tif").exists():
            continue
        with written_whole(target / f"{name}.qml") as beside:
            beside.write_bytes(style_file(raster_style(name, ranges, called), "raster"))
    return {**cell_counts, "ranges": ranges}


def check_cells(window: Window, box: Box) -> None:
    """`InputError` for a raster of a `box` whose echoes are far too few for its cells."""
    if math.prod(window.shape) > MAX_CELLS:
        raise InputError(
            "the survey's rasters would be too large",
            where="rasters",
            expected=f"at most {MAX_CELLS:,} cells",
            got=f"{window.ncols:,} x {window.nrows:,} cells of {window.cell:g} m from {box.bounds}",
            do="look for stray points with `fwclass info` and remove them, or choose larger terrain.cell and "
            "publish.class_cell",
        )


_TERRAIN = {
    "dtm": "terrain height [m]",
    "dsm": "height of the highest echo [m]",
    "ndsm": "highest echo above the terrain [m]",
    "dtm_distance": "distance of the nearest cell with a ground echo [m]",
    "slope": "angle of the terrain against the level, Horn 1981 [deg]",
    "roughness": "standard deviation of ground echoes about their plane in 3 x 3 cells [m]",
}


STEPS = {"dtm": 10, "ndsm": 10, "roughness": 10, "slope": 7}
"""Values are whole steps of 2^-bits: of 1 mm, as places have, and 0.008 degrees. Digits beyond are noise, and half of a
file."""

SMOOTH = ("dtm", "slope")
"""Surfaces, which compress by the differences of neighbours; echoes' heights, distances and counts repeat instead."""


def _terrain_rasters(
    window: Window,
    blocks: tuple[Tile, ...],
    crs: CRS | None,
    params: PublishParams,
    inputs: PartInputs,
    target: Path,
    spreads: dict[str, Spread],
) -> int:
    """Write heights, what they come from, slope, roughness and shaded relief; cells with terrain."""
    nothing = np.float32(np.nan)
    empty: dict[str, np.generic] = dict.fromkeys(("dtm", "dsm", "distance", "roughness"), nothing)
    empty["mask"] = np.uint8(NO_TERRAIN)
    mosaic = Mosaic(inputs, "terrain", blocks, window.cell, empty)
    cells = 0
    spreads |= {name: Spread() for name in _TERRAIN}
    with ExitStack() as files:
        put = {
            name: files.enter_context(
                cog(
                    *(nothing.dtype, window, target / f"{name}.tif", crs, params, np.nan),
                    tags={"what": what},
                    smooth=name in SMOOTH,
                )
            )
            for name, what in _TERRAIN.items()
        }
        what = {"what": "shaded relief, 1 to 255"}
        shade = files.enter_context(
            cog(np.dtype(np.uint8), window, target / "hillshade.tif", crs, params, 0, tags=what)
        )
        mask = files.enter_context(
            cog(np.dtype(np.uint8), window, target / "dtm_mask.tif", crs, params, NO_TERRAIN, names=MASK)
        )
        for stripe in stripes(window, STRIPE):
            if not mosaic.touches(stripe):
                continue
            around = stripe.grown(1)  # light and slope ask for the cells beside
            laid, inner = mosaic.laid(around), stripe.within(around)
            wide = laid["dtm"]
            heights = {name: raster[inner] for name, raster in laid.items()}
            dtm = heights["dtm"]
            there = np.isfinite(dtm)
            tone = np.where(there, 1 + 254 * hillshade(wide, window.cell, params)[inner], 0).astype(np.uint8)
            rasters = {
                "dtm": dtm,
                "dsm": heights["dsm"],
                "ndsm": heights["dsm"] - dtm,
                "dtm_distance": heights["distance"],
                "slope": slope(wide, window.cell),
                "roughness": heights["roughness"],
            }
            rasters |= {name: round_to_bits(rasters[name], bits) for name, bits in STEPS.items()}
            for name, raster in rasters.items():
                put[name](stripe, raster)
                spreads[name].add(raster)
            shade(stripe, tone)
            mask(stripe, heights["mask"])
            cells += int(there.sum())
    return cells


def _class_rasters(
    window: Window,
    blocks: tuple[Tile, ...],
    names: Mapping[int, str],
    crs: CRS | None,
    params: PublishParams,
    inputs: PartInputs,
    target: Path,
    spreads: dict[str, Spread],
) -> list[dict[str, Any]]:
    """Write the maps of classes, density and, where any echo has one, confidence; the area with a class, as
    `CoveredArea.plain` has it."""
    empty: dict[str, np.generic] = {
        "classes": np.uint8(0),
        "confidence": np.uint8(NO_CONFIDENCE),
        "echoes": np.uint32(0),
    }
    mosaic = Mosaic(inputs, "class-block", blocks, window.cell, empty)
    shown = colours([{"name": name, "code": code} for code, name in names.items()])
    small, real = np.dtype(np.uint8), np.dtype(np.float32)
    spreads["density"], confidence = Spread(), Spread()
    covered = CoveredArea(window.cell)
    with ExitStack() as files:
        put = files.enter_context(cog(small, window, target / "classes.tif", crs, params, 0, shown, names=names))
        what = {"what": "confidence of the class of the highest echo [%]"}
        sure = files.enter_context(
            cog(small, window, target / "confidence.tif", crs, params, NO_CONFIDENCE, tags=what, smooth=False)
        )
        what = {"what": "echoes per square metre"}
        many = files.enter_context(
            cog(real, window, target / "density.tif", crs, params, np.nan, tags=what, smooth=False)
        )
        for stripe in stripes(window, STRIPE):
            if not mosaic.touches(stripe):
                continue
            laid = mosaic.laid(stripe)
            there = laid["echoes"] > 0
            density = np.where(there, laid["echoes"] / window.cell**2, np.nan).astype(np.float32)
            put(stripe, laid["classes"])
            sure(stripe, laid["confidence"])
            many(stripe, density)
            spreads["density"].add(density)
            known = laid["confidence"] != NO_CONFIDENCE
            if known.any():
                spreads["confidence"] = confidence
                confidence.add(np.where(known, laid["confidence"] / 100, np.nan).astype(np.float32))
            covered.add(stripe, there)
    if "confidence" not in spreads:  # ground alone: nobody was asked how sure it is
        (target / "confidence.tif").unlink()
    return covered.plain()


MAP_CLASSES = Stage(
    "class-block",
    3,
    "block",
    "cell",
    map_classes,
    parts=lambda plan: terrain_blocks(plan.layout),
    edge=lambda plan: plan.config.terrain.block,
    arguments=lambda plan: {"params": plan.config.publish},
    silent=NO_BYTE,
    reads=("z", "classification", "confidence", "noise"),
    halo=0.0,
    area=lambda plan, block: Window.covering(block.box, plan.config.publish.class_cell).box,
)
DELIVER_RASTERS = Stage(
    "publish-rasters",
    11,
    "survey",
    "cell",
    deliver_rasters,
    parts=lambda plan: sites(plan.layout),
    part_name=lambda site: site.name,
    arguments=lambda plan: {
        "params": plan.config.publish,
        "crs": plan.survey.crs,
        "names": class_names(plan),
        "cell": plan.config.terrain.cell,
        "block": plan.config.terrain.block,
    },
    each=lambda plan, site: {"bounds": site.box.bounds},
    silent=NO_BYTE,
    after=("terrain", "class-block"),
    needs=lambda plan, site: [(stage, b.key) for stage in (TERRAIN.name, "class-block") for b in site.blocks],
    place="deliver",
)
