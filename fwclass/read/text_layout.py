"""How the lines of a text of points are made: what stands between columns, and which column is what."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from fwclass.errors import InputError
from fwclass.units import number_of

_NAMES = {
    "x": ("x", "easting", "east", "e", "rechtswert", "ostwert", "ost"),
    "y": ("y", "northing", "north", "n", "hochwert", "nordwert", "nord"),
    "z": ("z", "height", "elevation", "altitude", "h", "höhe", "hoehe"),
    "label": ("label", "labels", "reference"),
    "code": ("classification", "class", "code", "class_code"),
}
NULLS = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "NA", "N/A"]
"""What stands for no number."""
SHOWN = 80
"""Characters of a line that a message shows."""


_METRES = re.compile(r"\s*[\[(]\s*(?:m|met(?:re|er)s?)\s*[\])]$")
"""A heading's unit that changes nothing; of another unit the column is none that is known."""


@dataclass(frozen=True)
class Layout:
    """How the lines of a file are made.

    `columns` names the columns in their order; `start` is the byte of the first line of numbers, `first` the number of
    that line.
    """

    delimiter: str
    decimal: str
    columns: tuple[str, ...]
    start: int
    first: int


def layout_of(path: Path, data: bytes, ignored: Collection[str] = ()) -> Layout:
    """Separator and columns, from the first lines; columns of the names `ignored` are none that is known."""
    names: list[str] | None = None
    at = 0
    for number, match in enumerate(re.finditer(rb"([^\r\n]*)(\r\n|\r|\n|$)", data), start=1):
        line = match[1].strip()
        commented = line.startswith((b"#", b"//"))
        content = line.lstrip(b"#/").strip() if commented else line.split(b"#")[0].strip()
        at = match.start()
        if not content:
            continue
        delimiter, decimal = _separator(content)
        words = words_of(content, delimiter)
        if names is None and all(cells := words_of(content, "\t")) and len(cells) >= 3:
            words = cells  # a heading whose words have blanks
        numbers = _are_numbers(words, decimal, names)
        if not commented and numbers:
            return _named(path, names, words, delimiter, decimal, at, number)
        if names is None and not numbers and (not commented or len(_known(words)) >= 3):
            names = [f"?{w}" if w.lower() in ignored else w for w in words]
        elif not commented:
            raise refusal(
                path,
                "this line is neither numbers nor a header",
                _lacking(words, decimal, names),
                line_start(content),
                "mend or remove the line",
                number,
            )
    raise refusal(path, "the file has no points", "lines of x y z [label]", "none", "export it again")


def _separator(line: bytes) -> tuple[str, str]:
    """Separator of columns and decimal mark of a line."""
    if b";" in line:
        return ";", "," if b"," in line and b"." not in line else "."
    if b"\t" in line and b"," in line and b"." not in line:
        return "\t", ","
    return ("," if b"," in line else " "), "."


def _are_numbers(words: list[str], decimal: str, names: list[str] | None) -> bool:
    """Whether a line is one of points: every word is a number, but for columns that a header calls otherwise."""
    if names is None or len(names) != len(words) or len(_known(names)) < 3:
        return all(is_number(w, decimal) for w in words)
    return all(is_number(w, decimal) for w, n in zip(words, names, strict=True) if not _column(n).startswith("?"))


def _lacking(words: list[str], decimal: str, names: list[str] | None) -> str:
    """What a line is expected to be that has words where numbers should stand, below a header of `names`."""
    if names is None:
        return "x y z [label]"
    known = _known(names)
    if len(known) < 3:
        return f"numbers below a header that names x, y and z; this one names {', '.join(known) or 'none of them'}"
    wrong = [
        n for w, n in zip(words, names, strict=False) if not _column(n).startswith("?") and not is_number(w, decimal)
    ]
    codes = " (a code of the LAS specification)" if wrong and _column(wrong[0]) in ("label", "code") else ""
    return f"a number in column {wrong[0]}{codes}" if wrong else "x y z [label]"


def words_of(line: bytes, delimiter: str) -> list[str]:
    """The columns of a line, without quotes and blanks around them."""
    text = decoded(line)
    words = text.split() if delimiter == " " else text.split(delimiter)
    return [w.strip().strip('"').strip() for w in words]


def decoded(line: bytes) -> str:
    """Text of UTF-8, or as programs under Windows write their letters."""
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("cp1252", "replace")


def is_number(word: str, decimal: str = ".") -> bool:
    """A word is a number with `decimal` as its mark, or one that stands for no value."""
    try:
        number_of(word.replace(decimal, ".") if decimal != "." else word)
    except ValueError:
        return word in NULLS
    return True


def _known(words: list[str]) -> list[str]:
    """The columns that the words of a header mean, ``?word`` left out."""
    return [c for c in map(_column, words) if not c.startswith("?")]


def _column(word: str) -> str:
    plain = _METRES.sub("", word.strip().lower())
    return next((c for c, names in _NAMES.items() if plain in names), "?" + word)


def _named(
    path: Path, names: list[str] | None, words: list[str], delimiter: str, decimal: str, start: int, line: int
) -> Layout:
    """The layout, once the first line of numbers is there."""
    count = len(words)
    if names is None:
        if count not in (3, 4):
            raise refusal(
                path,
                "a line has another number of columns",
                "3 or 4: x y z [label]",
                count,
                "name the columns in a header line (x y z classification ...); those that are not known are left out",
                line,
            )
        return Layout(delimiter, decimal, ("x", "y", "z", "label")[:count], start, line)
    columns = tuple(map(_column, names))
    known = [c for c in columns if not c.startswith("?")]
    if len(names) != count:
        raise refusal(
            path,
            "header and lines have different numbers of columns",
            f"{len(names)}: {' '.join(names)[:SHOWN]}",
            count,
            "mend the header, or remove it",
            line,
        )
    if {"x", "y", "z"} - set(known) or len(set(known)) < len(known):
        raise refusal(
            path,
            "the header does not name x, y and z once each",
            "x y z and label or classification",
            " ".join(names)[:SHOWN],
            "mend the header, or remove it",
        )
    return Layout(delimiter, decimal, columns, start, line)


def refusal(path: Path, what: str, expected: object, got: object, do: str, line: int | None = None) -> InputError:
    """The fault of a text file, with the number of the line where one is to blame."""
    where = path if line is None else f"{path}, line {line}"
    return InputError(what, where=where, expected=expected, got=got, do=do)


def line_start(line: bytes) -> str:
    """The start of a line, for a message."""
    return repr(decoded(line)[:SHOWN])
