"""Decisions of a kernel machine in single precision, each with a bound of its error.

Support vectors of a class lie in blocks of near ones, so that a whole block far from a row is passed over by its box,
and a block is one run of instructions over several vectors at a time. Distances are scaled so that a kernel is 2^-t.

With u = 2^-24, a vector of length s and a row at a squared distance t of it, both in scaled units about the middle of
all vectors, rounding moves t by at most u (4 s sqrt(t) + (M + 5) t) for M features, and a kernel times its weight,
added up, by at most `ROUNDINGS` u of itself. A vector in a block whose box is at the squared distance b has t >= b;
over all such t the error of its kernel is thus at most

    u 2^-b (ROUNDINGS + 4 ln2 s (sqrt(b) + 0.5151) + ln2 (M + 5) (b + 0.5307))

where 0.5151 and 0.5307 are the largest values of sqrt(v) 2^-v and v 2^-v. The sum of that over the blocks, by the
weights of their vectors, bounds what a decision is wrong by; `SLACK` stands for terms of the second order.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel, vectorised
from fwclass.model import KernelMachine

LENGTH = 128
"""Support vectors of a block."""

EIGHTH = LENGTH // 8

ROUNDINGS = 16.0
"""Of a weighted kernel, in units of 2^-24: 6 of the power of two, 1 of its weight, 9 of product and sum."""

SLACK = 1.05

PASSED = 2e-4
"""Largest part of a decision that is left out by passing over blocks. Margins lie at -1 and 1: some 0.1 % of the rows
are so near to zero that this makes them unsure."""

FARTHEST = np.float32(120.0)
"""Squared distance from which on a kernel counts as 2^-120: the exponent of float32 ends at -126."""

WIDEST, HEAVIEST = 1e4, 1e25
"""Lengths of vectors and sums of weights up to which the bound holds; a machine beyond is computed in float64 alone."""

PADDING = np.float32(1e3)
"""Coordinate of what fills a block up; its weight is 0."""

_C1, _C2, _C3 = np.float32(6.9314718e-1), np.float32(2.4022651e-1), np.float32(5.5504109e-2)
_C4, _C5, _C6 = np.float32(9.6181291e-3), np.float32(1.3333558e-3), np.float32(1.5403530e-4)
"""Of 2^f about 0: ln(2)^k / k!."""


@dataclass(frozen=True, eq=False)
class SupportBlocks:
    """A machine's support vectors for `decide_by_blocks`.

    Attributes
    ----------
    middle, scale : float64 (features,) and number: (prepared value - middle) * scale is what vectors and rows are in.
    vectors : float32 (blocks, features, LENGTH).
    weights : float32 (blocks, classes - 1, LENGTH), 0 where a block is filled up.
    low, high : float32 (blocks, features), the box of the block.
    beyond : float32 (blocks,), squared distance of the box from which on the block is passed over.
    heavy : float64 (blocks, classes - 1), sums of absolute weights.
    long : float64 (blocks,), greatest length of a vector.
    of : int64 (blocks,), index of the class.
    """

    middle: NDArray[np.float64]
    scale: float
    vectors: NDArray[np.float32]
    weights: NDArray[np.float32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    beyond: NDArray[np.float32]
    heavy: NDArray[np.float64]
    long: NDArray[np.float64]
    of: NDArray[np.int64]

    def __call__(
        self, ready: NDArray[np.float64], bias: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Decisions (rows, pairs) of prepared rows (rows, features), and bounds of their errors."""
        decisions, bound = np.empty((len(ready), len(bias))), np.empty((len(ready), len(bias)))
        with np.errstate(over="ignore"):  # so far away that no kernel reaches it
            x = np.ascontiguousarray((ready - self.middle) * self.scale, np.float32)
        boxes = (self.low, self.high, self.beyond, self.heavy, self.long, self.of)
        decide_by_blocks(x, self.vectors, self.weights, *boxes, bias, PASSED, decisions, bound)
        return decisions, bound


_laid_out: WeakKeyDictionary[KernelMachine, SupportBlocks | None] = WeakKeyDictionary()


def support_blocks(model: KernelMachine) -> SupportBlocks | None:
    """The blocks of a checked machine, made once; None for one that single precision cannot hold."""
    if model not in _laid_out:
        _laid_out[model] = _lay_out(model)
    return _laid_out[model]


def _lay_out(model: KernelMachine) -> SupportBlocks | None:
    gamma, rows = float(model.gamma[0]), len(model.vectors)
    with np.errstate(over="ignore", invalid="ignore"):
        middle = (model.vectors.min(axis=0) + model.vectors.max(axis=0)) / 2 if rows else np.zeros(len(model.features))
        scale = float(np.sqrt(gamma * np.log2(np.e)))
        placed = (model.vectors - middle) * scale
        length = np.sqrt((placed * placed).sum(axis=1))
        total = float(np.abs(model.dual).sum())
    if not (np.all(length <= WIDEST) and total <= HEAVIEST):
        return None
    ends = np.concatenate([[0], np.cumsum(model.counts)])
    runs = [(c, run) for c in range(len(model.counts)) for run in _compact(placed, np.arange(ends[c], ends[c + 1]))]
    n, features, pairs = len(runs), placed.shape[1], len(model.dual)
    vectors = np.full((n, features, LENGTH), PADDING, np.float32)
    weights = np.zeros((n, pairs, LENGTH), np.float32)
    low, high = np.empty((n, features), np.float32), np.empty((n, features), np.float32)
    heavy, long = np.empty((n, pairs)), np.empty(n)
    for b, (_, run) in enumerate(runs):
        vectors[b, :, : len(run)] = placed[run].T
        weights[b, :, : len(run)] = model.dual[:, run]
        low[b] = vectors[b, :, : len(run)].min(axis=1)
        high[b] = vectors[b, :, : len(run)].max(axis=1)
        heavy[b], long[b] = np.abs(model.dual[:, run]).sum(axis=1), length[run].max()
    most = heavy.max(axis=1, initial=0.0) * n / PASSED  # each block that is passed over adds at most PASSED / n
    beyond = np.minimum(np.log2(np.maximum(most, 1.0)), float(FARTHEST)).astype(np.float32)
    of = np.array([c for c, _ in runs], np.int64)
    return SupportBlocks(middle, scale, vectors, weights, low, high, beyond, heavy, long, of)


def _compact(placed: NDArray[np.float64], rows: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """`rows` in runs of at most `LENGTH` that lie near to each other: halved along the widest axis."""
    if len(rows) <= LENGTH:
        return [rows] if len(rows) else []
    blocks = -(-len(rows) // LENGTH)
    axis = int(np.ptp(placed[rows], axis=0).argmax())
    order = rows[np.argsort(placed[rows, axis], kind="stable")]
    half = blocks // 2 * LENGTH
    return _compact(placed, order[:half]) + _compact(placed, order[half:])


@kernel
def decide_by_blocks(  # type: ignore[no-untyped-def]
    x, vectors, weights, low, high, beyond, heavy, long, of, bias, passed, decisions, bound
):
    """Decisions and bounds of rows x, float32 (rows, features); see `SupportBlocks`."""
    blocks, features, _ = vectors.shape
    pairs = weights.shape[1]
    near = np.empty(LENGTH, np.float32)
    total, error = np.empty((pairs + 1, pairs)), np.empty((pairs + 1, pairs))
    ln2 = 0.6931471805599453
    for i in range(len(x)):
        total[:] = 0.0
        error[:] = 0.0
        row = x[i]
        for b in range(blocks):
            far = np.float32(0.0)
            for m in range(features):
                apart = max(max(low[b, m] - row[m], row[m] - high[b, m]), np.float32(0.0))
                far += apart * apart
            if far > beyond[b]:
                continue
            _kernels(row, vectors[b], near)
            d = float(far)
            root = np.sqrt(d)
            each = ROUNDINGS + 4.0 * ln2 * long[b] * (root + 0.5151) + ln2 * (features + 5) * (d + 0.5307)
            each *= np.exp(-ln2 * d) * SLACK / 16777216.0
            for q in range(pairs):
                total[of[b], q] += _weighted(weights[b, q], near)
                error[of[b], q] += heavy[b, q] * each
        pair = 0
        for c in range(pairs + 1):
            for other in range(c + 1, pairs + 1):
                decisions[i, pair] = total[c, other - 1] + total[other, c] + bias[pair]
                bound[i, pair] = error[c, other - 1] + error[other, c] + passed
                pair += 1


@vectorised
def _kernels(row, vectors, near):  # type: ignore[no-untyped-def]
    """near = 2^-t for the squared distances t of `row` and `vectors` (features, LENGTH)."""
    features = len(row)
    here, along = row[0], vectors[0]
    for s in range(LENGTH):
        apart = here - along[s]
        near[s] = apart * apart
    for m in range(1, features - 1, 2):  # two at a time: half as often through memory
        here, along, there, beside = row[m], vectors[m], row[m + 1], vectors[m + 1]
        for s in range(LENGTH):
            apart, off = here - along[s], there - beside[s]
            near[s] += apart * apart + off * off
    if features > 1 and features % 2 == 0:
        here, along = row[features - 1], vectors[features - 1]
        for s in range(LENGTH):
            apart = here - along[s]
            near[s] += apart * apart
    for s in range(LENGTH):
        t = near[s] if near[s] < FARTHEST else FARTHEST
        whole = np.int32(t + np.float32(0.5))
        f = np.float32(whole) - t
        power = _C6 * f + _C5
        power = power * f + _C4
        power = power * f + _C3
        power = power * f + _C2
        power = power * f + _C1
        power = power * f + np.float32(1.0)
        near[s] = power * np.int32((np.int32(127) - whole) << np.int32(23)).view(np.float32)


@vectorised
def _weighted(weights, near):  # type: ignore[no-untyped-def]
    """Sum of weights * near: of eight terms each in single precision, in whatever order, then in double."""
    total = 0.0
    for k in range(EIGHTH):
        some = weights[k] * near[k] + weights[k + EIGHTH] * near[k + EIGHTH]
        some += weights[k + 2 * EIGHTH] * near[k + 2 * EIGHTH] + weights[k + 3 * EIGHTH] * near[k + 3 * EIGHTH]
        some += weights[k + 4 * EIGHTH] * near[k + 4 * EIGHTH] + weights[k + 5 * EIGHTH] * near[k + 5 * EIGHTH]
        some += weights[k + 6 * EIGHTH] * near[k + 6 * EIGHTH] + weights[k + 7 * EIGHTH] * near[k + 7 * EIGHTH]
        total += float(some)
    return total
