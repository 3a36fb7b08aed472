"""Parameters of the classifiers that the forest is compared with; numbers and sources stand in `conf/base.yaml`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from fwclass.params import Params

Positive = Annotated[float, Field(gt=0)]


class LinearSvmParams(Params):
    """Linear machine, one class against the rest; `c` weighs the errors, `iterations` end the search for its planes."""

    c: Positive
    tolerance: Positive
    iterations: int = Field(ge=1, le=100_000_000)


class RbfSvmParams(Params):
    """Machine with Gaussian kernel, every class against every other.

    `c` and `gamma`: values tried; of several the pair that is right most often in `folds` folds of the sample that lie
    apart (blocks and gap of the section `select`), of equally good ones the smoother.
    `max_rows`, `search_rows`: rows of the sample that train, and that the search looks at.
    `trim`: rows whose nearest other row has another class are dropped (`train.trim`), once or until none is left.
    """

    c: tuple[Positive, ...] = Field(min_length=1, max_length=100)
    gamma: tuple[Positive, ...] = Field(min_length=1, max_length=100)
    folds: int = Field(ge=2, le=20)
    max_rows: int = Field(ge=2, le=1_000_000)
    search_rows: int = Field(ge=2, le=1_000_000)
    trim: Literal["none", "nearest", "repeated"]


class BoostingParams(Params):
    """Gradient boosting on histograms."""

    rounds: int = Field(ge=1, le=10_000)
    learning_rate: float = Field(gt=0, le=1)
    leaves: int = Field(ge=2, le=65_535)
    min_samples_leaf: int = Field(ge=1, le=2_000_000_000)
    l2: float = Field(ge=0)
    bins: int = Field(ge=2, le=255)


class CompareParams(Params):
    """What the other classifiers are trained with; scikit-learn's forest takes the numbers of `train`.

    `scaling`: features of the machines to mean 0 and standard deviation 1 (`standard`), or to 0 to 1 (`minmax`), of the
    training rows.
    """

    scaling: Literal["standard", "minmax"]
    linear_svm: LinearSvmParams
    rbf_svm: RbfSvmParams
    boosting: BoostingParams
