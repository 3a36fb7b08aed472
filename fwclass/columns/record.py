"""What a column is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

NAN = float("nan")

SCALES = {
    "r": "sphere of radius",
    "c": "vertical cylinder of radius",
    "k": "nearest echoes, itself included,",
    "g": "cell of edge",
    "o": "sphere of optimal radius",
}
"""Kinds of neighbourhood. ``_r100``, ``_c100``, ``_g100``: centimetres; ``_k20``: echoes; ``_opt``: no size."""

PER_CODE = "p"
"""`scales` of what every class has one of: ``probability_6`` is that of class code 6."""


@dataclass(frozen=True)
class Column:
    """One column of any table.

    Attributes
    ----------
    name : the field's standard term; neighbourhood features carry their scale, as in ``echo_ratio_r100``.
    dtype : numpy dtype as text.
    unit : SI or field unit; "" for counts, codes and fractions.
    meaning : one sentence.
    null : the value that says "no value"; None where every row has one.
    scales : kinds of neighbourhood that a feature may be taken over, letters of `SCALES`; "": it has no scale.
    low, high : range of valid values, or None.
    source : paper and equation, or the format's field.
    las : name as a LAS extra byte, or "" if the column has a field of its own in LAS or is not published.
    las_about : what the extra byte's 32 bytes of description say after the unit; "": the first words of `meaning`.
    las_dtype, las_scale : how the extra byte stores it: value = scale x stored number; "" stores `dtype` itself.
        Where `null` is NaN and the stored type is whole, the lowest number (signed) or the highest (unsigned) stands
        for "no value" and is declared as the extra byte's no-data value.
    """

    name: str
    dtype: str
    unit: str
    meaning: str
    null: float | None = None
    low: float | None = None
    high: float | None = None
    scales: str = ""
    source: str = ""
    las: str = ""
    las_about: str = ""
    las_dtype: str = ""
    las_scale: float = 1.0


def published_columns(columns: Iterable[Column], extra_bytes: Mapping[str, tuple[Any, ...]]) -> tuple[Column, ...]:
    """`columns`, those of these names as LAS extra bytes: name there, what is said of it, how it is stored."""
    fields = ("las", "las_about", "las_dtype", "las_scale")
    about = {name: dict(zip(fields, of, strict=False)) for name, of in extra_bytes.items()}
    return tuple(replace(column, **about.get(column.name, {})) for column in columns)


def measured_column(name: str, unit: str, meaning: str, **more: Any) -> Column:
    """A column of what is measured: a 32-bit float, NaN where there is none."""
    return Column(name, "f4", unit, meaning, null=NAN, **more)
