"""How sure the figures of a confusion matrix are: intervals from a bootstrap of spatial blocks.

Echoes next to each other are right or wrong together, so that an interval from single echoes would be far too
narrow. Blocks (tiles) are drawn with replacement instead, each with all its echoes (Lahiri 2003, block bootstrap;
Efron 1979, percentile intervals). What this assumes: blocks are wider than the errors' correlation and alike enough
to stand for one another; the map's training and the reference are held fixed. With few blocks intervals come out too
narrow; below `LEAST` there are none.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fwclass.units import finite_or_none

DRAWS = 2000
"""Bootstrap samples; the ends of a 95 % interval are then known to 4 % of its width."""

SEED = 1
LEVEL = 0.95
TAILS = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))

LEAST = 5
"""Blocks; resamples of fewer are too much alike to tell anything."""

FEW = 20
"""Blocks below which an interval is told with a caution: it is too narrow, and a sliver at the border of the test area
weighs in the draw as a whole block."""

FIGURES = ("overall_accuracy", "kappa", "mean_iou")


def intervals(blocks: ArrayLike) -> dict[str, Any] | None:
    """95 % intervals of overall accuracy, kappa and mean IoU; None with fewer than `LEAST` blocks that hold an echo.

    Parameters
    ----------
    blocks : (blocks, classes, classes) or (blocks, classes, classes + 1) counts, rows reference, columns predicted; a
        last extra column counts rows that got none of the classes. Blocks without a count do not take part.

    Returns
    -------
    ``{"level", "blocks", figure: [low, high]}``, plain data for JSON; the same for the same counts in any order of
    the blocks. A figure that is 0 / 0 in a resample leaves that one out; None where it is in all.
    """
    counts = _sort_blocks(_counts(blocks))
    if len(counts) < LEAST:
        return None
    drawn = scores(_resample(counts))
    return {"level": LEVEL, "blocks": len(counts), **_ends(drawn)}


def difference(first: ArrayLike, second: ArrayLike) -> dict[str, Any] | None:
    """95 % intervals of the figures of `second` minus those of `first`, two maps of the same blocks.

    Both are drawn together, so that what is hard in both cancels: an interval without 0 says that one map is better.

    Parameters
    ----------
    first, second : as for `intervals`, block for block the same echoes; `ValueError` where their reference differs.

    Returns
    -------
    ``{"level", "blocks", "caution", figure: {"difference", "interval"}}``; see `caution`.
    """
    a, b = np.asarray(first, np.int64), np.asarray(second, np.int64)
    if a.shape[:2] != b.shape[:2] or (a.sum(axis=2) != b.sum(axis=2)).any():
        raise ValueError("two maps are compared on the same reference in the same blocks")
    split = a.shape[2]
    both = _sort_blocks(_counts(np.concatenate([a, b], axis=2)))
    if len(both) < LEAST:
        return None
    drawn = _resample(both)
    ends = _ends(scores(drawn[:, :, split:]) - scores(drawn[:, :, :split]))
    whole = both.sum(axis=0)[None]
    gain = (scores(whole[:, :, split:]) - scores(whole[:, :, :split]))[0]
    intervals = {
        name: {"difference": finite_or_none(value), "interval": ends[name]}
        for name, value in zip(FIGURES, gain, strict=True)
    }
    return {"level": LEVEL, "blocks": len(both), "caution": caution(len(both)), **intervals}


def class_gains(first: ArrayLike, second: ArrayLike) -> list[dict[str, Any] | None]:
    """95 % intervals of how much higher the IoU of each class is in `second` than in `first`, as `difference` takes
    them: ``(classes,)`` of ``{"value", "low", "high"}``, fractions; None of a class without a reference, ends None with
    fewer than `LEAST` blocks."""
    a, b = np.asarray(first, np.int64), np.asarray(second, np.int64)
    split = a.shape[2]
    both = _sort_blocks(_counts(np.concatenate([a, b], axis=2)))
    whole = both.sum(axis=0)[None]
    value = (_ious(whole[:, :, split:]) - _ious(whole[:, :, :split]))[0]
    drawn = None
    if len(both) >= LEAST:
        sums = _resample(both)
        drawn = _ious(sums[:, :, split:]) - _ious(sums[:, :, :split])
    gains: list[dict[str, Any] | None] = []
    for k, gain in enumerate(value.tolist()):
        known = np.empty(0) if drawn is None else drawn[~np.isnan(drawn[:, k]), k]
        ends = np.quantile(known, TAILS).tolist() if len(known) else (None, None)
        gains.append(None if np.isnan(gain) else {"value": gain, "low": ends[0], "high": ends[1]})
    return gains


def caution(blocks: int) -> str | None:
    """What is to be said beside intervals from so few blocks; None from `FEW` on."""
    if blocks >= FEW:
        return None
    return (
        f"{blocks} blocks are too few blocks to lean on (slivers at the border of the test area count as blocks): the "
        f"intervals are too narrow; {FEW} and more are wanted, from a larger test area"
    )


def scores(matrices: ArrayLike) -> NDArray[np.float64]:
    """(matrices, 3) overall accuracy, kappa and mean IoU of each, as `confusion.figures` defines them; NaN for 0 / 0.

    Parameters
    ----------
    matrices : (matrices, classes, classes) or with one more column, as for `intervals`.
    """
    m = np.asarray(matrices, float)
    classes = m.shape[1]
    rows, right = m.sum(axis=2), np.diagonal(m, axis1=1, axis2=2)
    columns = m[:, :, :classes].sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = rows.sum(axis=1)
        overall = right.sum(axis=1) / total
        chance = (rows * columns).sum(axis=1) / total**2
        kappa = np.where(chance < 1.0, (overall - chance) / (1.0 - chance), np.nan)
        iou = np.nansum(_ious(m), axis=1) / (rows > 0).sum(axis=1)
    return np.stack([overall, kappa, iou], axis=1)


def _ious(matrices: ArrayLike) -> NDArray[np.float64]:
    """(matrices, classes) intersection over union; NaN of a class without a reference."""
    m = np.asarray(matrices, float)
    rows, right = m.sum(axis=2), np.diagonal(m, axis1=1, axis2=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(rows > 0, right / (rows + m[:, :, : m.shape[1]].sum(axis=1) - right), np.nan)


def _counts(blocks: ArrayLike) -> NDArray[np.int64]:
    """Blocks that hold a count."""
    counts = np.asarray(blocks, np.int64)
    if counts.ndim != 3 or (counts < 0).any():
        raise ValueError(f"counts of shape {counts.shape} are no confusion matrices of blocks")
    return counts[counts.any(axis=(1, 2))]


def _sort_blocks(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """The blocks sorted by their counts, so that the order they came in does not matter."""
    flat = counts.reshape(len(counts), counts.shape[1] * counts.shape[2])
    return counts[np.lexsort(flat.T[::-1])]


def _resample(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """(DRAWS, ...) sums of `counts` over as many blocks, drawn with replacement; exact, as whole numbers below 2^53."""
    blocks, rest = len(counts), counts.shape[1:]
    flat = counts.reshape(blocks, -1).astype(float)
    random = np.random.Generator(np.random.PCG64(SEED))
    sums = np.empty((DRAWS, flat.shape[1]))
    for k in range(DRAWS):
        sums[k] = np.bincount(random.integers(0, blocks, blocks), minlength=blocks) @ flat
    return sums.reshape(DRAWS, *rest)


def _ends(drawn: NDArray[np.float64]) -> dict[str, list[float] | None]:
    """Percentile interval of every figure."""
    ends: dict[str, list[float] | None] = {}
    for name, values in zip(FIGURES, drawn.T, strict=True):
        known = values[~np.isnan(values)]
        ends[name] = [float(v) for v in np.quantile(known, TAILS)] if len(known) else None
    return ends
