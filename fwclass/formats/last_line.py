"""Whether a text was cut off inside its last line, as far as that can be seen."""

from __future__ import annotations

import re
from pathlib import Path

from fwclass.errors import InputError
from fwclass.paths import open_sized

TAIL = 1 << 20
"""Bytes at the end of a text that are looked at."""

LINES = 50
"""Lines before the last that must be of one shape before a smaller last one tells anything: who writes numbers without
zeros at their ends has one in ten of fewer decimals, and so many lines without any by a chance of 0.005."""

_APART = re.compile(rb"[\s,;]+")


def check_last_line(path: Path) -> None:
    """`InputError` where the last line lacks its end, and has fewer words, or its last word fewer decimals, than the
    `LINES` lines before it, which agree in both. A line that lacks nothing but its end is whole."""
    stream, size = open_sized(path)
    with stream:
        stream.seek(max(0, size - TAIL))
        tail = stream.read(TAIL)
    if tail[-1:] in (b"\n", b"\r", b""):
        return
    *before, last = tail.splitlines()
    shapes = {_shape(line) for line in before[-LINES:]}
    if len(before) > LINES and len(shapes) == 1:  # the first may be half a line, or a heading
        (words, decimals), got = shapes.pop(), _shape(last)
        if got[0] < words or (got[0] == words and got[1] < decimals):
            raise InputError(
                "the file ends inside its last line",
                where=path,
                expected=f"{words} words with {decimals} decimals at the end and the end of a line, as in those before",
                got=f"{got[0]} words with {got[1]} decimals at the end",
                do="copy or export the file again, or end the line if it is whole",
            )


def _shape(line: bytes) -> tuple[int, int]:
    """Words of a line, and decimals of the last."""
    words = _APART.split(line.strip())
    return len(words), len(words[-1].partition(b".")[2])
