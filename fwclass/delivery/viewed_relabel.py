"""Relabelling in the viewer: what was drawn is resolved on the delivered echoes, written, and told to pages."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery
from fwclass.delivery.viewed_corrections import Change, CorrectionRows, Corrections, in_place
from fwclass.errors import InputError
from fwclass.formats.echo_labels import TAKEN_BACK
from fwclass.schema import IDENTITY, Table, canonical_key
from fwclass.view.blocks import marks
from fwclass.view.params import ViewParams
from fwclass.view.pyramid import Node
from fwclass.view.selection import Selection

PLACE = (*IDENTITY, "x", "y", "z")
SEARCHED = ("classification", "confidence", "height_above_ground")

KEPT = 8
"""Selections that are kept until they are applied: two pages, four tries each."""

TOLD = 64
"""Tiles whose changes a page is told one by one; of more it takes all blocks anew."""

ALL_ANEW = 0xFFFFFFFF

RowsByTile = Mapping[str, NDArray[np.int64]]
"""Rows of tiles."""


@dataclass(frozen=True)
class Selected:
    """Rows by tile."""

    rows: RowsByTile

    @property
    def echoes(self) -> int:
        """Number of selected echoes."""
        return sum(map(len, self.rows.values()))


class Relabelling:
    """See `fwclass.view.scene.Relabel`. `in_blocks` gives node, row in its block and index of all given rows of a
    tile."""

    def __init__(
        self,
        delivery: Delivery,
        params: ViewParams,
        in_blocks: Callable[[str, NDArray[np.int64]], Sequence[tuple[Node, NDArray, NDArray]]],
    ) -> None:
        self._delivery, self._params, self._in_blocks = delivery, params, in_blocks
        self.corrections = Corrections(delivery)
        self._tiles = {t["tile"]: t for t in delivery.tiles}
        self._codes = delivery.correctable
        self._selected: OrderedDict[int, Selected] = OrderedDict()
        self._numbers, self._lock = count(1), Lock()

    def begin(self) -> dict[str, Any]:
        self.corrections.check()
        rows = self.corrections.rows()
        reference = self._delivery.report["config"]["survey"]["reference"]
        return {
            "rows": rows.all.rows,
            "standing": rows.labels.rows,
            "who": self.corrections.who,
            "classes": [{"code": code, "name": name} for code, name in self._codes.items()],
            "says": _reason_unused(reference["kind"], reference.get("corrections"), self._delivery.has_model),
        }

    def select(self, selection: Selection) -> dict[str, Any]:
        self.corrections.check_current()
        tiles = [key for key, t in self._tiles.items() if selection.touches(t["bounds"])]
        searched = sum(int(self._tiles[key]["echoes"]) for key in tiles)
        _check_amount("would be searched", searched, self._params.searched, len(tiles))
        rows_by_tile, echoes, classes = {}, 0, np.zeros(256, np.int64)
        with self._lock:  # one at a time: each takes a tile's memory
            corrections = self.corrections.rows()
            for key in tiles:
                rows, codes = self._inside(key, selection, corrections)
                echoes += len(rows)
                _check_amount("are selected", echoes, self._params.selected, len(tiles), "at least ")
                if len(rows):
                    rows_by_tile[key] = rows
                    classes += np.bincount(codes, minlength=256)
            number = next(self._numbers)
            self._selected[number] = Selected(rows_by_tile)
            while len(self._selected) > KEPT:
                self._selected.popitem(last=False)
        return {
            "selection": number,
            "echoes": echoes,
            "tiles": len(rows_by_tile),
            "classes": {str(c): int(classes[c]) for c in np.flatnonzero(classes).tolist()},
            "rows": corrections.all.rows,
        }

    def marks(self, number: int) -> bytes:
        rows = self._known(number).rows
        return self._marked(rows, {key: np.ones(len(r), np.uint8) for key, r in rows.items()})

    def correct(self, number: int, code: int | None) -> dict[str, Any]:
        if code is not None and code != 0 and code not in self._codes:
            raise InputError(
                "no class that this run learns has such a code",
                where="the page's request",
                expected=", ".join(f"{c} ({name})" for c, name in self._codes.items()) + ", 0 for no class",
                got=code,
                do="choose one of these",
            )
        self.corrections.check_current()
        selected = self._known(number)
        if not selected.echoes:
            raise InputError("nothing is selected", where="the page's request", do="draw around some echoes first")
        parts = [{n: v[rows] for n, v in self._read(key, PLACE).items()} for key, rows in selected.rows.items()]
        columns = {n: np.concatenate([p[n] for p in parts]) for n in PLACE}
        return self._outcome(self.corrections.add(columns, TAKEN_BACK if code is None else code))

    def revert(self, time: int) -> dict[str, Any]:
        self.corrections.check_current()
        return self._outcome(self.corrections.revert(time))

    def changes(self, known: int) -> bytes:
        self.corrections.check_current()
        rows = self.corrections.rows()
        tiles = [k for k in rows.since(known) if k in self._tiles] if known <= rows.all.rows else []
        if known > rows.all.rows or len(tiles) > TOLD:
            return np.array([rows.all.rows, ALL_ANEW], "<u4").tobytes()
        new = np.sort(rows.all.take(np.arange(known, rows.all.rows)).key)
        places, codes = {}, {}
        for key in tiles:
            columns = self._read(key, (*PLACE, "classification"))
            own = canonical_key(Table({n: columns[n] for n in IDENTITY}))
            at = np.minimum(np.searchsorted(new, own), len(new) - 1)  # np.isin hashes, and such keys collide
            places[key] = np.flatnonzero(new[at] == own)
            codes[key] = in_place(columns, rows.of(key), self.corrections.reach)[0][places[key]]
        return np.array([rows.all.rows, 0], "<u4").tobytes() + self._marked(places, codes)

    def _outcome(self, written: Change) -> dict[str, Any]:
        rows = self.corrections.rows()
        summary = {"time": written.time or None, "echoes": written.rows, "left": written.left}
        return {**summary, "rows": rows.all.rows, "standing": rows.labels.rows}

    def _known(self, number: int) -> Selected:
        with self._lock:
            if number not in self._selected:
                raise InputError("this selection is not kept any more", where="the page's request", do="draw it again")
            return self._selected[number]

    def _inside(
        self, key: str, selection: Selection, corrections: CorrectionRows
    ) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """Rows of a tile that are selected, and their classes, corrections in place."""
        labels = corrections.of(key)
        columns = self._read(key, (*(PLACE if labels.rows else "xyz"), *SEARCHED))
        columns["classification"] = in_place(columns, labels, self.corrections.reach)[0]
        rows = selection.rows(columns)
        return rows, columns["classification"][rows]

    def _read(self, key: str, names: Sequence[str]) -> dict[str, NDArray]:
        columns = table_columns(self._file(key), names)
        if lacking := [n for n in names if n not in columns]:
            raise InputError("a delivered tile lacks columns", where=key, got=", ".join(lacking), do="run again")
        return columns

    def _file(self, key: str) -> Path:
        return self._delivery.table(key)

    def _marked(self, places: RowsByTile, values: Mapping[str, NDArray[np.uint8]]) -> bytes:
        """All nodes that have one of the echoes; one that has them of several tiles comes several times."""
        return b"".join(
            marks(node, rows, values[key][index])
            for key, place in places.items()
            if len(place)
            for node, rows, index in self._in_blocks(key, place)
        )


def _reason_unused(kind: str, corrections: str | bool | None, model: bool) -> str:
    """Why the next run takes nothing of what is corrected here; "" where it does."""
    if kind == "none":
        return "This survey has no reference labels: a run takes no corrections, and trains nothing."
    if corrections is not None:
        named = repr(corrections) if corrections else "false"
        return f"The next run takes none of this: its configuration says survey.reference.corrections: {named}."
    if not model:
        return "A run of the ground alone (--workflow ground) takes no corrections: one that trains learns from them."
    return ""


def _check_amount(what: str, echoes: int, most: int, tiles: int, least: str = "") -> None:
    if echoes > most:
        raise InputError(
            f"too many echoes {what} at once",
            where=f"what was drawn, which touches {tiles:,} tiles",
            expected=f"at most {most:,} echoes",
            got=f"{least}{echoes:,}",
            do="draw less, or come nearer: nothing was selected",
        )
