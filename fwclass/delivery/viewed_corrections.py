"""Corrections of a run as the viewer shows them, adds to them and takes them back."""

from __future__ import annotations

import getpass
import time
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.opened import Delivery
from fwclass.delivery.viewed_open import OpenTile
from fwclass.errors import InputError, visible
from fwclass.formats.echo_labels import LONGEST_NAME, TAKEN_BACK, EchoLabels
from fwclass.grid import TileGrid
from fwclass.label.corrections import COLUMNS, match_labels
from fwclass.schema import Table
from fwclass.store.bucket import Remote
from fwclass.store.corrections import CORRECTIONS, add_corrections, check_writable, read_corrections
from fwclass.store.run_store import Store
from fwclass.view.cache import Cache
from fwclass.view.scene import Gone, Replaced

ASKED = 3.0
"""s, how long object storage is believed to hold what it held."""

NEVER = -1
"""Version of a tile in which nothing was ever corrected."""


@dataclass(frozen=True)
class Change:
    """What was added to the file: `time` of the rows (0 where there are none), how many, and how many echoes of those
    that were meant have none: they had the class already, or have another by now."""

    time: int
    rows: int
    left: int


class CorrectionRows:
    """The rows of the file, and which lie in and around a tile.

    `all`: every row, in the order in which they were added. `labels`: `COLUMNS` of the echoes that have a class by
    them.
    """

    def __init__(self, every: EchoLabels, size: float, reach: float) -> None:
        self.all = every
        standing = every.standing()
        standing = standing.take(standing.code >= 0)
        self.labels = Table({n: getattr(standing, n) for n in COLUMNS[:-1]} | {"label_code": standing.code})
        self._size, self._reach = size, reach
        self._tiles, self._rows = self._by_tile(standing)
        tiles, rows = self._by_tile(every)
        last = np.flatnonzero(np.diff(tiles, append=np.int64(2**62)))
        self._versions = dict(zip(tiles[last].tolist(), rows[last].tolist(), strict=True))

    def of(self, tile: str) -> Table:
        """The labels that an echo of the tile may have."""
        first, last = np.searchsorted(self._tiles, [_packed(tile), _packed(tile) + 1])
        return self.labels.take(self._rows[first:last])

    def version(self, tile: str) -> int:
        """Number of the last row that may be of an echo of the tile, `NEVER` for none."""
        return int(self._versions.get(_packed(tile), NEVER))

    def since(self, known: int) -> list[str]:
        """Tiles that rows from number `known` on may have changed."""
        tiles, _ = self._by_tile(self.all.take(np.arange(known, self.all.rows)))
        each = tiles[np.flatnonzero(np.diff(tiles, prepend=np.int64(-(2**62))))]
        return [f"{t >> 32}_{(t & 0xFFFFFFFF) - 2**31}" for t in each.tolist()]

    def _by_tile(self, labels: EchoLabels) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Tiles, packed and ascending, that an echo of each label may lie in, and its row, ascending in each tile."""
        grid, r = TileGrid(self._size), self._reach
        near = [_pack(*grid.indices(labels.x + u, labels.y + v)) for u in (-r, r) for v in (-r, r)]
        new = [np.ones(labels.rows, bool)]
        for k in range(1, 4):
            new.append(np.logical_and.reduce([near[k] != near[j] for j in range(k)]))
        rows = np.concatenate([np.flatnonzero(n) for n in new])
        tiles = np.concatenate([t[n] for t, n in zip(near, new, strict=True)])
        order = np.lexsort((rows, tiles))
        return tiles[order], rows[order]


class Corrections:
    """The file of a run's corrections, read anew when it has changed; who adds to it is the user of this process."""

    def __init__(self, delivery: Delivery) -> None:
        config = delivery.report["config"]
        self._delivery, self._size = delivery, float(config["tile"]["size"])
        self.reach = float(config["label"]["max_move"])
        self.who = _user()
        self._stamp: object = None
        self._ask_again = 0.0
        self._rows = CorrectionRows(EchoLabels.none(), self._size, self.reach)
        self._lock = Lock()

    def rows(self) -> CorrectionRows:
        """What the file says now; `InputError` where it is damaged."""
        with self._lock:
            stamp = self._version()
            if stamp != self._stamp:
                every = read_corrections(self._delivery.root)
                self._rows, self._stamp = CorrectionRows(every, self._size, self.reach), stamp
            return self._rows

    def _version(self) -> object:
        """Another one where the file changed. Object storage is asked every `ASKED` seconds, and after additions."""
        root = self._delivery.root
        if isinstance(root, Remote):
            if time.monotonic() < self._ask_again:
                return self._stamp
            listed = [item.mark for item in root.objects.list("labels") if item.key == CORRECTIONS]
            self._ask_again = time.monotonic() + ASKED
            return listed[0] if listed else None
        try:
            facts = (root / CORRECTIONS).stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        return facts.st_mtime_ns, facts.st_size, facts.st_ino

    def check(self) -> None:
        """`Replaced` where the run has delivered anew, `StoreError` where nothing can be written."""
        self.check_current()
        check_writable(self._delivery.root)

    def check_current(self) -> None:
        """`Replaced` where another delivery than this one is the run's current one, `Gone` where there is none."""
        current = Store(self._delivery.root, read_only=True).generations.current()
        if current is None:
            raise Gone(
                "the delivery that this page shows is gone: it was removed, or the run's directory was moved",
                where=self._delivery.root,
                do="put it back, or run the survey again; what the page has read of it is still shown",
            )
        if current.path != self._delivery.path:
            raise Replaced(
                "the run has delivered anew since this page was opened",
                where=self._delivery.root,
                expected=f"delivery {self._delivery.path.name}, which the page shows",
                got=f"delivery {current.name}",
                do="take the new one (button below), and draw again: its echoes may be others",
            )

    def add(self, columns: Mapping[str, NDArray], code: int) -> Change:
        """Give the echoes (strip, pulse, echo_number, x, y, z) the class `code`, `TAKEN_BACK` for none."""
        now = 0
        corrections = EchoLabels.of(columns, np.full(len(columns["strip"]), code), 0, self.who)

        def change(earlier: EchoLabels) -> EchoLabels:
            nonlocal now
            now = _next(earlier)
            stands = _standing_codes(earlier, corrections.key)
            return EchoLabels.of(
                {n: v[stands != code] for n, v in columns.items()}, corrections.code[stands != code], now, self.who
            )

        rows = add_corrections(self._delivery.root, change).rows
        self._ask_again = 0.0
        return Change(now if rows else 0, rows, corrections.rows - rows)

    def revert(self, when: int) -> Change:
        """Give the echoes of the rows that this user wrote at `when` what they had before; not those that have another
        class by now. `InputError` where there are no such rows."""
        now = left = 0

        def change(earlier: EchoLabels) -> EchoLabels:
            nonlocal now, left
            now = _next(earlier)
            mine = np.flatnonzero((earlier.time == when) & (earlier.who == self.who))
            if not len(mine):
                raise InputError(
                    "this step cannot be undone",
                    where=CORRECTIONS,
                    got=f"no rows of {self.who} at that time",
                    do="reload the page",
                )
            key = earlier.key
            order = np.argsort(key, kind="stable")
            at = np.empty(len(key), np.int64)
            at[order] = np.arange(len(key))
            before = np.maximum(at[mine] - 1, 0)
            had = (before != at[mine]) & (key[order[before]] == key[mine])
            former = np.where(had, earlier.code[order[before]], TAKEN_BACK)
            stands = _standing_codes(earlier, key[mine]) == earlier.code[mine]
            left = int((~stands).sum())
            rows = earlier.take(mine[stands])
            return EchoLabels.of({n: getattr(rows, n) for n in COLUMNS[:-1]}, former[stands], now, self.who)

        rows = add_corrections(self._delivery.root, change).rows
        self._ask_again = 0.0
        return Change(now if rows else 0, rows, left)


class ShownClasses:
    """Classes of open echoes, corrections in place."""

    def __init__(self, corrections: Corrections, cache: Cache) -> None:
        self._corrections, self._cache = corrections, cache

    def version(self, key: str) -> int:
        """What changes with corrections in a tile, with any for ""."""
        rows = self._corrections.rows()
        return rows.version(key) if key else rows.all.rows

    def of(self, opened: OpenTile, key: str) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Classes of a tile's echoes, or of the coarse ones for "", and the rows of those that were corrected."""
        rows = self._corrections.rows()
        labels = rows.of(key) if key else rows.labels
        if not labels.rows:
            return in_place(opened.columns, labels, 0.0)
        name, reach = ("classes", key, self.version(key)), self._corrections.reach
        return self._cache.get(name, lambda: in_place(opened.columns, labels, reach), lambda v: len(v[0]))


def in_place(
    columns: Mapping[str, NDArray], labels: Table, reach: float
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Classes of the echoes with those of `labels` in place of the delivered ones, and the rows that have one.

    `columns`: strip, pulse, echo_number, x, y, z [m], classification.
    """
    classes = np.asarray(columns["classification"], np.uint8)
    if not labels.rows:
        return classes, np.empty(0, np.int64)
    rows, own = match_labels(Table({n: columns[n] for n in COLUMNS[:-1]}), labels, reach)
    out = classes.copy()
    out[rows] = labels["label_code"][own]
    return out, rows


def _standing_codes(labels: EchoLabels, key: NDArray[np.uint64]) -> NDArray[np.int16]:
    """The code that counts of each echo, `TAKEN_BACK` where none does."""
    out = np.full(len(key), TAKEN_BACK, np.int16)
    standing = labels.standing()
    if standing.rows:
        at = np.minimum(np.searchsorted(standing.key, key), standing.rows - 1)
        same = standing.key[at] == key
        out[same] = standing.code[at[same]]
    return out


def _next(earlier: EchoLabels) -> int:
    """A time of now that no row has yet [µs]: rows of one step are known by it."""
    return max(time.time_ns() // 1000, int(earlier.time.max(initial=0)) + 1)


def _user() -> str:
    try:
        return visible(getpass.getuser())[:LONGEST_NAME]
    except (OSError, KeyError):  # one without a name
        return ""


def _pack(i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray((i.astype(np.int64) << 32) + (j.astype(np.int64) + 2**31))


def _packed(tile: str) -> int:
    i, j = map(int, tile.split("_"))
    return (i << 32) + j + 2**31
