"""Echoes that keep the class that their source has, and are not classified."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.params import ClassifyParams
from fwclass.schema import Table

CODES = 256


@dataclass(frozen=True)
class Kept:
    """Which class codes of the sources stay.

    Attributes
    ----------
    only : all but these, where any is named.
    keep : these.
    """

    only: tuple[int, ...]
    keep: tuple[int, ...]

    @classmethod
    def of(cls, params: ClassifyParams) -> Kept | None:
        """None where everything is classified."""
        return cls(params.only, params.keep) if params.only or params.keep else None

    @property
    def codes(self) -> NDArray[np.bool_]:
        """bool (256,): by code, whether it stays."""
        table = np.full(CODES, bool(self.only))
        table[list(self.only)] = False
        table[list(self.keep)] = True
        return table

    def rows(self, source: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """bool (rows,): which echoes stay, by the class of their `source`."""
        return self.codes[source]


def with_kept(answered: Table, source: NDArray[np.uint8], kept: Kept | None) -> Table:
    """`answered` (as `classify` gives it) with the source's class where it stays: nobody was asked how sure it is, so
    that confidence, entropy and shares are NaN there."""
    if kept is None:
        return answered
    return with_codes(answered, kept.rows(source), source)


def with_codes(answered: Table, rows: NDArray[np.bool_], codes: NDArray[np.uint8]) -> Table:
    """`answered` (as `classify` gives it) with `codes` (rows,) in some `rows`, bool (rows,); all else is NaN there."""
    others = {n: np.where(rows, np.float32(np.nan), answered[n]) for n in answered if n != "classification"}
    return Table({"classification": np.where(rows, codes, answered["classification"]), **others})
