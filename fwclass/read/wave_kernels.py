"""Kernels over the Waves file of PulseWaves: finding the segments of pulses."""

from __future__ import annotations

from fwclass.kernel import inlined, kernel

SOUND, NO_WAVES, PAST_END, CUT_SHORT, TOO_MANY, DAMAGED, UNREAD = 0, 1, 2, 3, 4, 5, 6
"""What walking the waves of a pulse ended in; `UNREAD`: more of the file is to be read first."""

EXTRA, FIRST, COUNT = 0, 1, 2
"""Columns of the descriptor table: extra bytes, first sampling, samplings."""

DURATION_BYTES, SEGMENT_BYTES, LENGTH_BYTES, SEGMENTS, SAMPLES, SAMPLE_BYTES = 0, 1, 2, 3, 4, 5
"""Columns of the sampling table."""

SEGMENT_COLUMNS = 5
"""Of the segments found: pulse, sampling, stored duration, samples, byte of the first sample."""


@inlined
def whole_number(data, at, length):  # type: ignore[no-untyped-def]
    """Unsigned little-endian number of `length` bytes."""
    value = 0
    for k in range(length):
        value |= int(data[at + k]) << (8 * k)
    return value


@inlined
def _short(to, end, size):  # type: ignore[no-untyped-def]
    """Whether what goes up to byte `to` ends behind the file's last, or what was read of it."""
    return CUT_SHORT if to > size else UNREAD if to > end else SOUND


@kernel
def find_segments(  # type: ignore[no-untyped-def]
    data, place, end, offset, size, descriptor, described, samplings, header, most, ends, reach, table
):
    """Find the segments of every pulse that have samples.

    `offset`, `descriptor` (n,): byte of the pulse's waves in the file of `size` bytes, and its row in `described` (-1:
    none). They are ``data[place[i]:end[i]]`` as far as they were read. `header` is the length of the file's header,
    `most` the segments a pulse may have. ``ends[i]`` becomes what the search in pulse i ended in, ``reach[i]`` the byte
    of the file up to which it has to be read. `table` (m, 5) receives the segments of the pulses that ended well; gives
    their number, whether or not they fit into `table`.
    """
    count = 0
    for i in range(len(offset)):
        before = count
        ends[i], reach[i] = NO_WAVES, 0
        d = descriptor[i]
        if d < 0 or offset[i] < header:
            continue
        if offset[i] >= size:
            ends[i] = PAST_END
            continue
        ends[i] = SOUND
        at, last = place[i] + described[d, EXTRA], size - offset[i] + place[i]
        to, seen = at, 0
        for m in range(described[d, FIRST], described[d, FIRST] + described[d, COUNT]):
            segments = samplings[m, SEGMENTS]
            if samplings[m, SEGMENT_BYTES] > 0:
                to = at + samplings[m, SEGMENT_BYTES]
                ends[i] = _short(to, end[i], last)
                if ends[i] != SOUND:
                    break
                segments = whole_number(data, at, samplings[m, SEGMENT_BYTES])
                at += samplings[m, SEGMENT_BYTES]
            seen += segments
            if seen > most:
                ends[i] = TOO_MANY
                break
            for _ in range(segments):
                to = at + samplings[m, DURATION_BYTES] + samplings[m, LENGTH_BYTES]
                ends[i] = _short(to, end[i], last)
                if ends[i] != SOUND:
                    break
                duration, wide = 0, samplings[m, DURATION_BYTES]
                if wide > 0:
                    duration = whole_number(data, at, wide)
                    if duration >= 1 << (8 * wide - 1):  # stored in two's complement
                        duration -= 1 << (8 * wide)
                    at += wide
                length = samplings[m, SAMPLES]
                if samplings[m, LENGTH_BYTES] > 0:
                    length = whole_number(data, at, samplings[m, LENGTH_BYTES])
                    at += samplings[m, LENGTH_BYTES]
                to = at + length * samplings[m, SAMPLE_BYTES]
                ends[i] = _short(to, end[i], last)
                if ends[i] != SOUND:
                    break
                if length > 0:
                    if count < len(table):
                        table[count, 0], table[count, 1], table[count, 2] = i, m, duration
                        table[count, 3], table[count, 4] = length, at
                    count += 1
                at += length * samplings[m, SAMPLE_BYTES]
            if ends[i] != SOUND:
                break
        reach[i] = to - place[i] + offset[i]
        if ends[i] != SOUND:
            count = before
    return count


@kernel
def clear_of_last(pulse, begin, end, slack, keep):  # type: ignore[no-untyped-def]
    """Which segments, sorted by pulse and begin, do not start before the end of the last one kept of their pulse."""
    last = -1
    for i in range(len(pulse)):
        keep[i] = last < 0 or pulse[i] != pulse[last] or begin[i] >= end[last] - slack[i]
        if keep[i]:
            last = i


@kernel
def gather_parted(data, first, length, second, offsets, samples):  # type: ignore[no-untyped-def]
    """Copy samples of 16 bits, ``length[i]`` bytes from byte ``first[i]`` of `data` on and the others from
    ``second[i]``, to ``samples[offsets[i]:offsets[i + 1]]``; rows of a negative length are left."""
    for i in range(len(first)):
        if length[i] < 0:
            continue
        for k in range(offsets[i + 1] - offsets[i]):
            value = 0
            for b in (2 * k, 2 * k + 1):
                at = first[i] + b if b < length[i] else second[i] + b - length[i]
                value |= int(data[at]) << (8 * (b - 2 * k))
            samples[offsets[i] + k] = value
