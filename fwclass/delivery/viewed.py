"""A run as the viewer shows it: blocks from its Parquet, and what stands behind an echo."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns, table_fields, table_row
from fwclass.delivery.opened import Delivery, open_at
from fwclass.delivery.places import listed_places
from fwclass.delivery.viewed_colours import (
    CORRECTED,
    DIFFERS,
    MEANING,
    RIGHT,
    compare_classes,
    compare_corrections,
    kinds,
    verdicts,
)
from fwclass.delivery.viewed_corrections import in_place
from fwclass.delivery.viewed_echo import BehindEchoes
from fwclass.delivery.viewed_pair import check_same_place, known_by, same_echo, tiles_of
from fwclass.delivery.viewed_relabel import Relabelling
from fwclass.delivery.viewed_span import Span, finite, span_of
from fwclass.delivery.viewed_tile import OpenTile, by_node, positions
from fwclass.errors import FwclassError, InputError
from fwclass.publish.palette import colours, css
from fwclass.schema import IDENTITY
from fwclass.store.run_store import Store
from fwclass.view.blocks import DRAWN, NO_VALUE, Scale, block, column_block, nothing
from fwclass.view.cache import Cache
from fwclass.view.params import ViewParams
from fwclass.view.pyramid import Node, Pyramid
from fwclass.view.scene import ECHOES
from fwclass.view.worklist import UnsureEchoes, WorkList

THREADS = 2
"""That read tiles ahead; more take turns at the interpreter's lock."""

HIDDEN = ("x", "y", "z", "pulse", "echo_number")
"""Columns that are no colours."""

UNSURE = ("x", "y", "z", "confidence", "classification")
"""Columns that the work list is made of."""

ENOUGH = 1000
"""Coarse echoes whose values tell those of all."""

REMEMBERED = 10_000
"""Echoes whose place in the tables is known from when they were looked at."""


class ViewedRun:
    """See `fwclass.view.scene.Scene`. What it shows is the delivery that was current when it was opened."""

    def __init__(self, delivery: Delivery, params: ViewParams, other: Delivery | None = None) -> None:
        self.delivery, self.params = delivery, params
        if other is not None:
            check_same_place(delivery, other)
        self.tiles = {t["tile"]: t for t in delivery.tiles}
        if not self.tiles:
            raise InputError("this delivery has no tile", where=delivery.path, do="run the survey again")
        self.size = float(delivery.report["config"]["tile"]["size"])
        places = np.array([key.split("_") for key in self.tiles], np.int64)
        self.echoes = sum(int(t["echoes"]) for t in self.tiles.values())
        self.pyramid = Pyramid.over(places, self.echoes, self.size, params.block, params.together)
        low = np.min([t["bounds"][:3] for t in self.tiles.values()], axis=0)
        self.origin = (*self.pyramid.corner, math.floor(float(low[2])))
        self._blocks, self._open = Cache(params.cache << 20), Cache(params.cache << 20)
        self._pool, self._lock = ThreadPoolExecutor(THREADS), Lock()
        self._skimmed: OpenTile | None = None
        self._behind = BehindEchoes(delivery)
        self.relabel = Relabelling(delivery, params, self._in_blocks)
        self._other = other
        self._asked: dict[tuple[int, ...], tuple[str, int]] = {}
        self._listed: Path | None = None

    @property
    def name(self) -> str:
        return self.delivery.path.name

    def reopened(self) -> ViewedRun:
        from fwclass.delivery.viewed_large import view_run  # which is made of this

        current = open_at(self.delivery.root)
        if current.path == self.delivery.path:
            return self
        scene = view_run(current, self.params)
        scene._listed = self._listed
        return scene

    def prepare(self) -> None:
        """Make ahead what the page asks for first; what fails will be said when it is asked for."""
        with suppress(FwclassError, OSError):
            for level in self.index()["together"]:
                self.level(ECHOES, level)
            self._behind.prepare()

    def index(self) -> dict[str, Any]:
        pyramid, report = self.pyramid, self.delivery.report
        boxes = np.array([t["bounds"] for t in self.tiles.values()])
        shown = colours(report["classes"])
        tiles = [
            [*map(int, key.split("_")), int(t["echoes"]), t["bounds"][2], t["bounds"][5]]
            for key, t in self.tiles.items()
        ]
        return {
            "name": report["survey"],
            "crs": report["place"].get("crs"),
            "delivery": self.name,
            "rows": self.relabel.corrections.rows().all.rows,
            "echoes": self.echoes,
            "against": self._other is not None,
            "goes_through": self._listed.name if self._listed is not None else None,
            "run": known_by(self.delivery, self._other or self.delivery),
            "relabels": self._other is None,
            "origin": self.origin,
            "bounds": [*boxes[:, :2].min(axis=0).tolist(), *boxes[:, 3:5].max(axis=0).tolist()],
            "height": sum(int(t["echoes"]) * float(t["height"]) for t in self.tiles.values()) / self.echoes,
            "size": pyramid.size,
            "west": pyramid.west,
            "south": pyramid.south,
            "joined": pyramid.joined,
            "halved": pyramid.halved,
            "together": list(pyramid.levels()[: pyramid.whole + 1]),
            "tiles": tiles,
            "classes": [{**c, "colour": css(shown[int(c["code"])])} for c in report["classes"]],
            "waveforms": self._waveforms,
            "columns": [f for f in self._fields if f["name"] not in HIDDEN],
        }

    def scale(self, part: str) -> dict[str, Any]:
        field = self._field(part)
        if (named := kinds(part, self.delivery.report["input"]["files"])) is not None:
            return {**field, "classes": named}
        return {**field, **{name: plain_value(end) for name, end in asdict(self._span(part)).items()}}

    def level(self, part: str, level: int) -> bytes:
        if level not in self.pyramid.levels():
            raise InputError("no such level", where=self.delivery.path, got=level)
        version = self.relabel.corrections.rows().all.rows if part in (ECHOES, CORRECTED) else 0
        return bytes(self._blocks.get((part, level, version), lambda: self._whole_level(part, level)))

    def node(self, part: str, node: Node) -> bytes:
        if not self.pyramid.has(node):
            raise InputError("no such block", where=self.delivery.path, got=node)
        version = self._version(self._key_of(node)) if part in (ECHOES, CORRECTED) else 0
        return bytes(self._blocks.get((part, node, version), lambda: self._block(part, node)))

    def echo(self, node: Node, row: int) -> dict[str, Any]:
        tile, at = self._row_of(node, row)
        self._pool.submit(self._behind.waves, *self._pulse_of(node, row))  # which is asked for next
        names = [f["name"] for f in self._fields if f["name"] not in MEANING]
        values = {n: plain_value(v) for n, v in table_row(self._file(tile), names, at).items()}
        if len(self._asked) >= REMEMBERED:
            self._asked.clear()
        self._asked[tuple(int(values[n]) for n in IDENTITY)] = tile, at
        return self._about(tile, at, values)

    def _about(self, tile: str, row: int, values: dict[str, Any]) -> dict[str, Any]:
        classes, rows = self._classes(self._tile(tile), tile)
        about = {"tile": tile, "row": row, "values": values, "corrected": int(classes[row]) if row in rows else None}
        if self._other is not None:
            twin = same_echo(self._other, values)
            about["other"] = {n: plain_value(v) for n, v in twin.items()} if twin else None
        return about

    def pulse(self, strip: int, pulse: int) -> dict[str, Any]:
        return self._behind.pulse(strip, pulse)

    def why(self, strip: int, pulse: int, echo_number: int) -> dict[str, Any]:
        tile, row = self._asked.get((strip, pulse, echo_number), ("", -1))
        if row < 0:
            tile, row = self._place_of(strip, pulse, echo_number)
        return self._behind.why(tile, row)

    def work(self) -> dict[str, Any]:
        places = [asdict(p) for p in self.work_list().places]
        return {"unsure": self.params.unsure, "places": places}

    def list_places(self, path: Path) -> None:
        """Take the places of a file for the work list, in its order, for as long as this scene is shown.

        Raises
        ------
        InputError
            It is no file of polygons, or no echo lies in any of them.
        """
        self._listed = path
        self.work_list()

    def work_list(self) -> WorkList:
        """The places of unsure echoes, as `work` tells them."""
        return self._open.get("work", self._places, lambda work: 1 << 20)

    def _places(self) -> WorkList:
        if self._listed is not None:
            return listed_places(self.delivery, self._listed)
        unsure = UnsureEchoes(self.params.cluster, self.params.place)
        for key in self.tiles:
            columns = self._columns(key, UNSURE)
            rows = columns["confidence"] < self.params.unsure
            unsure.add(*(columns[n][rows] for n in UNSURE))
        return unsure.work_list(self.params.places)

    def _place_of(self, strip: int, pulse: int, echo_number: int) -> tuple[str, int]:
        for key in self.tiles:
            who = self._columns(key, IDENTITY)
            here = (who["strip"] == strip) & (who["pulse"] == pulse) & (who["echo_number"] == echo_number)
            if here.any():
                return key, int(np.flatnonzero(here)[0])
        raise InputError("there is no such echo", where=self.delivery.path, got=f"{strip}, {pulse}, {echo_number}")

    # ------------------------------------------------------------------ blocks

    def _whole_level(self, part: str, level: int) -> bytes:
        if level < self.pyramid.own:
            nodes = [n for n in self._skim().nodes if n[0] == level]
            return b"".join(self._block(part, n) for n in nodes)
        keys = list(self.tiles)
        return b"".join(self._pool.map(lambda key: self._tile_level(part, key, level), keys))

    def _tile_level(self, part: str, tile: str, level: int) -> bytes:
        opened = self._tile(tile)
        return b"".join(self._block(part, n) for n in opened.nodes if n[0] == level)

    def _block(self, part: str, node: Node) -> bytes:
        opened = self._holder(node)
        if node not in opened.nodes:
            return nothing(node)
        first, last = opened.nodes[node]
        rows = opened.order[first:last]
        if part == ECHOES:
            shown = {**opened.columns, "classification": self._classes(opened, self._key_of(node))[0]}
            return block(self.pyramid, node, shown, rows, self.origin)
        return column_block(node, self._bytes(part, node, rows))

    def _holder(self, node: Node) -> OpenTile:
        key = self._key_of(node)
        if not key:
            return self._skim()
        return self._tile(key) if key in self.tiles else OpenTile.empty(self.pyramid)

    def _key_of(self, node: Node) -> str:
        """The tile that a node lies in, "" for one over several."""
        return "" if node[0] < self.pyramid.own else "{}_{}".format(*self.pyramid.tile_of(node))

    def _version(self, key: str) -> int:
        """What changes with corrections in a tile, with any for ""."""
        rows = self.relabel.corrections.rows()
        return rows.version(key) if key else rows.all.rows

    def _classes(self, opened: OpenTile, key: str) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Classes of a tile's echoes, or of the coarse ones for "", corrections in place; rows of corrected ones."""
        rows = self.relabel.corrections.rows()
        labels = rows.of(key) if key else rows.labels
        if not labels.rows:
            return in_place(opened.columns, labels, 0.0)
        name = "classes", key, self._version(key)
        reach = self.relabel.corrections.reach
        return self._open.get(name, lambda: in_place(opened.columns, labels, reach), lambda v: len(v[0]))

    def _in_blocks(self, key: str, rows: NDArray[np.int64]) -> list[tuple[Node, NDArray, NDArray]]:
        """Nodes that have echoes `rows` of a tile, their rows in the node's block, and indices into `rows`."""
        out = [part for part in by_node(self._tile(key), rows) if part[0][0] >= self.pyramid.own]
        if self.pyramid.own:
            at, index = self._coarse_rows(key, rows)
            out += [(node, r, index[i]) for node, r, i in by_node(self._skim(), at)]
        return out

    def _coarse_rows(self, key: str, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Where echoes `rows` of a tile stand among the coarse ones, for those that do, and indices into `rows`."""
        columns, number = self._skim().columns, list(self.tiles).index(key)
        first, last = np.searchsorted(columns["tile"], [number, number + 1])
        at, index = positions(columns["row"][first:last], rows)
        return first + at, index

    def _tile(self, key: str) -> OpenTile:
        return self._open.get(key, lambda: OpenTile(self.pyramid, self._read(key)), lambda tile: tile.size)

    def _read(self, key: str) -> dict[str, NDArray]:
        columns = self._columns(key, (*DRAWN, *IDENTITY))
        lacking = [n for n in (*DRAWN, *IDENTITY) if n not in columns]
        if lacking:
            raise InputError("a delivered tile lacks columns", where=key, got=", ".join(lacking), do="run again")
        return columns

    def _skim(self) -> OpenTile:
        """The echoes of the levels that squares of several tiles have."""
        with self._lock:
            if self._skimmed is None:
                self._skimmed = OpenTile(self.pyramid, self._coarsest())
            return self._skimmed

    def _coarsest(self) -> dict[str, NDArray]:
        """Columns of the coarse echoes, and the tile and row that each comes from."""
        parts = list(self._pool.map(self._coarse, range(len(self.tiles)), self.tiles))
        return {n: np.concatenate([p[n] for p in parts]) for n in parts[0]}

    def _coarse(self, number: int, key: str) -> dict[str, NDArray]:
        tile = self._tile(key)
        limit = self.pyramid.limit(self.pyramid.coarse) if self.pyramid.coarse >= 0 else 0
        rows = np.flatnonzero(tile.rank < np.uint64(limit))
        return {**{n: v[rows] for n, v in tile.columns.items()}, "tile": np.full(len(rows), number), "row": rows}

    def _row_of(self, node: Node, row: int) -> tuple[str, int]:
        """Tile, and row of it, of an echo of a block."""
        opened, at = self._echo_at(node, row)
        if "row" in opened.columns:
            return list(self.tiles)[int(opened.columns["tile"][at])], int(opened.columns["row"][at])
        return "{}_{}".format(*self.pyramid.tile_of(node)), at

    def _echo_at(self, node: Node, row: int) -> tuple[OpenTile, int]:
        """What holds an echo of a block, and its row there."""
        opened = self._holder(node)
        first, last = opened.nodes.get(node, (0, 0))
        if not 0 <= row < last - first:
            raise InputError("no such echo", where=node, expected=f"0 to {last - first - 1}", got=row)
        return opened, int(opened.order[first + row])

    def _pulse_of(self, node: Node, row: int) -> tuple[int, int]:
        """Strip and pulse of an echo of a block."""
        opened, at = self._echo_at(node, row)
        return int(opened.columns["strip"][at]), int(opened.columns["pulse"][at])

    # ------------------------------------------------------------------ columns

    @cached_property
    def _waveforms(self) -> dict[str, Any]:
        """Strips whose pulses have one, and what is said of the others."""
        recorded = {int(f["strip"]) for f in self.delivery.report["input"]["files"] if f.get("pulses")}
        store = Store(self.delivery.root, read_only=True)
        kept = recorded & {int(part.split("-")[0]) for stage, part in store.parts() if stage == "read"}
        if not recorded:
            says = "This survey has no waveforms."
        elif kept:
            says = "This strip has no waveforms."
        else:
            says = "This run has no waveforms any more: `fwclass clean` removed them. Run again to have them."
        return {"strips": sorted(kept), "says": says}

    @cached_property
    def _fields(self) -> list[dict[str, str]]:
        fields = table_fields(self._file(next(iter(self.tiles))))
        more = [CORRECTED]
        if self.delivery.report["accuracy"] and self._behind.has_reference:
            more.append(RIGHT)
        if self._other is not None:
            more.append(DIFFERS)
        return fields + [{"name": name, "unit": "", "meaning": MEANING[name]} for name in more]

    def _field(self, name: str) -> dict[str, str]:
        known = {f["name"]: f for f in self._fields}
        if name not in known:
            raise InputError("no such column", where=self.delivery.path, got=name)
        return known[name]

    def _scale(self, name: str) -> Scale:
        span = self._span(name)
        return Scale(span.low, span.high)

    def _span(self, name: str) -> Span:
        return self._open.get(("span", name), lambda: self._measured(name), lambda _: 64)

    def _measured(self, name: str) -> Span:
        """Of what blocks have, by the coarse echoes, which are of all tiles. Of other columns, whose bytes are made
        here, of both runs where two are compared: the same colour is the same value in either."""
        self._field(name)
        if name in DRAWN and self.pyramid.own:
            values = finite(self._skim().columns[name])
            if len(values) >= ENOUGH:
                return Span.over(values)
        others = [self._other] if self._other is not None and name not in DRAWN else []
        return Span.joined([span_of(d, name) for d in (self.delivery, *others)])

    def _column(self, key: str, name: str) -> NDArray:
        return self._columns(key, (name,))[name]

    def _columns(self, key: str, names: Sequence[str]) -> dict[str, NDArray]:
        return table_columns(self._file(key), names)

    def _file(self, key: str) -> Path:
        return self.delivery.table(key)

    def _bytes(self, name: str, node: Node, rows: NDArray[np.int64]) -> NDArray[np.uint8]:
        if node[0] < self.pyramid.own:
            if name == CORRECTED:
                return self._accepted(self._skim(), "")[rows]
            return self._skimmed_column(name)[rows]
        key = "{}_{}".format(*self.pyramid.tile_of(node))
        return self._tile_bytes(key, name)[rows]

    def _tile_bytes(self, key: str, name: str) -> NDArray[np.uint8]:
        """A byte an echo of a tile, in the table's order."""
        if name == RIGHT:
            return self._verdicts(key)
        if name == CORRECTED:
            return self._accepted(self._tile(key), key)
        if name == DIFFERS and self._other is not None:
            return compare_classes(self._file(key), map(self._other.table, tiles_of(self._other, self.tiles[key])))
        values = self._column(key, name)
        return self._strip_bytes(values) if name == "strip" else self._scale(name).bytes_of(values)

    def _strip_bytes(self, strips: NDArray) -> NDArray[np.uint8]:
        """The codes that `kinds` gives the survey's strips."""
        known = sorted({int(f["strip"]) for f in self.delivery.report["input"]["files"]})
        return np.asarray(np.searchsorted(known, strips) % NO_VALUE, np.uint8)

    def _accepted(self, opened: OpenTile, key: str) -> NDArray[np.uint8]:
        return compare_corrections(opened.columns["classification"], *self._classes(opened, key))

    def _verdicts(self, key: str) -> NDArray[np.uint8]:
        classes = self._column(key, "classification")
        try:
            reference = self._behind.reference(key)
        except (FwclassError, OSError):
            return np.zeros(len(classes), np.uint8)
        return verdicts(classes, reference, self.delivery.classes)

    def _skimmed_column(self, name: str) -> NDArray[np.uint8]:
        return self._open.get(("skimmed", name), lambda: self._skim_column(name), lambda v: v.nbytes)

    def _skim_column(self, name: str) -> NDArray[np.uint8]:
        columns = self._skim().columns
        tile, row = columns["tile"], columns["row"]
        bounds = np.searchsorted(tile, np.arange(len(self.tiles) + 1))
        out = np.empty(len(tile), np.uint8)
        for number, key in enumerate(self.tiles):
            mine = slice(bounds[number], bounds[number + 1])
            out[mine] = self._tile_bytes(key, name)[row[mine]]
        return out


def plain_value(value: Any) -> Any:
    """For JSON: no NaN, no numpy."""
    plain = value.item() if hasattr(value, "item") else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
