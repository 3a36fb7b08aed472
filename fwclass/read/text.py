"""Points as plain text: ``x y z [label]``, one a line.

Columns stand apart by spaces, commas, tabs or semicolons (these two with decimal commas, if numbers have some). Empty
lines and what follows a ``#`` are passed over. A header line may name the columns, in any order; without one they are
x, y, z and, if there is a fourth, the label.
"""

from __future__ import annotations

import io
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from fwclass.errors import InputError
from fwclass.formats.last_line import check_last_line
from fwclass.paths import open_regular
from fwclass.read.text_kernels import tidy
from fwclass.read.text_layout import NULLS, SHOWN, Layout, decoded, is_number, layout_of, line_start, refusal, words_of

SUFFIXES = (".txt", ".xyz", ".csv", ".asc", ".tsv")
"""Names of text files end so."""

GROUND, OTHER = 2, 1
"""Class codes that stand for the labels 0 and 1 of the ISPRS filter test."""

_ALLOWED = bytes(c for c in range(256) if c >= 32 or 9 <= c <= 13)
"""Every byte that a text may have."""


@dataclass(frozen=True)
class TextCloud:
    """The points of a text file, in its order.

    Attributes
    ----------
    path : the file.
    x, y, z : (n,) coordinates as they stand there; NaN where there is no number.
    label : uint8 (n,) as it stands there, or None.
    kind : what a label is: ``isprs`` (0 ground, 1 object) or a class ``code``.
    dropped : names of further columns.
    names : what a column that was asked for calls every point; None without one.
    """

    path: Path
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    label: NDArray[np.uint8] | None
    kind: Literal["isprs", "code"]
    dropped: tuple[str, ...] = ()
    names: tuple[str, ...] | None = None

    @property
    def xyz(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The three coordinates."""
        return self.x, self.y, self.z

    @property
    def codes(self) -> NDArray[np.uint8] | None:
        """Labels as class codes: ground is 2, an ISPRS object 1."""
        if self.label is None or self.kind == "code":
            return self.label
        return np.where(self.label == 0, GROUND, OTHER).astype(np.uint8)


def is_text(path: str | Path) -> bool:
    """The name says that the file is text, and it does not start as a LAS file does."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) != b"LASF"


def read_text(path: str | Path, ignored: Collection[str] = (), named: Collection[str] = ()) -> TextCloud:
    """Every point of a text file, without the columns of the names `ignored`; the first further column of the names
    `named` (lower case) tells what points are called.

    A fourth column is a label: class codes where the header calls it so (``classification``, ``class``, ``code``) or
    where it holds anything but 0 and 1, else the labels of the ISPRS filter test, 0 ground and 1 object.

    `InputError`: no text, no points, a line with another number of columns or something that is no number, labels
    beyond 0 to 255.
    """
    path = Path(path)
    data = _text_of(path)
    check_last_line(path)
    layout = layout_of(path, data, ignored)
    body = _tidy(data[layout.start :], layout.delimiter == " ")
    values, names = _parse_columns(path, body, layout, named)
    label, kind = _labels(path, values, layout, body)
    dropped = tuple(n.removeprefix("?") for n in layout.columns if n.startswith("?"))
    return TextCloud(path, values["x"], values["y"], values["z"], label, kind, dropped, names)


def _text_of(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            data = file.read()
    except OSError as fault:
        raise InputError("cannot open the file", where=path, got=fault, do="check the path and its rights") from fault
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise refusal(path, "the text is UTF-16", "plain text (ASCII or UTF-8)", "UTF-16", "save it as UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    strange = data.translate(None, _ALLOWED)
    if strange:
        at = data.index(strange[:1])
        raise refusal(
            path,
            "this is no text",
            "lines of x y z [label]",
            f"byte {data[at]} at place {at}",
            "give a LAS or LAZ file its own suffix, or export the points as text",
        )
    if not data or data.isspace():
        raise refusal(path, "the file has no points", "lines of x y z [label]", f"{len(data)} bytes", "export it again")
    return data


def _lines(data: bytes) -> io.BytesIO:
    """Lines, whatever ends them."""
    return io.BytesIO(data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data)


def _tidy(data: bytes, collapse: bool) -> bytes:
    """`data` without comments; with `collapse`, one space for every run of blanks and none at the ends of lines."""
    if not collapse and b"#" not in data:
        return data
    text = np.frombuffer(data, np.uint8)
    out = np.empty(len(text), np.uint8)
    return out[: tidy(text, collapse, out)].tobytes()


def _parse_columns(
    path: Path, body: bytes, layout: Layout, named: Collection[str]
) -> tuple[dict[str, NDArray[np.float64]], tuple[str, ...] | None]:
    wanted = [c for c in layout.columns if not c.startswith("?")]
    columns = [f"{c}{i}" if c.startswith("?") else c for i, c in enumerate(layout.columns)]
    own = zip(columns, layout.columns, strict=True)
    names = next((c for c, name in own if name.startswith("?") and name.strip("? ").lower() in named), None)
    try:
        table = csv.read_csv(
            io.BytesIO(body),
            csv.ReadOptions(column_names=columns, block_size=1 << 24, use_threads=False),
            csv.ParseOptions(delimiter=layout.delimiter, quote_char=False if layout.delimiter == " " else '"'),
            csv.ConvertOptions(
                column_types={**dict.fromkeys(wanted, pa.float64()), **({names: pa.binary()} if names else {})},
                include_columns=[*wanted, *([names] if names else [])],
                null_values=NULLS,
                decimal_point=layout.decimal,
            ),
        )
    except (pa.ArrowException, UnicodeDecodeError) as fault:
        raise _explain(path, body, layout, str(fault)) from fault
    missing = pa.scalar(float("nan"))
    values = {c: table[c].combine_chunks().fill_null(missing).to_numpy(zero_copy_only=False) for c in wanted}
    return values, tuple(decoded(w or b"").strip() for w in table[names].to_pylist()) if names else None


def _explain(path: Path, body: bytes, layout: Layout, reason: str) -> InputError:
    """Which line is wrong, and why."""
    count = len(layout.columns)
    for number, line in enumerate(_lines(body), start=layout.first):
        content = line.strip()
        if not content:
            continue
        words = words_of(content, layout.delimiter)
        if len(words) != count:
            return refusal(
                path,
                "a line has another number of columns",
                f"{count}, as in line {layout.first}",
                f"{len(words)}: {line_start(content)}",
                "mend or remove the line",
                number,
            )
        for word, column in zip(words, layout.columns, strict=True):
            if not column.startswith("?") and not is_number(word, layout.decimal):
                return refusal(
                    path,
                    "this is no number",
                    f"a number as {column}",
                    line_start(word.encode()),
                    "mend or remove the line",
                    number,
                )
    return refusal(path, "the text cannot be read", "lines of x y z [label]", reason[:SHOWN], "export it again")


def _labels(
    path: Path, values: dict[str, NDArray[np.float64]], layout: Layout, body: bytes
) -> tuple[NDArray[np.uint8] | None, Literal["isprs", "code"]]:
    name = next((n for n in ("code", "label") if n in values), None)
    if name is None:
        return None, "code"
    labels = values[name]
    wrong = ~((labels >= 0) & (labels <= 255) & (labels == np.floor(labels)))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise refusal(
            path,
            "the labels are no labels",
            "whole numbers from 0 to 255",
            f"{labels[row]:g}",
            "if this column is something else, name the columns in a header line (x y z intensity)",
            _line_of(body, row, layout.first),
        )
    label = labels.astype(np.uint8)
    isprs = name == "label" and not (label > 1).any()
    return label, "isprs" if isprs else "code"


def _line_of(body: bytes, row: int, first: int) -> int:
    """Number of the line that holds point `row`."""
    seen = -1
    for number, line in enumerate(_lines(body), start=first):
        seen += bool(line.strip())
        if seen == row:
            return number
    return first
