"""Parameters of the classification."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from fwclass.classes import NOISE_CODES
from fwclass.model import ClassifierMethod
from fwclass.model.contextual import MOST_CELLS, MOST_WEIGHT, WIDEST
from fwclass.params import Params
from fwclass.schema import scaled

FURTHEST = 100.0
"""m, no feature and no boundary reaches further."""


class RefineParams(Params):
    """A second layer, which answers again where two classes meet; numbers stand in `conf/base.yaml`.

    Attributes
    ----------
    between : names of the two classes; empty: no second layer.
    within : an echo of the one class with an answer of the other as near as this is at their boundary [m].
    method : its classifier, as of `train.method`.
    features : shares of the eigenvalues in spheres of `scales` alone, or with what the first layer decides by.
    scales : radii of the spheres [m].
    rows : it learns from rows of both classes near their boundary, or from anywhere in the training areas.
    samples_per_class : rows that it learns from, at most.
    """

    between: tuple[str, ...]
    within: float = Field(gt=0, le=FURTHEST)
    method: ClassifierMethod
    features: Literal["shares", "shares+coarse"]
    scales: tuple[Annotated[float, Field(ge=0.01, le=FURTHEST)], ...] = Field(min_length=1, max_length=50)
    rows: Literal["boundary", "anywhere"]
    samples_per_class: int = Field(ge=1, le=100_000_000)

    @field_validator("between")
    @classmethod
    def _a_pair(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if names and (len(names) != 2 or names[0] == names[1]):
            raise ValueError("two different classes are wanted, as in [building, vegetation], or [] for none")
        return names

    @field_validator("scales")
    @classmethod
    def _rising(cls, scales: tuple[float, ...]) -> tuple[float, ...]:
        if any(b <= a for a, b in zip(scales, scales[1:], strict=False)):
            raise ValueError("radii must rise")
        if any(abs(100 * s - round(100 * s)) > 1e-6 for s in scales):
            raise ValueError("radii must be whole centimetres")
        return scales

    @property
    def shares(self) -> tuple[str, ...]:
        """Names of the features at all scales."""
        return tuple(scaled(f"eigenvalue_{k}", s) for s in self.scales for k in (1, 2, 3))


Cells = Annotated[tuple[Annotated[float, Field(strict=True, ge=0.1, le=WIDEST)], ...], Field(max_length=MOST_CELLS)]


class ContextParams(Params):
    """A second layer that decides every echo again, by the first one's answers around it; numbers stand in
    `conf/base.yaml`.

    Attributes
    ----------
    cells : edges of the cells that neighbours are counted in, boxes of 5 x 5 and of 5 x 5 x 5 of them [m]; empty: no
        such layer; None: as the model has that is given or learned further, and none without one; auto: likewise, and
        without one `auto_cells`, where squares that neither layer has learned from say that both are better.
    auto_cells : edges that `auto` tries [m].
    folds : so many first layers answer for the training areas, each for squares that it has not learned from.
    trees : of each of these, and of the second layers that are tried, where they are forests; at most as many as a
        forest of the run has.
    most_weight : the share of a class weighs at most so many times another's; 1: all weigh the same.
    """

    cells: Literal["auto"] | Cells | None
    auto_cells: Cells = Field(min_length=1)
    folds: int = Field(ge=2, le=50)
    trees: int = Field(ge=1, le=10_000)
    most_weight: float = Field(ge=1.0, le=MOST_WEIGHT)

    @property
    def tried(self) -> tuple[float, ...]:
        """Edges of the cells of a layer that is learned, or tried [m]; empty where none is asked for."""
        return self.auto_cells if self.cells == "auto" else self.cells or ()

    @field_validator("cells", "auto_cells")
    @classmethod
    def _rising(cls, cells: Literal["auto"] | tuple[float, ...] | None) -> Literal["auto"] | tuple[float, ...] | None:
        if cells is None or cells == "auto":
            return cells
        if any(b <= a for a, b in zip(cells, cells[1:], strict=False)):
            raise ValueError("edges must rise")
        if any(abs(100 * c - round(100 * c)) > 1e-6 for c in cells):
            raise ValueError("edges must be whole centimetres")
        return cells


class RegularizeParams(Params):
    """Neighbours that agree, by a mean field over the shares of all classes; numbers stand in `conf/base.yaml`.

    Attributes
    ----------
    strength : what a neighbour's share of a class counts, as a logarithm of the own one; 0: no mean field.
    neighbours : nearest echoes that an echo agrees with, at most.
    reach : neighbours are at most as far as this [m].
    height : what a metre of height counts as [m].
    rounds : so many times all echoes agree with their neighbours.
    least : own share of a class at least.
    """

    strength: float = Field(ge=0.0, le=10.0)
    neighbours: int = Field(ge=1, le=100)
    reach: float = Field(ge=0.1, le=20.0)
    height: float = Field(ge=1.0, le=100.0)
    rounds: int = Field(ge=1, le=10)
    least: float = Field(gt=0.0, le=0.1)

    @property
    def halo(self) -> float:
        """Distance around an echo within which all lies that its answer depends on [m]."""
        return self.rounds * self.reach


Code = Annotated[int, Field(strict=True, ge=0, le=255)]


class LineParams(Params):
    """Classes whose echoes lie on straight lines: wires; numbers stand in `conf/base.yaml`.

    Attributes
    ----------
    codes : class codes.
    reach : along a line, to both sides of an echo [m].
    tolerance : echoes of a line are at most as far beside, above or below it [m].
    sag : what heights may differ besides, times the products of distances along the line [1/m].
    slope : steepest line.
    sure : share of the class from which an echo says where a line is.
    least : share of the class from which an echo may join it.
    share : cells of a line that must hold a sure echo, of those that a wire's echoes would be in.
    fewest : cells at least.
    width : pulses that come so near to a wire, both sides together, return from it [m].
    most : sure echoes within the reach, one for half a metre; where there are more nothing changes.
    """

    codes: tuple[Code, ...] = Field(max_length=256)
    reach: float = Field(ge=15.0, le=30.0)
    tolerance: float = Field(gt=0.0, le=1.0)
    sag: float = Field(ge=0.0, le=0.1)
    slope: float = Field(gt=0.0, le=2.0)
    sure: float = Field(gt=0.0, le=1.0)
    least: float = Field(gt=0.0, le=1.0)
    share: float = Field(gt=0.0, le=1.0)
    fewest: int = Field(ge=3, le=30)
    width: float = Field(gt=0.0, le=10.0)
    most: int = Field(ge=10, le=10_000)

    @property
    def halo(self) -> float:
        """Distance around an echo within which all lies that its answer depends on [m]."""
        return 2 * self.reach

    def among(self, codes: Iterable[int]) -> tuple[int, ...]:
        """Those of the class `codes` whose echoes lie on lines."""
        return tuple(code for code in codes if code in self.codes)

    @model_validator(mode="after")
    def _sure_may_join(self) -> Self:
        if self.least > self.sure:
            raise ValueError("an echo that is sure may join: least is at most sure")
        return self


class ClassifyParams(Params):
    """What is classified and written, and second layers; everything else that decides comes from the model.

    `only`: class codes of the sources whose echoes are classified, all others keep theirs; empty: all are classified.
    `keep`: class codes of the sources that stay. `probabilities`: the share of every class too, in columns
    ``probability_<code>``. `max_outside`: share of the echoes whose value of a feature lies outside of what the model
    has seen, above which a command ends with exit code 4, unless `accept_drift`; `unsure`: confidence below which an
    echo is unsure; `max_unsure`: share of unsure echoes above which it does so too, by a given model, and `max_rough`:
    residual of the smoothest tenth of level places [m], likewise. None of these changes a class; `leave` does: the code
    that echoes with a confidence below `leave_below` get instead of one, None: they have their class; and `noise`:
    echoes that the noise filter takes out are written as 7 and 18.
    """

    only: tuple[Code, ...] = Field(max_length=256)
    keep: tuple[Code, ...] = Field(max_length=256)
    probabilities: bool
    max_outside: float = Field(ge=0.0, le=1.0)
    unsure: float = Field(ge=0.0, le=1.0)
    max_unsure: float = Field(ge=0.0, le=1.0)
    max_rough: float = Field(gt=0.0, le=100.0)
    leave: Code | None
    leave_below: float = Field(gt=0.0, le=1.0)
    accept_drift: bool
    noise: bool
    refine: RefineParams
    context: ContextParams
    regularize: RegularizeParams
    lines: LineParams

    @model_validator(mode="after")
    def _kept_or_classified(self) -> Self:
        both = sorted({*self.only} & {*self.keep})
        if both:
            raise ValueError(f"code {both[0]} is to be classified (only) and to be kept (keep)")
        if self.noise and self.leave in NOISE_CODES:
            raise ValueError(f"unsure echoes (leave) would get code {self.leave}, which noise is written as")
        return self
