"""Parameters of the sample, the forest and its importance; numbers and sources stand in `conf/base.yaml`."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fwclass.model import ClassifierMethod
from fwclass.params import Params
from fwclass.train.bag import Drawing


class TrainParams(Params):
    """How the sample is drawn and the trees are grown.

    Attributes
    ----------
    method : kind of classifier; the others are for comparison, and what only a forest has does not bind them.
    split : thresholds that a node tries: `equal-width`, the node's range in `steps` (Fan 2013); `exact`, between
        all its distinct values; `histogram`, between at most `bins` quantiles of the whole sample.
    criterion : `entropy` (information gain) or `gini`.
    features_per_split : `log2` is int(lb M + 1) (Fan 2013, eq. 4), `sqrt` int(√M), `all` M, or the number itself.
    bagging, replacement : share of the sample that a tree draws, with replacement or without.
    class_weights : `none`, `balanced` (rows / (classes × rows of the class)), or a weight per class name; a class
        without one weighs 1, the others 0.001 to 1000.
    corrected_share : of a class's rows corrected echoes are at most this share, unless others do not suffice.
    base_rows : of a base model's rows at least so many of every class train beside the survey's own.
    importance_repeats : permutations of a feature and tree that the importance is measured by; 0 leaves it out.
    """

    method: ClassifierMethod
    seed: int = Field(ge=0, lt=2**63)
    samples_per_class: int = Field(ge=1, le=100_000_000)
    corrected_share: float = Field(gt=0, le=1)
    base_rows: int = Field(ge=0, le=100_000_000)
    trees: int = Field(ge=1, le=65535)
    split: Literal["equal-width", "exact", "histogram"]
    criterion: Literal["entropy", "gini"]
    features_per_split: Literal["log2", "sqrt", "all"] | Annotated[int, Field(ge=1)]
    steps: int = Field(ge=1, le=1000)
    bins: int = Field(ge=2, le=255)
    min_samples_split: int = Field(ge=2, le=2_000_000_000)
    bagging: float = Field(gt=0, le=1)
    replacement: bool
    class_weights: Literal["none", "balanced"] | dict[str, Annotated[float, Field(ge=0.001, le=1000)]]
    importance_repeats: int = Field(ge=0, le=1000)

    @model_validator(mode="after")
    def _something_out_of_bag(self) -> Self:
        if self.importance_repeats and self.bagging == 1 and not self.replacement:
            raise ValueError("importance needs rows that a tree did not see: bagging below 1, or importance_repeats 0")
        return self

    @property
    def drawing(self) -> Drawing:
        """How the rows of a tree are drawn."""
        return Drawing(self.seed, self.bagging, self.replacement)

    def per_split(self, features: int) -> int:
        """Features drawn at a node of a forest of so many."""
        number = self.features_per_split
        if number == "log2":
            number = int(math.log2(features) + 1)
        elif number == "sqrt":
            number = math.isqrt(features)
        elif number == "all":
            number = features
        return min(features, number)


class AdaptParams(Params):
    """How a model learns from a survey without labels.

    Attributes
    ----------
    pool : echoes of the survey that are looked at.
    sure : confidence from which on an echo counts as labelled by its class.
    rounds : how often the model answers and learns.
    unsure : an echo with less confidence is an unsure one.
    most_unsure : of a survey with a larger share of unsure echoes nothing is learned: what the model is sure of is
        wrong there too often.
    """

    pool: int = Field(ge=1000, le=10_000_000)
    sure: float = Field(gt=0, le=1)
    rounds: int = Field(ge=1, le=10)
    unsure: float = Field(gt=0, le=1)
    most_unsure: float = Field(gt=0, le=1)
