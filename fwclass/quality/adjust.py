"""Height, roll and pitch of strips against each other: a robust free adjustment of pairs of planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.quality.pieces import PlacedStrip
from fwclass.units import SIGMA_PER_MAD

ROUNDS = 30
"""At most, of weights that follow the residuals."""

TUKEY = 6.0
"""Standard deviations from which on a pair does not count (Tukey's biweight)."""

LEAST_SIGMA = 1e-4
"""m, a tenth of the coordinates' step."""

ZERO = 1e-9
"""Eigenvalue over the largest one, below which overlaps do not see what the vector stands for."""

LIFTS = 1e-6
"""Weight of a lift beside that of a tilt, where what overlaps do not see is chosen."""

UNSEEN = 0.75
"""Share of a tilt that lies in what overlaps do not see, from which on it is not told."""


@dataclass(frozen=True)
class Pairs:
    """Pairs of planes of two strips: `first`, `second` numbers of strips, place (x, y) [m], `dz` of the first less the
    second [m], `weight`; all of one length."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    dz: NDArray[np.float64]
    weight: NDArray[np.float64]


@dataclass(frozen=True)
class Adjusted:
    """Residuals of strips.

    Attributes
    ----------
    values, errors : float64 (strips, 3), what lifts a strip at its centre, at its right edge and at its far end [m],
        and standard errors; NaN where pairs do not tell.
    pairs : that every strip takes part in.
    sigma : of a pair of weight 1 [m], NaN without any.
    left : root mean square of dz that these do not explain [m], NaN without any.
    """

    values: NDArray[np.float64]
    errors: NDArray[np.float64]
    pairs: NDArray[np.int64]
    sigma: float
    left: float


def adjust(strips: Sequence[PlacedStrip], pairs: Pairs, max_tilt_error: float) -> Adjusted:
    """The residuals that explain `pairs` best, those with the least tilts of all that do so equally well.

    Each strip is lifted by ``h + r u + p v``, u and v its places across and along the line, -1 to 1 from edge to edge.
    What all strips have in common (a lift, a tilt of the whole survey) no overlap sees, and it is taken as none: a free
    network adjustment, and of its solutions that of least tilts (by squares), then of least lifts, so that these have
    mean zero. Lines side by side of which one is lifted would else be tilted together. A tilt whose standard error is
    above `max_tilt_error` [m], or that lies in what is not seen, is left out, and the rest is adjusted again.
    """
    n = len(strips)
    counts = np.bincount(np.concatenate([pairs.first, pairs.second]), minlength=n)
    values, errors = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    if not len(pairs.dz):
        return Adjusted(values, errors, counts, np.nan, np.nan)
    design = _Design(strips, pairs)
    free = np.repeat(counts[:, None] > 0, 3, axis=1)
    for _ in range(ROUNDS):
        x, cov, unseen, sigma = design.solve(free)
        error = np.sqrt(np.maximum(0.0, np.diag(cov))).reshape(n, 3)
        unsure = free & (~(error <= max_tilt_error) | (unseen.reshape(n, 3) > UNSEEN))
        unsure[:, 0] = False
        if not unsure.any():
            break
        free &= ~unsure
    free &= np.isfinite(error)
    values[free], errors[free] = x.reshape(n, 3)[free], error[free]
    residual = design.residuals(x)
    return Adjusted(values, errors, counts, sigma, float(np.sqrt((residual**2).mean())))


class _Design:
    """The equations: sorted by the pair of strips, so that each pair's are one block."""

    def __init__(self, strips: Sequence[PlacedStrip], pairs: Pairs) -> None:
        order = np.lexsort((pairs.dz, pairs.y, pairs.x, pairs.second, pairs.first))
        self.dz, self.weight = pairs.dz[order], pairs.weight[order]
        both = np.stack([pairs.first[order], pairs.second[order]], axis=1)
        self.n = len(strips)
        starts = np.flatnonzero((np.diff(both, axis=0, prepend=both[:1] - 1) != 0).any(axis=1))
        x, y = pairs.x[order], pairs.y[order]
        self.blocks = []
        for begin, end in zip(starts.tolist(), [*starts[1:].tolist(), len(both)], strict=True):
            a, b = both[begin].tolist()
            some = slice(begin, end)
            rows = np.ones((end - begin, 6))
            rows[:, 1], rows[:, 2] = strips[a].within(x[some], y[some])
            rows[:, 4], rows[:, 5] = strips[b].within(x[some], y[some])
            rows[:, 3:] *= -1
            at = np.array([*range(3 * a, 3 * a + 3), *range(3 * b, 3 * b + 3)])
            self.blocks.append((some, at, rows))

    def residuals(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.dz - np.concatenate([rows @ x[at] for _, at, rows in self.blocks])

    def solve(self, free: NDArray[np.bool_]) -> tuple[NDArray, NDArray, NDArray, float]:
        """Solution (3 strips), covariance, the share of each unknown that is not seen, and sigma."""
        used = np.flatnonzero(free.ravel())
        residual = np.concatenate([self.dz[some] - np.median(self.dz[some]) for some, _, _ in self.blocks])
        x, sigma = np.zeros(3 * self.n), np.nan
        for _ in range(ROUNDS):
            spread = max(SIGMA_PER_MAD * float(np.median(np.abs(residual))), LEAST_SIGMA)
            far = np.minimum(1.0, (residual / (TUKEY * spread)) ** 2)
            weight = self.weight * (1 - far) ** 2
            normal, right = np.zeros((3 * self.n, 3 * self.n)), np.zeros(3 * self.n)
            for some, at, rows in self.blocks:
                weighted = rows * weight[some, None]
                normal[np.ix_(at, at)] += weighted.T @ rows
                right[at] += weighted.T @ self.dz[some]
            value, vector = np.linalg.eigh(normal[np.ix_(used, used)])
            seen = value > ZERO * max(float(value[-1]), 1e-300)
            inverse = vector[:, seen] / value[seen] @ vector[:, seen].T
            before, x = x, np.zeros(3 * self.n)
            x[used] = inverse @ right[used]
            residual = self.residuals(x)
            inside = np.where(far < 1, self.weight, 0.0)
            freedom = inside.sum() - seen.sum()
            sigma = float(np.sqrt((inside * residual**2).sum() / freedom)) if freedom > 0 else np.nan
            if np.abs(x - before).max() < LEAST_SIGMA / 100:
                break
        cov, unseen = np.zeros((3 * self.n, 3 * self.n)), np.zeros(3 * self.n)
        moved = _least_tilts(vector[:, ~seen], used % 3 != 0)
        x[used] = moved @ x[used]
        cov[np.ix_(used, used)] = moved @ inverse @ moved.T * sigma**2
        unseen[used] = (vector[:, ~seen] ** 2).sum(axis=1)
        return x, cov, unseen, sigma


def _least_tilts(unseen: NDArray[np.float64], tilt: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The matrix (n, n) that moves unknowns along `unseen` (n, k), which changes nothing that overlaps see, to where
    the squares of those that are a `tilt` (n,) have the least sum, and then those of the others: an S-transformation
    (Baarda 1973)."""
    weighted = unseen.T * np.where(tilt, 1.0, LIFTS)
    return np.eye(len(unseen)) - unseen @ np.linalg.lstsq(weighted @ unseen, weighted, rcond=None)[0]
