"""What a picture of a waveform is drawn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class WavePicture:
    """One pulse as it was recorded and as it was fitted. Times are from its first sample [ns], heights in DN.

    Attributes
    ----------
    title, subtitle : two lines above the panel.
    time, samples : the record, shape (n,).
    clipped : samples at the digitiser's end; the fit leaves them out, and so does the residual.
    model : fitted sum at `time`, with the baseline; NaN draws no fit.
    sigma : standard deviation of the noise, shape (n,).
    fine, total : the fitted sum at closer times, shape (m,); NaN where the record has a gap.
    curves : every echo alone, with the baseline, shape (k, m).
    echoes, heights : time of every echo and its top, with the baseline, shape (k,).
    new : echoes that no return of the vendor explains, shape (k,).
    vendor : times of the vendor's returns.
    """

    title: str
    subtitle: str
    time: NDArray[np.float64]
    samples: NDArray[np.float64]
    clipped: NDArray[np.bool_]
    model: NDArray[np.float64]
    sigma: NDArray[np.float64]
    fine: NDArray[np.float64]
    total: NDArray[np.float64]
    curves: NDArray[np.float64]
    echoes: NDArray[np.float64]
    heights: NDArray[np.float64]
    new: NDArray[np.bool_]
    vendor: NDArray[np.float64]
