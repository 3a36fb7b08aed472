"""A check whether polygons of labels lie beside their echoes: labels against answers, of a draw of tested echoes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.graph.stage import Plan
from fwclass.grid import millimetres
from fwclass.hashing import hash_keys
from fwclass.label.offset import measure_offset
from fwclass.model import ClassDef, class_index, code_index
from fwclass.schema import Table, canonical_key

MOST = 20_000
"""Echoes of every class that are drawn, those with the smallest hashes: the same whatever the tiles."""

NAMES = ("tested_hash", "tested_place", "tested_label", "tested_answer")


def by_place(plan: Plan) -> Mapping[str, Any]:
    """What a stage gets besides, where labels are those of polygons."""
    return {"by_place": True} if plan.config.survey.reference.kind == "polygons" else {}


def draw_tested(table: Table, classes: tuple[ClassDef, ...]) -> dict[str, NDArray]:
    """`NAMES` of the drawn echoes of a tile, (rows,) each, places (rows, 2) [mm]: label and answer are indices of
    `classes`; an echo without either is none."""
    label, answer = class_index(table["reference"], classes), code_index(table["classification"], classes)
    rows = np.flatnonzero((label >= 0) & (answer >= 0))
    tested = table.take(rows)
    place = np.stack([millimetres(tested["x"]), millimetres(tested["y"])], axis=1)
    values = (hash_keys(0, canonical_key(tested)), place, label[rows].astype(np.uint8), answer[rows].astype(np.uint8))
    return _smallest(dict(zip(NAMES, values, strict=True)))


def merge_tested(drawn: Mapping[str, NDArray], part: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """What was `drawn` of some tiles (empty: of none) and of one more; never more rows than `MOST` of a class."""
    if not drawn:
        return {name: part[name] for name in NAMES}
    return _smallest({name: np.concatenate([drawn[name], part[name]]) for name in NAMES})


def offset_of_tested(drawn: Mapping[str, NDArray], classes: int) -> dict[str, Any] | None:
    """As `measure_offset`, of the answers; None where too few were drawn beside each other."""
    if not drawn:
        return None
    answers = np.eye(classes, dtype=np.float32)[drawn["tested_answer"]]
    offset = measure_offset(answers, drawn["tested_label"], drawn["tested_place"], classes)
    return None if offset is None else asdict(offset)


def _smallest(drawn: dict[str, NDArray]) -> dict[str, NDArray]:
    """Of every label at most `MOST` rows with the smallest hashes, sorted by label and hash."""
    label = drawn["tested_label"]
    order = np.lexsort((drawn["tested_hash"], label))
    first = np.searchsorted(label[order], label[order])
    kept = order[np.arange(len(order)) - first < MOST]
    return {name: values[kept] for name, values in drawn.items()}
