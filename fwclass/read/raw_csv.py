"""Raw waveforms as text: a heading and a row a waveform, see `raw_columns`; lists are numbers apart by blanks.

Lines before the heading that begin with ``#`` may hold metadata as ``# key: value``.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.last_line import check_last_line
from fwclass.paths import open_regular
from fwclass.read.beam_source import BeamRows, Layout, Ragged
from fwclass.read.raw_columns import (
    KEYS,
    LISTS,
    OPTIONAL,
    REQUIRED,
    Settings,
    beam_rows,
    check_columns,
    kind_of_direction,
)
from fwclass.read.text_blocks import LONGEST_LINE, line_blocks, row_marks, rows_between, rows_of
from fwclass.units import number_of

HEAD = 65_536
"""Bytes that metadata and heading have at most."""

LOOKED_AT = 1000
"""Rows whose directions are looked at."""

CLOSE = 0.66
"""Likeness of a comment's first word to a key from which it is taken for a slip."""

_DECIMAL_COMMA, _BLANK = re.compile(r"\d,\d"), re.compile(r"[\d.]\s+[-+.\d]")
"""Both in a list: its numbers are apart by blanks and have decimal commas, or nobody knows."""

_LIST_MARKS = str.maketrans("[](){};,", " " * 8)

csv.field_size_limit(max(csv.field_size_limit(), LONGEST_LINE))  # of the whole process: csv has no other way to say it


@dataclass(frozen=True)
class CsvLayout(Layout):
    """`columns` in their order, apart by `delimiter`; rows begin at byte `start`."""

    path: Path
    settings: Settings
    columns: tuple[str, ...]
    delimiter: str
    start: int
    direction: str = ""

    @property
    def timed(self) -> bool:
        return "begin_ns" in self.columns

    @property
    def n_rows(self) -> int:
        return int(row_marks(self.path, self.start)[-1, 0])

    def blocks(self) -> Iterator[BeamRows]:
        first = 0
        for _, data in line_blocks(self.path, self.start):
            lines = rows_of(data)
            if lines:
                yield self._parsed(lines, first)
            first += len(lines)

    def read(self, first: int, last: int) -> BeamRows:
        return self._parsed(rows_between(self.path, self.start, first, last), first)

    def _parsed(self, lines: list[bytes], first: int) -> BeamRows:
        numbers, lists = self._cells(lines, first)
        return beam_rows(numbers, lists, self.settings, self.direction, first, self.path)

    def _cells(self, lines: list[bytes], first: int) -> tuple[dict[str, NDArray[np.float64]], dict[str, Ragged]]:
        try:
            cells = list(csv.reader((line.decode("utf-8", "replace") for line in lines), delimiter=self.delimiter))
        except csv.Error as fault:
            raise self._wrong("a row cannot be read, or a later one", first, "quotes that end", fault) from None
        for k, row in enumerate(cells):
            if len(row) != len(self.columns):
                raise self._wrong("a row has another number of columns", first + k, len(self.columns), len(row))
        if len(cells) != len(lines):
            raise self._wrong("a quote does not end in its row, or in a later one", first, len(lines), len(cells))
        numbers: dict[str, NDArray[np.float64]] = {}
        lists: dict[str, Ragged] = {}
        for at, name in enumerate(self.columns):
            words = [row[at] for row in cells]
            if name in LISTS:
                lists[name] = self._lists(words, name, first)
            elif name in (*REQUIRED, *OPTIONAL):
                numbers[name] = np.array([self._number(w, name, first + k) for k, w in enumerate(words)], np.float64)
        return numbers, lists

    def _lists(self, words: list[str], name: str, first: int) -> Ragged:
        parts = []
        for k, word in enumerate(words):
            try:
                if _DECIMAL_COMMA.search(word) and _BLANK.search(word):
                    raise ValueError(word)
                if "_" in word or not word.isascii():  # as `number_of`
                    raise ValueError(word)
                parts.append(np.array(word.translate(_LIST_MARKS).split(), np.float64))
            except ValueError:
                raise self._wrong(
                    f"{name} hold what is no number", first + k, "numbers apart by blanks, with decimal points", word
                ) from None
        ends = np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int64)
        return Ragged(np.concatenate([*parts, np.empty(0)]), ends)

    def _number(self, word: str, name: str, row: int) -> float:
        try:
            return number_of(word) if word.strip() else np.nan
        except ValueError:
            raise self._wrong("this is no number", row, f"a number as {name}", word) from None

    def _wrong(self, what: str, row: int, expected: object, got: object) -> InputError:
        return InputError(
            what, where=f"{self.path}: row {row + 1}", expected=expected, got=str(got)[:80], do="mend or remove the row"
        )


def is_raw_csv(path: Path) -> bool:
    """A text whose heading names a column of samples."""
    try:
        return "samples" in _heading(path)[1]
    except (OSError, InputError):
        return False


def open_raw_csv(path: Path) -> tuple[CsvLayout, Settings]:
    """Look at metadata, heading and first rows; `InputError` for what is no table of waveforms."""
    metadata, columns, delimiter, start, others = _heading(path)
    check_last_line(path)
    _refuse_slips(others, path)
    settings = Settings.of(metadata, path)
    check_columns(list(columns), settings, path)
    layout = CsvLayout(path, settings, columns, delimiter, start)
    lines = next((rows_of(data)[:LOOKED_AT] for _, data in line_blocks(path, start)), [])
    numbers, _ = layout._cells(lines, 0)
    spacing = numbers.get("spacing_ns", np.full(len(lines), settings.spacing or np.nan))
    direction = kind_of_direction(np.stack([numbers[n] for n in ("dx", "dy", "dz")], axis=1), spacing, path)
    return CsvLayout(path, settings, columns, delimiter, start, direction), settings


def _refuse_slips(others: Mapping[str, int], path: Path) -> None:
    """`InputError` for metadata that is like a known key and none: it would be passed over."""
    for key, number in others.items():
        if meant := get_close_matches(key.replace("sample_", ""), KEYS, 1, CLOSE):
            raise InputError(
                "this is no known metadata",
                where=f"{path}, line {number}",
                expected=", ".join(KEYS),
                got=key,
                do=f"write {meant[0]}, or make a comment of it without a colon",
            )


def _heading(path: Path) -> tuple[dict[str, str], tuple[str, ...], str, int, dict[str, int]]:
    """Metadata, columns of the heading, what stands between them, the byte behind it, and lines of other metadata."""
    with open_regular(path) as stream:
        head = stream.read(HEAD)
    metadata: dict[str, str] = {}
    others: dict[str, int] = {}
    at = 0
    for number, raw in enumerate(head.splitlines(keepends=True), 1):
        at += len(raw)
        text = raw.decode("utf-8-sig" if number == 1 else "utf-8", "replace").strip()
        if not text:
            continue
        if text.startswith("#"):
            key, _, value = text.lstrip("# ").partition(":")
            key = key.strip().lower()
            if key in KEYS:
                metadata[key] = value.strip()
            elif value.strip():
                others[key] = number
            continue
        delimiter = next((mark for mark in ",;\t" if mark in text), ",")
        names = tuple(word.strip().strip('"').strip() for word in text.split(delimiter))
        return metadata, names, delimiter, at, others
    raise InputError("the file has no heading", where=path, expected="a line that names the columns", got="none")
