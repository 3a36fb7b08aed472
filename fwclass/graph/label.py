"""Stages of the reference: its polygons, and the class of every echo, by whatever it comes from and is corrected by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pyproj import CRS

from fwclass.graph.corrections import (
    CORRECTIONS,
    ECHO_LABELS,
    apply_labels,
    corrections_here,
    corrections_of,
    labels_of,
    reach_here,
)
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.label.cloud_offset import HALO, compare_heights
from fwclass.label.params import LabelParams
from fwclass.label.polygons import Polygons, from_polygons
from fwclass.label.stage import LABEL, from_cloud, from_source
from fwclass.label.values import codes_of, groups_of_codes
from fwclass.model import ClassDef
from fwclass.read.polygons import open_polygons, read_polygons, reproject
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Name
from fwclass.schema import Table
from fwclass.stage import Chunk
from fwclass.store.arrays import read_arrays, write_arrays
from fwclass.survey.layout import PolygonFile
from fwclass.waveforms import IMPLAUSIBLE

POLYGONS = "polygons"
_CLOUD = ("x", "y", "z", "gps_time", "source_class")
_CLASSES = LABEL.writes
_OF_ECHOES = frozenset({"max_move"})
"""Settings that say nothing of labels of another kind; where there are corrections, it is among what a part gets."""


def read_reference_polygons(
    here: StageInputs,
    field: str,
    values: Mapping[str | int, str | int | None],
    classes: tuple[ClassDef, ...],
    crs: str | None,
    layer: str,
    own_crs: str | None,
) -> Result:
    """Polygons of a file with their codes, in whole millimetres of the survey's system (`crs`, WKT).

    `own_crs`: the system that the file's coordinates are in (WKT; None: the survey's).
    """
    path = here.file()
    opened = open_polygons(path, layer)
    read, shapes = read_polygons(opened, field)
    codes, counts = codes_of(read, values, classes, f"{path}: field {field}")
    moved = ""
    if own_crs is not None and crs is not None:
        shapes, moved = reproject(shapes, CRS.from_wkt(own_crs), CRS.from_wkt(crs), path)
    polygons = Polygons.of(shapes, codes, groups_of_codes(codes, classes), path)
    write_arrays(here.directory / POLYGONS, polygons.arrays())
    least_x, least_y, most_x, most_y = polygons.bounds
    return {
        "file": path.name,
        "features": opened.features,
        "polygons": polygons.parts,
        "values": counts,
        "without_code": int((codes < 0).sum()),
        "without_polygon": shapes.empty,
        "invalid": shapes.invalid,
        "reprojected": moved,
        "bounds": [int(v) / 1000 for v in (least_x.min(), least_y.min(), most_x.max(), most_y.max())]
        if polygons.parts
        else None,
    }


_loaded: dict[tuple[str, ...], Polygons] = {}


def polygons_at(parts: tuple[str, ...], inputs: PartInputs) -> Polygons:
    """Polygons of all files, kept in this process as long as their paths, named by their content, are the same."""
    paths = [inputs.arrays_path("polygons", part, POLYGONS) for part in parts]
    key = tuple(map(str, paths))
    if key not in _loaded:
        _loaded.clear()
        _loaded[key] = Polygons.joined([Polygons.from_arrays(read_arrays(path)[0]) for path in paths])
    return _loaded[key]


def label_by_source(here: StageInputs, reach: float = 0.0) -> Result:
    """Reference classes from the source's own classification; corrections lie within `reach` [m] of their echo."""
    chunk = here.chunk()
    return _with_counts(*_correct(here, chunk, _without_implausible(chunk, from_source(chunk)), reach))


def label_by_cloud(here: StageInputs, params: LabelParams, reach: float = 0.0) -> Result:
    """Reference classes from the nearest point of another cloud, and how its heights fit those of the echoes."""
    box, clouds = here.tile.box.grown(here.halo), here.parts("reference")
    cloud = here.inputs.inside(box, here.tile_size, dict.fromkeys(_CLOUD, "reference"), clouds, base="reference")
    order = np.lexsort(tuple(cloud[n] for n in ("source_class", "gps_time", "z", "y", "x")))
    chunk = here.chunk()
    table, above = from_cloud(chunk, cloud.take(order), params.max_distance)
    table, facts = _with_counts(*_correct(here, chunk, _without_implausible(chunk, table), reach))
    echoes, points = ((t["x"], t["y"], t["z"]) for t in (chunk.table, cloud))
    sums, counts = compare_heights(echoes, points, here.tile.box)
    return table, {**facts, "above": above.tolist(), "moved": {"sums": sums.tolist(), "counts": counts.tolist()}}


def label_by_echoes(here: StageInputs, params: LabelParams, reach: float = 0.0) -> Result:
    """Reference classes by strip, pulse and number of the echo."""
    chunk = here.chunk()
    echoes = chunk.table.take(chunk.core)
    labels = labels_of(here.inputs, ECHO_LABELS, here.parts(ECHO_LABELS), here.part)
    reference, known = apply_labels(echoes, labels, params.max_move, np.zeros(echoes.rows, np.uint8))
    table, facts = _with_counts(*_correct(here, chunk, Table({"reference": reference}), reach))
    return table, {**facts, "by_echo": known}


def label_by_polygons(here: StageInputs, reach: float = 0.0) -> Result:
    """Reference classes from the polygons that the echoes lie in."""
    chunk = here.chunk()
    table, ambiguous = from_polygons(chunk, polygons_at(here.parts("polygons"), here.inputs).within(here.tile.box))
    table, facts = _with_counts(*_correct(here, chunk, _without_implausible(chunk, table), reach))
    return table, {**facts, "ambiguous": ambiguous}


def _without_implausible(chunk: Chunk, table: Table) -> Table:
    """`table` with no class of implausible and withheld echoes, whatever lies near or above them."""
    implausible = (chunk.table["fit_flags"][chunk.core] & IMPLAUSIBLE) > 0
    return Table({"reference": np.where(implausible, 0, table["reference"])})


def _correct(here: StageInputs, chunk: Chunk, table: Table, reach: float) -> tuple[Table, int | None]:
    """`table` with the corrections of the tile's echoes, and how many there are; None where nothing is corrected."""
    if not here.parts(CORRECTIONS):
        return table, None
    reference, number = apply_labels(chunk.table.take(chunk.core), corrections_of(here), reach, table["reference"])
    return Table({"reference": reference}), number


def _with_counts(table: Table, corrected: int | None) -> tuple[Table, dict[str, Any]]:
    codes, counts = np.unique(table["reference"], return_counts=True)
    facts: dict[str, Any] = {"codes": {str(c): int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)}}
    return table, facts if corrected is None else {**facts, "corrected": corrected}


@dataclass(frozen=True)
class _Polygons:
    """The file of polygons of a number."""

    key: str
    file: PolygonFile


def _field(plan: Plan) -> Mapping[str, Any]:
    reference = plan.config.survey.reference
    return {
        "field": reference.field or "",
        "values": reference.values,
        "classes": plan.config.classes,
        "crs": plan.survey.crs,
    }


def _of_kind(*kinds: str) -> Any:
    return lambda plan: plan.config.survey.reference.kind in kinds


def _params(plan: Plan) -> Mapping[str, Any]:
    return {"params": plan.config.label}


def _only_judges(plan: Plan) -> bool:
    """Nothing is trained by the labels."""
    return plan.config.survey.model is not None


def _cloud_halo(plan: Plan) -> float:
    return max(LABEL.halo(plan.config.label), HALO, _correction_reach(plan))


def _clouds(plan: Plan, tile: Any) -> list[Name]:
    box = tile.box.grown(_cloud_halo(plan))
    return [*(("reference", c) for c in plan.layout.around(box, plan.layout.clouds)), *corrections_here(plan, tile)]


def _label_parts(plan: Plan, tile: Any) -> list[Name]:
    return [*((ECHO_LABELS, p) for p in plan.layout.echo_labels.get(tile.key, ())), *corrections_here(plan, tile)]


def _correction_reach(plan: Plan) -> float:
    """How far around a tile corrections are read that may be of its echoes [m]."""
    return plan.config.label.max_move if plan.tiled is not None and plan.tiled.corrected else 0.0


READ_POLYGONS = Stage(
    "polygons",
    1,
    "file",
    "part",
    read_reference_polygons,
    when=_of_kind("polygons"),
    parts=lambda plan: [_Polygons(f"{number:03d}", file) for number, file in enumerate(plan.survey.polygons)],
    arguments=_field,
    each=lambda plan, part: {"layer": part.file.layer, "own_crs": part.file.crs},
    source=lambda plan, part: (part.file.path, part.file.digests),
)
LABEL_BY_CLOUD = Stage(
    LABEL.name,
    LABEL.version,
    "tile",
    "echo",
    label_by_cloud,
    when=_of_kind("cloud"),
    arguments=_params,
    each=reach_here,
    silent=_OF_ECHOES,
    own=("x", "y", "z", "gps_time", "fit_flags"),
    writes=_CLASSES,
    halo=_cloud_halo,
    after=("reference", CORRECTIONS),
    needs=_clouds,
    check=_only_judges,
)
LABEL_BY_SOURCE = replace(
    LABEL_BY_CLOUD,
    function=label_by_source,
    when=_of_kind("source"),
    arguments=lambda plan: {},
    keyed=_params,
    own=("x", "y", "z", "source_class", "fit_flags"),
    halo=_correction_reach,
    after=(CORRECTIONS,),
    needs=corrections_here,
)
LABEL_BY_ECHOES = replace(
    LABEL_BY_CLOUD,
    function=label_by_echoes,
    when=_of_kind("echoes", "corrections"),
    silent=frozenset({"max_distance"}),
    own=("x", "y", "z"),
    halo=lambda plan: plan.config.label.max_move,
    after=(ECHO_LABELS, CORRECTIONS),
    needs=_label_parts,
)
LABEL_BY_POLYGONS = Stage(
    LABEL.name,
    LABEL.version,
    "tile",
    "echo",
    label_by_polygons,
    when=_of_kind("polygons"),
    each=reach_here,
    own=("x", "y", "z", "fit_flags"),
    writes=_CLASSES,
    halo=_correction_reach,
    after=("polygons", CORRECTIONS),
    needs=lambda plan, tile: [*(("polygons", p) for p in plan.layout.polygons), *corrections_here(plan, tile)],
    check=_only_judges,
)
