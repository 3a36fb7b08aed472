"""Cells that hang together, the rings around them, which of their corners stay, and whether rings meet."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel


@kernel
def mark_corners(line, stays, tolerance):  # type: ignore[no-untyped-def]
    """Mark the corners of a line that no more than `tolerance` is lost of without the others.

    Parameters
    ----------
    line : float64 (corners, 2), in some unit.
    stays : bool (corners,); the corners between two that stay are looked at, and more are set.
    tolerance : distance of a corner from the line through those that stay, in the same unit.

    Source: Douglas and Peucker 1973.
    """
    pending = np.empty((len(line) + 1, 2), np.int64)
    count, last = 0, 0
    for k in range(1, len(line)):
        if stays[k]:
            pending[count] = last, k
            count += 1
            last = k
    while count:
        count -= 1
        a, b = pending[count]
        ax, ay = line[b, 0] - line[a, 0], line[b, 1] - line[a, 1]
        length = math.hypot(ax, ay)
        worst, most = -1, tolerance
        for k in range(a + 1, b):
            x, y = line[k, 0] - line[a, 0], line[k, 1] - line[a, 1]
            if length > 0.0:
                share = min(max((x * ax + y * ay) / (length * length), 0.0), 1.0)
                x -= share * ax
                y -= share * ay
            off = math.hypot(x, y)
            if off > most:
                worst, most = k, off
        if worst >= 0:
            stays[worst] = True
            pending[count] = a, worst
            pending[count + 1] = worst, b
            count += 2


@kernel
def kept_corners(ring, tolerance):  # type: ignore[no-untyped-def]
    """bool (corners,): the corners of a `ring`, float64 (corners, 2), that `outline.simplify` keeps."""
    number, x, y = len(ring), 0.0, 0.0
    for k in range(number):
        x += ring[k, 0]
        y += ring[k, 1]
    begin = _furthest(ring, x / number, y / number)
    line = np.empty((number + 1, 2))
    for k in range(number + 1):
        for axis in range(2):
            line[k, axis] = ring[(begin + k) % number, axis]
    stays = np.zeros(number + 1, np.bool_)
    stays[0] = stays[number] = stays[_furthest(line, line[0, 0], line[0, 1])] = True
    mark_corners(line, stays, tolerance)
    kept = np.empty(number, np.bool_)
    for k in range(number):
        kept[(begin + k) % number] = stays[k]
    return kept


@kernel
def _furthest(ring, x, y):  # type: ignore[no-untyped-def]
    """Index of the corner of a `ring`, float64 (corners, 2), furthest from (x, y); the first of equal ones."""
    furthest, most = 0, -1.0
    for k in range(len(ring)):
        off = (ring[k, 0] - x) ** 2 + (ring[k, 1] - y) ** 2
        if off > most:
            furthest, most = k, off
    return furthest


@kernel
def cells_around(labels, seen, cells, row, col):  # type: ignore[no-untyped-def]
    """Find the cells that hang together with one, by sides and corners, and have its label.

    Parameters
    ----------
    labels : int32 (rows, columns).
    seen : bool (rows, columns); those of the label are not looked at, and cells that are met are set.
    cells : int64 (cells, 2), as many as may be met: row and column of each are written to it.
    row, col : of the one.

    Returns
    -------
    How many there are.
    """
    cells[0, 0], cells[0, 1] = row, col
    seen[row, col] = True
    first, number = 0, 1
    while first < number:
        r0, c0 = cells[first, 0], cells[first, 1]
        first += 1
        for r in range(max(0, r0 - 1), min(labels.shape[0], r0 + 2)):
            for c in range(max(0, c0 - 1), min(labels.shape[1], c0 + 2)):
                if labels[r, c] == labels[row, col] and not seen[r, c]:
                    seen[r, c] = True
                    cells[number, 0], cells[number, 1] = r, c
                    number += 1
    return number


@kernel
def fill_small(mask, least):  # type: ignore[no-untyped-def]
    """Fill holes of fewer than `least` cells of a `mask`, bool (rows, columns) with an empty margin."""
    seen = mask.copy()
    cells = np.empty((mask.size, 2), np.int64)
    for row in range(mask.shape[0]):
        for col in range(mask.shape[1]):
            if seen[row, col]:
                continue
            cells[0, 0], cells[0, 1] = row, col
            seen[row, col] = True
            first, number = 0, 1
            while first < number:
                r0, c0 = cells[first, 0], cells[first, 1]
                first += 1
                for k in range(4):
                    r, c = r0 + (k == 0) - (k == 1), c0 + (k == 2) - (k == 3)
                    if 0 <= r < mask.shape[0] and 0 <= c < mask.shape[1] and not seen[r, c]:
                        seen[r, c] = True
                        cells[number, 0], cells[number, 1] = r, c
                        number += 1
            if number < least and row + col > 0:  # the margin comes first
                for k in range(number):
                    mask[cells[k, 0], cells[k, 1]] = True


@kernel
def join_corners(mask):  # type: ignore[no-untyped-def]
    """Join cells of a `mask`, bool (rows, columns), that touch by a corner alone, by a third in the row south of it,
    until there are none."""
    joined = True
    while joined:
        joined, before = False, mask.copy()
        for r in range(mask.shape[0] - 1):
            for c in range(mask.shape[1] - 1):
                a, b = before[r, c], before[r, c + 1]
                if a != b and a == before[r + 1, c + 1] and b == before[r + 1, c]:
                    mask[r, c] = mask[r, c + 1] = joined = True


@kernel
def trace_rings(mask):  # type: ignore[no-untyped-def]
    """Corners, int64 (corners, 2), column and row, of the rings around the cells of a `mask`, bool (rows, columns) with
    an empty margin, whose cells touch by no corner alone, and of its holes; and int64 (rings + 1,), where each begins.

    A ring runs with the cells on its left from its corner of least column and row; rings come in that order.
    """
    side = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), np.int8)  # where a ring goes on to, by its corner
    number = 0
    for r in range(1, mask.shape[0] - 1):
        for c in range(1, mask.shape[1] - 1):
            if mask[r, c]:
                for way in range(1, 5):
                    down, right = (way == 3) - (way == 1), (way == 2) - (way == 4)
                    if not mask[r + down, c + right]:
                        side[r + (way > 2), c + (way == 2 or way == 3)] = way
                        number += 1
    corners, first = np.empty((number, 2), np.int64), np.empty(number // 4 + 1, np.int64)
    count, some = 0, 0
    for col in range(side.shape[1]):
        for row in range(side.shape[0]):
            if side[row, col]:
                first[some] = count
                some += 1
                r, c = row, col
                while side[r, c]:
                    corners[count, 0], corners[count, 1] = c, r
                    count += 1
                    way = side[r, c]
                    side[r, c] = 0
                    if way == 1 or way == 3:
                        c += 2 - way
                    else:
                        r += 3 - way
    first[some] = count
    return corners, first[: some + 1]


@kernel
def edges_meet(begin, ahead):  # type: ignore[no-untyped-def]
    """Whether two edges that are no neighbours share a point, or two neighbours run back over each other.

    Parameters
    ----------
    begin : float64 (edges, 2), the corners that they begin at.
    ahead : int64 (edges,), the one that each goes on with.
    """
    for i in range(len(begin)):
        k = ahead[i]
        x, y = begin[k, 0] - begin[i, 0], begin[k, 1] - begin[i, 1]
        x1, y1 = begin[ahead[k], 0] - begin[k, 0], begin[ahead[k], 1] - begin[k, 1]
        if x * y1 == y * x1 and x * x1 + y * y1 <= 0.0:
            return True
        for j in range(i):
            m = ahead[j]
            apart = k == j or m == i or not _boxes_meet(begin, i, k, j, m)
            if not apart and _ends_aside(begin, i, k, j, m) and _ends_aside(begin, j, m, i, k):
                return True
    return False


@kernel
def _boxes_meet(corners, a, b, c, d):  # type: ignore[no-untyped-def]
    """Whether the boxes around two edges share a point: from corner a to b and from c to d."""
    for axis in range(2):
        one, other = corners[a, axis], corners[b, axis]
        third, last = corners[c, axis], corners[d, axis]
        if max(one, other) < min(third, last) or max(third, last) < min(one, other):
            return False
    return True


@kernel
def _ends_aside(corners, a, b, c, d):  # type: ignore[no-untyped-def]
    """Whether corners c and d do not lie on the same side of the line from a to b."""
    x, y = corners[b, 0] - corners[a, 0], corners[b, 1] - corners[a, 1]
    one = x * (corners[c, 1] - corners[a, 1]) - y * (corners[c, 0] - corners[a, 0])
    other = x * (corners[d, 1] - corners[a, 1]) - y * (corners[d, 0] - corners[a, 0])
    return (one <= 0.0 or other <= 0.0) and (one >= 0.0 or other >= 0.0)


@kernel
def crown_outline(cells):  # type: ignore[no-untyped-def]
    """float64 (corners, 2), column and row: the outline of `cells`, int64 (cells, 2), row and column, that hang
    together, without holes, simplified by a cell where it does not meet itself then."""
    low_r, low_c, high_r, high_c = cells[0, 0], cells[0, 1], cells[0, 0], cells[0, 1]
    for k in range(len(cells)):
        low_r, high_r = min(low_r, cells[k, 0]), max(high_r, cells[k, 0])
        low_c, high_c = min(low_c, cells[k, 1]), max(high_c, cells[k, 1])
    mask = np.zeros((high_r - low_r + 3, high_c - low_c + 3), np.bool_)
    for k in range(len(cells)):
        mask[cells[k, 0] - low_r + 1, cells[k, 1] - low_c + 1] = True
    fill_small(mask, mask.size)
    join_corners(mask)
    corners, first = trace_rings(mask)
    most, largest = 0.0, 0
    for k in range(len(first) - 1):
        size = abs(twice_area(corners, first[k], first[k + 1]))
        if size > most:
            most, largest = size, k
    ring = _chosen(corners, first[largest], np.ones(first[largest + 1] - first[largest], np.bool_))
    plain = _chosen(ring, 0, kept_corners(ring, 1.0))
    ahead = np.empty(len(plain), np.int64)
    for k in range(len(plain)):
        ahead[k] = (k + 1) % len(plain)
    if len(plain) < 3 or twice_area(plain, 0, len(plain)) <= 0.0 or edges_meet(plain, ahead):
        turns = np.empty(len(ring), np.bool_)
        for k in range(len(ring)):
            after = (k + 1) % len(ring)
            x, y = ring[after, 0] - ring[k, 0], ring[after, 1] - ring[k, 1]
            turns[k] = x * (ring[k, 1] - ring[k - 1, 1]) != y * (ring[k, 0] - ring[k - 1, 0])
        plain = _chosen(ring, 0, turns)
    for k in range(len(plain)):
        plain[k, 0] += low_c - 1
        plain[k, 1] += low_r - 1
    return plain


@kernel
def _chosen(corners, first, which):  # type: ignore[no-untyped-def]
    """float64 (chosen, 2): the corners, int64 or float64, from `first` on that `which`, bool (corners,), chooses."""
    number = 0
    for k in range(len(which)):
        number += which[k]
    out, number = np.empty((number, 2)), 0
    for k in range(len(which)):
        if which[k]:
            out[number, 0], out[number, 1] = corners[first + k, 0], corners[first + k, 1]
            number += 1
    return out


@kernel
def twice_area(corners, first, last):  # type: ignore[no-untyped-def]
    """Twice the signed area of the ring of `corners`, (corners, 2) in some unit, from row `first` to before `last`, in
    its square; positive where the ring runs counterclockwise."""
    total = 0.0
    for k in range(first, last):
        before = k - 1 if k > first else last - 1
        total += corners[before, 0] * corners[k, 1] - corners[before, 1] * corners[k, 0]
    return total
