"""Labels by echo identity: stages that read them, and what the stages after them know of those in and around a tile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf.sections import AreasSection
from fwclass.formats.echo_labels import FIELD, EchoLabels, read_echo_labels
from fwclass.graph.areas import rows_to_test
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import TileGrid
from fwclass.label.corrections import COLUMNS, last_of_each, match_labels, outside, reference_codes
from fwclass.model import ClassDef
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.run.part import Name
from fwclass.schema import Table
from fwclass.store.remote_file import Location
from fwclass.store.row_digests import ROW_DIGESTS, digests_by_name, digests_by_square
from fwclass.store.tables import write_groups
from fwclass.survey.layout import FileDigests, Layout

CORRECTIONS, ECHO_LABELS = "corrections", "echo-labels"
ALL = "all"
_ROUNDING = 0.001
"""Added to reaches [m], so that a place at a tile's very border is cut for both tiles whatever its rounding."""


def cut_echo_labels(here: StageInputs, size: float, reach: float, margin: float, field: str) -> Result:
    """Labels of a file that are not taken back, cut by the tiles of `size` that an echo of theirs may lie in."""
    labels = read_echo_labels(here.file(), here.file(), field).standing()
    return _cut(here, labels, labels.code, size, reach, margin)


def cut_corrections(
    here: StageInputs, size: float, reach: float, margin: float, classes: tuple[ClassDef, ...]
) -> Result:
    """Corrections that are not taken back, cut by the tiles of `size` that lie within `margin` of them [m]."""
    labels = read_echo_labels(here.file(), here.file()).standing()
    stands = labels.code >= 0
    codes = np.full(labels.rows, -1, np.int16)
    codes[stands] = reference_codes(labels.code[stands], classes, here.file())
    return _cut(here, labels, codes, size, reach, margin)


def _cut(
    here: StageInputs, labels: EchoLabels, codes: NDArray[np.int16], size: float, reach: float, margin: float
) -> dict[str, Any]:
    stands = codes >= 0
    columns = {n: getattr(labels, n)[stands] for n in COLUMNS[:-1]}
    table = Table({**columns, "label_code": codes[stands]})
    rows, tiles = _near(table, size, max(margin, reach) + _ROUNDING)
    ranked = np.lexsort((rows, tiles[:, 1], tiles[:, 0]))
    rows, tiles = rows[ranked], tiles[ranked]
    new = np.ones(len(rows), bool)
    new[1:] = (tiles[1:] != tiles[:-1]).any(axis=1)
    first = np.flatnonzero(new)
    keys = [f"{a}_{b}" for a, b in tiles[first].tolist()]
    offsets = np.append(first, len(rows))
    own, owners = _near(table, size, reach + _ROUNDING)
    mine = {f"{a}_{b}" for a, b in np.unique(owners, axis=0).tolist()} if len(own) else set()
    pieces = table.take(rows)
    write_groups(here.directory / TABLE, pieces, offsets)
    used, counts = np.unique(table["label_code"], return_counts=True)
    return {
        "rows": table.rows,
        "taken_back": int((~stands).sum()),
        "codes": {str(c): int(n) for c, n in zip(used.tolist(), counts.tolist(), strict=True)},
        "tiles": {k: [i, int(n), k in mine] for i, (k, n) in enumerate(zip(keys, np.diff(offsets), strict=True))},
        ROW_DIGESTS: {**digests_by_name(pieces, keys, offsets), **digests_by_square(pieces, pieces["x"], pieces["y"])},
    }


def _near(table: Table, size: float, margin: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows, and (column, row) of every tile within `margin` of each [m]."""
    grid = TileGrid(size)
    low = np.stack(grid.indices(table["x"] - margin, table["y"] - margin), axis=1)
    high = np.stack(grid.indices(table["x"] + margin, table["y"] + margin), axis=1)
    span = (high - low).max(axis=0, initial=0)
    rows, tiles = [], []
    for a in range(int(span[0]) + 1):
        for b in range(int(span[1]) + 1):
            there = low + np.array([a, b])
            some = np.flatnonzero((there <= high).all(axis=1))
            rows.append(some)
            tiles.append(there[some])
    return np.concatenate(rows), np.concatenate(tiles).astype(np.int64)


def labels_of(inputs: PartInputs, stage: str, parts: tuple[str, ...], tile: str) -> Table:
    """The labels of `parts` in and around a tile; of several of one echo the last counts."""
    pieces = [inputs.fragment(stage, part, tile) for part in parts]
    return last_of_each(Table.concat(pieces).select(COLUMNS)) if pieces else Table.empty(COLUMNS)


def corrections_of(here: StageInputs) -> Table:
    """The corrections in and around the part's tile; without rows where the part was planned with none."""
    return labels_of(here.inputs, CORRECTIONS, here.parts(CORRECTIONS), here.part)


def apply_labels(echoes: Table, labels: Table, reach: float, reference: NDArray) -> tuple[NDArray, int]:
    """`reference` (rows,) with what `labels` say in its place, and how many of them say something."""
    rows, own = match_labels(echoes, labels, reach)
    codes = np.array(reference, np.uint8)
    codes[rows] = labels["label_code"][own]
    return codes, len(rows)


def corrected_training_rows(echoes: Table, corrections: Table, areas: AreasSection, reach: float) -> NDArray[np.bool_]:
    """bool (rows,): the echo is corrected, and trains wherever it lies; not within `areas.gap` of a listed test
    area."""
    trained = np.zeros(echoes.rows, bool)
    trained[match_labels(echoes, teaching_corrections(corrections, areas), reach)[0]] = True
    return trained


def teaching_corrections(corrections: Table, areas: AreasSection) -> Table:
    """The corrections that the model learns from: none near a listed test area, which stays one."""
    return corrections.take(outside(corrections, [box.grown(areas.gap) for box in areas.boxes("test")]))


def untaught_rows(echoes: Table, corrections: Table, areas: AreasSection, reach: float) -> NDArray[np.bool_]:
    """bool (rows,): the echo is tested; it neither lies near an area or an echo that the model learns from, nor is one
    of these."""
    train, test = areas.boxes("train"), areas.boxes("test")
    rows = rows_to_test(echoes, train, test, areas.gap, teaching_corrections(corrections, areas))
    return rows & ~corrected_training_rows(echoes, corrections, areas, reach)


def corrections_in(inputs: PartInputs, layout: Layout, tile: str) -> Table:
    """As `corrections_of`, for who reads a run and makes no part of it."""
    return labels_of(inputs, CORRECTIONS, (ALL,) if tile in layout.near_corrected else (), tile)


def without_corrections(plan: Plan) -> Plan:
    """For the experiments of papers, which draw their own rows: the labels as they were."""
    return replace(plan, tiled=replace(plan.layout, corrected=frozenset(), near_corrected=frozenset()))


def corrections_here(plan: Plan, tile: Any) -> tuple[Name, ...]:
    """The corrections, where one may be of an echo of the tile."""
    return ((CORRECTIONS, ALL),) if tile.key in plan.layout.corrected else ()


def corrections_around(plan: Plan, tile: Any) -> tuple[Name, ...]:
    """The corrections, where one lies so near that an echo of the tile may not be tested."""
    return ((CORRECTIONS, ALL),) if tile.key in plan.layout.near_corrected else ()


def reach_here(plan: Plan, tile: Any) -> Mapping[str, Any]:
    """What a stage gets besides where corrections are in its tile; nothing elsewhere, so that its key stays."""
    return {"reach": plan.config.label.max_move} if corrections_here(plan, tile) else {}


def reach_around(plan: Plan, tile: Any) -> Mapping[str, Any]:
    """As `reach_here`, where corrections are around its tile."""
    return {"reach": plan.config.label.max_move} if corrections_around(plan, tile) else {}


@dataclass(frozen=True)
class _File:
    """A file of labels by echo."""

    key: str
    path: Location
    digests: FileDigests


def _corrections(plan: Plan) -> list[_File]:
    file = plan.survey.corrections
    return [_File(ALL, *file)] if file is not None else []


def _cutting(plan: Plan, margin: float) -> Mapping[str, Any]:
    return {"size": plan.config.tile.size, "reach": plan.config.label.max_move, "margin": margin}


def _hidden(plan: Plan) -> float:
    """How far around a correction nothing is tested [m]; a given model has not learned from it."""
    return plan.config.areas.gap if plan.config.survey.model is None else 0.0


def label_parts(layout: Layout, receipts: Mapping[Name, Any]) -> dict[str, Any]:
    """What a layout says of labels by echo, by the receipts of the stages that read them."""
    labels: dict[str, list[str]] = {}
    for name in sorted(receipts):
        if name[0] == ECHO_LABELS:
            for tile in receipts[name].meta["tiles"]:
                labels.setdefault(tile, []).append(name[1])
    receipt = receipts.get((CORRECTIONS, ALL))
    tiles = receipt.meta["tiles"] if receipt is not None else {}
    return {
        "echo_labels": {tile: tuple(parts) for tile, parts in labels.items()},
        "near_corrected": frozenset(tiles) & layout.keys,
        "corrected": frozenset(k for k, (_, _, own) in tiles.items() if own) & layout.keys,
    }


READ_ECHO_LABELS = Stage(
    ECHO_LABELS,
    1,
    "file",
    "part",
    cut_echo_labels,
    when=lambda plan: plan.config.survey.reference.kind == "echoes",
    parts=lambda plan: [_File(f"{number:03d}", *file) for number, file in enumerate(plan.survey.echo_labels)],
    arguments=lambda plan: {**_cutting(plan, 0.0), "field": plan.config.survey.reference.field or FIELD},
    source=lambda plan, file: (file.path, file.digests),
)
READ_CORRECTIONS = Stage(
    CORRECTIONS,
    1,
    "file",
    "part",
    cut_corrections,
    when=lambda plan: plan.config.survey.reference.kind != "none",
    parts=_corrections,
    arguments=lambda plan: {**_cutting(plan, _hidden(plan)), "classes": plan.config.classes},
    source=lambda plan, file: (file.path, file.digests),
)
