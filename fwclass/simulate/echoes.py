"""The true echoes of a pulse: its hits, grouped as the best receiver of this pulse length could."""

from __future__ import annotations

import math

from fwclass.kernel import kernel


@kernel
def sort_hits(hits, time, energy, code):  # type: ignore[no-untyped-def]
    """Insertion sort of the first `hits` of `time` [samples] with their `energy` and `code`, in place."""
    for i in range(1, hits):
        t, e, c = time[i], energy[i], code[i]
        j = i - 1
        while j >= 0 and time[j] > t:
            time[j + 1], energy[j + 1], code[j + 1] = time[j], energy[j], code[j]
            j -= 1
        time[j + 1], energy[j + 1], code[j + 1] = t, e, c


@kernel
def peak(energy, variance, sigma):  # type: ignore[no-untyped-def]
    """Height [counts] of an echo of `energy` that is widened by the spread `variance` [samples²] of its hits; `sigma`
    [samples]."""
    return energy * sigma / math.sqrt(sigma * sigma + variance)


@kernel
def _copy(echo, source, target):  # type: ignore[no-untyped-def]
    for c in range(echo.shape[1]):
        echo[target, c] = echo[source, c]


@kernel
def _merge(echo, at, count):  # type: ignore[no-untyped-def]
    """Join echoes `at` and `at + 1`, keeping the first hit of the former; returns the new count."""
    t0, e0, v0 = echo[at, 0], echo[at, 1], echo[at, 2]
    t1, e1, v1 = echo[at + 1, 0], echo[at + 1, 1], echo[at + 1, 2]
    e = e0 + e1
    mean = (t0 * e0 + t1 * e1) / e
    echo[at, 0], echo[at, 1] = mean, e
    echo[at, 2] = (e0 * (v0 + (t0 - mean) ** 2) + e1 * (v1 + (t1 - mean) ** 2)) / e
    for k in range(at + 1, count - 1):
        _copy(echo, k + 1, k)
    return count - 1


@kernel
def _dominant(energy, code, first, last, totals):  # type: ignore[no-untyped-def]
    """Class with the largest energy among hits [first, last)."""
    for k in range(first, last):
        totals[code[k]] = 0.0
    best = code[first]
    for k in range(first, last):
        totals[code[k]] += energy[k]
    for k in range(first, last):
        if totals[code[k]] > totals[best]:
            best = code[k]
    return best


@kernel
def cluster(time, energy, code, hits, sigma, separation, visible, echo, echo_code, totals):  # type: ignore[no-untyped-def]
    """True echoes of sorted hits: (time, energy, variance, first hit) in `echo`, the class of most of
    the energy in `echo_code`; returns their number.

    Neighbouring clusters are joined, closest first, while they are closer than `separation` or while the weaker
    one does not rise above the flank of the stronger; what stays below `visible` is left out.
    """
    for k in range(hits):
        echo[k, 0], echo[k, 1], echo[k, 2], echo[k, 3] = time[k], energy[k], 0.0, k
    count = hits
    while count > 1:
        best, at = separation, -1
        for k in range(count - 1):
            gap = echo[k + 1, 0] - echo[k, 0]
            if gap < best:
                best, at = gap, k
        if at < 0:
            for k in range(count - 1):
                left, right = (peak(echo[k, 1], echo[k, 2], sigma), peak(echo[k + 1, 1], echo[k + 1, 2], sigma))
                spread = sigma * sigma + (echo[k, 2] if left > right else echo[k + 1, 2])
                gap = echo[k + 1, 0] - echo[k, 0]
                if min(left, right) < max(left, right) * math.exp(-0.5 * gap * gap / spread):
                    at = k
                    break
        if at < 0:
            break
        count = _merge(echo, at, count)
    used = 0
    for k in range(count):
        if peak(echo[k, 1], echo[k, 2], sigma) >= visible:
            last = int(echo[k + 1, 3]) if k + 1 < count else hits
            echo_code[used] = _dominant(energy, code, int(echo[k, 3]), last, totals)
            _copy(echo, k, used)
            used += 1
    return used
