"""Parameters of labels; the numbers stand in `conf/base.yaml`."""

from __future__ import annotations

from pydantic import Field

from fwclass.stage import Params


class LabelParams(Params):
    """`max_distance`: a point of a reference cloud further away than this labels nothing [m]; every tile reads the
    cloud that far around itself."""

    max_distance: float = Field(gt=0, le=100)
