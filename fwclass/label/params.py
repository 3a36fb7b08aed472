"""Parameters of labels; the numbers stand in `conf/base.yaml`."""

from __future__ import annotations

from pydantic import Field

from fwclass.stage import Params


class LabelParams(Params):
    """`max_distance`: a point of a reference cloud further away than this labels nothing [m]; every tile reads the
    cloud that far around itself. `max_move`: a label by echo is of an echo of its number that lies at most so far from
    where it lay when it was labelled [m]."""

    max_distance: float = Field(gt=0, le=100)
    max_move: float = Field(gt=0, le=10)
