"""Runs so large that the viewer does not read all tiles: their coarse echoes come from the delivered overview."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_fields
from fwclass.delivery.opened import REPAIR, Delivery
from fwclass.delivery.viewed_colours import identity_keys
from fwclass.delivery.viewed_open import OpenRun, positions
from fwclass.errors import InputError
from fwclass.formats.extra_bytes import published_columns
from fwclass.grid import TileGrid
from fwclass.publish.copc import copc_columns
from fwclass.publish.geoparquet import shortened
from fwclass.publish.octree import echo_hashes
from fwclass.read.las import open_las
from fwclass.read.points import PointReader, coordinates
from fwclass.schema import IDENTITY, Table, column
from fwclass.view.params import ViewParams
from fwclass.view.pyramid import Node, Pyramid

OVERVIEW = "laz/overview.copc.laz"
LAST_RETURN = 15
"""Point format 6 has four bits for the number of a return: who an echo with it is, the file does not tell."""

TILE = 20_000
"""Echoes that are read in the time in which a tile is opened."""


def open_tiles(delivery: Delivery, params: ViewParams, pyramid: Pyramid) -> OpenRun:
    """The tiles and coarse echoes of a run; of a large one these are the overview's."""
    cost = sum(TILE + int(t["echoes"]) for t in delivery.tiles)
    large = cost > params.whole and delivery.lists(OVERVIEW)  # fetched when it is asked for
    return (OverviewRun if large else OpenRun)(delivery, pyramid, params.cache << 20)


class OverviewRun(OpenRun):
    """A run whose levels of squares of several tiles are read from the overview, which was drawn by the same hash.

    Its echoes are known by strip, pulse and number; rows of the tables are looked up for those that are asked for.
    """

    def _coarsest(self) -> dict[str, NDArray]:
        echoes = self._overview()
        limit = self.pyramid.limit(self.pyramid.coarse) if self.pyramid.coarse >= 0 else 0
        rank = echo_hashes(Table({n: echoes[n] for n in IDENTITY}))
        if limit > int(rank.max(initial=np.uint64(0))):
            return super()._coarsest()
        return {n: v[rank < np.uint64(limit)] for n, v in echoes.items()}

    def _overview(self) -> dict[str, NDArray]:
        source = open_las(self.delivery.file(OVERVIEW))
        with PointReader(source) as reader:
            points = reader.read(0, source.n_points)
            if "pulse" not in reader.extra_names or np.ndim(points["pulse"]) != 1:
                raise InputError(
                    "the overview does not say which pulses its echoes are of",
                    where=source.path,
                    expected="an extra byte pulse",
                    got=", ".join(reader.extra_names) or "no extra byte",
                    do=REPAIR,
                )
            there = [f["name"] for f in table_fields(self.delivery.table(next(iter(self.tiles))))]
            more = {
                c.name: reader.extra_byte(points, c.las)
                for c in published_columns(copc_columns(there))
                if c.name != "pulse"
            }
            if column("amplitude").las not in reader.extra_names:  # left out where no waveform made another
                decibels = more.get("amplitude_db", np.full(source.n_points, np.nan))
                more["amplitude"] = np.where(np.isnan(decibels), points["intensity"], decibels).astype(np.float32)
        x, y, z = map(shortened, coordinates(source, points))
        echoes: dict[str, NDArray] = {
            **more,
            **{"x": x, "y": y, "z": z},
            "classification": np.asarray(points["classification"], np.uint8),
            "intensity": np.asarray(points["intensity"], np.uint16),
            "strip": np.asarray(points["point_source_id"], np.uint16),
            "pulse": np.asarray(points["pulse"], np.uint32),
            "echo_number": np.asarray(points["return_number"], np.uint8),
        }
        known = np.flatnonzero(echoes["echo_number"] < LAST_RETURN)
        return {n: v[known] for n, v in echoes.items()}

    def row_of(self, node: Node, row: int) -> tuple[str, int]:
        opened = self.coarse()
        span = opened.nodes.get(node, (0, 0))
        if node[0] >= self.pyramid.own or "row" in opened.columns or not 0 <= row < span[1] - span[0]:
            return super().row_of(node, row)
        at = opened.order[[span[0] + row]]
        echo = {n: v[at] for n, v in opened.columns.items()}
        i, j = TileGrid(self.pyramid.size).indices(echo["x"], echo["y"])
        key = f"{i[0]}_{j[0]}"
        here = at[:0]
        if key in self.tiles:
            here = np.flatnonzero(identity_keys(self.columns(key, IDENTITY)) == identity_keys(echo))
        if not len(here):
            raise InputError("the overview has an echo that its tile has not", where=self.delivery.path, got=key)
        return key, int(here[0])

    def _coarse_rows(self, key: str, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        if "row" in self.coarse().columns:
            return super()._coarse_rows(key, rows)
        order, ascending = self._by_key
        at, index = positions(ascending, identity_keys(self.tile(key).columns)[rows])
        return order[at], index

    @cached_property
    def _by_key(self) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
        """The order of the coarse echoes by who they are, and who they are in that order."""
        who = identity_keys(self.coarse().columns)
        order = np.argsort(who)
        return order, who[order]

    def for_coarse(self, of_tile: Callable[[str], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        if "row" in self.coarse().columns:
            return super().for_coarse(of_tile)
        order, ascending = self._by_key
        out = np.empty(len(order), np.uint8)
        for key in self.tiles:
            at, here = positions(ascending, identity_keys(self.columns(key, IDENTITY)))
            out[order[at]] = of_tile(key)[here]
        return out
