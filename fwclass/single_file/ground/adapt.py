"""`fwclass ground --auto`: parameters that follow from what is measured in the points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.ground.auto import adapted
from fwclass.ground.params import GroundParams
from fwclass.ground.tuning_params import GroundAutoParams
from fwclass.read.cloud import PointCloud
from fwclass.single_file.ground.file import Adapt
from fwclass.single_file.ground.steps import Tell, quiet


def adapting(choose: bool, settings: tuple[str, ...] = (), tell: Tell = quiet) -> Adapt:
    """What changes parameters to suit a cloud; with `choose` the filter too. `tell` hears how much is tried."""
    rules: GroundAutoParams = conf.section("ground_auto", settings)

    def adapt(cloud: PointCloud, shown: NDArray[np.bool_], params: GroundParams) -> tuple[GroundParams, dict[str, Any]]:
        method = rules.method if choose else params.method
        tried = len(rules.updates(method))
        tell(f"measuring, then trying {tried} settings of {method}" if tried else "measuring")
        points = cloud.x[shown], cloud.y[shown], cloud.z[shown]
        found, measured = adapted(points, cloud.last[shown], params, rules, None if choose else params.method)
        return found, measured.plain()

    return adapt
