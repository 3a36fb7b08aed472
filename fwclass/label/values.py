"""What the class field of polygons means: values to reference codes, and codes to classes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError, first_few, set_words
from fwclass.model import ClassDef, class_index

NO_CODE = -1
"""The value says that the polygon labels nothing, or there is no value."""

SHOWN = 8
"""Values that a message lists."""

Meaning = Mapping[str | int, str | int | None]


def text_of(value: Any) -> str | None:
    """A field's value as one text whatever its type in the file: 6, 6.0 and " 6 " are "6"; None without a value."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return None
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return str(value).strip() or None


def codes_of(
    values: Sequence[Any], meaning: Meaning, classes: Sequence[ClassDef], where: object
) -> tuple[NDArray[np.int16], dict[str, int]]:
    """Reference code of every value, and how many features have each value.

    A value is looked up in `meaning` (a code, the name of a class, or None for what labels nothing), then among the
    names of the classes, then taken as a code. The name of a class means the first of its `codes`.

    Returns
    -------
    int16 (values,), `NO_CODE` for no value and for None in `meaning`; and the counts, by text of the value.

    `ConfigError`: a value that is none of these, or none of the values belongs to any class.
    """
    texts = [text_of(v) for v in values]
    counts = Counter(t for t in texts if t is not None)
    table = {text: _code(text, meaning, classes) for text in counts}
    unknown = sorted(text for text, code in table.items() if code is None)
    if unknown:
        listed = first_few([f"{text!r} ({counts[text]} features)" for text in unknown], SHOWN)
        raise ConfigError(
            "the class field has values that stand for no class",
            where=where,
            expected="codes, or " + ", ".join([c.name for c in classes] + [str(k) for k in meaning]),
            got=listed,
            do=f"map each to a code, a class or null: {set_words('survey.reference.values', {unknown[0]: 'null'})}",
        )
    codes = np.array([NO_CODE if t is None else table[t] for t in texts], np.int16)
    _check_some(codes, classes, counts, where)
    return codes, dict(sorted(counts.items()))


def groups_of_codes(codes: NDArray[np.int16], classes: Sequence[ClassDef]) -> NDArray[np.int16]:
    """int16 (parts,): what tells two codes apart, the class's index, or 256 + code where no class counts the code."""
    index = class_index(np.clip(codes, 0, 255).astype(np.uint8), classes)
    return np.where(index >= 0, index, 256 + codes).astype(np.int16)


def _code(text: str, meaning: Meaning, classes: Sequence[ClassDef]) -> int | None:
    """The code of one value, None where it stands for nothing known."""
    codes = {str(k).strip(): v for k, v in meaning.items()}
    if text in codes:
        meant = codes[text]
        if meant is None:
            return NO_CODE
        code = _plain_code(str(meant), classes)
        if code is None:
            raise ConfigError(
                "a value is mapped to neither a code nor a class",
                where=f"survey.reference.values: {text}",
                expected="0 to 255, or " + ", ".join(c.name for c in classes),
                got=meant,
                do="give a reference code, the name of a class, or null",
            )
        return code
    return _plain_code(text, classes)


def _plain_code(text: str, classes: Sequence[ClassDef]) -> int | None:
    for one in classes:
        if text == one.name:
            return one.codes[0] if one.codes else one.code
    return int(text) if text.isascii() and text.isdigit() and int(text) <= 255 else None


def _check_some(
    codes: NDArray[np.int16], classes: Sequence[ClassDef], counts: Mapping[str, int], where: object
) -> None:
    wanted = sorted({code for one in classes for code in one.codes})
    if not np.isin(codes, wanted).any():
        raise ConfigError(
            "no polygon belongs to any class",
            where=where,
            expected="reference codes " + ", ".join(map(str, wanted)),
            got="; ".join(f"{v}: {n}" for v, n in list(counts.items())[:SHOWN]) or "no value in any feature",
            do="check survey.classes (codes), survey.reference.field and survey.reference.values",
        )
