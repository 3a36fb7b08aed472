"""Parameters of labels; the numbers stand in `conf/base.yaml`."""

from __future__ import annotations

from pydantic import Field

from fwclass.params import Params


class LabelParams(Params):
    """`max_distance`: a point of a reference cloud further away than this labels nothing [m]; every tile reads the
    cloud that far around itself. `max_move`: a label by echo is of an echo of its number that lies at most so far from
    where it lay when it was labelled [m]."""

    max_distance: float = Field(gt=0, le=100)
    max_move: float = Field(gt=0, le=10)


class SuggestParams(Params):
    """Which places `suggest` names.

    Attributes
    ----------
    size : edge of a place, a square of the global grid [m].
    echoes : the edge is doubled until half of all places have so many; 0 leaves it.
    places : how many, at most.
    least : a place has at least this share of the echoes that half of all places have.
    apart : a place that touches another is put off until the best that touches none has less than this share of its
        score; 0: until there is none.
    """

    size: float = Field(ge=1, le=1000)
    echoes: int = Field(ge=0, le=1_000_000)
    places: int = Field(ge=1, le=100_000)
    least: float = Field(ge=0, le=1)
    apart: float = Field(ge=0, le=1)
