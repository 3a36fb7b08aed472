"""Recordings as CSV: a heading, then a line a frame; the ranges are the columns behind `ranges`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from fwclass.errors import InputError
from fwclass.paths import open_regular
from fwclass.street.frames import Frame, Scan
from fwclass.street.recording_columns import MOST_BEAMS, NUMBERS, check_columns, frame_of

LONGEST_LINE = 1 << 20
"""Bytes; 30 000 ranges of ten letters have 330 kB."""


class CsvRecording:
    """Frames of a text file: ``time,speed,ranges`` and then, on every line, time, speed and one range per beam.

    Separated by comma, semicolon or tab; an empty field or ``nan`` is no value. `ranges` is the last column.
    """

    def __init__(self, path: Path, scan: Scan) -> None:
        self.path, self._scan = path, scan
        with open_regular(path) as stream:
            head = self._text(stream.readline(LONGEST_LINE), 1)
        self._mark = next((m for m in (",", ";", "\t") if m in head), ",")
        names = [n.strip() for n in head.strip().split(self._mark)]
        while names and names[-1] == "":
            names.pop()
        check_columns(names, path)
        if names[-1] != "ranges" or "labels" in names or "intensities" in names:
            raise InputError(
                "the heading does not end with ranges",
                where=f"{path}: line 1",
                expected="ranges as the last column, no other list",
                got=", ".join(names)[:200],
                do="write labels and intensities as Parquet",
            )
        self._names = names[:-1]
        self.about: Mapping[str, Any] = {"kind": "CSV", "columns": names}

    def frames(self) -> Iterator[Frame]:
        """As `Recording.frames`."""
        with open_regular(self.path) as stream:
            stream.readline(LONGEST_LINE)
            line, at = 1, 0
            while raw := stream.readline(LONGEST_LINE):
                line += 1
                text = self._text(raw, line).strip()
                if text:
                    yield self._frame(text, line, at)
                    at += 1

    def _frame(self, text: str, line: int, at: int) -> Frame:
        fields = text.split(self._mark)
        n = len(self._names)
        if len(fields) <= n or len(fields) - n > MOST_BEAMS:
            self._refuse(line, f"{n} columns and 1 to {MOST_BEAMS} ranges", f"{len(fields)} fields")
        try:
            numbers = {k: _number(v) for k, v in zip(self._names, fields, strict=False) if k in NUMBERS}
            ranges = np.array([_number(v) for v in fields[n:]], np.float32)
        except ValueError as fault:
            self._refuse(line, "numbers", str(fault)[:100])
        return frame_of(at, numbers, ranges, None, self._scan, self.path)

    def _text(self, raw: bytes, line: int) -> str:
        if len(raw) >= LONGEST_LINE:
            self._refuse(line, f"lines below {LONGEST_LINE} bytes", "a longer one")
        try:
            return raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            self._refuse(line, "text", "bytes that are none")

    def _refuse(self, line: int, expected: str, got: str) -> NoReturn:
        raise InputError(
            "a line cannot be read",
            where=f"{self.path}: line {line}",
            expected=expected,
            got=got,
            do="write the file again, or cut it before this line",
        )


def _number(text: str) -> float:
    text = text.strip()
    return float(text) if text else math.nan
