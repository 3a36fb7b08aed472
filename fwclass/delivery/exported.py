"""A run as the viewer shows it, written to a folder that any web server can serve."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns, table_fields
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import UNSURE, ViewedRun
from fwclass.delivery.viewed_columns import plain_value
from fwclass.delivery.viewed_open import OpenRun
from fwclass.errors import several
from fwclass.publish.copc import copc_columns
from fwclass.publish.files import whole_directory
from fwclass.schema import IDENTITY, Table, canonical_key
from fwclass.store.run_location import RunLocation
from fwclass.view.blocks import DRAWN, identity_block
from fwclass.view.folder import UnsureEcho, write_folder
from fwclass.view.params import ViewParams
from fwclass.view.pyramid import Node


class ExportedRun(ViewedRun):
    """See `fwclass.view.folder.WholeScene`."""

    def _opened(self) -> OpenRun:
        """Every tile is read anyway, whatever the run's size."""
        return OpenRun(self.delivery, self.pyramid, self.params.cache << 20)

    def colours(self) -> Sequence[str]:
        """The columns that the delivered COPC has, strips, and what is right and differs."""
        delivered = [f["name"] for f in table_fields(self.delivery.table(next(iter(self.tiles))))]
        left_out = {*delivered} - {*copc_columns(delivered), "strip"} | {*DRAWN}
        return [f["name"] for f in self.index()["columns"] if f["name"] not in left_out]

    def scale(self, part: str) -> dict[str, Any]:
        """As that of the viewer, with names of files alone: where they lie on this host is nobody's business."""
        about = super().scale(part)
        if part == "strip":
            about["classes"] = [{**c, "name": Path(c["name"]).name} for c in about["classes"]]
        return about

    def nodes(self) -> Iterator[Node]:
        """See `WholeScene.nodes`; one tile is open at a time."""
        yield from (n for n in self.open.coarse().nodes if n[0] < self.pyramid.own)
        for key in self.tiles:
            yield from (n for n in self.open.tile(key).nodes if n[0] >= self.pyramid.own)

    def identities(self, node: Node) -> bytes:
        """See `WholeScene.identities`."""
        opened = self.open.holder(node)
        rows = opened.order[slice(*opened.nodes[node])]
        return identity_block(node, *(opened.columns[n][rows] for n in IDENTITY))

    def unsure_echoes(self) -> list[list[UnsureEcho]]:
        """The least sure echoes of every place, `view.export` each; equally sure ones by strip, pulse and echo."""
        parts = [self._unsure(number, key) for number, key in enumerate(self.tiles)]
        place, tile, row = (np.concatenate([p[k] for p in parts]) for k in ("place", "tile", "row"))
        order = _first_of_each(place, np.concatenate([p["order"] for p in parts]), self.params.export)
        out: list[dict[int, UnsureEcho]] = [{} for _ in self.work_list().places]
        for number, key in enumerate(self.tiles):
            mine = np.flatnonzero(tile[order] == number)
            for at, unsure_echoes in zip(mine.tolist(), self._unsure_echoes(key, row[order[mine]]), strict=True):
                out[int(place[order[at]])][at] = unsure_echoes
        return [[one for _, one in sorted(echoes.items())] for echoes in out]

    def _unsure(self, number: int, key: str) -> dict[str, NDArray]:
        """Place, tile and row of the least sure echoes of a tile, and by what they are ordered."""
        columns = self.open.columns(key, (*UNSURE, *IDENTITY))
        row = np.flatnonzero(columns["confidence"] < self.params.unsure)
        place = self.work_list().of(columns["x"][row], columns["y"][row])
        row, place = row[place >= 0], place[place >= 0]
        who = canonical_key(Table({n: columns[n][row] for n in IDENTITY}))
        sure = columns["confidence"][row].astype(np.float64)
        order = np.array(list(zip(sure.tolist(), who.tolist(), strict=True)), [("sure", "f8"), ("who", "u8")])
        best = _first_of_each(place, order, self.params.export)
        return {"place": place[best], "tile": np.full(len(best), number), "row": row[best], "order": order[best]}

    def _unsure_echoes(self, key: str, rows: NDArray[np.int64]) -> list[UnsureEcho]:
        if not len(rows):
            return []
        path = self.delivery.table(key)
        columns = {n: v[rows] for n, v in table_columns(path, [f["name"] for f in self.columns.fields]).items()}
        out = []
        for k, row in enumerate(rows.tolist()):
            values = {n: plain_value(v[k]) for n, v in columns.items()}
            node, at, _ = self.open.in_blocks(key, np.array([row]))[0]
            x, y, z = (round(values[a] - o, 3) for a, o in zip("xyz", self.origin, strict=True))
            strip, pulse, number = (int(values[n]) for n in IDENTITY)
            self._asked[strip, pulse, number] = key, row
            out.append(UnsureEcho(node, int(at[0]), strip, pulse, number, (x, y, z), self._about(key, row, values)))
        return out


def _first_of_each(place: NDArray[np.int64], order: NDArray, most: int) -> NDArray[np.int64]:
    """Rows by place, at most `most` of each, those that come first in `order`."""
    rows = np.lexsort((order["who"], order["sure"], place))
    sorted_ = place[rows]
    rank = np.arange(len(rows)) - np.searchsorted(sorted_, sorted_)
    return np.asarray(rows[rank < most])


def export_view(
    run: RunLocation, against: RunLocation | None, params: ViewParams, directory: Path, tell: Callable[[str], object]
) -> str:
    """Write the page of a run, or of two side by side, to a new directory; a sentence of what is there.

    `InputError`: `run` or `against` is no run that has delivered. `ConfigError`: the directory is not empty.
    """
    first = open_run(run)
    second = open_run(against) if against is not None else None
    scenes = [ExportedRun(first, params, second)]
    if second is not None:
        scenes.append(ExportedRun(second, params, first))
    with whole_directory(directory) as beside:
        write_folder(scenes, beside, tell)
        sizes = [p.stat().st_size for p in beside.rglob("*") if p.is_file()]
    return f"{several(len(sizes), 'file')}, {sum(sizes) / 1e6:,.1f} MB: let a web server show {directory}"
