"""Where the returns of a frame lie."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel
from fwclass.street.sphere_kernels import FAR, UNIT

CAUSES = ("below range_min", "above range_max", "NaN", "infinite")
"""Why a range is no return."""


@kernel
def place_frame(ranges, direction, low, high, near, below, x, y, z, r, missing, under):  # type: ignore[no-untyped-def]
    """Coordinates of a frame's returns from the scanner, and the heights of those beside the vehicle.

    Parameters
    ----------
    ranges : float32 (beams,) [m]; 0 is none. direction : float64 (beams, 3), of the beams.
    low, high : valid ranges begin at low and end before high [m]: scanners give their furthest range for no return.
    near, below : returns with \\|y\\| < near and z < below [m] are the road beside the vehicle.
    x, y, z : int32 (beams,), filled [units]; x may be empty. r : float32 (beams,), filled, NaN without a return.
    missing : int64, `CAUSES` of ranges that are no return, added up.
    under : float64 (beams,), begins with the heights of the road [m]; their number is returned.
    """
    count = 0
    for j in range(len(ranges)):
        range_ = np.float64(ranges[j])
        cause = -1
        if math.isnan(range_):
            cause = 2
        elif math.isinf(range_):
            cause = 3
        elif range_ < low or range_ == 0.0:
            cause = 0
        elif range_ >= high:
            cause = 1
        if cause >= 0:
            missing[cause] += 1
            r[j] = np.nan
            y[j] = z[j] = FAR
            if len(x):
                x[j] = FAR
            continue
        r[j] = range_
        there_y, there_z = range_ * direction[j, 1], range_ * direction[j, 2]
        y[j], z[j] = np.int32(np.rint(there_y / UNIT)), np.int32(np.rint(there_z / UNIT))
        if len(x):
            x[j] = np.int32(np.rint(range_ * direction[j, 0] / UNIT))
        if abs(there_y) < near and there_z < below:
            under[count] = there_z
            count += 1
    return count
