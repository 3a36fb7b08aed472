"""Parameters of the assessment."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from fwclass.params import Params


class ObjectParams(Params):
    """What an object is, and when it is found; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    classes : those whose objects are judged, by name; null: buildings, wires, towers, bridges and own codes.
    cell : least edge of the cells that objects hang together by [m], an even number of millimetres.
    spacings : edge of wider ones [mean spacings of the tested echoes where these are sparse].
    echoes : of an object, at least.
    sizes : areas of cells that sizes begin with [m²], rising; what is smaller than the first is no object.
    overlap : share of an object's echoes that must have its class in the other cloud too.
    piece : share of its echoes in an object of the answer from which this is a piece of it.
    """

    classes: tuple[str, ...] | None = Field(max_length=256)
    cell: float = Field(ge=0.1, le=100)
    spacings: float = Field(ge=0.5, le=10)
    echoes: int = Field(ge=1, le=1_000_000)
    sizes: tuple[Annotated[float, Field(gt=0, le=1e9)], ...] = Field(min_length=1, max_length=20)
    overlap: float = Field(gt=0, le=1)
    piece: float = Field(gt=0, le=0.5)

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        if list(self.sizes) != sorted(set(self.sizes)):
            raise ValueError("sizes must rise")
        if abs(500.0 * self.cell - round(500.0 * self.cell)) > 1e-6:
            raise ValueError("cell must be an even number of millimetres")
        return self

    @property
    def step(self) -> float:
        """Edge of the cells that tiles keep, and that those of objects are a multiple of [m]."""
        return round(500.0 * self.cell) / 1000.0


class AssessParams(Params):
    """What is reported, and what accuracy is asked for; numbers and sources stand in `conf/base.yaml`.

    `block`: edge of the squares of the global grid [m] that intervals are drawn from. A remark stands beside the
    accuracy where a share of at least `pure` of the tested echoes lies in squares of one class, where a share of less
    than `tested` of all echoes is tested, and where more than `unscored` of them have a reference that no class counts.
    `objects`: what an object is.
    """

    block: float = Field(ge=0.1, le=100_000)
    quantiles: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(min_length=1, max_length=100)
    pure: float = Field(ge=0, le=1)
    tested: float = Field(ge=0, le=1)
    unscored: float = Field(ge=0, le=1)
    objects: ObjectParams
    min_overall_accuracy: float | None = Field(ge=0, le=1)
    min_kappa: float | None = Field(ge=-1, le=1)
