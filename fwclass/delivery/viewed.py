"""A run as the viewer shows it: blocks from its Parquet, and what stands behind an echo."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.delivery.echoes import table_row
from fwclass.delivery.opened import Delivery, open_at
from fwclass.delivery.places import listed_places
from fwclass.delivery.viewed_colours import CORRECTED, MEANING
from fwclass.delivery.viewed_columns import ColourColumns, plain_value
from fwclass.delivery.viewed_corrections import ShownClasses
from fwclass.delivery.viewed_echo import BehindEchoes
from fwclass.delivery.viewed_large import open_tiles
from fwclass.delivery.viewed_open import OpenRun
from fwclass.delivery.viewed_pair import check_same_place, known_by, same_echo
from fwclass.delivery.viewed_relabel import Relabelling
from fwclass.errors import FwclassError, InputError
from fwclass.publish.palette import colours, css
from fwclass.schema import IDENTITY
from fwclass.store.run_store import Store
from fwclass.view.blocks import block, column_block, nothing
from fwclass.view.cache import Cache
from fwclass.view.params import ViewParams
from fwclass.view.pyramid import Node, Pyramid
from fwclass.view.scene import ECHOES
from fwclass.view.worklist import UnsureEchoes, WorkList

HIDDEN = ("x", "y", "z", "pulse", "echo_number")
"""Columns that are no colours."""

UNSURE = ("x", "y", "z", "confidence", "classification")
"""Columns that the work list is made of."""

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
        size = float(delivery.report["config"]["tile"]["size"])
        places = np.array([key.split("_") for key in self.tiles], np.int64)
        self.echoes = sum(int(t["echoes"]) for t in self.tiles.values())
        self.pyramid = Pyramid.over(places, self.echoes, size, params.block, params.together)
        low = np.min([t["bounds"][:3] for t in self.tiles.values()], axis=0)
        self.origin = (*self.pyramid.corner, math.floor(float(low[2])))
        self.open = self._opened()
        self._blocks = Cache(params.cache << 20)
        self._behind = BehindEchoes(delivery)
        self.relabel = Relabelling(delivery, params, self.open.in_blocks)
        self._classes = ShownClasses(self.relabel.corrections, self.open.cache)
        self.columns = ColourColumns(self.open, self._behind, self._classes, other)
        self._other = other
        self._asked: dict[tuple[int, ...], tuple[str, int]] = {}
        self._listed: Path | None = None

    def _opened(self) -> OpenRun:
        return open_tiles(self.delivery, self.params, self.pyramid)

    @property
    def name(self) -> str:
        return self.delivery.path.name

    def reopened(self) -> ViewedRun:
        current = open_at(self.delivery.root)
        if current.path == self.delivery.path:
            return self
        scene = ViewedRun(current, self.params)
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
            "crs": (report["place"] or {}).get("crs"),
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
            "columns": [f for f in self.columns.fields if f["name"] not in HIDDEN],
        }

    def scale(self, part: str) -> dict[str, Any]:
        return self.columns.scale(part)

    def level(self, part: str, level: int) -> bytes:
        if level not in self.pyramid.levels():
            raise InputError("no such level", where=self.delivery.path, got=level)
        version = self.relabel.corrections.rows().all.rows if part in (ECHOES, CORRECTED) else 0
        return bytes(self._blocks.get((part, level, version), lambda: self._whole_level(part, level)))

    def node(self, part: str, node: Node) -> bytes:
        if not self.pyramid.has(node):
            raise InputError("no such block", where=self.delivery.path, got=node)
        version = self._classes.version(self.open.key_of(node)) if part in (ECHOES, CORRECTED) else 0
        return bytes(self._blocks.get((part, node, version), lambda: self._block(part, node)))

    def echo(self, node: Node, row: int) -> dict[str, Any]:
        tile, at = self.open.row_of(node, row)
        opened, at_ = self.open.echo_at(node, row)
        who = (int(opened.columns[n][at_]) for n in ("strip", "pulse"))
        self.open.pool.submit(self._behind.waves, *who)  # which is asked for next
        names = [f["name"] for f in self.columns.fields if f["name"] not in MEANING]
        values = {n: plain_value(v) for n, v in table_row(self.delivery.table(tile), names, at).items()}
        if len(self._asked) >= REMEMBERED:
            self._asked.clear()
        self._asked[tuple(int(values[n]) for n in IDENTITY)] = tile, at
        return self._about(tile, at, values)

    def _about(self, tile: str, row: int, values: dict[str, Any]) -> dict[str, Any]:
        classes, rows = self._classes.of(self.open.tile(tile), tile)
        about = {
            "tile": tile,
            "row": row,
            "values": values,
            "corrected": int(classes[row]) if row in rows else None,
            "reference": self.columns.reference(tile, row),
        }
        if self._other is not None:
            twin = same_echo(self._other, values)
            about["other"] = {n: plain_value(v) for n, v in twin.items()} if twin else None
        return about

    def pulse(self, strip: int, pulse: int) -> dict[str, Any]:
        return self._behind.pulse(strip, pulse)

    def why(self, strip: int, pulse: int, echo_number: int) -> dict[str, Any]:
        tile, row = self._asked.get((strip, pulse, echo_number), ("", -1))
        if row < 0:
            tile, row = self.open.find(strip, pulse, echo_number)
        return self._behind.why(tile, row)

    def work(self) -> dict[str, Any]:
        listed = self.work_list()
        return {"unsure": self.params.unsure, "places": [asdict(p) for p in listed.places], "total": listed.total}

    def list_places(self, path: Path) -> None:
        """Take the places of a file for the work list, in its order, for as long as this scene is shown.

        `InputError`: it is no file of polygons, or no echo lies in any of them.
        """
        self._listed = path
        self.work_list()

    def work_list(self) -> WorkList:
        """The places of unsure echoes, as `work` tells them."""
        return self.open.cache.get("work", self._places, lambda work: 1 << 20)

    def _places(self) -> WorkList:
        if self._listed is not None:
            return listed_places(self.delivery, self._listed)
        unsure = UnsureEchoes(self.params.cluster, self.params.place)
        for key in self.tiles:
            columns = self.open.columns(key, UNSURE)
            rows = columns["confidence"] < self.params.unsure
            unsure.add(*(columns[n][rows] for n in UNSURE))
        return unsure.work_list(self.params.places)

    def _whole_level(self, part: str, level: int) -> bytes:
        if level < self.pyramid.own:
            nodes = [n for n in self.open.coarse().nodes if n[0] == level]
            return b"".join(self._block(part, n) for n in nodes)
        keys = list(self.tiles)
        return b"".join(self.open.pool.map(lambda key: self._tile_level(part, key, level), keys))

    def _tile_level(self, part: str, tile: str, level: int) -> bytes:
        opened = self.open.tile(tile)
        return b"".join(self._block(part, n) for n in opened.nodes if n[0] == level)

    def _block(self, part: str, node: Node) -> bytes:
        opened = self.open.holder(node)
        if node not in opened.nodes:
            return nothing(node)
        first, last = opened.nodes[node]
        rows = opened.order[first:last]
        if part == ECHOES:
            shown = {**opened.columns, "classification": self._classes.of(opened, self.open.key_of(node))[0]}
            return block(self.pyramid, node, shown, rows, self.origin)
        return column_block(node, self.columns.of_node(part, node, rows))

    @cached_property
    def _waveforms(self) -> dict[str, Any]:
        """Strips whose pulses have one, those whose have one no more, and what is said of the others."""
        recorded = {int(f["strip"]) for f in self.delivery.report["input"]["files"] if f.get("pulses")}
        store = Store(self.delivery.root, read_only=True)
        kept = recorded & {int(part.split("-")[0]) for stage, part in store.parts() if stage == "read"}
        if not recorded:
            says = "This survey has no waveforms."
        elif kept:
            says = "This strip has no waveforms."
        else:
            says = "This run has no waveforms any more: `fwclass clean` removed them. Run again to have them."
        return {"strips": sorted(kept), "lost": sorted(recorded - kept), "says": says}
