"""Stages of the survey's quality: blocks of the fixed grid, and what is delivered of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass import __version__
from fwclass.formats.crs import crs_of_wkt
from fwclass.formats.wkb import box_wkb, point_wkb
from fwclass.graph.check_points import CHECK_POINTS, FILE, has_check_points
from fwclass.graph.coverage import area_coverage, read_area
from fwclass.graph.ground import survey_blocks
from fwclass.graph.left_aside import LEFT_ASIDE
from fwclass.graph.outputs import NO_BYTE
from fwclass.graph.raster_outputs import check_cells
from fwclass.graph.rasters import Mosaic, stripes, write_rasters
from fwclass.graph.sites import WHOLE, sites
from fwclass.graph.stage import Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box, Tile, TileGrid, Window
from fwclass.publish.cog import STRIPE, cog
from fwclass.publish.files import written_whole
from fwclass.publish.gpkg import Layer, write_gpkg
from fwclass.publish.params import PublishParams
from fwclass.publish.qgis_style import MANY, ramp_raster_style, style_file
from fwclass.publish.raster_styles import Spread
from fwclass.quality.block import READS, block_quality, pairs_from
from fwclass.quality.check_points import CHECKED, check_remarks, compared_points
from fwclass.quality.compared import compare_strips
from fwclass.quality.density import Density, density_remarks
from fwclass.quality.params import THRESHOLDS, QualityParams
from fwclass.quality.roughness import roughness_remarks
from fwclass.quality.steps import step_remarks
from fwclass.quality.strips import largest_differences, strip_remarks
from fwclass.quality.voids import LISTED, CellGroups, Void, piece_remarks, void_facts
from fwclass.run.inputs import PartInputs
from fwclass.store.arrays import write_arrays
from fwclass.store.atomic import write_json
from fwclass.survey.shape_files import source_of

if TYPE_CHECKING:
    from fwclass.publish.quality_page import Picture

COMPARED = "compared"
FACTS, PAGE, POLYGONS = "quality.json", "quality.html", "quality.gpkg"


def measure_quality(here: StageInputs, params: QualityParams) -> Result:
    """Counts by cell, pieces of strips and pairs of planes of one block."""
    box = here.tile.box
    quality = block_quality(here.inputs.inside(box, here.tile_size, here.columns, here.present), box, params)
    write_rasters(
        here.directory, {"echoes": quality.echoes, "pulses": quality.pulses}, Window.covering(box, params.cell)
    )
    write_arrays(here.directory / COMPARED, quality.arrays())
    files, lines = quality.between()
    return {
        "echoes": int(quality.echoes.sum()),
        "pulses": int(quality.pulses.sum()),
        "noise": quality.noise,
        "pairs": len(quality.pairs.dz),
        "between_files": files,
        "between_lines": lines,
    }


class _Differences(Mosaic):
    """The largest difference of strips in every cell, made of the pairs of each block."""

    def __init__(
        self, inputs: PartInputs, blocks: Sequence[Tile], params: QualityParams, number: Mapping[str, NDArray[np.int64]]
    ) -> None:
        super().__init__(inputs, MEASURE_QUALITY.name, blocks, params.planes.cell, {"dz": np.float32(np.nan)})
        self._params, self._number = params.planes, number
        self._windows = {b.key: Window.covering(b.box, params.planes.cell) for b in blocks}

    def _read(self, key: str) -> tuple[dict[str, NDArray], Window]:
        arrays, _ = self._inputs.arrays(self._stage, key, COMPARED)
        window = self._windows[key]
        largest = largest_differences(pairs_from(arrays), self._number[key], self._params.max_step, window.shape)
        return {"dz": largest}, window


def deliver_quality(
    here: StageInputs,
    params: QualityParams,
    publish: PublishParams,
    survey: str,
    crs: str | None,
    files: Mapping[str, str],
    block: float,
    places: Mapping[str, tuple[float, float, float, float]],
    area_source: Mapping[str, Any] | None,
    left_aside: bool = False,
) -> Result:
    """The survey's quality as JSON and rasters. `files`: names by number; `block`: edge of the blocks [m]; `places`:
    bounds [m] of the sites; `area_source`: layer and system of the area that was to be flown, None without one;
    `left_aside`: the sources' waveforms were."""
    # matplotlib is slow to load, and only the page needs it
    from fwclass.publish.quality_page import render_quality

    grid = TileGrid(block)
    blocks = tuple(grid.tile(key) for key in here.parts(MEASURE_QUALITY.name))
    metas = [here.inputs.meta(MEASURE_QUALITY.name, b.key) for b in blocks]
    strips, number = compare_strips(
        blocks,
        lambda key, only: here.inputs.arrays(MEASURE_QUALITY.name, key, COMPARED, only)[0],
        tuple(sum(int(m[name]) for m in metas) for name in ("pairs", "between_files", "between_lines")),
        params,
        {int(k): name for k, name in files.items()},
    )
    counted = Mosaic(
        here.inputs, MEASURE_QUALITY.name, blocks, params.cell, {"echoes": np.uint32(0), "pulses": np.uint32(0)}
    )
    differences = _Differences(here.inputs, blocks, params, number)
    density, system, empty, full = Density(params.cell), crs_of_wkt(crs), list[CellGroups](), list[CellGroups]()
    for place, bounds in places.items():
        target = here.directory / ("rasters" if place == WHOLE else f"rasters/{place}")
        target.mkdir(parents=True)
        without, covered_cells = _density_raster(counted, Box(*bounds), density, target, system, publish)
        empty.append(without)
        full.append(covered_cells)
        _difference_raster(differences, Box(*bounds), target, system, publish)
    density_facts = density.facts(params.void_spacings)
    least = (params.void_spacings * (density_facts["spacing"] or 0.0)) ** 2
    voids = sorted((v for one in empty for v in one.voids(least)), key=lambda v: (-v.area, v.box.bounds))
    covered, gaps = None, list[Void]()
    if area_source is not None:
        covered, gaps = area_coverage(counted, read_area(here.file(), crs, **area_source), least)
    checked = None
    if here.parts(CHECK_POINTS):
        checked = {k: v for k, v in here.inputs.meta(CHECK_POINTS, "all").items() if k in CHECKED}
    layers = _layers(here, voids, gaps)
    if layers:
        write_gpkg(layers, here.directory / POLYGONS, system)
    echoes, noise = (sum(int(m[name]) for m in metas) for name in ("echoes", "noise"))
    remarks = [
        *([LEFT_ASIDE] if left_aside else []),
        *(["all echoes are noise"] if not echoes else []),
        *(density_remarks(density_facts) or (piece_remarks(full[0].pieces(), full[0].area) if len(full) == 1 else [])),
        *strip_remarks(strips),
        *step_remarks(strips),
        *roughness_remarks(strips["roughness"]),
        *(check_remarks(checked, params.check_points.reach) if checked else ()),
    ]
    facts = {
        "survey": survey,
        "echoes": echoes + noise,
        "noise": noise,
        "noise_share": noise / (echoes + noise) if echoes + noise else None,
        "pulses": sum(int(m["pulses"]) for m in metas),
        "density": density_facts,
        "voids": void_facts(voids, least, density_facts["area"]),
        "strips": strips,
        "coverage": covered,
        "check_points": checked,
        **({"judged_by": "returns"} if left_aside else {}),
        "remarks": remarks,
    }
    write_json(here.directory / FACTS, facts)
    largest = Box(*max(places.values(), key=lambda b: (Box(*b).area, b)))
    pictures, named = _pictures(counted, differences, largest, publish), list(files.values())
    render_quality(facts, pictures, __version__, here.directory / PAGE, system, named)
    return {"quality": facts, "layers": [layer.name for layer in layers]}


def _layers(here: StageInputs, voids: Sequence[Void], gaps: Sequence[Void]) -> list[Layer]:
    """For a GIS: the largest voids and gaps as boxes, and the check points with what lies at them."""
    layers = []
    for name, areas in (("voids", voids[:LISTED]), ("gaps", gaps[:LISTED])):
        if areas:
            sizes = np.array([v.area for v in areas])
            layers.append(Layer(name, box_wkb([v.box for v in areas]), {"area_m2": sizes}))
    if here.parts(CHECK_POINTS):
        points = here.inputs.arrays(CHECK_POINTS, "all", FILE)[0]
        layers.append(Layer("check_points", point_wkb(points["x"], points["y"]), compared_points(points), "Point"))
    return layers


def _density_raster(
    counted: Mosaic, box: Box, density: Density, target: Path, crs: CRS | None, publish: PublishParams
) -> tuple[CellGroups, CellGroups]:
    """Write the raster, count into `density`, and return the cells without a pulse, and those with echoes."""
    window = Window.of_points(box, density.cell)
    check_cells(window, box)
    spread, tags = Spread(), {"what": "pulses per square metre, noise left out"}
    empty, full = CellGroups(window), CellGroups(window, corners=True)
    with cog(np.dtype(np.float32), window, target / "pulse_density.tif", crs, publish, np.nan, tags=tags) as put:
        for stripe in stripes(window, STRIPE):
            laid = counted.laid(stripe)
            empty.add(stripe, laid["pulses"] == 0)
            full.add(stripe, laid["echoes"] > 0)
            if counted.touches(stripe):
                density.add(stripe, laid["echoes"], laid["pulses"])
                values = np.where(laid["echoes"] > 0, laid["pulses"] / density.cell**2, np.nan).astype(np.float32)
                put(stripe, values)
                spread.add(values)
    _style(target / "pulse_density.qml", spread, "pulses/m²")
    return empty, full


def _difference_raster(
    differences: _Differences, box: Box, target: Path, crs: CRS | None, publish: PublishParams
) -> None:
    window = Window.of_points(box, differences.cell)
    spread, tags = Spread(), {"what": "largest difference in height of two strips' planes [m]"}
    with cog(np.dtype(np.float32), window, target / "strip_dz.tif", crs, publish, np.nan, tags=tags) as put:
        for stripe in stripes(window, STRIPE):
            if differences.touches(stripe):
                values = differences.laid(stripe)["dz"]
                put(stripe, values)
                spread.add(values)
    _style(target / "strip_dz.qml", spread, "m")


def _pictures(counted: Mosaic, differences: _Differences, box: Box, publish: PublishParams) -> list[Picture]:
    """Maps of the place that covers `box`, of some cells of a large one."""
    from fwclass.publish.drawing import View
    from fwclass.publish.figures import step_of
    from fwclass.publish.quality_page import density_picture, difference_picture

    windows = [Window.of_points(box, mosaic.cell) for mosaic in (counted, differences)]
    steps = [step_of(window, publish.figure_pixels) for window in windows]
    pulses, dz = (m.thinned(w, s) for m, w, s in zip((counted, differences), windows, steps, strict=True))
    views = [View.of(window, step) for window, step in zip(windows, steps, strict=True)]
    density = np.where(pulses["echoes"] > 0, pulses["pulses"] / counted.cell**2, np.nan).astype(np.float32)
    pictures = density_picture(density, views[0], publish), difference_picture(dz["dz"], views[1], publish)
    return [picture for picture in pictures if picture is not None]


def _style(path: Path, spread: Spread, unit: str) -> None:
    low, high = spread.shown()
    with written_whole(path) as beside:
        beside.write_bytes(style_file(ramp_raster_style(MANY, low, high, unit), "raster"))


MEASURE_QUALITY = Stage(
    "quality-block",
    5,
    "block",
    "echo",
    measure_quality,
    edge=lambda plan: plan.config.terrain.block,
    arguments=lambda plan: {"params": plan.config.quality},
    silent=THRESHOLDS | {"echoes", "strips", "check_points", "area"},
    reads=READS,
    halo=0.0,
)
DELIVER_QUALITY = Stage(
    "publish-quality",
    18,
    "survey",
    "cell",
    deliver_quality,
    arguments=lambda plan: {
        "params": plan.config.quality,
        "publish": plan.config.publish,
        "survey": plan.config.survey.name,
        "crs": plan.survey.crs,
        "files": {str(s.number): s.path.stem for s in plan.survey.strips},
        "block": plan.config.terrain.block,
        "places": {site.name: site.box.bounds for site in sites(plan.layout)},
        "area_source": {"layer": area.layer, "own_crs": area.crs} if (area := plan.survey.area) else None,
        **({"left_aside": True} if plan.returns else {}),
    },
    silent=NO_BYTE - {"figure_pixels"} | THRESHOLDS | {"echoes", "file"},
    after=(MEASURE_QUALITY.name, CHECK_POINTS),
    needs=lambda plan, part: [
        *((MEASURE_QUALITY.name, b.key) for b in survey_blocks(plan)),
        *([(CHECK_POINTS, "all")] if has_check_points(plan) else []),
    ],
    source=lambda plan, part: source_of(plan.survey.area),
    place="deliver",
)
