"""What QGIS changed in tiles that were checked out becomes corrections of their run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.checkout import Note, add_time, labels_file, read_note, tile_file
from fwclass.delivery.opened import Delivery, open_run
from fwclass.errors import InputError
from fwclass.formats.echo_labels import TAKEN_BACK, EchoLabels, read_echo_labels
from fwclass.grid import millimetres
from fwclass.read.las import open_las
from fwclass.read.points import PointReader, coordinates
from fwclass.schema import IDENTITY, PLACE
from fwclass.store.atomic import file_digest
from fwclass.store.corrections import add_corrections, place_of

LAST_RETURN = 15
"""Point format 6 has four bits for the number of a return: later echoes of a pulse are told by their place alone."""


@dataclass(frozen=True)
class Collected:
    """What was added to the corrections of a run.

    Attributes
    ----------
    pairs : echoes by (class that was delivered, class that they have now).
    withdrawn : echoes whose earlier change was undone.
    differ : echoes whose class is not the one that was checked out, those of earlier collections among them.
    names : of the classes by code.
    where : the file of corrections.
    """

    pairs: Mapping[tuple[int, int], int]
    withdrawn: int
    differ: int
    names: Mapping[int, str]
    where: Path

    def __str__(self) -> str:
        rows = sum(self.pairs.values()) + self.withdrawn
        lines = [f"{self._name(a)} -> {self._name(b)}: {n:,}" for (a, b), n in sorted(self.pairs.items())]
        lines += [f"taken back: {self.withdrawn:,}"] if self.withdrawn else []
        summary = f"{self.differ:,} echoes differ from what was checked out; "
        lines.append(summary + (f"{rows:,} rows added to {self.where}" if rows else "nothing new was added"))
        return "\n".join(lines)

    def _name(self, code: int) -> str:
        return self.names.get(code, "no class" if code == 0 else f"code {code}")


@dataclass(frozen=True)
class _Changed:
    """Echoes of a tile with their new class, the class that each had, and the keys of all echoes of the tile."""

    labels: EchoLabels
    before: NDArray[np.int16]
    keys: NDArray[np.uint64]


def collect(directory: Path, run: Path | None, who: str, time: int) -> Collected:
    """Add what was changed since the last collection to the corrections of the run.

    Nothing is written unless all tiles are sound. An echo whose change was undone is taken back, unless somebody else
    corrected it meanwhile; only echoes of the tiles are. Changed echoes have to lie where the delivery has them now.

    `run`: where the run lies now; None for where it lay. `time`: of these rows, microseconds since 1970 (UTC).

    `InputError`: there is no note; the run is another or gone; a tile is missing, cut or has other echoes; a class is
    none of the survey; or a changed echo is not at its place any more. `StoreError`: the run or the directory cannot be
    written to.
    """
    note = read_note(directory)
    delivery = run_of(note, run, directory)
    tiles = [_changes(directory, key, digest) for key, digest in sorted(note.tiles.items())]
    _check_codes(tiles, list(note.tiles), delivery.correctable)
    changed = EchoLabels.joined([t.labels for t in tiles])
    before, keys = (
        np.concatenate([getattr(t, n) for t in tiles] or [np.empty(0, kind)])
        for n, kind in (("before", np.int16), ("keys", np.uint64))
    )
    stays = np.concatenate([np.empty(0, bool), *(_at_their_place(t.labels, delivery) for t in tiles)])
    time = max(time, *note.collected, 0) + 1

    def change(earlier: EchoLabels) -> EchoLabels:
        new = new_rows(earlier, changed, keys, note.collected, time, who)
        lost = np.isin(changed.key[~stays], new.take(new.code != TAKEN_BACK).key)
        if lost.any():
            raise _lost_error(changed.take(np.flatnonzero(~stays)[lost]), note, delivery)
        if new.rows:
            add_time(directory, note, time)
        return new

    added = add_corrections(delivery.root, change)
    labels = added.take(added.code != TAKEN_BACK)
    old = dict(zip(changed.key.tolist(), before.tolist(), strict=True))
    pairs = Counter((old[k], c) for k, c in zip(labels.key.tolist(), labels.code.tolist(), strict=True))
    names = {int(c["code"]): str(c["name"]) for c in delivery.report["classes"]}
    where = place_of(delivery.root)
    return Collected(pairs, added.rows - labels.rows, changed.rows, names, Path(str(where)))


def new_rows(
    earlier: EchoLabels, changed: EchoLabels, keys: NDArray[np.uint64], collected: Sequence[int], time: int, who: str
) -> EchoLabels:
    """Rows that say of every echo what its tile says now, where `earlier` ones do not.

    `changed`: all echoes of the directory whose class is not the one that was checked out, each once. `keys`: of all
    its echoes; others are left as they are. `collected`: times of earlier rows that come from this directory.
    """
    ours, last = earlier.take(np.isin(earlier.time, np.array(collected, np.int64))).standing(), earlier.standing()
    said, stands = codes_that_stand(changed, ours), codes_that_stand(changed, last)
    add = changed.take((changed.code != said) & (changed.code != stands))
    undone = ours.take((ours.code != TAKEN_BACK) & np.isin(ours.key, keys) & ~np.isin(ours.key, changed.key))
    undone = undone.take(last.time[np.searchsorted(last.key, undone.key)] == undone.time)
    both = EchoLabels.joined([add, undone])
    codes = np.append(add.code, np.full(undone.rows, TAKEN_BACK))
    return EchoLabels.of({n: getattr(both, n) for n in (*IDENTITY, *PLACE)}, codes, time, who)


def codes_that_stand(echoes: EchoLabels, standing: EchoLabels) -> NDArray[np.int16]:
    """What `standing` labels, by echo, say of echoes at their place; `TAKEN_BACK` where nothing."""
    if not standing.rows:
        return np.full(echoes.rows, TAKEN_BACK, np.int16)
    at = np.minimum(np.searchsorted(standing.key, echoes.key), standing.rows - 1)
    same = standing.key[at] == echoes.key
    for axis in PLACE:
        same &= millimetres(getattr(standing, axis)[at]) == millimetres(getattr(echoes, axis))
    return np.where(same, standing.code[at], np.int16(TAKEN_BACK))


def run_of(note: Note, run: Path | None, directory: Path) -> Delivery:
    """The current delivery of the run that tiles were checked out of; `InputError` where it is gone or another."""
    root = Path(note.run) if run is None else run
    if run is None and not root.is_dir():
        raise InputError(
            "the run that these tiles are of is not where it was",
            where=directory,
            expected=f"a run directory at {root}",
            got="none",
            do="say with --run where it is now",
        )
    delivery = open_run(root)
    if delivery.report["survey"] != note.survey:
        raise InputError(
            "these tiles are of another run",
            where=directory,
            expected=f"a run of the survey {note.survey}",
            got=f"{delivery.report['survey']} at {delivery.root}",
            do="say with --run where the run is that they were checked out of",
        )
    return delivery


def _changes(directory: Path, tile: str, digest: str) -> _Changed:
    """The echoes of a tile whose class is not the one that was checked out."""
    path, labels_path = tile_file(directory, tile), labels_file(directory, tile)
    for one in (path, labels_path):
        if not one.is_file():
            raise InputError(
                "a file that was checked out is missing",
                where=one,
                do="put it back; a tile without changes is needed too, for a change that was undone is told by it",
            )
    if file_digest(labels_path) != digest:
        raise InputError(
            "the classes that a tile had are not what was written",
            where=labels_path,
            do="check the tile out again, to another directory",
        )
    labels = read_echo_labels(labels_path, labels_path)
    number = np.minimum(labels.echo_number, LAST_RETURN)
    place = [millimetres(getattr(labels, a)) for a in PLACE]
    before = _rows(labels.strip, labels.pulse, number, *place, labels.code)
    now = _read_points(path, labels.rows)
    a, b = (np.lexsort(rows.T[::-1]) for rows in (before, now))
    if not np.array_equal(before[a][:, :-1], now[b][:, :-1]):
        raise _other_echoes(path, len(now), _difference(before[:, :-1], now[:, :-1]))
    code = now[b][:, -1].astype(np.int16)
    rows = np.flatnonzero(code != labels.code[a])
    own = labels.take(a[rows])
    columns = {n: getattr(own, n) for n in (*IDENTITY, *PLACE)}
    return _Changed(EchoLabels.of(columns, code[rows], 0, ""), own.code, labels.key)


def _read_points(path: Path, echoes: int) -> NDArray[np.int64]:
    """int64 (points, 7): strip, pulse, number of the return, x, y, z [mm], class."""
    source = open_las(path)
    if source.n_points != echoes:
        raise _other_echoes(path, echoes, f"{source.n_points:,}")
    blocks = []
    with PointReader(source) as reader:
        if "pulse" not in reader.extra_names:
            raise InputError(
                "a tile lacks the number of the pulse, by which its echoes are known",
                where=path,
                expected="the extra byte pulse",
                got=", ".join(reader.extra_names) or "no extra byte",
                do="edit the file that was checked out, and save it with all that it has",
            )
        for _, points in reader.blocks():
            who = [points[n] for n in ("point_source_id", "pulse", "return_number")]
            place = [millimetres(v) for v in coordinates(source, points)]
            blocks.append(_rows(*who, *place, points["classification"]))
    return np.concatenate(blocks) if blocks else np.empty((0, 7), np.int64)


def _rows(*columns: Any) -> NDArray[np.int64]:
    return np.stack([np.asarray(c, np.int64) for c in columns], axis=1)


def _difference(before: NDArray[np.int64], now: NDArray[np.int64]) -> str:
    _, number = np.unique(np.concatenate([before, now]), axis=0, return_inverse=True)
    there, here = (np.bincount(n, minlength=number.max() + 1) for n in np.split(number.ravel(), [len(before)]))
    missing = int((there - here).clip(0).sum())
    return f"as many, but {missing:,} of them are missing, and others doubled or elsewhere"


def _other_echoes(path: Path, echoes: int, got: str) -> InputError:
    return InputError(
        "a tile has not the echoes any more that were checked out",
        where=path,
        expected=f"{echoes:,} echoes, each at its place",
        got=got,
        do="classes alone may be changed: undo the rest, or check the tile out again, to another directory",
    )


def _check_codes(tiles: Sequence[_Changed], keys: Sequence[str], names: Mapping[int, str]) -> None:
    for tile, key in zip(tiles, sorted(keys), strict=True):
        code, count = np.unique(tile.labels.code, return_counts=True)
        alien = [(c, n) for c, n in zip(code.tolist(), count.tolist(), strict=True) if c and c not in names]
        if alien:
            raise InputError(
                "echoes were given a class that the survey has not",
                where=f"tile {key}",
                expected=", ".join(f"{c} ({name})" for c, name in names.items()) + ", or 0 for no class",
                got=", ".join(f"{c} ({n:,} echoes)" for c, n in alien),
                do="give them one of these in QGIS, or add the class to survey.classes and run first",
            )


def _at_their_place(changed: EchoLabels, delivery: Delivery) -> NDArray[np.bool_]:
    """bool (rows,): the delivery has the echo of a tile where it was when it was checked out. Not even of the same
    delivery is this believed: who sends a directory may have written all of it."""
    if not changed.rows:
        return np.ones(0, bool)
    box = (changed.x.min() - 1, changed.y.min() - 1, changed.x.max() + 1, changed.y.max() + 1)
    table = delivery.echoes(box, (*IDENTITY, *PLACE)).to_arrow()
    columns = {n: table.column(n).to_numpy() for n in (*IDENTITY, *PLACE)}
    there = EchoLabels.of(columns, np.zeros(table.num_rows), 0, "").standing()
    return codes_that_stand(changed, there) != TAKEN_BACK


def _lost_error(lost: EchoLabels, note: Note, delivery: Delivery) -> InputError:
    return InputError(
        "echoes that were changed are not at their place any more",
        where=delivery.path,
        expected=f"the echoes of delivery {note.generation}",
        got=f"{lost.rows:,} others, for example strip {lost.strip[0]}, pulse {lost.pulse[0]}, "
        f"echo {lost.echo_number[0]}",
        do="the run found other echoes since, or is another: check the tiles out again, and change them there",
    )
