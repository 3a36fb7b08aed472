"""Small PulseWaves files (.pls with .wvs), byte by byte, for tests: independent of the reader.

>>> truth = survey(tmp_path / "a.pls", pulses=50)
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from lasmaker import METRES_PER_NS, UTM33, digitise, gaussian
from numpy.typing import ArrayLike, NDArray

OUTGOING, RETURNING = 1, 2
LAST = 0xFFFFFFFF


@dataclass
class Sampling:
    """How a part of a pulse is sampled; a bit count of 0 means a fixed number of segments or samples."""

    kind: int = RETURNING
    channel: int = 0
    bits: int = 8
    spacing: float = 1.0
    duration_bits: int = 32
    scale: float = 1.0
    offset: float = 0.0
    segment_bits: int = 8
    length_bits: int = 16
    segments: int = 0
    samples: int = 0
    table: int = 0
    compression: int = 0
    padding: int = 0

    def pack(self) -> bytes:
        """104 bytes, and `padding` that a later version may put before the description."""
        return (
            struct.pack("<IIBBBB", 104 + self.padding, 0, self.kind, self.channel, 0, self.duration_bits)
            + struct.pack("<ffBBH", self.scale, self.offset, self.segment_bits, self.length_bits, self.segments)
            + struct.pack("<IHHfI", self.samples, self.bits, self.table, self.spacing, self.compression)
            + bytes(self.padding + 64)
        )


@dataclass
class Descriptor:
    """A pulse descriptor; `unit` [ns] is what durations and the target are counted in."""

    samplings: Sequence[Sampling] = field(default_factory=lambda: [Sampling()])
    unit: float = 1.0
    centre: int = 0
    extra: int = 0
    tail: tuple[int, int] = (0, 1)
    padding: int = 0

    def pack(self) -> bytes:
        head = struct.pack(
            "<IIIHHf", 92 + self.padding, 0, self.centre & 0xFFFFFFFF, self.extra, len(self.samplings), self.unit
        )
        return (
            head
            + struct.pack("<II", *self.tail)
            + bytes(self.padding + 64)
            + b"".join(s.pack() for s in self.samplings)
        )


@dataclass
class Pulse:
    """A pulse: anchor [m], direction away from the sensor (any length), and per sampling its segments as
    (begin after the anchor [ns], samples)."""

    anchor: ArrayLike
    away: ArrayLike
    waves: Sequence[Sequence[tuple[float, ArrayLike]]]
    time: float = 1000.0
    descriptor: int = 1
    speed: float = METRES_PER_NS


def vlr(user: str, number: int, body: bytes) -> bytes:
    return struct.pack("<16sIIq64s", user.encode(), number, 0, len(body), b"") + body


def avlr(user: str, number: int, body: bytes) -> bytes:
    return body + struct.pack("<16sIIq64s", user.encode(), number, 0, len(body), b"")


def geo_keys(keys: Mapping[int, int]) -> bytes:
    rows = [(1, 1, 0, len(keys)), *((k, 0, 1, v) for k, v in sorted(keys.items()))]
    return np.array(rows, "<u2").tobytes()


def _waves(pulse: Pulse, descriptor: Descriptor) -> bytes:
    out = [b"\xee" * descriptor.extra]
    for sampling, segments in zip(descriptor.samplings, pulse.waves, strict=True):
        if sampling.segment_bits:
            out.append(len(segments).to_bytes(sampling.segment_bits // 8, "little"))
        for begin, samples in segments:
            if sampling.duration_bits:
                stored = round((begin / descriptor.unit - sampling.offset) / sampling.scale)
                out.append(stored.to_bytes(sampling.duration_bits // 8, "little", signed=True))
            if sampling.length_bits:
                out.append(len(np.asarray(samples)).to_bytes(sampling.length_bits // 8, "little"))
            out.append(np.asarray(samples, "<u2" if sampling.bits > 8 else "u1").tobytes())
    return b"".join(out)


def _returning(pulse: Pulse, descriptor: Descriptor) -> list[float]:
    """Times of the first and last returning samples [ns]."""
    found = []
    for sampling, segments in zip(descriptor.samplings, pulse.waves, strict=True):
        for begin, samples in segments if sampling.kind == RETURNING else []:
            found += [begin, begin + (len(np.asarray(samples)) - 1) * sampling.spacing]
    return found


def write_pls(
    path: str | Path,
    pulses: Sequence[Pulse],
    descriptors: Mapping[int, Descriptor] | None = None,
    *,
    scale: float = 0.001,
    time_scale: float = 1e-6,
    time_offset: float = 0.0,
    keys: Mapping[int, int] | None = UTM33,
    version: tuple[int, int] = (0, 3),
    extra_bytes: int = 0,
    appended: int | None = None,
    compression: int = 0,
    waves_compression: int = 0,
) -> Path:
    """Write a Pulse file and the Waves file beside it.

    Parameters
    ----------
    extra_bytes : bytes behind every pulse.
    appended : None puts the descriptors before the pulses; a number puts them behind, and is stated as how many
        records are appended (-1: unknown).
    """
    path, descriptors = Path(path), descriptors or {1: Descriptor()}
    anchors = np.array([p.anchor for p in pulses], float).reshape(-1, 3)
    offset = np.floor(anchors.min(axis=0)) if len(pulses) else np.zeros(3)
    rows, blobs, at = [], [], 60
    ends: list[NDArray] = []
    for p, anchor in zip(pulses, anchors, strict=True):
        known = descriptors.get(p.descriptor)
        unit = known.unit if known else 1.0
        away = np.asarray(p.away, float)
        away = away / np.linalg.norm(away) * p.speed
        target = anchor + away * unit * 1000
        times = _returning(p, known) if known else []
        ends += [anchor + t * away for t in times]
        first, last = (round(f(times) / unit) % 32768 for f in (min, max)) if times else (0, 0)
        blob = _waves(p, known) if known else b""
        whole = [round(v) for v in (*(anchor - offset) / scale, *(target - offset) / scale)]
        stamp = round((p.time - time_offset) / time_scale)
        rows.append(struct.pack("<qq6ihhHBB", stamp, at if blob else 0, *whole, first, last, p.descriptor, 7, 0))
        rows.append(b"\xdd" * extra_bytes)
        blobs.append(blob)
        at += len(blob)
    described = [("PulseWaves_Spec", 200_000 + i, d.pack()) for i, d in descriptors.items()]
    scanner = struct.pack("<II64s64s", 248, 0, b"scanner", b"1") + bytes(48 + 64)
    front = [("PulseWaves_Spec", 100_001, scanner)]
    front += [("PulseWaves_Proj", 34735, geo_keys(keys))] if keys else []
    front += described if appended is None else []
    vlrs = b"".join(vlr(*r) for r in front)
    tail = b""
    if appended is not None:
        tail = avlr("PulseWaves_Spec", LAST, b"") + b"".join(avlr(*r) for r in described)
    low, high = (np.min(ends, axis=0), np.max(ends, axis=0)) if ends else (np.zeros(3), np.zeros(3))
    head = struct.pack(
        "<16sII16s64s64sHHBBH", b"PulseWavesPulse", 0, 1, b"", b"maker", b"plsmaker", 1, 2026, *version, 352
    )
    head += struct.pack(
        "<qqIIIIqIi", 352 + len(vlrs), len(pulses), 0, 0, 48 + extra_bytes, compression, 0, len(front), appended or 0
    )
    head += struct.pack("<ddqq3d3d", time_scale, time_offset, 0, 0, scale, scale, scale, *offset)
    head += struct.pack("<6d", low[0], high[0], low[1], high[1], low[2], high[2])
    path.write_bytes(head + vlrs + b"".join(rows) + tail)
    waves = struct.pack("<16sI40s", b"PulseWavesWaves", waves_compression, b"")
    path.with_suffix(".wvs").write_bytes(waves + b"".join(blobs))
    return path


@dataclass
class Truth:
    """What `survey` put into its file: per echo pulse, amplitude [DN], two-way time after the outgoing pulse's peak
    [ns], FWHM [ns], place (n, 3) [m]; per pulse the time of the outgoing peak after the anchor [ns]."""

    path: Path
    pulse: NDArray
    amplitude: NDArray
    time: NDArray
    width: NDArray
    xyz: NDArray
    outgoing: NDArray
    pulses: list[Pulse]


def survey(
    path: str | Path,
    pulses: int = 50,
    seed: int = 0,
    noise: float = 1.0,
    bits: int = 8,
    spacing: float = 1.0,
    height: float = 600.0,
    jitter: float = 0.3,
    pulse_width: float = 3.5,
    two_segments: float = 0.3,
    **options,
) -> Truth:
    """Pulses from a sensor `height` above flat ground, with the outgoing pulse, whose peak is up to `jitter` [ns] off
    its place; a share of `two_segments` of the pulses has a second echo in a segment of its own, 60 m higher."""
    rng = np.random.default_rng(seed)
    rows: dict[str, list] = {k: [] for k in ("pulse", "a", "t", "w", "xyz")}
    made, peaks = [], []
    lead, n = 20.0, 60
    for p in range(pulses):
        anchor = np.round([500000.0 + 0.5 * p, 5400000.0 + rng.uniform(0, 1), 200.0 + height], 3)
        away = np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), -1.0])
        away /= np.linalg.norm(away)
        peak = 8.0 + rng.uniform(-jitter, jitter)
        outgoing = gaussian(20, [(180.0, peak, pulse_width)], 10.0, spacing) + rng.normal(0, noise, 20)
        ground = height / -away[2] / METRES_PER_NS
        times = [ground - 400.0, ground] if rng.uniform() < two_segments else [ground]
        segments = []
        for t in times:
            a, w = rng.uniform(60, 200), pulse_width * rng.uniform(1.0, 1.15)
            begin = np.floor(t - lead)
            y = gaussian(n, [(a, t + peak - 8.0 - begin, w)], 10.0, spacing) + rng.normal(0, noise, n)
            segments.append((begin, digitise(y, bits)))
            for key, value in zip(rows, (p, a, t, w, anchor + t * METRES_PER_NS * away), strict=True):
                rows[key].append(value)
        made.append(Pulse(anchor, away, [[(-8.0, digitise(outgoing, bits))], segments], time=1000.0 + 1e-5 * p))
        peaks.append(peak - 8.0)
    kinds = [
        Sampling(OUTGOING, bits=bits, spacing=spacing, length_bits=0, samples=20, segment_bits=0, segments=1),
        Sampling(RETURNING, bits=bits, spacing=spacing),
    ]
    options.setdefault("descriptors", {1: Descriptor(kinds)})
    written = write_pls(path, made, **options)
    cols = {k: np.array(v) for k, v in rows.items()}
    return Truth(written, cols["pulse"], cols["a"], cols["t"], cols["w"], cols["xyz"], np.array(peaks), made)


def two_segments_of(duration_bits: int, segment_bits: int, length_bits: int) -> tuple[Sampling, list]:
    """A sampling whose durations are signed, scaled and offset, with counts of these widths, fixed where 0; and two
    segments of it."""
    rng = np.random.default_rng(0)
    sampling = Sampling(
        duration_bits=duration_bits,
        scale=0.5,
        offset=3000.0,
        segment_bits=segment_bits,
        length_bits=length_bits,
        segments=0 if segment_bits else 2,
        samples=0 if length_bits else 30,
        bits=16,
        padding=4,
    )
    return sampling, [(2950.0, rng.integers(0, 65536, 30)), (3040.5, rng.integers(0, 65536, 30))]


SENT, BACK, LEAD, HEAD = 20, 60, 4, 7
"""Outgoing and returning samples of a pulse, and bytes before either: duration; segments, duration, samples."""


def run_together(path: Path) -> None:
    """The Waves file of a `survey` of 16 bits with one segment a pulse, as a converter of 2013 wrote it: outgoing
    samples of 8 bits taken for such of 16."""
    waves = path.with_suffix(".wvs")
    head, body = waves.read_bytes()[:60], np.frombuffer(waves.read_bytes()[60:], np.uint8)
    whole = body.reshape(-1, LEAD + 2 * SENT + HEAD + 2 * BACK).copy()
    rows = whole[:, LEAD:]
    sent = rows[:, : 2 * SENT].copy().view("<u2").astype(np.uint8)
    back = rows[:, 2 * SENT + HEAD :].copy()
    rows[:, :SENT], rows[:, SENT : 2 * SENT] = sent, back[:, :SENT]
    rows[:, 2 * SENT + HEAD :] = np.concatenate([back[:, SENT:], np.roll(sent, -1, axis=0)], axis=1)
    waves.write_bytes(head + whole.tobytes())
