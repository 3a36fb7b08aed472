"""Noise whose neighbours are correlated, as an autoregression: every sample is foretold from those before it.

x_i = phi_1 x_(i-1) + … + phi_p x_(i-p) + e_i, where the e, the innovations, are white. Samples and templates filtered
by (1, -phi_1, …, -phi_p) are those of a receiver with white noise. Source: Box, Jenkins and Reinsel 2008, chapter 3,
and the recursion of Levinson 1947 and Durbin 1960.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Autoregression:
    """A stationary autoregression of unit variance; without coefficients it is white.

    Attributes
    ----------
    phi : the coefficients, of the nearest sample first.
    """

    phi: tuple[float, ...] = ()

    @classmethod
    def of(cls, correlation: Floats, order: int) -> Autoregression:
        """The best predictor from `order` samples of noise with the correlations at lags 0, 1, …, `order`."""
        phi, left = np.empty(0), 1.0
        for m in range(1, order + 1):
            k = (correlation[m] - phi @ correlation[m - 1 : 0 : -1]) / left
            phi, left = np.append(phi - k * phi[::-1], k), left * (1.0 - k * k)
            if not left > 0.0:
                raise ValueError("correlations of no process")
        return cls(tuple(phi.tolist()))

    @cached_property
    def _steps(self) -> list[tuple[float, ...]]:
        """Coefficients of the predictors from 1, 2, … samples; the last of each is the partial correlation."""
        steps, phi = [], np.array(self.phi)
        while len(phi):
            steps.append(tuple(phi.tolist()))
            k = phi[-1]
            if not abs(k) < 1.0:
                raise ValueError("the autoregression is not stationary")
            phi = (phi[:-1] + k * phi[-2::-1]) / (1.0 - k * k) if len(phi) > 1 else phi[:0]
        return steps[::-1]

    @property
    def stationary(self) -> bool:
        """Whether such noise keeps its variance: all its partial correlations lie within -1 to 1."""
        try:
            return len(self._steps) == len(self.phi) and bool(np.isfinite(self.phi).all())
        except ValueError:
            return False

    def shorter(self, order: int) -> Autoregression:
        """The best predictor of the same noise from at most `order` samples."""
        return self if order >= len(self.phi) else Autoregression(self._steps[order - 1] if order > 0 else ())

    @property
    def innovation(self) -> float:
        """Variance of the innovations, as a share of the noise's, 0 to 1."""
        return float(np.prod([1.0 - step[-1] ** 2 for step in self._steps]))

    @property
    def filter(self) -> Floats:
        """(1, -phi_1, …): what makes the noise white."""
        return np.concatenate([[1.0], -np.array(self.phi)])

    def correlation(self, lags: int) -> Floats:
        """Correlation at the lags 0 to `lags`."""
        correlation = np.ones(lags + 1)
        for lag in range(1, lags + 1):
            phi = np.array(self._steps[min(lag, len(self.phi)) - 1] if self.phi else ())
            correlation[lag] = phi @ correlation[lag - 1 :: -1][: len(phi)]
        return correlation


WHITE = Autoregression()


def output_gain(correlation: Floats, filter: Sequence[float] | Floats) -> float:
    """Variance of the output of `filter` (taps,) on noise of unit variance with the `correlation` float64 (lags,) at
    lags 0, 1, …; beyond the last it counts as uncorrelated."""
    overlap = np.correlate(filter, filter, "full")[len(filter) - 1 :]
    n = min(len(overlap), len(correlation))
    return float(overlap[0] * correlation[0] + 2.0 * (overlap[1:n] @ correlation[1:n]))
