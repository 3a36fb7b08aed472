"""Cloth simulation first, the simple morphological filter on what it kept. He et al. 2023."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.methods.csf import csf
from fwclass.ground.methods.smrf import smrf
from fwclass.ground.params import CsfSmrfParams


def csf_smrf(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: CsfSmrfParams
) -> NDArray[np.bool_]:
    """Ground among points: what both filters call ground; SMRF sees only what the cloth kept.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized; the cloth's should keep all ground, for what it drops is not asked again.

    Source: He et al. 2023.
    """
    ground = csf(x, y, z, params.csf)
    if ground.any():
        ground[ground] = smrf(x[ground], y[ground], z[ground], params.smrf)
    return ground
