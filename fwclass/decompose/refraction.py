"""Beams through a horizontal water surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def refract(beam: NDArray[np.float64], before: float, after: float) -> NDArray[np.float64]:
    """Unit vectors of `beam`, (n, 3), behind a horizontal surface, by Snell's law.

    Parameters
    ----------
    beam : unit vectors; up or down.
    before, after : refractive index on the side that the beam comes from, and behind the surface.

    Returns
    -------
    float64 (n, 3); NaN beyond the limit angle, where nothing passes, and for a beam along the surface.
    """
    ratio, down = before / after, beam[:, 2]
    with np.errstate(invalid="ignore"):
        steep = np.sqrt(1.0 - ratio**2 * (1.0 - down**2))
    out = ratio * beam
    out[:, 2] = np.where(down == 0.0, np.nan, np.copysign(steep, down))
    out[np.isnan(out[:, 2])] = np.nan
    return out
