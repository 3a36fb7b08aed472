"""Stages of products from waveforms themselves: samples freed of the pulse, voxels, vertical profiles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.deconvolution import SAMPLES, backscatter_samples, join_samples
from fwclass.decompose.params import DecomposeParams, SampleParams
from fwclass.errors import ConfigError, several
from fwclass.formats.crs import crs_of_wkt
from fwclass.graph.ground import around_block, survey_blocks, terrain_blocks
from fwclass.graph.outputs import NO_BYTE
from fwclass.graph.rasters import Mosaic, owned
from fwclass.graph.sources import (
    MEASURE_PULSE,
    READ_SPAN,
    placement_of,
    pulse_of,
    strip_of,
    strips_declared,
    waveforms_of,
)
from fwclass.graph.stacking import spans_near
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box, Tile, TileGrid, Window
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.stage import TERRAIN
from fwclass.publish.geoparquet import write_geoparquet
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.params import PublishParams
from fwclass.run.inputs import TABLE
from fwclass.run.part import Name
from fwclass.schema import Table, canonical_key
from fwclass.store.arrays import SurveyArray, write_arrays, write_grids
from fwclass.store.tables import write_groups
from fwclass.tile.stage import split
from fwclass.voxels import profiles, voxels
from fwclass.voxels.params import ProfileParams, VoxelParams

ARRAYS = "arrays"
LAYERS, EDGE = 32, 128
"""Voxels of a chunk of the delivered arrays: up, and to both sides; 2 MiB."""


def sample_waves(here: StageInputs, params: SampleParams, fit: DecomposeParams, block: float) -> Result:
    """The samples of a span, freed of the pulse, by block of the fixed grid."""
    strip = strip_of(here.part)
    pulse, placement = pulse_of(strip, here.inputs), placement_of(strip, here.inputs)
    table, facts = backscatter_samples(waveforms_of(here.part, here.inputs), strip, params, fit, pulse, placement)
    cut = split(table, TileGrid(block))
    write_groups(here.directory / TABLE, cut.table, cut.offsets)
    rows = np.diff(cut.offsets).tolist()
    return {
        "tiles": {k: [i, n] for i, (k, n) in enumerate(zip(cut.keys, rows, strict=True))},
        "rows": sum(rows),
        **facts,
    }


def samples_in(here: StageInputs, box: Box, block: float) -> Table:
    """The samples of the declared spans in all blocks that touch `box`, in one order."""
    keys, parts = list(TileGrid(block).keys_touching(box)), []
    for span in here.parts(SAMPLES.name):
        there = here.inputs.meta(SAMPLES.name, span)["tiles"]
        parts += [here.inputs.fragment(SAMPLES.name, span, key) for key in keys if key in there]
    table = join_samples(parts)
    return table.take(box.contains(table["x"], table["y"]))


def fill_voxels(here: StageInputs, params: VoxelParams, block: float) -> Result:
    """The voxels of a block."""
    window = owned(here.tile, params.size)
    echoes = around_block(here).table
    echoes = echoes.take(np.argsort(canonical_key(echoes), kind="stable"))
    result = voxels.voxels_of(echoes, samples_in(here, window.box, block), window, params, here.part)
    if result is None:
        return {"layers": None}
    arrays, lattice = result
    write_arrays(here.directory / ARRAYS, arrays)
    return {
        "layers": [lattice.layer, lattice.layer + lattice.shape[0]],
        "hits": int(arrays["hits"].sum()),
        "occluded": int(((arrays["occluded"] > 0) & (arrays["passes"] == 0)).sum()),
        "seen": int((arrays["passes"] > 0).sum()),
    }


def fill_profiles(here: StageInputs, params: ProfileParams, terrain_cell: float, block: float) -> Result:
    """The vertical profiles of the cells of a block."""
    window = owned(here.tile, params.cell)
    samples = samples_in(here, window.box, block)
    around = Window.covering(window.box, terrain_cell, 1)
    blocks = [TileGrid(block).tile(key) for key in here.parts(TERRAIN.name)]
    dtm = Mosaic(here.inputs, TERRAIN.name, blocks, terrain_cell, {"dtm": np.float32(np.nan)}).laid(around)["dtm"]
    above = samples["z"] - bilinear(dtm, around, samples["x"], samples["y"])
    arrays = profiles.profiles_of(samples, above, window, params)
    write_arrays(here.directory / ARRAYS, arrays)
    return {"cells": int((arrays["pulses"] > 0).sum()), "samples": samples.rows}


def deliver_samples(
    here: StageInputs, params: PublishParams, crs: str | None, standard_time: bool, block: float
) -> Result:
    """The samples of a block as LAZ and GeoParquet."""
    table = samples_in(here, here.tile.box, block)
    if table.rows:
        target = here.directory / "samples"
        target.mkdir(parents=True)
        one = np.ones(table.rows, np.uint8)
        shown = table.with_columns({"echo_number": one, "number_of_echoes": one, "classification": 0 * one})
        write_tile_laz(shown, target / f"{here.part}.laz", crs_of_wkt(crs), params, standard_time=standard_time)
        write_geoparquet(table, target / f"{here.part}.parquet", crs_of_wkt(crs), params)
    return {"rows": table.rows}


def deliver_voxels(here: StageInputs, size: float, block: float, crs: str | None) -> Result:
    """The voxels of the survey as one Zarr group: z, y, x, in chunks that can be read alone."""
    parts = {k: here.inputs.meta("voxels", k)["layers"] for k in here.parts("voxels")}
    windows = {k: owned(TileGrid(block).tile(k), size) for k, layers in parts.items() if layers is not None}
    if not windows:
        return {"chunks": 0}
    whole, low, high = (
        _whole(windows.values()),
        min(v[0] for v in parts.values() if v),
        max(v[1] for v in parts.values() if v),
    )
    shape, chunks = (high - low, *whole.shape), (LAYERS, EDGE, EDGE)
    grids = _axes({"z": (low, high - low), "y": (whole.row, whole.nrows), "x": (whole.col, whole.ncols)})
    for name, (unit, what) in voxels.ARRAYS.items():
        kind = "u4" if name in ("hits", "passes", "occluded") else "f4"
        about = {"units": unit, "long_name": what, "grid_mapping": "crs"}
        grids[name] = SurveyArray(shape, chunks, kind, 0.0, ("z", "y", "x"), about)

    def pieces() -> Iterator[Mapping[str, tuple[tuple[slice, ...], NDArray]]]:
        yield _coordinates({"z": (low, high - low), "y": (whole.row, whole.nrows), "x": (whole.col, whole.ncols)}, size)
        for key, window in windows.items():
            arrays, _ = here.inputs.arrays("voxels", key, ARRAYS)
            where = (slice(parts[key][0] - low, parts[key][1] - low), *window.within(whole))
            yield {n: (where, arrays[n]) for n in voxels.ARRAYS}

    write_grids(here.directory / "voxels.zarr", grids, _about(crs, "voxels", size), pieces())
    return {"voxels": math.prod(shape), "blocks": len(windows)}


def deliver_profiles(here: StageInputs, params: ProfileParams, block: float, crs: str | None) -> Result:
    """The profiles of the survey as one Zarr group: height, y, x."""
    windows = {k: owned(TileGrid(block).tile(k), params.cell) for k in here.parts("profiles")}
    whole = _whole(windows.values())
    y, x = whole.shape
    edge = min(EDGE, max(y, x))
    shapes = {"profile": ("height", params.bins), "relative_height": ("percent", len(profiles.SHARES))}
    across = {"y": (whole.row, y), "x": (whole.col, x)}
    grids = _axes(across)
    heights = params.lowest + params.bin * (np.arange(params.bins) + 0.5)
    grids["height"] = SurveyArray(
        (params.bins,), (params.bins,), "f8", 0.0, ("height",), {"units": "m", "long_name": "above ground"}
    )
    percent = np.array(profiles.SHARES, np.float64)
    grids["percent"] = SurveyArray((len(percent),), (len(percent),), "f8", 0.0, ("percent",), {"units": "%"})
    for name, (unit, what) in profiles.ARRAYS.items():
        axis = shapes.get(name)
        first = ((axis[1],), (axis[0],)) if axis else ((), ())
        kind, fill = ("u4", 0.0) if name == "pulses" else ("f4", math.nan)
        about = {"units": unit, "long_name": what, "grid_mapping": "crs"}
        grids[name] = SurveyArray((*first[0], y, x), (*first[0], edge, edge), kind, fill, (*first[1], "y", "x"), about)

    def pieces() -> Iterator[Mapping[str, tuple[tuple[slice, ...], NDArray]]]:
        yield {
            **_coordinates(across, params.cell),
            "height": ((slice(None),), heights),
            "percent": ((slice(None),), percent),
        }
        for key, window in windows.items():
            arrays, _ = here.inputs.arrays("profiles", key, ARRAYS)
            where = window.within(whole)
            yield {n: ((..., *where) if n in shapes else where, arrays[n]) for n in profiles.ARRAYS}  # type: ignore[misc]

    write_grids(here.directory / "profiles.zarr", grids, _about(crs, "profiles", params.cell), pieces())
    return {"cells": y * x}


def _whole(windows: Any) -> Window:
    some: Sequence[Window] = list(windows)
    col, row = min(w.col for w in some), min(w.row for w in some)
    right, top = max(w.col + w.ncols for w in some), max(w.row + w.nrows for w in some)
    return Window(some[0].cell, col, row, right - col, top - row)


def _axes(axes: Mapping[str, tuple[int, int]]) -> dict[str, SurveyArray]:
    named = {"x": "projection_x_coordinate", "y": "projection_y_coordinate", "z": "height"}
    return {
        n: SurveyArray(
            (k,), (k,), "f8", 0.0, (n,), {"units": "m", "standard_name": named[n], "long_name": "middle of the cell"}
        )
        for n, (_, k) in axes.items()
    }


def _coordinates(axes: Mapping[str, tuple[int, int]], size: float) -> dict[str, tuple[tuple[slice, ...], NDArray]]:
    return {n: ((slice(None),), size * (first + np.arange(k) + 0.5)) for n, (first, k) in axes.items()}


def _about(crs: str | None, title: str, size: float) -> dict[str, Any]:
    return {"Conventions": "CF-1.11", "title": title, "cell_size_m": size, "crs_wkt": crs or ""}


def _any_product(plan: Plan) -> bool:
    config = plan.config
    return config.samples.write or config.voxels.write or config.profile.write


def check_waves(plan: Plan) -> str:
    """A note on files without waveforms, of which no sample, voxel or profile tells; "" where all have some.

    `ConfigError`: none of the files has any, or they are left aside (`survey.echoes`).
    """
    if not _any_product(plan):
        return ""
    strips = plan.survey.strips
    without = len(strips) - (0 if plan.returns else len(strips_declared(plan)))
    if without == len(strips):
        raise ConfigError(
            "samples, voxels and profiles are of waveforms, and this survey has none",
            where=plan.config.path,
            expected="files with waveforms (`fwclass info` tells)",
            got="survey.echoes: returns" if plan.returns else f"{several(without, 'file')} of returns alone",
            do="leave voxels.write, profile.write and samples.write out, or name the files that have waveforms",
        )
    left_out = f"{without} of {len(strips)} files have no waveforms: samples, voxels and profiles lack their pulses"
    return left_out if without else ""


def _samples_around(box: Callable[[Plan, Tile], Box]) -> Callable[[Plan, Tile], list[Name]]:
    """The spans whose samples may lie in the box of a block's product."""

    def needs(plan: Plan, block: Tile) -> list[Name]:
        return [(SAMPLES.name, c) for c in spans_near(plan, box(plan, block))]

    return needs


def _profile_box(plan: Plan, block: Tile) -> Box:
    return owned(block, plan.config.profile.cell).box


def _profile_needs(plan: Plan, block: Tile) -> list[Name]:
    box = _profile_box(plan, block).grown(2.0 * plan.config.terrain.cell)
    near = [(TERRAIN.name, b.key) for b in terrain_blocks(plan.layout) if b.box.touches(box)]
    return [*_samples_around(_profile_box)(plan, block), *near]


SAMPLE_WAVES = Stage(
    SAMPLES.name,
    SAMPLES.version,
    "chunk",
    "pulse",
    sample_waves,
    when=_any_product,
    parts=READ_SPAN.parts,
    waves=True,
    arguments=lambda plan: {
        "params": plan.config.samples.model_copy(update={"write": False}),
        "fit": plan.config.decompose,
        "block": plan.config.terrain.block,
    },
    after=("read", "pulse", "places"),
    needs=lambda plan, part: (("read", part.key), (MEASURE_PULSE.name, part.strip.key), ("places", part.strip.key)),
)
FILL_VOXELS = Stage(
    "voxels",
    1,
    "block",
    "echo",
    fill_voxels,
    when=lambda plan: plan.config.voxels.write,
    parts=survey_blocks,
    arguments=lambda plan: {"params": plan.config.voxels, "block": plan.config.terrain.block},
    reads=voxels.ECHOES_READ,
    halo=lambda plan: plan.config.voxels.halo + plan.config.voxels.size,
    after=(SAMPLES.name,),
    needs=_samples_around(lambda plan, block: owned(block, plan.config.voxels.size).box),
)
FILL_PROFILES = Stage(
    "profiles",
    1,
    "block",
    "echo",
    fill_profiles,
    when=lambda plan: plan.config.profile.write,
    parts=survey_blocks,
    arguments=lambda plan: {
        "params": plan.config.profile,
        "terrain_cell": plan.config.terrain.cell,
        "block": plan.config.terrain.block,
    },
    after=(SAMPLES.name, TERRAIN.name),
    needs=_profile_needs,
)
DELIVER_SAMPLES = Stage(
    "publish-samples",
    2,
    "block",
    "echo",
    deliver_samples,
    when=lambda plan: plan.config.samples.write,
    parts=survey_blocks,
    arguments=lambda plan: {
        "params": plan.config.publish,
        "crs": plan.survey.crs,
        "standard_time": plan.survey.standard_time,
        "block": plan.config.terrain.block,
    },
    silent=NO_BYTE,
    after=(SAMPLES.name,),
    needs=_samples_around(lambda plan, block: block.box),
    place="deliver",
)
DELIVER_VOXELS = Stage(
    "publish-voxels",
    1,
    "survey",
    "part",
    deliver_voxels,
    when=lambda plan: plan.config.voxels.write,
    arguments=lambda plan: {
        "size": plan.config.voxels.size,
        "block": plan.config.terrain.block,
        "crs": plan.survey.crs,
    },
    after=("voxels",),
    needs=lambda plan, part: [("voxels", b.key) for b in survey_blocks(plan)],
    place="deliver",
)
DELIVER_PROFILES = Stage(
    "publish-profiles",
    1,
    "survey",
    "part",
    deliver_profiles,
    when=lambda plan: plan.config.profile.write,
    arguments=lambda plan: {"params": plan.config.profile, "block": plan.config.terrain.block, "crs": plan.survey.crs},
    after=("profiles",),
    needs=lambda plan, part: [("profiles", b.key) for b in survey_blocks(plan)],
    place="deliver",
)
