"""Parameters of labels; the numbers stand in `conf/base.yaml`."""

from __future__ import annotations

from fwclass.stage import Params


class LabelParams(Params):
    """`max_distance`: a point of a reference cloud further away than this labels nothing [m]."""

    max_distance: float
