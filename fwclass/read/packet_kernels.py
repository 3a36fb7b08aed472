"""Kernels over packet references: grouping returns into pulses, cutting spans, gathering samples."""

from __future__ import annotations

from fwclass.kernel import kernel


@kernel
def pulse_heads(keys, order, own, most, head):  # type: ignore[no-untyped-def]
    """For every point the first point of its pulse; `order` sorts `keys` stably.

    Points of key `own`, and of keys that more than `most` points share, are pulses of their own.
    """
    n = len(order)
    a = 0
    while a < n:
        key = keys[order[a]]
        b = a + 1
        while b < n and keys[order[b]] == key:
            b += 1
        alone = key == own or b - a > most
        for k in range(a, b):
            head[order[k]] = order[k] if alone else order[a]
        a = b


@kernel
def join_heads(head, link):  # type: ignore[no-untyped-def]
    """Make one pulse of the pulses of points i - 1 and i wherever ``link[i]``; heads stay the first points."""
    n = len(head)
    for i in range(1, n):
        if not link[i]:
            continue
        a, b = head[i - 1], head[i]
        while head[a] != a:
            a = head[a]
        while head[b] != b:
            b = head[b]
        head[max(a, b)] = min(a, b)
    for i in range(n):
        head[i] = head[head[i]]


@kernel
def join_segments(order, pulse, begin, lasts, spacing, saturation, slack, row, head, start, shift):  # type: ignore[no-untyped-def]
    """Rows of packets in `order` (by pulse and `begin`); see `fwclass.read.layout`. Gives the number of rows."""
    rows = 0
    origin, end = 0.0, 0.0
    for k in range(len(order)):
        p = order[k]
        q = order[k - 1] if k > 0 else p
        fresh = k == 0 or pulse[p] != pulse[q]
        if fresh:
            origin = begin[p]
        own = begin[p] - origin
        alike = not fresh and spacing[p] == spacing[q] and saturation[p] == saturation[q]
        if alike and abs(own - end) <= slack * spacing[p]:
            own = end
        else:
            head[rows] = p
            start[rows] = own
            rows += 1
        row[p] = rows - 1
        shift[p] = own
        end = own + lasts[p]
    return rows


@kernel
def crowded_keys(keys, order, own, most, crowded):  # type: ignore[no-untyped-def]
    """Keys other than `own` that more than `most` points share, into `crowded`; how many there are."""
    count, run = 0, 0
    for k in range(len(order)):
        key = keys[order[k]]
        run = run + 1 if k > 0 and keys[order[k - 1]] == key else 1
        if run == most + 1 and key != own:
            if count < len(crowded):
                crowded[count] = key
            count += 1
    return count


@kernel
def number_pulses(head, pulse):  # type: ignore[no-untyped-def]
    """Number pulses by first appearance into `pulse`; the count."""
    count = 0
    for i in range(len(head)):
        if head[i] == i:
            pulse[i] = count
            count += 1
        else:
            pulse[i] = pulse[head[i]]
    return count


@kernel
def cut_spans(head, reach, wanted, cuts):  # type: ignore[no-untyped-def]
    """Cut runs of at least `wanted` pulses where no pulse straddles; `cuts` rows are (first point, first pulse).

    `reach` is scratch: the last point of every pulse, at its head. Gives (rows written, pulses).
    """
    n = len(head)
    for i in range(n):
        reach[head[i]] = i
    rows, pulse, far = 0, 0, -1
    since = wanted
    for i in range(n):
        if since >= wanted and far < i:
            cuts[rows, 0], cuts[rows, 1] = i, pulse
            rows += 1
            since = 0
        if head[i] == i:
            pulse += 1
            since += 1
            far = max(far, reach[i])
    return rows, pulse


@kernel
def first_anchors(pulse, usable, return_number, anchor):  # type: ignore[no-untyped-def]
    """Per pulse the usable point of the lowest return number, the first in the file on a tie; -1 without one."""
    anchor[:] = -1
    for i in range(len(pulse)):
        if not usable[i]:
            continue
        best = anchor[pulse[i]]
        if best < 0 or return_number[i] < return_number[best]:
            anchor[pulse[i]] = i


@kernel
def gather(data, start, wide, offsets, samples):  # type: ignore[no-untyped-def]
    """Copy packet i, from byte ``start[i]`` of `data`, to ``samples[offsets[i]:offsets[i + 1]]``.

    `wide` says which packets hold two little-endian bytes a sample.
    """
    for i in range(len(start)):
        at, s = offsets[i], start[i]
        n = offsets[i + 1] - at
        if wide[i]:
            for k in range(n):
                samples[at + k] = int(data[s + 2 * k]) | (int(data[s + 2 * k + 1]) << 8)
        else:
            for k in range(n):
                samples[at + k] = data[s + k]
