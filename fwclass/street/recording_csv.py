"""Recordings as CSV: a heading, then a line a frame; ranges, and labels and intensities where named, stand last."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from fwclass.errors import InputError
from fwclass.formats.last_line import check_last_line
from fwclass.paths import open_regular
from fwclass.street.frames import Frame, Scan
from fwclass.street.recording_columns import LISTS, MOST_BEAMS, NUMBERS, check_columns, class_codes, frame_of
from fwclass.units import number_of

LONGEST_LINE = 1 << 20
"""Bytes; 30 000 ranges of ten letters have 330 kB."""


class CsvRecording:
    """Frames of a text file: ``time,speed,ranges`` and then, on every line, time, speed and one range per beam.

    Separated by comma, semicolon or tab; an empty field or ``nan`` is no value. Lists are the last columns: with
    ``time,ranges,intensities`` all ranges of a line stand before its intensities, as many of both.
    """

    def __init__(self, path: Path, scan: Scan) -> None:
        self.path, self._scan = path, scan
        check_last_line(path)
        with open_regular(path) as stream:
            head = self._text(stream.readline(LONGEST_LINE), 1)
        self._mark = next((m for m in (",", ";", "\t") if m in head), ",")
        names = [n.strip() for n in head.strip().split(self._mark)]
        while names and names[-1] == "":
            names.pop()
        check_columns(names, path)
        self._lists = [n for n in names if n in LISTS]
        self._names = names[: -len(self._lists)]
        if names != self._names + self._lists:
            raise InputError(
                "the heading does not end with ranges",
                where=f"{path}: line 1",
                expected="ranges, labels and intensities as the last columns",
                got=", ".join(names)[:200],
                do="write the ranges behind all other columns",
            )
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
        n, many = len(self._names), len(self._lists)
        beams, rest = divmod(len(fields) - n, many)
        if rest or not 0 < beams <= MOST_BEAMS:
            each = " and as many ".join(self._lists)
            self._refuse(line, f"{n} columns and 1 to {MOST_BEAMS} {each}", f"{len(fields)} fields")
        try:
            numbers = {k: _number(v) for k, v in zip(self._names, fields, strict=False) if k in NUMBERS}
            values = np.array([_number(v) for v in fields[n:]]).reshape(many, beams)
        except ValueError as fault:
            self._refuse(line, "numbers", str(fault)[:100])
        lists = dict(zip(self._lists, values, strict=True))
        where = f"{self.path}: line {line}"
        labels = (
            class_codes(np.where(np.isnan(lists["labels"]), 0, lists["labels"]), where) if "labels" in lists else None
        )
        light = lists["intensities"].astype(np.float32) if "intensities" in lists else None
        return frame_of(at, numbers, lists["ranges"].astype(np.float32), labels, self._scan, self.path, light)

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
    return number_of(text) if text else math.nan
