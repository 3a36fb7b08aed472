"""A run as the viewer shows it: blocks from its Parquet, and what stands behind an echo."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns, table_fields
from fwclass.delivery.opened import Delivery
from fwclass.delivery.viewed_echo import BehindEchoes
from fwclass.errors import FwclassError, InputError
from fwclass.publish.octree import drawn_by
from fwclass.publish.palette import colours, css
from fwclass.schema import IDENTITY, Table, canonical_key
from fwclass.view.blocks import DRAWN, NO_VALUE, Scale, block, column_block, nothing
from fwclass.view.cache import Cache
from fwclass.view.params import ViewParams
from fwclass.view.pyramid import Node, Pyramid, levels_of, placed
from fwclass.view.scene import ECHOES
from fwclass.view.worklist import UnsureEchoes, WorkList

THREADS = 2
"""That read tiles ahead; more take turns at the interpreter's lock."""


RIGHT, DIFFERS = "right_or_wrong", "differs"
HIDDEN = ("x", "y", "z", "pulse", "echo_number")
"""Columns that are no colours."""

VERDICTS = (("no reference", "#b8bec3"), ("right", "#2f7d46"), ("wrong", "#c8102e"))
COMPARED = (("not in the other run", "#b8bec3"), ("same class", "#7fa7b5"), ("another class", "#c8102e"))
STRIPS = ("#009ea3", "#c44e8c", "#f0c43c", "#566ebe", "#8c563c", "#5fa83c", "#e2782a", "#7a4fb0")
"""Colours of strips, in turn."""

UNSURE = ("x", "y", "z", "confidence", "classification")
"""Columns that the work list is made of."""

REMEMBERED = 10_000
"""Echoes whose place in the tables is known from when they were looked at."""


@dataclass(frozen=True)
class OpenTile:
    """A tile's columns, the order of its echoes in blocks, and the span of every node in that order."""

    columns: Mapping[str, NDArray]
    order: NDArray[np.int64]
    nodes: Mapping[Node, tuple[int, int]]

    @property
    def size(self) -> int:
        return int(sum(v.nbytes for v in self.columns.values()) + self.order.nbytes)


class ViewedRun:
    """See `fwclass.view.scene.Scene`. What it shows is the delivery that was current when it was opened."""

    def __init__(self, delivery: Delivery, params: ViewParams, other: Delivery | None = None) -> None:
        self.delivery, self.params = delivery, params
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
        self._other = other.path / "parquet" if other is not None else None
        self._asked: dict[tuple[int, ...], tuple[str, int]] = {}

    def prepare(self) -> None:
        """Make ahead what the page asks for first; what fails will be said when it is asked for."""
        with suppress(FwclassError, OSError):
            for level in self.index()["together"]:
                self.level(ECHOES, level)
            self._behind.prepare()

    def index(self) -> dict[str, Any]:
        pyramid, report = self.pyramid, self.delivery.report
        shown = colours(report["classes"])
        tiles = [
            [*map(int, key.split("_")), int(t["echoes"]), t["bounds"][2], t["bounds"][5]]
            for key, t in self.tiles.items()
        ]
        return {
            "name": report["survey"],
            "crs": report["place"].get("crs"),
            "delivery": self.delivery.path.name,
            "echoes": self.echoes,
            "against": self._other is not None,
            "origin": self.origin,
            "size": pyramid.size,
            "west": pyramid.west,
            "south": pyramid.south,
            "joined": pyramid.joined,
            "halved": pyramid.halved,
            "together": list(pyramid.levels()[: pyramid.whole + 1]),
            "tiles": tiles,
            "classes": [{**c, "colour": css(shown[int(c["code"])])} for c in report["classes"]],
            "columns": [f for f in self._fields if f["name"] not in HIDDEN],
        }

    def scale(self, part: str) -> dict[str, Any]:
        field = self._field(part)
        if part == "strip":
            names = {int(f["strip"]): str(f["path"]) for f in self.delivery.report["input"]["files"]}
            kinds = [(n % NO_VALUE, name) for n, name in sorted(names.items())][:NO_VALUE]
            return {**field, "classes": [_kind(code, name, STRIPS[code % len(STRIPS)]) for code, name in kinds]}
        if part == DIFFERS:
            return {**field, "classes": [_kind(code, *kind) for code, kind in enumerate(COMPARED)]}
        if part == RIGHT:
            return {**field, "classes": [_kind(code, *kind) for code, kind in enumerate(VERDICTS)]}
        scale = self._scale(part)
        return {**field, "low": scale.low, "high": scale.high}

    def level(self, part: str, level: int) -> bytes:
        if level not in self.pyramid.levels():
            raise InputError("no such level", where=self.delivery.path, got=level)
        return bytes(self._blocks.get((part, level), lambda: self._whole_level(part, level)))

    def node(self, part: str, node: Node) -> bytes:
        if not self.pyramid.has(node):
            raise InputError("no such block", where=self.delivery.path, got=node)
        return bytes(self._blocks.get((part, node), lambda: self._block(part, node)))

    def echo(self, node: Node, row: int) -> dict[str, Any]:
        tile, at = self._row_of(node, row)
        path = self.delivery.path / "parquet" / f"{tile}.parquet"
        names = [f["name"] for f in self._fields if f["name"] not in (RIGHT, DIFFERS)]
        values = {n: _plain(v[at]) for n, v in table_columns(path, names).items()}
        if len(self._asked) >= REMEMBERED:
            self._asked.clear()
        self._asked[tuple(int(values[n]) for n in IDENTITY)] = tile, at
        return {"tile": tile, "row": at, "values": values}

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

    def work_list(self) -> WorkList:
        """The places of unsure echoes, as `work` tells them."""
        return self._open.get("work", self._places, lambda work: 1 << 20)

    def _places(self) -> WorkList:
        unsure = UnsureEchoes(self.params.cluster)
        for key in self.tiles:
            columns = self._columns(key, UNSURE)
            rows = columns["confidence"] < self.params.unsure
            unsure.add(*(columns[n][rows] for n in UNSURE))
        return unsure.work_list(self.params.places)

    def _place_of(self, strip: int, pulse: int, echo_number: int) -> tuple[str, int]:
        for key in self.tiles:
            who = table_columns(self.delivery.path / "parquet" / f"{key}.parquet", IDENTITY)
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
            return block(self.pyramid, node, opened.columns, rows, self.origin)
        return column_block(node, self._bytes(part, node, rows))

    def _holder(self, node: Node) -> OpenTile:
        if node[0] < self.pyramid.own:
            return self._skim()
        key = "{}_{}".format(*self.pyramid.tile_of(node))
        return self._tile(key) if key in self.tiles else OpenTile({}, np.empty(0, np.int64), {})

    def _tile(self, key: str) -> OpenTile:
        return self._open.get(key, lambda: self._opened(key), lambda tile: tile.size)

    def _opened(self, key: str) -> OpenTile:
        return self._arranged(self._read(key))

    def _arranged(self, columns: Mapping[str, NDArray]) -> OpenTile:
        level = levels_of(self.pyramid, _rank(columns))
        return OpenTile(columns, *placed(self.pyramid, level, columns["x"], columns["y"]))

    def _read(self, key: str) -> dict[str, NDArray]:
        columns = table_columns(self.delivery.path / "parquet" / f"{key}.parquet", (*DRAWN, *IDENTITY))
        lacking = [n for n in (*DRAWN, *IDENTITY) if n not in columns]
        if lacking:
            raise InputError("a delivered tile lacks columns", where=key, got=", ".join(lacking), do="run again")
        return columns

    def _skim(self) -> OpenTile:
        """The echoes of the levels that squares of several tiles have."""
        with self._lock:
            if self._skimmed is None:
                self._skimmed = self._arranged(self._coarsest())
            return self._skimmed

    def _coarsest(self) -> dict[str, NDArray]:
        """Columns of the coarse echoes, and the tile and row that each comes from."""
        parts = list(self._pool.map(self._coarse, range(len(self.tiles)), self.tiles))
        return {n: np.concatenate([p[n] for p in parts]) for n in parts[0]}

    def _coarse(self, number: int, key: str) -> dict[str, NDArray]:
        columns = self._read(key)
        rank = _rank(columns)
        limit = self.pyramid.limit(self.pyramid.coarse) if self.pyramid.coarse >= 0 else 0
        rows = np.flatnonzero(rank < np.uint64(limit))
        return {**{n: v[rows] for n, v in columns.items()}, "tile": np.full(len(rows), number), "row": rows}

    def _row_of(self, node: Node, row: int) -> tuple[str, int]:
        """Tile, and row of it, of an echo of a block."""
        opened = self._holder(node)
        first, last = opened.nodes.get(node, (0, 0))
        if not first <= first + row < last:
            raise InputError("no such echo", where=node, expected=f"0 to {last - first - 1}", got=row)
        at = int(opened.order[first + row])
        if "row" in opened.columns:
            return list(self.tiles)[int(opened.columns["tile"][at])], int(opened.columns["row"][at])
        return "{}_{}".format(*self.pyramid.tile_of(node)), at

    # ------------------------------------------------------------------ columns

    @cached_property
    def _fields(self) -> list[dict[str, str]]:
        fields = table_fields(self.delivery.path / "parquet" / f"{next(iter(self.tiles))}.parquet")
        if self.delivery.report["accuracy"] and self._behind.has_reference:
            fields.append(
                {"name": RIGHT, "unit": "", "meaning": "the class beside the reference's, training areas too"}
            )
        if self._other is not None:
            fields.append(
                {"name": DIFFERS, "unit": "", "meaning": "the class beside that of the same echo in the other run"}
            )
        return fields

    def _field(self, name: str) -> dict[str, str]:
        known = {f["name"]: f for f in self._fields}
        if name not in known:
            raise InputError("no such column", where=self.delivery.path, got=name)
        return known[name]

    def _scale(self, name: str) -> Scale:
        return self._open.get(("scale", name), lambda: self._measured(name), lambda _: 64)

    def _measured(self, name: str) -> Scale:
        """From one hundredth to 99 of the values of some tiles."""
        self._field(name)
        keys = list(self.tiles)[:: max(1, len(self.tiles) // 8)]
        values = np.concatenate([self._column(key, name).astype(np.float64) for key in keys])
        finite = values[np.isfinite(values)]
        low, high = np.quantile(finite, (0.01, 0.99)).tolist() if len(finite) else (0.0, 0.0)
        return Scale(low, high)

    def _column(self, key: str, name: str) -> NDArray:
        return self._columns(key, (name,))[name]

    def _columns(self, key: str, names: Sequence[str]) -> dict[str, NDArray]:
        return table_columns(self.delivery.path / "parquet" / f"{key}.parquet", names)

    def _bytes(self, name: str, node: Node, rows: NDArray[np.int64]) -> NDArray[np.uint8]:
        if node[0] < self.pyramid.own:
            return self._skimmed_column(name)[rows]
        key = "{}_{}".format(*self.pyramid.tile_of(node))
        return self._tile_bytes(key, name)[rows]

    def _tile_bytes(self, key: str, name: str) -> NDArray[np.uint8]:
        """A byte an echo of a tile, in the table's order."""
        if name == RIGHT:
            return self._verdicts(key)
        if name == DIFFERS:
            return self._compared(key)
        values = self._column(key, name)
        return (values % NO_VALUE).astype(np.uint8) if name == "strip" else self._scale(name).bytes_of(values)

    def _compared(self, key: str) -> NDArray[np.uint8]:
        """0 for an echo that the other run has not in this tile, 1 where the classes are the same, 2 where not."""
        path = self._other / f"{key}.parquet" if self._other is not None else None
        mine = self._columns(key, (*IDENTITY, "classification"))
        out = np.zeros(len(mine["strip"]), np.uint8)
        if path is None or not path.is_file():
            return out
        other = table_columns(path, (*IDENTITY, "classification"))
        _, here, there = np.intersect1d(_key(mine), _key(other), assume_unique=True, return_indices=True)
        out[here] = np.where(mine["classification"][here] == other["classification"][there], 1, 2)
        return out

    def _verdicts(self, key: str) -> NDArray[np.uint8]:
        """0 without a reference, 1 right, 2 wrong; of a code that no class counts there is no verdict."""
        given = self._column(key, "classification")
        try:
            reference = self._behind.reference(key)
        except (FwclassError, OSError):
            return np.zeros(len(given), np.uint8)
        counted = np.zeros(256, np.int64)
        for one in self.delivery.report["config"]["survey"]["classes"]:
            counted[list(one["codes"])] = one["code"]
        known = counted[reference]
        return np.where(known == 0, 0, np.where(known == given, 1, 2)).astype(np.uint8)

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


def _rank(columns: Mapping[str, NDArray]) -> NDArray[np.uint64]:
    return drawn_by(Table({n: columns[n] for n in IDENTITY}))


def _key(columns: Mapping[str, NDArray]) -> NDArray[np.uint64]:
    return canonical_key(Table({n: columns[n] for n in IDENTITY}))


def _kind(code: int, name: str, colour: str) -> dict[str, Any]:
    return {"code": code, "name": name, "colour": colour}


def _plain(value: Any) -> Any:
    """For JSON: no NaN, no numpy."""
    plain = value.item() if hasattr(value, "item") else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
