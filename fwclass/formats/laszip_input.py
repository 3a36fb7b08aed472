"""LAS and LAZ files as LASzip may see them."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

from fwclass.formats.las_header import SPEC_USERS, Record

EXTRA_BYTES_NUMBER = 4


def open_for_laszip(path: Path, records: Iterable[Record]) -> BinaryIO:
    """The file, opened; a record that describes extra bytes and is empty has no name in it: LASzip ends the process
    that opens one."""
    empty = [r.start for r in records if r.user in SPEC_USERS and r.number == EXTRA_BYTES_NUMBER and not r.length]
    return io.BufferedReader(_Nameless(path, empty)) if empty else path.open("rb")


class _Nameless(io.FileIO):
    """A file whose records at some places have no user and no number."""

    def __init__(self, path: Path, records: Iterable[int]) -> None:
        super().__init__(path)
        self._hidden = [range(at + 2, at + 20) for at in records]
        self._last = max(hidden.stop for hidden in self._hidden)

    def readinto(self, buffer: Any) -> int | None:
        first = self.tell()
        count = super().readinto(buffer)
        if count and first < self._last:
            view = memoryview(buffer).cast("B")
            for hidden in self._hidden:
                for at in hidden:
                    if first <= at < first + count:
                        view[at - first] = 0
        return count
