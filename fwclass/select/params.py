"""Parameters of the selection of features."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from fwclass.params import Params


class SelectParams(Params):
    """Numbers and sources stand in `conf/base.yaml`.

    Attributes
    ----------
    block : edge of the squares of the global grid that go to one fold as a whole [m].
    gap : training rows nearer than this to a block that is judged are left out [m]; at most `block`.
    folds : every block is judged once, by a forest of the other folds.
    samples_per_class : rows of a class that take part, at most.
    trees : of every forest.
    score : what decides: overall accuracy, kappa, or the mean of the classes' producer's accuracies.
    patience : forward selection ends after so many features without gain.
    drop : share of the features that a round of backward elimination drops, one at least.
    least : features at which backward elimination ends.
    repeats : permutations of a feature for its importance, in every fold.
    timing_repeats, timing_echoes : runs of a timing, and the echoes of the tile that it is taken on.
    rates : shares of the echoes that the thinning curve has.
    """

    block: float = Field(ge=0.1, le=100_000)
    gap: float = Field(ge=0)
    folds: int = Field(ge=2, le=50)
    samples_per_class: int = Field(ge=1, le=100_000_000)
    trees: int = Field(ge=1, le=65535)
    score: Literal["overall", "kappa", "balanced"]
    patience: int = Field(ge=1, le=100_000)
    drop: float = Field(ge=0, lt=1)
    least: int = Field(ge=1, le=100_000)
    repeats: int = Field(ge=1, le=1000)
    timing_repeats: int = Field(ge=1, le=1000)
    timing_echoes: int = Field(ge=1, le=100_000_000)
    rates: tuple[Annotated[float, Field(gt=0, le=1)], ...] = Field(min_length=1, max_length=100)

    @model_validator(mode="after")
    def _gap_within_block(self) -> SelectParams:
        if self.gap > self.block:
            raise ValueError("select.gap must not be wider than select.block")
        return self
