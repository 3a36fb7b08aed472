"""Checks that the headers of all formats share."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from fwclass.errors import InputError


def check_length(path: Path, size: int, start: int, record_length: int, count: int, what: str) -> None:
    """`InputError` where `count` records (`what`: points, pulses) do not fit into the file behind byte `start`."""
    records = (size - start) // record_length
    if count > records:
        raise InputError(
            "the file is cut short",
            where=path,
            expected=f"{count} {what} of {record_length} bytes from byte {start}",
            got=f"room for {records} {what}",
            do="copy the file again",
        )


def check_scales(path: Path, scales: tuple[float, ...], offsets: tuple[float, ...]) -> None:
    """`InputError` where stored whole numbers cannot be turned into coordinates."""
    sound = all(math.isfinite(v) for v in (*scales, *offsets)) and all(0 < abs(s) < 1e6 for s in scales)
    if not sound or any(abs(o) > 1e12 for o in offsets):
        raise InputError(
            "the header's scales or offsets cannot be used",
            where=path,
            expected="finite numbers, no scale of 0",
            got=f"scales {scales}, offsets {offsets}",
            do="the header is damaged; export the file again",
        )


def counts_fewer(path: Path, count: int, what: str, got: str) -> InputError:
    """What to raise where a file holds more `what` (points, pulses) than its header counts."""
    return InputError(
        f"the header counts fewer {what} than the file holds",
        where=path,
        expected=f"{count} {what}",
        got=got,
        do=f"its writer was cut off, or {what} were added: export it again or repair its header",
    )


_BLOCK = 1 << 24
"""Bytes that are held at a time."""

SECTOR = 512
"""Bytes; of a hole of a page (4096) in a file, wherever it begins, at least seven whole ones are zeros."""


def first_hole(path: Path, begin: int, end: int, least: int = 7) -> int | None:
    """The byte where at least `least` sectors of nothing but zeros begin between `begin` and `end`, None without any.

    Whoever sets a file's length before its content (downloads, `rsync --preallocate`, file systems after a power cut)
    leaves such holes where a copy broke off.
    """
    run = 0
    with path.open("rb") as stream:
        stream.seek(begin)
        for at in range(begin, end, _BLOCK):
            sectors = np.frombuffer(stream.read(min(_BLOCK, end - at)), np.uint8)
            whole = sectors[: len(sectors) // SECTOR * SECTOR].view(np.uint64).reshape(-1, SECTOR // 8)
            empty = np.r_[False, ~whole.any(axis=1), False]
            starts, ends = np.flatnonzero(np.diff(empty.view(np.int8))).reshape(-1, 2).T
            lengths = ends - starts
            if len(starts) and starts[0] == 0:
                lengths[0] += run
            long = np.flatnonzero(lengths >= least)
            if len(long):
                before = run if starts[long[0]] == 0 else 0
                return int(at + SECTOR * (starts[long[0]] - before))
            run = int(lengths[-1]) if len(ends) and ends[-1] == len(whole) else 0
    return None


def cut_off(path: Path, least: int, size: int) -> InputError:
    """What to raise where a file has fewer bytes than the `least` that it had when it was opened."""
    return InputError(
        "the file was changed while it was read",
        where=path,
        expected=f"at least {least} bytes, as when it was opened",
        got=f"{size} bytes",
        do="run the same again when the file is whole",
    )
