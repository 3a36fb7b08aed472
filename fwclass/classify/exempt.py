"""Echoes that do not get the class that a model says of them: kept, left without one, or noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.classes import HIGH_NOISE, LOW_NOISE
from fwclass.classify.kept import Kept, with_codes, with_kept
from fwclass.classify.params import ClassifyParams
from fwclass.classify.unsure import Left, with_left
from fwclass.schema import Table


@dataclass(frozen=True)
class Exempt:
    """Which echoes do not get the model's class.

    Attributes
    ----------
    kept : echoes that have the class of their source.
    left : unsure ones that get none.
    noise : those that the noise filter takes out get `LOW_NOISE` or `HIGH_NOISE`.
    """

    kept: Kept | None = None
    left: Left | None = None
    noise: bool = False

    @classmethod
    def of(cls, params: ClassifyParams) -> Exempt | None:
        """None where every echo gets the model's class."""
        exempt = cls(Kept.of(params), Left.of(params), params.noise)
        return None if exempt == cls() else exempt

    @property
    def columns(self) -> tuple[str, ...]:
        """What tells which echoes they are."""
        return (*(("source_class",) if self.kept else ()), *(("noise", "height_above_ground") if self.noise else ()))

    def rows_kept(self, own: Table) -> NDArray[np.bool_]:
        """bool (rows,): echoes, with `columns`, that have the class of their source."""
        return self.kept.rows(own["source_class"]) if self.kept else np.zeros(own.rows, bool)

    def written(self, answered: Table, own: Table) -> Table:
        """What is written of the model's answers, as `classify` gives them, for echoes with `columns`. An echo that is
        kept is neither left nor noise; nobody was asked how sure noise is, so that its confidence is NaN."""
        answered = with_left(answered, self.left)
        if self.noise:
            above = own["height_above_ground"] > 0.0
            answered = with_codes(answered, own["noise"], np.where(above, HIGH_NOISE, LOW_NOISE).astype(np.uint8))
        return with_kept(answered, own["source_class"], self.kept) if self.kept else answered
