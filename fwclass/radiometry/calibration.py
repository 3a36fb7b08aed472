"""From the tiles' statistics to the gains of the strips and the constant C_cal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.pieces import linked_groups
from fwclass.radiometry.overlap import PARTS, STEP, Overlap, merge
from fwclass.radiometry.params import RadiometryParams
from fwclass.units import SIGMA_PER_MAD

LEAST_ON_TARGET = 5
"""Echoes on a target; with fewer, the standard error of their median says nothing."""


@dataclass(frozen=True)
class StripGain:
    """Gain of one strip.

    Attributes
    ----------
    strip : index of the strip.
    gain : recorded energy over that of the survey's mean strip (geometric).
    error : standard error of ln gain; None where nothing is compared with the strip.
    group : strips of one group are tied by overlaps; groups are numbered from 0, by first strip.
    tied : C_cal holds for the strip.
    echoes : usable echoes of the strip.
    """

    strip: int
    gain: float
    error: float | None
    group: int
    tied: bool
    echoes: int


@dataclass(frozen=True)
class PairRatio:
    """Two strips compared: ln(gain of first / gain of second), over so many cells; residual of the adjustment.

    A cell that k strips share is 2 / k of a cell for each of their pairs.
    """

    first: int
    second: int
    cells: int
    log_ratio: float
    error: float
    residual: float


@dataclass(frozen=True)
class Calibration:
    """Gains and constant of a survey.

    Attributes
    ----------
    constant : C_cal [m⁻² DN⁻¹ ns⁻¹]; 1 where `source` is "none".
    error : standard error of ln C_cal, from the target's echoes; None where it was not measured.
    source : where C_cal comes from.
    target_echoes : usable echoes on the target.
    unit_error : a posteriori standard error of unit weight of the gains' adjustment; None without redundancy.
    strips, pairs : sorted by strip.
    others : C_cal holds for strips that are not among `strips`, as they have no usable echo.
    target_spread : standard deviation of ln γ of the target's echoes, from their quartiles, gains taken off.
    target_levels : (strip, median ln γ on the target, gain taken off) of strips with enough echoes on it.
    """

    constant: float = 1.0
    error: float | None = None
    source: Literal["none", "given", "target"] = "none"
    target_echoes: int = 0
    unit_error: float | None = None
    strips: tuple[StripGain, ...] = ()
    pairs: tuple[PairRatio, ...] = ()
    others: bool = False
    target_spread: float | None = None
    target_levels: tuple[tuple[int, float], ...] = ()

    def gains(self, strip: NDArray) -> NDArray[np.float64]:
        """float64 (rows,): gain [factor] of every row's strip; 1 for a strip that is not known."""
        return self._look_up(strip, np.array([s.gain for s in self.strips], np.float64), 1.0)

    def calibrated(self, strip: NDArray) -> NDArray[np.bool_]:
        """bool (rows,): whether C_cal holds for every row's strip."""
        return self._look_up(strip, np.array([s.tied for s in self.strips], np.float64), float(self.others)) > 0.0

    def _look_up(self, strip: NDArray, values: NDArray[np.float64], other: float) -> NDArray[np.float64]:
        out = np.full(len(strip), other)
        known = np.array([s.strip for s in self.strips], np.int64)
        if len(known):
            at = np.minimum(np.searchsorted(known, strip), len(known) - 1)
            hit = known[at] == strip
            out[hit] = values[at[hit]]
        return out

    def to_json(self) -> dict[str, Any]:
        """Numbers, texts and lists of them; `from_json` gives all back exactly."""
        plain = asdict(self)
        levels = [list(one) for one in plain["target_levels"]]
        return {**plain, "strips": list(plain["strips"]), "pairs": list(plain["pairs"]), "target_levels": levels}

    @classmethod
    def from_json(cls, stored: Any) -> Calibration:
        """`InputError` where `stored` is not what `to_json` gives."""
        try:
            read: dict[str, Any] = dict(stored)
            strips = tuple(StripGain(**one) for one in read.pop("strips"))
            pairs = tuple(PairRatio(**one) for one in read.pop("pairs"))
            levels = tuple((int(s), float(v)) for s, v in read.pop("target_levels", ()))
            return cls(**read, strips=strips, pairs=pairs, target_levels=levels)
        except (ValueError, TypeError, KeyError, AttributeError) as fault:
            raise InputError("this is no calibration", got=str(fault), do="run the calibrate stage again") from None


def calibrate(statistics: Iterable[Overlap], params: RadiometryParams) -> Calibration:
    """Gains by weighted least squares on the strips' log ratios, then C_cal from the target; any order of tiles.

    A log ratio is the median over the common cells; its standard error comes from the order statistics around the
    median (McKean and Schrader 1984). In every group of strips that overlaps tie together the mean ln gain is 0; where
    the adjustment has redundancy and fits worse than the errors say, they are enlarged by its unit error.

    C_cal is such that the median γ of the target's echoes is 4 × its reflectance. Strips of a group without echoes
    on the target are not tied to it. A second group that has some is brought to the same constant by its gains.
    Systematic differences (targets that are not matt, moisture between two flights) are not in the standard errors.

    `InputError`: a target with fewer than 5 usable echoes on it.
    """
    total = merge(statistics)
    strips = np.unique(np.concatenate([total.strip, total.first, total.second, total.target_strip]))
    pairs = _ratios(total, params.overlap.least_cells) if params.balance else np.empty((0, 5))
    log_gain, error, group, residual, unit = _adjust(strips, pairs)
    if not params.balance:
        group[:] = 0
    constant, constant_error, hits, tied = 1.0, None, 0, np.zeros(len(strips), bool)
    source: Literal["none", "given", "target"] = "none"
    if params.calibration is not None:
        constant, source, tied = params.calibration, "given", ~tied
    elif params.target is not None:
        constant, constant_error, hits = _on_target(total, strips, log_gain, group, tied, params.target.reflectance)
        source = "target"
    echoes = dict(zip(total.strip.tolist(), total.echoes.tolist(), strict=True))
    gains = tuple(
        StripGain(
            s, float(np.exp(log_gain[k])), _finite_or_none(error[k]), int(group[k]), bool(tied[k]), echoes.get(s, 0)
        )
        for k, s in enumerate(strips.tolist())
    )
    compared = tuple(
        PairRatio(int(a), int(b), round(n), float(d), float(e), float(r))
        for (a, b, n, d, e), r in zip(pairs, residual, strict=True)
    )
    levels, spread = _levels_on_target(total, strips, log_gain) if source == "target" else ((), None)
    others = source == "given" or (source == "target" and not params.balance)
    return Calibration(constant, constant_error, source, hits, unit, gains, compared, others, spread, levels)


def _finite_or_none(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _median(low: NDArray[np.float64], count: NDArray) -> tuple[float, float]:
    """Median and its standard error of a histogram with bins [low, low + STEP)."""
    order = np.argsort(low, kind="stable")
    low, upto = low[order], np.cumsum(count[order])
    total = upto[-1]
    share = np.clip(np.array([0.5, 0.5 - 1.0 / np.sqrt(total), 0.5 + 1.0 / np.sqrt(total)]), 0.0, 1.0) * total
    at = np.minimum(np.searchsorted(upto, share), len(upto) - 1)
    value = low[at] + STEP * (1.0 - (upto[at] - share) / count[order][at])
    error = max(float(value[2] - value[1]) / 4.0, STEP / np.sqrt(12.0 * total))
    return float(value[0]), float(error)


def _ratios(total: Overlap, least_cells: int) -> NDArray[np.float64]:
    """Rows (first, second, cells, log ratio, standard error) of the pairs with enough cells."""
    rows = []
    key = (total.first << 32) | total.second
    for pair in np.unique(key):
        mine = key == pair
        cells = total.cells[mine] / PARTS
        if cells.sum() >= least_cells:
            value, error = _median(total.difference[mine] * STEP, cells)
            rows.append((int(pair) >> 32, int(pair) & 0xFFFFFFFF, cells.sum(), value, error))
    return np.array(rows, np.float64).reshape(-1, 5)


def _adjust(
    strips: NDArray[np.int64], pairs: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], float | None]:
    """ln gains and their errors, groups, residuals of the pairs, and the unit error."""
    n = len(strips)
    if len(pairs) == 0:
        return np.zeros(n), np.full(n, np.nan), np.arange(n), np.empty(0), None
    a, b = (np.searchsorted(strips, pairs[:, k].astype(np.int64)) for k in (0, 1))
    group = linked_groups(n, a, b)
    groups = int(group.max()) + 1
    design = np.zeros((len(pairs), n))
    design[np.arange(len(a)), a], design[np.arange(len(a)), b] = 1.0, -1.0
    weight = 1.0 / pairs[:, 4] ** 2
    # the mean of a group is free: hold it while inverting, then take it out
    mean = (group[:, None] == group) / np.bincount(group)[group]
    hold = float(weight.max())
    inverse = np.linalg.inv((design.T * weight) @ design + hold * mean) - mean / hold
    log_gain = inverse @ (design.T @ (weight * pairs[:, 3]))
    log_gain -= mean @ log_gain
    residual = pairs[:, 3] - design @ log_gain
    freedom = len(pairs) - (n - groups)
    unit = float(np.sqrt((weight * residual**2).sum() / freedom)) if freedom > 0 else None
    alone = np.bincount(group, minlength=groups)[group] == 1
    error = np.where(alone, np.nan, np.sqrt(np.diag(inverse).clip(0.0)) * max(1.0, unit or 0.0))
    return np.where(alone, 0.0, log_gain), error, group, residual, unit


def _levels_on_target(
    total: Overlap, strips: NDArray[np.int64], log_gain: NDArray[np.float64]
) -> tuple[tuple[tuple[int, float], ...], float | None]:
    """Median level of the target in every strip with enough echoes on it, and the spread of all within their strip."""
    levels, about, weights = [], [], []
    for strip in np.unique(total.target_strip).tolist():
        mine = total.target_strip == strip
        count = total.target_echoes[mine]
        if count.sum() < LEAST_ON_TARGET:
            continue
        level = total.target_level[mine] * STEP - log_gain[np.searchsorted(strips, strip)]
        middle, _ = _median(level, count)
        levels.append((int(strip), middle))
        about.append(np.abs(level - middle))
        weights.append(count)
    if not levels:
        return (), None
    away, count = np.concatenate(about), np.concatenate(weights)
    order = np.argsort(away, kind="stable")
    upto = np.cumsum(count[order])
    return tuple(levels), SIGMA_PER_MAD * float(away[order][np.searchsorted(upto, 0.5 * upto[-1])])


def _on_target(
    total: Overlap,
    strips: NDArray[np.int64],
    log_gain: NDArray[np.float64],
    group: NDArray[np.int64],
    tied: NDArray[np.bool_],
    reflectance: float,
) -> tuple[float, float, int]:
    """C_cal, its error and the echoes on the target; marks `tied` strips and moves `log_gain` of further groups."""
    at = np.searchsorted(strips, total.target_strip)
    level = total.target_level * STEP - log_gain[at]
    hits = np.bincount(group[at], weights=total.target_echoes, minlength=len(strips)).astype(np.int64)
    best = int(hits.argmax()) if len(hits) else 0
    if len(hits) == 0 or hits[best] < LEAST_ON_TARGET:
        raise InputError(
            "too few usable echoes on the reference target",
            where="radiometry.target",
            expected=f"at least {LEAST_ON_TARGET} single, unsaturated echoes with range and normal, at low incidence",
            got=int(hits.max(initial=0)),
            do="check the polygon's coordinates and CRS, and that the echoes have a range (platform altitude or "
            "trajectory), or set the target to null",
        )
    constants = {}
    for g in np.flatnonzero(hits >= LEAST_ON_TARGET).tolist():
        mine = group[at] == g
        middle, error = _median(level[mine], total.target_echoes[mine])
        constants[g] = (np.log(reflectance) - middle, error)
        tied |= group == g
    for g, (constant, _) in constants.items():
        log_gain[group == g] += constants[best][0] - constant
    return float(np.exp(constants[best][0])), constants[best][1], int(total.target_echoes.sum())
