"""Stages that cut the survey: echoes and reference points of every span by tile, and the tiles from all spans."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fwclass.decompose.stage import DECOMPOSE
from fwclass.graph.kept import kept_noise
from fwclass.graph.sources import span_name, spans_of, strip_of, water_columns
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import TileGrid, quantise
from fwclass.read.stage import read_cloud
from fwclass.run.inputs import TABLE
from fwclass.run.part import Name
from fwclass.schema import Table
from fwclass.store.receipts import Receipt
from fwclass.store.remote_file import Location
from fwclass.store.row_digests import ROW_DIGESTS, digests_by_name
from fwclass.store.tables import write_groups
from fwclass.survey.bounds import CLOUD_ROWS
from fwclass.survey.layout import FileDigests
from fwclass.survey.numbering import assign_numbers
from fwclass.tile.params import TileParams
from fwclass.tile.stage import REFERENCE, SPLIT, TILE, assemble, assemble_points, repeats, split, twice_measured
from fwclass.waveforms import IMPLAUSIBLE

CLOUD_COLUMNS = ("x", "y", "z", "gps_time", "source_class")
"""What a reference cloud's points have."""


@dataclass(frozen=True)
class CloudPiece:
    """Points [`first`, `last`) of a file of the reference."""

    key: str
    path: Location
    digests: FileDigests
    first: int
    last: int


def _cloud_pieces(plan: Plan) -> list[CloudPiece]:
    listed = plan.survey.reference
    numbered = assign_numbers(path.name for path, _, _ in listed)
    return [
        CloudPiece(span_name(numbered[path.name], k), path, digests, first, min(points, first + CLOUD_ROWS))
        for path, digests, points in listed
        for k, first in enumerate(range(0, points, CLOUD_ROWS))
    ]


@dataclass(frozen=True)
class _TileOfSpans:
    """A tile that is still to be put together, and the spans that hold rows of it, in their order."""

    key: str
    spans: tuple[str, ...]


def _tiles_cut_by(stage: str) -> Callable[[Plan], list[_TileOfSpans]]:
    """The tiles that the spans of `stage` are cut into."""

    def parts(plan: Plan) -> list[_TileOfSpans]:
        spans: dict[str, list[str]] = {}
        for name in sorted(plan.splits):
            if name[0] == stage:
                for key in plan.splits[name].meta["tiles"]:
                    spans.setdefault(key, []).append(name[1])
        return [_TileOfSpans(key, tuple(some)) for key, some in sorted(spans.items())]

    return parts


def tiles_of_strips(plan: Plan) -> dict[int, tuple[str, ...]]:
    """For every strip the tiles that hold its echoes."""
    tiles: dict[int, set[str]] = {}
    for stage, part in plan.splits:
        if stage == SPLIT.name:
            tiles.setdefault(strip_of(part), set()).update(plan.splits[stage, part].meta["tiles"])
    return {strip: tuple(sorted(keys)) for strip, keys in tiles.items()}


def split_echoes(here: StageInputs, params: TileParams) -> Result:
    """Echoes of a span in tile order, one row group a tile; tells how many the source has of every class."""
    echoes = here.inputs.table("decompose", here.part)
    codes, counts = np.unique(echoes["source_class"], return_counts=True)
    by_code = {str(c): int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)}
    return {**_write_split(here, echoes, params), "codes": by_code}


def source_codes(splits: Mapping[Name, Receipt]) -> Counter[int]:
    """Echoes of the survey by the class of their source; none of parts that do not tell, as of an earlier version."""
    counted: Counter[int] = Counter()
    for (stage, _), receipt in splits.items():
        if stage == SPLIT.name:
            counted.update({int(code): n for code, n in receipt.meta.get("codes", {}).items()})
    return counted


def codes_of_strips(receipts: Iterable[Receipt]) -> dict[int, Counter[int]]:
    """Echoes of every strip by the class of their source."""
    counted: dict[int, Counter[int]] = {}
    for receipt in receipts:
        codes = {int(code): n for code, n in receipt.meta.get("codes", {}).items()}
        counted.setdefault(strip_of(receipt.part), Counter()).update(codes)
    return counted


def split_reference(
    here: StageInputs, params: TileParams, rows: tuple[int, int], project_to: str | None = None
) -> Result:
    """Reference points of part of a file, in tile order."""
    cloud = read_cloud(here.file(), *rows, project_to)
    return _write_split(here, cloud.with_columns({n: quantise(cloud[n]) for n in "xyz"}), params)


def _write_split(here: StageInputs, table: Table, params: TileParams) -> dict[str, Any]:
    result = split(table, TileGrid(params.size))
    write_groups(here.directory / TABLE, result.table, result.offsets)
    rows = (result.offsets[1:] - result.offsets[:-1]).tolist()
    return {
        "tiles": {k: [i, n] for i, (k, n) in enumerate(zip(result.keys, rows, strict=True))},
        "rows": sum(rows),
        ROW_DIGESTS: digests_by_name(result.table, result.keys, result.offsets),
    }


def _fragments(here: StageInputs, stage: str) -> list[Table]:
    """The rows of a tile in every span that has some."""
    return [here.inputs.fragment(stage, part, here.part) for part in here.parts(stage)]


def tile_echoes(here: StageInputs, blocks: tuple[float, ...], kept_noise: tuple[int, ...] = ()) -> Result:
    """A tile's echoes from all spans, in final row order; tells which blocks of each size [m] own one of them.

    Those of the source classes `kept_noise` are flagged as implausible ones are, so that no ground is made of them.
    """
    table = assemble(_fragments(here, "split"), f"tile {here.part}")
    if kept_noise:
        noise = np.isin(table["source_class"], kept_noise)
        flags = table["fit_flags"] | np.where(noise, IMPLAUSIBLE, 0).astype(np.uint8)
        table = table.with_columns({"fit_flags": flags})
    return table, {
        "rows": table.rows,
        "blocks": {str(size): sorted(TileGrid(size).keys(table["x"], table["y"])) for size in blocks},
        "bounds": [float(f(table[n])) for f in (np.min, np.max) for n in "xyz"],
        "strips": sorted({int(s) for s in set(table["strip"].tolist())}),
        "times": _passes(table),
        "repeated": repeats(table),
        "moved": twice_measured(table),
    }


def _passes(table: Table) -> list[list[float]]:
    """(strip, first, last) of the known times of every strip that has some."""
    times, strips = table["gps_time"], table["strip"]
    known = np.isfinite(times)
    passes = []
    for strip in np.unique(strips[known]).tolist():
        own = times[known & (strips == strip)]
        passes.append([int(strip), float(own.min()), float(own.max())])
    return passes


def tile_reference(here: StageInputs) -> Result:
    """A tile's reference points."""
    table = assemble_points(_fragments(here, "reference-split"))
    return table, {"rows": table.rows}


def _has_cloud(plan: Plan) -> bool:
    return plan.config.survey.reference.kind == "cloud"


def _tile_settings(plan: Plan) -> Mapping[str, Any]:
    return {"params": plan.config.tile}


def _brought_into(plan: Plan) -> Mapping[str, Any]:
    """The system that a cloud in feet, or in degrees, is brought into as the strips are, where one is named."""
    target = plan.config.read.project_to
    return {} if target is None else {"project_to": target}


def _blocks(plan: Plan) -> tuple[float, ...]:
    return tuple(sorted({float(plan.config.ground.block), float(plan.config.terrain.block)}))


SPLIT_ECHOES = Stage(
    SPLIT.name,
    SPLIT.version,
    "chunk",
    "pulse",
    split_echoes,
    parts=lambda plan: [span for strip in plan.survey.strips for span in spans_of(plan, strip)],
    arguments=_tile_settings,
    after=("decompose",),
    needs=lambda plan, part: ((DECOMPOSE.name, part.key),),
    bulky=True,
)
SPLIT_REFERENCE = Stage(
    "reference-split",
    SPLIT.version,
    "file",
    "reference",
    split_reference,
    when=_has_cloud,
    parts=_cloud_pieces,
    arguments=lambda plan: {**_tile_settings(plan), **_brought_into(plan)},
    each=lambda plan, piece: {"rows": (piece.first, piece.last)},
    source=lambda plan, piece: (piece.path, piece.digests),
)
TILE_ECHOES = Stage(
    TILE.name,
    TILE.version,
    "tile",
    "echo",
    tile_echoes,
    parts=_tiles_cut_by("split"),
    arguments=lambda plan: {"blocks": _blocks(plan), **kept_noise(plan)},
    keyed=_tile_settings,
    after=("split",),
    needs=lambda plan, tile: [("split", part) for part in tile.spans],
    writes=lambda plan: (*DECOMPOSE.writes, *water_columns(plan)),
    named=True,
    row_digests=True,
)
TILE_REFERENCE = Stage(
    REFERENCE.name,
    REFERENCE.version,
    "tile",
    "reference",
    tile_reference,
    when=_has_cloud,
    parts=_tiles_cut_by("reference-split"),
    keyed=_tile_settings,
    after=("reference-split",),
    needs=lambda plan, tile: [("reference-split", part) for part in tile.spans],
    writes=CLOUD_COLUMNS,
    named=True,
    row_digests=True,
)
