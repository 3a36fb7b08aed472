"""Long texts of one row a line, a block of whole lines at a time."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.paths import open_regular

BLOCK = 1 << 22
"""Bytes of a block, about."""

LONGEST_LINE = 1 << 22
"""Bytes of a line at most: 100 000 samples of forty characters."""


def line_blocks(path: Path, start: int) -> Iterator[tuple[int, bytes]]:
    """(byte, whole lines) from byte `start` on; the last line may lack its end."""
    at, rest = start, b""
    with open_regular(path) as stream:
        stream.seek(start)
        while True:
            data = stream.read(BLOCK)
            if not data:
                if rest:
                    yield at, rest
                return
            whole = rest + data
            cut = whole.rfind(b"\n") + 1
            if cut == 0 and len(whole) > LONGEST_LINE:
                raise InputError(
                    "a line is too long",
                    where=path,
                    expected=f"at most {LONGEST_LINE} bytes",
                    got=f"more, from byte {at}",
                    do="the file is damaged, or no text",
                )
            if cut:
                yield at, whole[:cut]
                at += cut
            rest = whole[cut:]


def rows_of(data: bytes) -> list[bytes]:
    """Lines that are neither empty nor a comment."""
    return [line for line in data.splitlines() if line.strip() and not line.lstrip().startswith(b"#")]


@lru_cache(maxsize=16)
def _marked(path: Path, mark: tuple[int, int], start: int) -> tuple[tuple[int, int], ...]:
    marks, rows = [], 0
    for at, data in line_blocks(path, start):
        marks.append((rows, at))
        rows += len(rows_of(data))
    return (*marks, (rows, -1))


def row_marks(path: Path, start: int) -> NDArray[np.int64]:
    """(k, 2): the first row of every block and its byte; the last one holds the number of rows."""
    facts = path.stat()
    return np.array(_marked(path, (facts.st_size, facts.st_mtime_ns), start), np.int64)


def rows_between(path: Path, start: int, first: int, last: int) -> list[bytes]:
    """Lines of rows [first, last)."""
    marks = row_marks(path, start)
    block = int(np.searchsorted(marks[:-1, 0], first, side="right")) - 1
    lines: list[bytes] = []
    if block < 0 or first >= last:
        return lines
    skipped = int(marks[block, 0])
    for _, data in line_blocks(path, int(marks[block, 1])):
        lines += rows_of(data)
        if skipped + len(lines) >= last:
            break
    return lines[first - skipped : last - skipped]
