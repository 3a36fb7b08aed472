"""Compressed PulseWaves (.plz with .wvz) of what `plsmaker` wrote, as PulseWaves' own compressor writes them. Shares
nothing with the reader.

>>> plz = compress(write_pls(tmp_path / "a.pls", pulses, descriptors), descriptors)
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from plsmaker import LAST, RETURNING, Descriptor, avlr, vlr
from wdzmaker import Coder, Differences, Frequencies

NONE = 1 << 31


def signed(value: int) -> int:
    return (value + NONE) % (2 * NONE) - NONE


def compress(
    path: Path,
    descriptors: Mapping[int, Descriptor],
    *,
    chunk: int | Sequence[int] = 50_000,
    source: int = 0,
    pulses: bool = True,
    waves: bool = True,
    piped: bool = False,
) -> Path:
    """Replace `path` and its .wvs by compressed ones; gives the Pulse file.

    Parameters
    ----------
    chunk : pulses of a chunk, or of each.
    source : bits of the number that stands behind every pulse, 0 for none; what is left are other bytes.
    pulses, waves : what is compressed.
    piped : the place of the table of chunks stands at the end.
    """
    raw, wvs = path.read_bytes(), path.with_suffix(".wvs").read_bytes()
    _, start, n, _, _, size, _ = struct.unpack_from("<HqqIIII", raw, 174)
    rows = [bytearray(raw[start + i * size : start + (i + 1) * size]) for i in range(n)]
    if waves:
        body = bytearray(wvs[:16] + struct.pack("<I", 1) + wvs[20:60])
        for row in rows:
            at, known = struct.unpack_from("<q", row, 8)[0], descriptors.get(row[44])
            if at and known:
                row[8:16] = struct.pack("<q", len(body))
                body += wave(wvs[at:], known)
        path.with_suffix(".wvz").write_bytes(body)
        path.with_suffix(".wvs").unlink()
    head = bytearray(raw[:start])
    tail = raw[start + n * size :]
    if not pulses:
        path.write_bytes(bytes(head) + b"".join(rows) + tail)
        return path
    items = [(1001, 48, 1), *([(1001 + source // 16, source // 8, 1)] if source else [])]
    if size > sum(i[1] for i in items):
        items.append((1000, size - sum(i[1] for i in items), 1))
    fixed = isinstance(chunk, int)
    record = struct.pack("<HHBBHIIH", 1, 0, 0, 0, 0, 0, chunk if fixed else 0xFFFFFFFF, len(items))
    head += vlr("PulseWaves_Spec", 5, record + b"".join(struct.pack("<3H", *i) for i in items))
    struct.pack_into("<q", head, 176, len(head))
    count = struct.unpack_from("<I", head, 216)[0]
    struct.pack_into("<I", head, 216, count + 1)
    sizes = [min(chunk, n - i) for i in range(0, n, chunk)] if fixed else list(chunk)
    blobs, at = [], 0
    for many in sizes:
        blobs.append(packed_pulses(rows[at : at + many], items))
        at += many
    place = len(head) + 8 + sum(map(len, blobs))
    table = struct.pack("<II", 0, len(blobs)) + (packed_table(sizes, blobs, fixed) if blobs else b"")
    where = struct.pack("<q", -1 if piped else place)
    end = struct.pack("<q", place) if piped else b""
    last = avlr("PulseWaves_Spec", LAST, b"") if not tail else b""
    out = path.with_suffix(".plz")
    out.write_bytes(bytes(head) + where + b"".join(blobs) + table + tail + end + last)
    path.unlink()
    return out


def packed_table(sizes: Sequence[int], blobs: Sequence[bytes], fixed: bool) -> bytes:
    coder = Coder()
    numbers = Differences(coder, 32, 2)
    before = (0, 0)
    for size, blob in zip(sizes, blobs, strict=True):
        if not fixed:
            numbers.put(before[0], size, 0)
        numbers.put(before[1], len(blob), 1)
        before = size, len(blob)
    return coder.done()


def wave(data: bytes, descriptor: Descriptor) -> bytes:
    """The waves of a pulse, which `data` begins with."""
    at, coder = descriptor.extra, Coder()
    counts = Differences(coder, 32)
    duration = length = 0
    for sampling in descriptor.samplings:
        segments = sampling.segments
        if sampling.segment_bits:
            wide = sampling.segment_bits // 8
            segments = int.from_bytes(data[at : at + wide], "little")
            counts.put(1, segments)
            at += wide
        for _ in range(segments):
            if sampling.duration_bits:
                wide = sampling.duration_bits // 8
                value = int.from_bytes(data[at : at + wide], "little", signed=True)
                counts.put(duration, value)
                duration, at = value, at + wide
            n = sampling.samples
            if sampling.length_bits:
                wide = sampling.length_bits // 8
                n = int.from_bytes(data[at : at + wide], "little")
                counts.put(length, n)
                length, at = n, at + wide
            wide, last = sampling.bits // 8, 0
            samples = Differences(coder, sampling.bits, 2)
            for _ in range(n):
                value = int.from_bytes(data[at : at + wide], "little")
                samples.put(last, value, int(sampling.kind != RETURNING))
                last, at = value, at + wide
    return data[: descriptor.extra] + coder.done()


class Contexts(dict):
    """Numbers of values as they come, 128 at most; the last value is behind the table, where 0 stands."""

    def __init__(self, last: int) -> None:
        self.last = last

    def of(self, key: int) -> int:
        return 0 if key == self.last else self.setdefault(key, len(self) % 128)


def packed_pulses(rows: Sequence[bytes], items: Sequence[tuple[int, int, int]]) -> bytes:
    """A chunk: its first pulse as it is, then the others, item by item."""
    if not rows:
        return b""
    coder = Coder()
    writers = []
    at = 0
    for kind, size, _ in items:
        writer = (extras, pulses, lambda *a: sources(16, *a), lambda *a: sources(32, *a))[kind - 1000]
        one = writer(coder, bytes(rows[0][at : at + size]))
        next(one)
        writers.append((one, at, size))
        at += size
    for row in rows[1:]:
        for one, at, size in writers:
            one.send(bytes(row[at : at + size]))
    return bytes(rows[0]) + coder.done()


def extras(coder: Coder, last: bytes) -> Iterator[None]:
    models = [Frequencies(256) for _ in last]
    while True:
        row = yield
        for k, value in enumerate(row):
            coder.symbol(models[k], (value - last[k]) % 256)
        last = row


def sources(bits: int, coder: Coder, first: bytes) -> Iterator[None]:
    table, oldest, last = list(range(bits)), 0, int.from_bytes(first, "little")
    model, new = Frequencies(bits + 2), Differences(coder, bits)
    while True:
        value = int.from_bytes((yield), "little")
        if value == last:
            coder.symbol(model, 0)
        elif value in table:
            coder.symbol(model, table.index(value) + 2)
        else:
            coder.symbol(model, 1)
            table[oldest], oldest = last, (oldest + 1) % bits
            new.put(last, value)
        last = value


FIELDS = "<qq6iHHBBBB"


def pulses(coder: Coder, first: bytes) -> Iterator[None]:
    symbols: dict[tuple, Frequencies] = {}

    def put(name: str, context: int, value: int, n: int = 256) -> None:
        coder.symbol(symbols.setdefault((name, context), Frequencies(n)), value)

    t, off = Differences(coder, 32, 9), Differences(coder, 32, 128)
    place = [Differences(coder, 32, 4) for _ in range(6)]
    samples = [Differences(coder, 16, 512) for _ in range(2)]
    bright = Differences(coder, 8, 256)
    known, scans, classes = Contexts(255), Contexts(65535), Contexts(65535)
    offsets: dict[int, int] = {}
    moves: list[dict[int, int]] = [{}, {}, {}]
    offset, move, context, mask, step, far = 0, [0, 0, 0], 0, 0, 0, 0
    last = struct.unpack(FIELDS, first)
    while True:
        row = struct.unpack(FIELDS, (yield))
        time, at, *xyz = row[:8]
        a, b, descriptor, scan, intensity, code = row[8:]
        last_a, last_b = last[8:10]
        around, moved = mask | context, int(mask != 0)
        guess = min(max(last_b - last_a + a, -(1 << 15)), (1 << 15) - 1)
        what = (
            8 * (descriptor != last[10])
            + 4 * (scan != last[11])
            + 2 * (intensity != last[12])
            + (code != last[13])
            + 32 * (a != last_a)
            + 16 * (b - a != last_b - last_a)
        )
        put("what", around, what, 64)
        if what & 8:
            put("descriptor", around, descriptor)
            context = known.of(descriptor)
            around = mask | context
        both = around
        if what & 4:
            put("scan", scans.of(around << 8 | last[11]), scan)
            mask, both, moved = 128, both | 256, moved | 2
        if what & 2:
            bright.put(last[12], intensity, context)
        if what & 1:
            put("class", classes.of(around << 8 | last[13]), code)
        if what & 32:
            samples[0].put(last_a, a, both)
        if what & 16:
            samples[1].put(guess, b, both)
        gap = time - last[0]
        fits = -NONE <= gap < NONE
        if step == 0:
            put("still", 0, 0 if gap == 0 else 1 if fits else 2, 3)
            if gap and fits:
                t.put(0, gap, 0)
                step, far = gap, 0
            elif gap:
                wide(coder, time)
        elif not fits:
            put("times", 0, 255)
            wide(coder, time)
        elif gap == step:
            put("times", 0, 254)
            far = 0
        else:
            many = times_in(gap, step)
            extreme = many == 0 or many >= 243 or many <= -10
            if many == 1:
                put("times", 0, 1)
                t.put(step, gap, 1)
                far = 0
            elif many > 0:
                put("times", 0, min(many, 243))
                times = min(many, 243)
                t.put(signed(times * step), gap, 2 if times < 10 else 3 if times < 243 else 4)
            elif many < 0:
                times = max(many, -10)
                put("times", 0, 243 - times)
                t.put(signed(times * step), gap, 5 if times > -10 else 6)
            else:
                put("times", 0, 0)
                t.put(0, gap, 7)
            if extreme:
                far += 1
                if far > 3:
                    step, far = gap, 0
        gap = at - last[1]
        expected = seen(offsets.get(context), offset)
        if -NONE < gap < NONE:
            off.put(expected, gap, context)
            offset = offsets[context] = gap
        else:
            off.put(expected, -NONE, context)
            wide(coder, at)
        for k in range(3):
            gap = signed(xyz[k] - last[2 + k])
            place[k].put(seen(moves[k].get(moved), move[k]), gap, moved)
            move[k] = moves[k][moved] = gap
        for k in range(3):
            place[3 + k].put(signed(last[5 + k] + move[k]), xyz[3 + k])
        last = row


def times_in(gap: int, step: int) -> int:
    """How many times, in single precision; what is beyond 32 bits becomes the least of them."""
    share = np.float32(gap) / np.float32(step)
    near = float(np.float32(share + np.float32(0.5 if share >= 0 else -0.5)))
    return int(near) if -NONE <= near < NONE else -NONE


def seen(value: int | None, otherwise: int) -> int:
    """The largest difference of 32 bits means none yet."""
    return otherwise if value in (None, NONE - 1) else value


def wide(coder: Coder, value: int) -> None:
    for k in range(4):
        coder.raw(value >> (16 * k) & 0xFFFF, 16)


WILD = {
    "time": [0, 1, 2, 5, 5, -7, 2**40, 2**40 + 3, 2**40 + 900, -(2**45), 0, 0, 2**31, 3 * 2**31],
    "place": [0, 2**31 - 1, -(2**31), 5, 5, 5, -1, 2**30, 17, 0, 0, -(2**31), 1, 2],
    "sample": [0, 40_000, 65_535, 1, 32_768, 32_767, 0, 0, 9, 9, 8, 60_000, 3, 2],
    "byte": [0, 255, 1, 1, 1, 7, 254, 0, 0, 3, 128, 128, 2, 9],
}


def wild_records(n: int, seed: int) -> np.ndarray:
    """Pulses of any values: runs that go on, leaps of more than 32 bits, fields that change or do not."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(n, np.dtype("<i8,<i8,(6,)<i4,(2,)<u2,(4,)u1"))
    for k, row in enumerate(rows):
        steady = rng.random() < 0.6 and k
        before = rows[k - 1] if k else row
        gap = rng.choice([0, 10, 10, 10, 20, 90, 2430, 3000, -10, -100, -300, 2**33])
        row["f0"] = before["f0"] + gap if steady else rng.choice(WILD["time"])
        row["f1"] = before["f1"] + rng.choice([80, 80, 120, -(2**31), 2**35]) if steady else rng.choice(WILD["time"])
        for j in range(6):
            leap = (int(before["f2"][j]) + int(rng.integers(-9, 9)) + 2**31) % 2**32 - 2**31
            row["f2"][j] = leap if steady else rng.choice(WILD["place"])
        row["f3"] = before["f3"] if steady and rng.random() < 0.5 else rng.choice(WILD["sample"], 2)
        changed = rng.random(4) < (0.2 if steady else 1.0)
        row["f4"] = np.where(changed, rng.integers(0, 256, 4), before["f4"])
    return rows
