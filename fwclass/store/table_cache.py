"""Columns of tables that this process has just written or read: a tile is read for itself, for its neighbours, stage
after stage.

What is kept goes by the file's path, size and times, as its digest does; the least lately read goes first.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.cost import counted
from fwclass.grid import Box
from fwclass.schema import Table
from fwclass.store.digests import Looks, looks
from fwclass.store.tables import ROW_GROUP, Group, bytes_of, group_of, read_table, row_groups_of, write_table

MOST = 64 << 20
"""Bytes of columns that a process keeps: six columns of three rows of tiles in a survey 2 km wide, at 4 echoes/m²."""

FILES = 1 << 15
"""Files whose row groups are remembered, 25 MB: those of the stages of some 5,000 tiles. A stage goes through all tiles
before the next one does, so that of more files than fit each is read anew."""

File = tuple[str, Looks]

_columns: OrderedDict[tuple[File, int, str], NDArray] = OrderedDict()
_groups: OrderedDict[File, tuple[Group, ...]] = OrderedDict()
_bytes = 0
_guard = threading.Lock()
_own = threading.local()
"""The table that a thread has written last, and where: it becomes readable by the name that its part brings it to."""


def write_and_hold(path: Path, table: Table) -> None:
    """As `tables.write_table`, of a table that nobody writes to any more; who reads it under the name that it gets
    (`moved`) has it from memory."""
    write_table(path, table)
    _own.last = (str(path), table) if 0 < table.rows <= ROW_GROUP and 4 * bytes_of(table) <= MOST else None


def moved(source: Path | str, target: Path | str) -> None:
    """A file that this thread has written is now that of a finished part."""
    last, there = getattr(_own, "last", None), str(target)
    if last is None or last[0] != str(source):
        return
    _own.last, table, file = None, last[1], (there, looks(there))
    _keep(file, [0], {name: [values.copy()] for name, values in table.items()})
    group = group_of(table)
    if group is not None:
        _note_groups(file, (group,))


def groups_touching(path: Path, box: Box | None) -> list[int]:
    """As `tables.row_groups`."""
    return [k for k, group in enumerate(_groups_in((str(path), looks(path)))) if group.touches(box)]


def rows_of_groups(path: Path) -> list[int]:
    """Rows of every row group of the table at `path`."""
    return [group.rows for group in _groups_in((str(path), looks(path)))]


@counted("reading")
def read_kept(path: Path, columns: Iterable[str], groups: list[int]) -> Table:
    """As `tables.read_table`; the columns are not to be written to."""
    file, names = (str(path), looks(path)), list(columns)
    rows = [_groups_in(file)[g].rows for g in groups]
    with _guard:
        there = {n: [_columns.get((file, g, n)) for g in groups] for n in names}
        for name, pieces in there.items():
            for g, piece in zip(groups, pieces, strict=True):
                if piece is not None:
                    _columns.move_to_end((file, g, name))
    columns_by_name = {n: [p for p in pieces if p is not None] for n, pieces in there.items()}
    lacking = [n for n in names if len(columns_by_name[n]) < len(groups)]
    if lacking:
        table = read_table(path, lacking, groups)
        ends = np.cumsum(rows)[:-1]
        columns_by_name |= {n: np.split(table[n], ends) for n in lacking}
        if 4 * sum(table[n].nbytes for n in lacking) <= MOST:  # else it would take the place of all others
            _keep(file, groups, {n: columns_by_name[n] for n in lacking})
    if not groups:
        return Table.empty(names)
    return Table({n: columns_by_name[n][0] if len(groups) == 1 else np.concatenate(columns_by_name[n]) for n in names})


def _groups_in(file: File) -> tuple[Group, ...]:
    with _guard:
        groups = _groups.get(file)
    if groups is None:
        groups = row_groups_of(Path(file[0]))
        _note_groups(file, groups)
    return groups


def _note_groups(file: File, groups: tuple[Group, ...]) -> None:
    with _guard:
        _groups[file] = groups
        if len(_groups) > FILES:
            _groups.popitem(last=False)


def _keep(file: File, groups: list[int], columns: dict[str, list[NDArray]]) -> None:
    global _bytes
    with _guard:
        for name, pieces in columns.items():
            for group, piece in zip(groups, pieces, strict=True):
                one = piece if piece.base is None and len(groups) == 1 else piece.copy()
                one.setflags(write=False)
                before = _columns.pop((file, group, name), None)
                _columns[file, group, name] = one
                _bytes += one.nbytes - (before.nbytes if before is not None else 0)
        while _bytes > MOST:
            _bytes -= _columns.popitem(last=False)[1].nbytes
