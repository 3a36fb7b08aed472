"""Columns of a run as the viewer colours by them: a byte an echo."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns, table_fields
from fwclass.delivery.opened import Delivery
from fwclass.delivery.viewed_colours import (
    CORRECTED,
    DIFFERS,
    MEANING,
    RIGHT,
    compare_classes,
    compare_corrections,
    kinds,
    verdicts,
)
from fwclass.delivery.viewed_corrections import ShownClasses
from fwclass.delivery.viewed_echo import BehindEchoes
from fwclass.delivery.viewed_open import OpenRun, OpenTile
from fwclass.delivery.viewed_pair import tiles_of
from fwclass.errors import FwclassError, InputError
from fwclass.view.blocks import DRAWN, NO_VALUE, ByteScale
from fwclass.view.pyramid import Node

ENDS = (0.01, 0.99)
"""Quantiles between which values have colours of their own."""

SAMPLED = 8
"""Tiles, about, that are looked at."""


@dataclass(frozen=True)
class ColourSpan:
    """From `low` to `high` colours tell values apart; `least` and `most` are the ends of what was looked at.

    All are NaN where there is no value.
    """

    low: float
    high: float
    least: float
    most: float

    @classmethod
    def over(cls, values: NDArray) -> ColourSpan:
        """Of finite values; from end to end where nearly all are one, as flags are."""
        if not len(values):
            return cls(math.nan, math.nan, math.nan, math.nan)
        least, most = float(values.min()), float(values.max())
        low, high = np.quantile(values, ENDS, method="nearest").tolist()
        return cls(low, high, least, most) if low < high else cls(least, most, least, most)

    @classmethod
    def joined(cls, spans: Sequence[ColourSpan]) -> ColourSpan:
        """The narrowest that holds all."""
        least, most = (
            [float(end.reduce([getattr(s, name) for s in spans])) for name in names]
            for end, names in ((np.fmin, ("low", "least")), (np.fmax, ("high", "most")))
        )
        return cls(least[0], most[0], least[1], most[1])


def finite(values: NDArray) -> NDArray[np.float64]:
    """Those that are numbers."""
    return np.asarray(values[np.isfinite(values)], np.float64)


def span_of(delivery: Delivery, name: str) -> ColourSpan:
    """Of a column in some tiles, in the first with any value where those have none."""
    keys = [str(t["tile"]) for t in delivery.tiles]
    values = np.concatenate([_finite(delivery, key, name) for key in keys[:: max(1, len(keys) // SAMPLED)]])
    for key in keys if not len(values) else ():
        if len(values := _finite(delivery, key, name)):
            break
    return ColourSpan.over(values)


def _finite(delivery: Delivery, key: str, name: str) -> NDArray[np.float64]:
    """Nothing where the run has no such column."""
    return finite(table_columns(delivery.table(key), (name,)).get(name, np.empty(0)))


ENOUGH = 1000
"""Coarse echoes whose values tell those of all."""


class ColourColumns:
    """Columns of the delivery's tables, and those that compare its classes with others."""

    def __init__(self, open_: OpenRun, behind: BehindEchoes, classes: ShownClasses, other: Delivery | None) -> None:
        self._open, self._delivery, self._other = open_, open_.delivery, other
        self._behind, self._classes = behind, classes

    @cached_property
    def fields(self) -> list[dict[str, str]]:
        """Name, unit and meaning of each."""
        fields = table_fields(self._delivery.table(next(iter(self._open.tiles))))
        more = [CORRECTED]
        if self._delivery.report["accuracy"] and self._behind.has_reference:
            more.append(RIGHT)
        if self._other is not None:
            more.append(DIFFERS)
        return fields + [{"name": name, "unit": "", "meaning": MEANING[name]} for name in more]

    def scale(self, name: str) -> dict[str, Any]:
        """What the bytes of a column stand for; `InputError` where there is none of this name."""
        field = self._field(name)
        if (named := kinds(name, self._delivery.report["input"]["files"])) is not None:
            return {**field, "classes": named}
        return {**field, **{end: plain_value(v) for end, v in asdict(self._span(name)).items()}}

    def of_node(self, name: str, node: Node, rows: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Of echoes `rows` of what holds a node."""
        key = self._open.key_of(node)
        if key:
            return self.of_tile(key, name)[rows]
        if name == CORRECTED:
            return self._accepted(self._open.coarse(), "")[rows]
        return self._kept("", name, lambda: self._of_coarse(name))[rows]

    def of_tile(self, key: str, name: str) -> NDArray[np.uint8]:
        """Of all echoes of a tile, in the table's order."""
        return self._kept(key, name, lambda: self._make(key, name))

    def _kept(self, key: str, name: str, make: Callable[[], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        version = self._classes.version(key) if name == CORRECTED else 0
        return np.asarray(self._open.cache.get(("bytes", key, name, version), make))

    def _make(self, key: str, name: str) -> NDArray[np.uint8]:
        if name == RIGHT:
            return self._verdicts(key)
        if name == CORRECTED:
            return self._accepted(self._open.tile(key), key)
        if name == DIFFERS and self._other is not None:
            others = map(self._other.table, tiles_of(self._other, self._open.tiles[key]))
            return compare_classes(self._delivery.table(key), others)
        self._field(name)
        return self._bytes_of(name, self._open.columns(key, (name,))[name])

    def _of_coarse(self, name: str) -> NDArray[np.uint8]:
        self._field(name)
        columns = self._open.coarse().columns
        if name in columns:
            return self._bytes_of(name, columns[name])
        return self._open.for_coarse(lambda key: self.of_tile(key, name))

    def _bytes_of(self, name: str, values: NDArray) -> NDArray[np.uint8]:
        if name == "strip":  # the codes that `kinds` gives
            strips = sorted({int(f["strip"]) for f in self._delivery.report["input"]["files"]})
            return np.asarray(np.searchsorted(strips, values) % NO_VALUE, np.uint8)
        span = self._span(name)
        return ByteScale(span.low, span.high).bytes_of(values)

    def _accepted(self, opened: OpenTile, key: str) -> NDArray[np.uint8]:
        return compare_corrections(opened.columns["classification"], *self._classes.of(opened, key))

    def _verdicts(self, key: str) -> NDArray[np.uint8]:
        classes = self._open.columns(key, ("classification",))["classification"]
        try:
            reference = self._behind.reference(key)
        except (FwclassError, OSError):
            return np.zeros(len(classes), np.uint8)
        return verdicts(classes, reference, self._delivery.classes)

    def reference(self, tile: str, row: int) -> int | None:
        """Code of the reference of an echo, by its row in the delivered table; None where it has none, or the run."""
        if not any(field["name"] == RIGHT for field in self.fields):
            return None
        try:
            return int(self._behind.reference(tile)[row]) or None
        except (FwclassError, OSError):
            return None

    def _field(self, name: str) -> dict[str, str]:
        by_name = {f["name"]: f for f in self.fields}
        if name not in by_name:
            raise InputError("no such column", where=self._delivery.path, got=name)
        return by_name[name]

    def _span(self, name: str) -> ColourSpan:
        return self._open.cache.get(("span", name), lambda: self._measured(name), lambda _: 64)

    def _measured(self, name: str) -> ColourSpan:
        """Of what blocks have, by the coarse echoes, which are of all tiles. Of other columns, whose bytes are made
        here, of both runs where two are compared: the same colour is the same value in either."""
        if name in DRAWN and self._open.pyramid.own:
            values = finite(self._open.coarse().columns[name])
            if len(values) >= ENOUGH:
                return ColourSpan.over(values)
        others = [self._other] if self._other is not None and name not in DRAWN else []
        return ColourSpan.joined([span_of(d, name) for d in (self._delivery, *others)])


def plain_value(value: Any) -> Any:
    """For JSON: no NaN, no numpy."""
    plain = value.item() if hasattr(value, "item") else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
