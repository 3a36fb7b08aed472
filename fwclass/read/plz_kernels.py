"""Kernels that unpack compressed PulseWaves: the table of chunks, pulses, and the waves of a pulse.

Every number is coded as what it is more than was expected, by models of the last pulses' changes. Source: M. Isenburg's
PulseWaves library, compressed items of version 1.
"""

from __future__ import annotations

import numpy as np

from fwclass.kernel import inlined, kernel
from fwclass.read.range_coder import begin, difference, forget, passed, position, raw, symbol
from fwclass.read.wave_kernels import (
    COUNT,
    CUT_SHORT,
    DAMAGED,
    DURATION_BYTES,
    EXTRA,
    FIRST,
    LENGTH_BYTES,
    NO_WAVES,
    PAST_END,
    SAMPLE_BYTES,
    SAMPLES,
    SEGMENT_BYTES,
    SEGMENTS,
    SOUND,
    TOO_MANY,
    UNREAD,
    whole_number,
)

EXTRA_BYTES, PULSE_0, SOURCE_16, SOURCE_32 = 1000, 1001, 1002, 1003
"""Items that a pulse consists of, as the file has them."""

_OVER = -1
"""What reading a pulse ends in where its waves take more bytes than there may be."""

_UNKNOWN = 0x7FFFFFFF
"""A difference that was not seen yet."""

_MULTI, _MULTI_MINUS = 243, -10
_UNCHANGED, _FULL = _MULTI - _MULTI_MINUS + 1, _MULTI - _MULTI_MINUS + 2
"""Times follow each other by the last difference times a number between these, or as the last did, or stand as they
are."""

_CONTEXTS = 128
_CHANGED_BEFORE, _CHANGED_NOW = 128, 256
"""Added to the context of a descriptor where scan line, direction or facet changed in the last pulse, in this one."""

_CHANGED, _DESCRIPTOR, _SCAN, _CLASS, _TIMES, _STILL = 0, 256, 512, 640, 768, 769
_TIME = 770
_OFFSET = _TIME + 9 + 33
_PLACE = _OFFSET + 128 + 33
_FIRST = _PLACE + 6 * (4 + 33)
_LAST = _FIRST + 512 + 17
_INTENSITY = _LAST + 512 + 17
_BEHIND = _INTENSITY + 256 + 9
_SOURCE = 1 + 1 + 33
MODELS, BITS = _BEHIND + 2 * _SOURCE, 13
"""Models of a pulse: the contexts of a number, then one for each number of its significant bits; each byte behind the
pulse adds one. And models of single bits, one for each number."""

TABLE_MODELS = 2 + 33

_EIGHT = 1 + 33
_SIXTEEN = _EIGHT + 2 + 9
WAVE_MODELS, WAVE_BITS = _SIXTEEN + 2 + 17, 3


@inlined
def _signed(value):  # type: ignore[no-untyped-def]
    """A number of 32 bits that may have run over."""
    return ((value + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)


@inlined
def _put(to, at, length, value):  # type: ignore[no-untyped-def]
    """Write a number of `length` bytes where there is room for it."""
    for k in range(length):
        if at + k < len(to):
            to[at + k] = (value >> (8 * k)) & 255


@kernel
def _whole(data, state):  # type: ignore[no-untyped-def]
    """64 bits as they are: four times 16, the lowest first."""
    value = raw(data, state, 16)
    value |= raw(data, state, 16) << 16
    value |= raw(data, state, 16) << 32
    top = raw(data, state, 16)
    return value | ((top - (1 << 16) if top >> 15 else top) << 48)


@inlined
def _stored(row, at):  # type: ignore[no-untyped-def]
    """A signed number of 64 bits."""
    return (_signed(whole_number(row, at + 4, 4)) << 32) | whole_number(row, at, 4)


@kernel
def unpack_table(data, state, counts, below, models, bits, at, end, variable, sizes, lengths):  # type: ignore[no-untyped-def]
    """Pulses of every chunk, where these are `variable`, and its bytes: numbers of one coder with two contexts."""
    forget(models, bits)
    begin(data, state, at, end)
    size = length = 0
    for i in range(len(lengths)):
        if variable:
            size = _signed(size + difference(data, state, counts, below, models, bits, 0, 2, 0, 32))
            sizes[i] = size
        length = _signed(length + difference(data, state, counts, below, models, bits, 1, 2, 0, 32))
        lengths[i] = length


@kernel
def _context(known, key, count):  # type: ignore[no-untyped-def]
    """The context of a value: they are numbered as they come, and begin anew after `_CONTEXTS`. The library's own table
    lacks the last value, and what it reads behind it is 0."""
    if key == len(known) - 1:
        return 0
    if known[key] < 0:
        known[key] = count[0] & (_CONTEXTS - 1)
        count[0] += 1
    return known[key]


@kernel
def _next_time(data, state, counts, below, models, bits, time, memory):  # type: ignore[no-untyped-def]
    """The next pulse's time; `memory` (2,): the last difference, and how many in a row were far from its multiples."""
    step = memory[0]
    if step == 0:
        kind = symbol(data, state, counts, below, models, _STILL, 3)
        if kind == 1:
            memory[0] = _signed(difference(data, state, counts, below, models, bits, _TIME, _TIME + 9, 0, 32))
            memory[1] = 0
            return time + memory[0]
        return _whole(data, state) if kind == 2 else time
    many = symbol(data, state, counts, below, models, _TIMES, _FULL + 1)
    if many == _FULL:
        return _whole(data, state)
    if many == _UNCHANGED:
        memory[1] = 0
        return time + step
    context, times, extreme = 3, many, False
    if many == 0:
        context, extreme = 7, True
    elif many == 1:
        context = 1
        memory[1] = 0
    elif many < 10:
        context = 2
    elif many == _MULTI:
        context, extreme = 4, True
    elif many > _MULTI:
        times = _MULTI - many
        context, extreme = (5, False) if times > _MULTI_MINUS else (6, True)
    more = difference(data, state, counts, below, models, bits, _TIME + context, _TIME + 9, 0, 32)
    gap = _signed(times * step + more)
    if extreme:
        memory[1] += 1
        if memory[1] > 3:
            memory[0], memory[1] = gap, 0
    return time + gap


@kernel
def _next_source(data, state, counts, below, models, bits, at, zero, width, row, model, table, oldest):  # type: ignore[no-untyped-def]
    """Write the number of the pulse's source at byte `at` of `row`: the last, a new one, or one of `table`."""
    length = width >> 3
    last = whole_number(row, at, length)
    code = symbol(data, state, counts, below, models, model, len(table) + 2)
    if code == 1:
        table[oldest[0]] = last
        oldest[0] = (oldest[0] + 1) % len(table)
        last += difference(data, state, counts, below, models, bits, model + 1, model + 2, zero, width)
    elif code != 0:
        last = table[code - 2]
    _put(row, at, length, last)


@kernel
def _next_place(data, state, counts, below, models, bits, scan, moves, move, place):  # type: ignore[no-untyped-def]
    """The next anchor and target, `place` (6,): as far from the last as pulses of the same `scan` were before, `moves`
    (4, 3), or any, `move` (3,)."""
    for k in range(3):
        c, wanted = _PLACE + k * 37, move[k] if moves[scan, k] == _UNKNOWN else moves[scan, k]
        move[k] = _signed(wanted + difference(data, state, counts, below, models, bits, c + scan, c + 4, 2 + k, 32))
        moves[scan, k] = move[k]
        place[k] = _signed(place[k] + move[k])
    for k in range(3, 6):
        c, wanted = _PLACE + k * 37, _signed(place[k] + move[k - 3])
        place[k] = _signed(wanted + difference(data, state, counts, below, models, bits, c, c + 4, 2 + k, 32))


@kernel
def _next_behind(data, state, counts, below, models, bits, items, row, narrow, wide, oldest):  # type: ignore[no-untyped-def]
    """What stands behind the next pulse, item by item, into `row`."""
    at = items[0, 1]
    for j in range(1, len(items)):
        if items[j, 0] == SOURCE_16:
            _next_source(data, state, counts, below, models, bits, at, 11, 16, row, _BEHIND, narrow, oldest[0:])
        elif items[j, 0] == SOURCE_32:
            c = _BEHIND + _SOURCE
            _next_source(data, state, counts, below, models, bits, at, 12, 32, row, c, wide, oldest[1:])
        else:
            for k in range(items[j, 1]):
                c = int(row[at + k]) + symbol(data, state, counts, below, models, MODELS + k, 256)
                row[at + k] = c & 255
        at += items[j, 1]


@kernel
def unpack_pulses(data, state, counts, below, models, bits, at, end, items, out):  # type: ignore[no-untyped-def]
    """Unpack the pulses of a chunk, `out` (n, bytes of a pulse); gives how many are whole.

    `items` (k, 2): kind and bytes of what a pulse consists of, the pulse itself first.
    """
    size = out.shape[1]
    if at + size > end or len(out) == 0:
        return 0
    row = np.empty(size, np.uint8)
    for k in range(size):
        row[k] = out[0, k] = data[at + k]
    if len(out) == 1:
        return 1
    forget(models, bits)
    begin(data, state, at + size, end)
    time, waves = _stored(row, 0), _stored(row, 8)
    place = np.empty(6, np.int64)
    for k in range(6):
        place[k] = _signed(whole_number(row, 16 + 4 * k, 4))
    first, last = whole_number(row, 40, 2), whole_number(row, 42, 2)
    known, scans, classes = np.full(256, -1), np.full(1 << 16, -1), np.full(1 << 16, -1)
    numbers, memory = np.zeros(3, np.int64), np.zeros(2, np.int64)
    offsets, offset = np.full(_CONTEXTS, _UNKNOWN), 0
    moves, move = np.full((4, 3), _UNKNOWN), np.zeros(3, np.int64)
    narrow, wide, oldest = np.arange(16), np.arange(32), np.zeros(2, np.int64)
    context = before = 0
    for i in range(1, len(out)):
        around, length = before | context, last - first
        scan = 1 if before else 0
        what = symbol(data, state, counts, below, models, _CHANGED + around, 64)
        if what & 8:
            row[44] = symbol(data, state, counts, below, models, _DESCRIPTOR + around, 256)
            context = _context(known, int(row[44]), numbers[0:])
            around = before | context
        both = around
        if what & 4:
            near = _context(scans, (around << 8) | int(row[45]), numbers[1:])
            row[45] = symbol(data, state, counts, below, models, _SCAN + near, 256)
            before = _CHANGED_BEFORE
            both |= _CHANGED_NOW
            scan |= 2
        if what & 2:
            c = _INTENSITY + context
            more = difference(data, state, counts, below, models, bits, c, _INTENSITY + 256, 10, 8)
            row[46] = (int(row[46]) + more) & 255
        if what & 1:
            near = _context(classes, (around << 8) | int(row[47]), numbers[2:])
            row[47] = symbol(data, state, counts, below, models, _CLASS + near, 256)
        if what & 32:
            first += difference(data, state, counts, below, models, bits, _FIRST + both, _FIRST + 512, 8, 16)
            first &= 0xFFFF
        if what:
            last = length + first
            if what & 16:
                last = min(max(last, -(1 << 15)), (1 << 15) - 1)
                last += difference(data, state, counts, below, models, bits, _LAST + both, _LAST + 512, 9, 16)
            last &= 0xFFFF
        time = _next_time(data, state, counts, below, models, bits, time, memory)
        wanted = offset if offsets[context] == _UNKNOWN else offsets[context]
        more = difference(data, state, counts, below, models, bits, _OFFSET + context, _OFFSET + 128, 1, 32)
        more = _signed(wanted + more)
        if more == -(1 << 31):  # too far: the place itself, though the library's own reader adds it
            waves = _whole(data, state)
        else:
            offset = offsets[context] = more
            waves += more
        _next_place(data, state, counts, below, models, bits, scan, moves, move, place)
        _next_behind(data, state, counts, below, models, bits, items, row, narrow, wide, oldest)
        if passed(state):
            return i
        _put(row, 0, 8, time)
        _put(row, 8, 8, waves)
        for k in range(6):
            _put(row, 16 + 4 * k, 4, place[k])
        _put(row, 40, 2, first)
        _put(row, 42, 2, last)
        out[i] = row
    return len(out)


@kernel
def _unpack_segments(  # type: ignore[no-untyped-def]
    data, state, counts, below, models, bits, described, samplings, returning, most, limit, short, to, out
):
    """Unpack the segments of one pulse of the descriptor `described` into `out`, from byte `to` on; the byte behind
    them, and what reading them ended in: `_OVER` where they need more than `limit` bytes, `short` where data end."""
    duration = length = seen = 0
    for m in range(described[FIRST], described[FIRST] + described[COUNT]):
        wide, counted = samplings[m, DURATION_BYTES], samplings[m, SEGMENT_BYTES]
        segments = samplings[m, SEGMENTS]
        if counted > 0:
            segments = 1 + difference(data, state, counts, below, models, bits, 0, 1, 0, 32)
            if not 0 <= segments < 1 << (8 * counted):
                return to, DAMAGED
            _put(out, to, counted, segments)
            to += counted
        seen += segments
        if seen > most:
            return to, TOO_MANY
        for _ in range(segments):
            if wide > 0:
                duration = _signed(duration + difference(data, state, counts, below, models, bits, 0, 1, 0, 32))
                _put(out, to, wide, duration)
                to += wide
            n = samplings[m, SAMPLES]
            if samplings[m, LENGTH_BYTES] > 0:
                n = length = _signed(length + difference(data, state, counts, below, models, bits, 0, 1, 0, 32))
                if not 0 <= n < 1 << (8 * samplings[m, LENGTH_BYTES]):
                    return to, DAMAGED
                _put(out, to, samplings[m, LENGTH_BYTES], n)
                to += samplings[m, LENGTH_BYTES]
            if to + n * samplings[m, SAMPLE_BYTES] > limit:
                return to, UNREAD if passed(state) and short == UNREAD else _OVER
            to = _unpack_samples(
                data, state, counts, below, models, bits, n, samplings[m, SAMPLE_BYTES], returning[m], to, out
            )
            if passed(state):
                return to, short
    return to, SOUND


@kernel
def unpack_waves(  # type: ignore[no-untyped-def]
    data,
    state,
    counts,
    below,
    models,
    bits,
    place,
    end,
    offset,
    size,
    descriptor,
    described,
    samplings,
    returning,
    header,
    most,
    limit,
    ends,
    start,
    stop,
    out,
):
    """Unpack the waves of every pulse into `out`, laid out as in a Waves file from byte `header` on.

    `offset` (n,): byte of the pulse's waves in the file of `size` bytes; they are ``data[place[i]:end[i]]`` as far as
    they were read. ``start[i]`` becomes the byte where those of pulse i begin, ``ends[i]`` what reading them ended in,
    ``stop[i]`` the byte of the file behind them. Gives the bytes that all need, whether or not `out` holds them;
    ``limit + 1`` where that is more than `limit`, and nothing else is right then.
    """
    total = header
    for i in range(len(offset)):
        start[i], stop[i], ends[i] = total, 0, NO_WAVES
        d = descriptor[i]
        if d < 0 or offset[i] < header:
            continue
        at, last = place[i] + described[d, EXTRA], size - offset[i] + place[i]
        short = CUT_SHORT if end[i] == last else UNREAD
        if offset[i] >= size or at + 4 > end[i]:
            ends[i] = PAST_END if offset[i] >= size else short
            continue
        to = total
        for k in range(described[d, EXTRA]):
            _put(out, to, 1, data[place[i] + k])
            to += 1
        forget(models[:_EIGHT], bits[:1])
        begin(data, state, at, end[i])
        to, ended = _unpack_segments(
            data, state, counts, below, models, bits, described[d], samplings, returning, most, limit, short, to, out
        )
        if ended == _OVER:
            return limit + 1
        ends[i] = short if passed(state) else ended
        if ends[i] == SOUND:
            total, stop[i] = to, position(state) - place[i] + offset[i]
    return total


@kernel
def _unpack_samples(data, state, counts, below, models, bits, n, length, returning, to, out):  # type: ignore[no-untyped-def]
    """Differences of neighbours, by models that know nothing yet; those of outgoing pulses are another context."""
    c, width, zero = (_EIGHT, 8, 1) if length == 1 else (_SIXTEEN, 16, 2)
    forget(models[c : c + width + 3], bits[zero : zero + 1])
    value, context = 0, c if returning else c + 1
    for _ in range(n):
        value += difference(data, state, counts, below, models, bits, context, c + 2, zero, width)
        value &= (1 << width) - 1
        _put(out, to, length, value)
        to += length
        if passed(state):
            break
    return to
