"""Small LAS files with waveform packets, byte by byte, for tests: independent of the reader and of laspy.

>>> truth = survey(tmp_path / "a.las", pulses=50, point_format=9)
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from wdzmaker import packed

METRES_PER_NS = 0.299792458 / 2 / 1.000273
FWHM = 2 * np.sqrt(2 * np.log(2))

_LEGACY = [
    ("X", "<i4"),
    ("Y", "<i4"),
    ("Z", "<i4"),
    ("intensity", "<u2"),
    ("bits", "u1"),
    ("class", "u1"),
    ("angle", "i1"),
    ("user", "u1"),
    ("strip", "<u2"),
]
_MODERN = [
    ("X", "<i4"),
    ("Y", "<i4"),
    ("Z", "<i4"),
    ("intensity", "<u2"),
    ("bits", "u1"),
    ("flags", "u1"),
    ("class", "u1"),
    ("user", "u1"),
    ("angle", "<i2"),
    ("strip", "<u2"),
    ("gps", "<f8"),
]
_GPS, _RGB, _NIR = [("gps", "<f8")], [("rgb", "<u2", 3)], [("nir", "<u2")]
_WAVE = [("wave", [("index", "u1"), ("offset", "<u8"), ("size", "<u4"), ("location", "<f4"), ("step", "<f4", 3)])]
LAYOUTS = {
    0: _LEGACY,
    1: _LEGACY + _GPS,
    2: _LEGACY + _RGB,
    3: _LEGACY + _GPS + _RGB,
    4: _LEGACY + _GPS + _WAVE,
    5: _LEGACY + _GPS + _RGB + _WAVE,
    6: _MODERN,
    7: _MODERN + _RGB,
    8: _MODERN + _RGB + _NIR,
    9: _MODERN + _WAVE,
    10: _MODERN + _RGB + _NIR + _WAVE,
}
UTM33 = {3072: 32633}


@dataclass
class Descriptor:
    """A waveform packet descriptor: bits per sample, samples, spacing [ps], gain."""

    bits: int = 8
    n_samples: int = 60
    spacing_ps: int = 1000
    compression: int = 0
    gain: float = 1.0

    def pack(self) -> bytes:
        return struct.pack("<BBIIdd", self.bits, self.compression, self.n_samples, self.spacing_ps, self.gain, 0.0)


def vlr(user: str, number: int, body: bytes) -> bytes:
    return struct.pack("<H16sHH32s", 0, user.encode(), number, len(body), b"") + body


def evlr_head(user: str, number: int, length: int) -> bytes:
    return struct.pack("<H16sHQ32s", 0, user.encode(), number, length, b"")


def geo_keys(keys: Mapping[int, int]) -> bytes:
    rows = [(1, 1, 0, len(keys)), *((k, 0, 1, v) for k, v in sorted(keys.items()))]
    return vlr("LASF_Projection", 34735, np.array(rows, "<u2").tobytes())


def extra_bytes(extra: Mapping[str, tuple[str, float, ArrayLike]]) -> bytes:
    codes = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 9, "f8": 10}
    rows = []
    for name, (dtype, scale, _) in extra.items():
        options = 8 if scale != 1.0 else 0
        rows.append(
            struct.pack("<2xBB32s4x24s24s24s", codes[dtype], options, name.encode(), b"", b"", b"")
            + struct.pack("<3d3d32s", scale, 0, 0, 0, 0, 0, b"")
        )
    return vlr("LASF_Spec", 4, b"".join(rows)) if rows else b""


def write_las(
    path: str | Path,
    xyz: ArrayLike,
    *,
    point_format: int = 9,
    version: tuple[int, int] | None = None,
    return_number: ArrayLike = 1,
    number_of_returns: ArrayLike = 1,
    intensity: ArrayLike = 100,
    classification: ArrayLike = 1,
    gps_time: ArrayLike = 0.0,
    channel: ArrayLike = 0,
    waveforms: Sequence[NDArray] = (),
    descriptor_of: Sequence[int] = (),
    pulse: ArrayLike | None = None,
    location: ArrayLike = 0.0,
    step: ArrayLike = (0.0, 0.0, METRES_PER_NS),
    descriptors: Mapping[int, Descriptor] | None = None,
    where: str = "external",
    wave_user: str = "LASF_Spec",
    keys: Mapping[int, int] | None = UTM33,
    wkt: str = "",
    citations: str = "",
    extra: Mapping[str, tuple[str, float, ArrayLike]] | None = None,
    scale: float = 0.001,
    wave: Mapping[str, ArrayLike] | None = None,
) -> Path:
    """Write a LAS file, and its WDP (WDZ where a descriptor says that packets are compressed) beside it if `where` is
    ``external``.

    Parameters
    ----------
    xyz : (n, 3) coordinates [m].
    waveforms, descriptor_of : samples of every pulse and the index of its descriptor (1 where not given).
    pulse : pulse of every point; -1 is a point without packet.
    location, step : return location [ns] and beam vector [m/ns] of every point.
    extra : extra bytes, name -> (dtype, scale, raw values).
    wave : raw values that overwrite wave packet fields (index, offset, size, location [ps], step [m/ps]).
    """
    path, xyz = Path(path), np.asarray(xyz, float).reshape(-1, 3)
    extra = extra or {}
    descriptors = descriptors if descriptors is not None else {1: Descriptor()}
    version = version or ((1, 4) if point_format >= 6 else (1, 3) if point_format >= 4 else (1, 2))
    layout = [*LAYOUTS[point_format], *((name, "<" + dtype) for name, (dtype, _, _) in extra.items())]
    points = np.zeros(len(xyz), np.dtype(layout))
    offset = np.floor(xyz.min(axis=0)) if len(xyz) else np.zeros(3)
    for k, name in enumerate("XYZ"):
        points[name] = np.rint((xyz[:, k] - offset[k]) / scale)
    number, of = np.broadcast_arrays(np.asarray(return_number), np.asarray(number_of_returns))
    shift = 4 if point_format >= 6 else 3
    points["bits"] = number.astype("u1") | (of.astype("u1") << shift)
    points["intensity"], points["class"] = intensity, classification
    if "gps" in points.dtype.names:
        points["gps"] = gps_time
    if "flags" in points.dtype.names:
        points["flags"] = np.asarray(channel, "u1") << 4
    for name, (_, _, values) in extra.items():
        points[name] = values
    packets = b""
    if "wave" in points.dtype.names:
        packets = _fill_waves(points["wave"], waveforms, descriptor_of, pulse, location, step, descriptors)
        for name, values in (wave or {}).items():
            points["wave"][name] = values
    records = [extra_bytes(extra)] if extra else []
    records += [geo_keys(keys)] if keys else []
    records += [vlr("LASF_Projection", 34737, citations.encode() + b"\0")] if citations else []
    records += [vlr("LASF_Projection", 2112, wkt.encode() + b"\0")] if wkt else []
    if "wave" in points.dtype.names:
        records += [vlr(wave_user, 99 + i, d.pack()) for i, d in descriptors.items()]
    body = points.tobytes()
    internal = where == "internal" and bool(packets)
    head = _header(path, point_format, version, points, xyz, offset, scale, records, len(body), internal, bool(wkt))
    tail = evlr_head(wave_user, 65535, len(packets)) + packets if internal else b""
    path.write_bytes(head + b"".join(records) + body + tail)
    if packets and where == "external":
        compressed = any(d.compression for d in descriptors.values())
        beside = path.with_suffix(".wdz" if compressed else ".wdp")
        beside.write_bytes(evlr_head(wave_user, 65535, len(packets)) + packets)
    return path


def _fill_waves(wave, waveforms, descriptor_of, pulse, location, step, descriptors) -> bytes:
    kinds = list(descriptor_of) or [1] * len(waveforms)
    blobs = []
    for samples, kind in zip(waveforms, kinds, strict=True):
        known = descriptors.get(kind)
        if known and known.compression == 1:
            blobs.append(packed(samples, known.bits))
        else:
            blobs.append(np.asarray(samples, "<u2" if known and known.bits > 8 else "u1").tobytes())
    sizes = np.array([len(b) for b in blobs], "u8")
    starts = 60 + np.concatenate([[0], np.cumsum(sizes)]).astype("u8")
    owner = np.arange(len(wave)) if pulse is None else np.asarray(pulse)
    has = (owner >= 0) & (owner < len(blobs))
    wave["index"][has] = np.asarray(kinds, "u1")[owner[has]] if len(kinds) else 0
    wave["offset"][has] = starts[owner[has]]
    wave["size"][has] = sizes[owner[has]] if len(sizes) else 0
    wave["location"] = np.asarray(location, float) * 1e3
    wave["step"] = np.asarray(step, float) * 1e-3
    wave["location"][~has] = 0
    wave["step"][~has] = 0
    return b"".join(blobs)


def _header(path, point_format, version, points, xyz, offset, scale, records, body, internal, wkt) -> bytes:
    size = {(1, 2): 227, (1, 3): 235, (1, 4): 375}[version]
    start = size + sum(map(len, records))
    has_waves = point_format in (4, 5, 9, 10)
    encoding = (2 if internal else 4) * has_waves | 16 * wkt
    low = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    high = xyz.max(axis=0) if len(xyz) else np.zeros(3)
    n = len(points)
    mask = 15 if point_format >= 6 else 7
    by_return = np.bincount(points["bits"] & mask, minlength=17)[1:16]
    legacy = n if point_format < 6 else 0
    head = struct.pack(
        "<4sHH16sBB32s32sHHHIIBHI5I",
        b"LASF",
        0,
        encoding,
        b"",
        *version,
        b"lasmaker",
        b"lasmaker",
        1,
        2026,
        size,
        start,
        sum(1 for r in records if r),
        point_format,
        points.dtype.itemsize,
        legacy,
        *(by_return[:5] if legacy else [0] * 5),
    )
    head += struct.pack("<3d3d", scale, scale, scale, *offset)
    head += struct.pack("<6d", high[0], low[0], high[1], low[1], high[2], low[2])
    if version >= (1, 3):
        head += struct.pack("<Q", start + body if internal else 0)
    if version >= (1, 4):
        evlrs = (start + body, 1) if internal else (0, 0)
        head += struct.pack("<QIQ15Q", *evlrs, n, *by_return)
    return head


def to_laz(source: str | Path, target: str | Path) -> Path:
    """Compress with LASzip, without touching anything else."""
    import laspy

    las = laspy.read(source)
    las.write(target, do_compress=True, laz_backend=laspy.LazBackend.Laszip)
    return Path(target)


def gaussian(n: int, echoes: Sequence[tuple[float, float, float]], baseline: float = 10.0, spacing: float = 1.0):
    """Noise-free samples: `echoes` are (amplitude [DN], time [ns], FWHM [ns])."""
    t = np.arange(n) * spacing
    y = np.full(n, float(baseline))
    for a, at, width in echoes:
        y += a * np.exp(-0.5 * ((t - at) * FWHM / width) ** 2)
    return y


def digitise(y: NDArray, bits: int = 8) -> NDArray:
    """Rounded and held to the digitiser's range."""
    return np.clip(np.rint(y), 0, 2**bits - 1).astype(np.uint8 if bits <= 8 else np.uint16)


@dataclass
class Truth:
    """What `survey` put into its file: per echo pulse, amplitude [DN], time [ns], FWHM [ns], place (n, 3) [m]."""

    path: Path
    pulse: NDArray
    amplitude: NDArray
    time: NDArray
    width: NDArray
    xyz: NDArray
    waveforms: list[NDArray]


def survey(
    path: str | Path,
    pulses: int = 100,
    seed: int = 0,
    noise: float = 1.0,
    bits: int = 8,
    spacing_ps: int = 1000,
    n_samples: int = 60,
    max_echoes: int = 3,
    pulse_width: float = 3.5,
    jitter: float = 0.0,
    **options,
) -> Truth:
    """A file of pulses with 1 to `max_echoes` well separated echoes, each with a return at its true place.

    Points are in file order of the pulses; every return's location is true but for a shift per pulse of up to
    `jitter` [ns].
    """
    rng = np.random.default_rng(seed)
    spacing, scale = spacing_ps * 1e-3, 1.0 if bits <= 8 else 4.0
    lasts = n_samples * spacing
    beams = np.c_[rng.uniform(-0.2, 0.2, (pulses, 2)), np.ones(pulses)]
    beams *= METRES_PER_NS / np.linalg.norm(beams, axis=1)[:, None]
    rows: dict[str, list] = {k: [] for k in ("pulse", "a", "t", "w", "xyz", "number", "of", "step", "location")}
    waveforms = []
    for p in range(pulses):
        k = int(rng.integers(1, max_echoes + 1))
        times = np.sort(lasts * 0.2 + rng.uniform(0, 1, k) + np.arange(k) * 4 * pulse_width)
        echoes = [(scale * rng.uniform(20, 200), t, pulse_width * rng.uniform(1.0, 1.2)) for t in times]
        y = gaussian(n_samples, echoes, 10.0 * scale, spacing) + rng.normal(0, noise, n_samples)
        waveforms.append(digitise(y, bits))
        ground = np.array([500000.0 + 0.5 * (p % 20), 5400000.0 + 0.5 * (p // 20), 200.0])
        shift = rng.uniform(-jitter, jitter)
        for i, (a, t, w) in enumerate(echoes):
            rows["pulse"].append(p)
            rows["a"].append(a)
            rows["t"].append(t)
            rows["w"].append(w)
            rows["xyz"].append(ground + (times[-1] - t) * beams[p])
            rows["number"].append(i + 1)
            rows["of"].append(k)
            rows["step"].append(beams[p])
            rows["location"].append(t + shift)
    cols = {k: np.array(v) for k, v in rows.items()}
    options.setdefault("descriptors", {1: Descriptor(bits, n_samples, spacing_ps)})
    options.setdefault("gps_time", 1000.0 + 1e-5 * cols["pulse"])
    options.setdefault("classification", np.where(cols["number"] == cols["of"], 2, 5))
    options.setdefault("intensity", np.rint(cols["a"]))
    written = write_las(
        path,
        cols["xyz"],
        return_number=cols["number"],
        number_of_returns=cols["of"],
        waveforms=waveforms,
        pulse=cols["pulse"],
        location=cols["location"],
        step=cols["step"],
        **options,
    )
    return Truth(written, cols["pulse"], cols["a"], cols["t"], cols["w"], cols["xyz"], waveforms)


def correlated(rows: int, samples: int, lag1: float, wander: float = 0.0, seed: int = 0) -> NDArray:
    """Noise of a receiver that is not white, (rows, samples): AR(1) of unit variance whose neighbours correlate by
    `lag1`, and a baseline that wanders slowly (over some 40 samples) by `wander`."""
    rng = np.random.default_rng(seed)

    def process(share: float) -> NDArray:
        out = rng.standard_normal((rows, samples))
        for k in range(1, samples):
            out[:, k] = share * out[:, k - 1] + np.sqrt(1.0 - share**2) * out[:, k]
        return out

    return process(lag1) + wander * process(0.975)


def flat_survey(
    path: str | Path,
    pulses: int,
    lag1: float,
    *,
    wander: float = 0.0,
    noise: float = 0.8,
    extra: int = 0,
    ghosts: float = 0.0,
    samples: int = 256,
    seed: int = 0,
    **options: Any,
) -> Path:
    """Single returns of gently sloping ground at 265 m, 0.7 m apart, in long records of `correlated` noise.

    `extra` weak but clear echoes a pulse, some 3 m apart, stand above the ground, as leaves that the vendor has not. So
    large a share of the pulses as `ghosts` has an echo 15 m below the ground, as a reflection inside the receiver.
    """
    rng = np.random.default_rng([seed, 1])
    side = int(np.ceil(np.sqrt(pulses)))
    row = np.arange(pulses)
    x, y = 0.7 * (row % side), 0.7 * (row // side)
    z = 265.0 + 0.01 * x + rng.normal(0.0, 0.02, pulses)
    at = 100.0 + rng.uniform(-0.5, 0.5, pulses)
    height = rng.uniform(60.0, 150.0, pulses)
    quiet = noise * correlated(pulses, samples, lag1, wander, seed)
    strewn = np.random.default_rng([seed, 2]).uniform(-0.8, 0.8, (pulses, extra))  # all at one distance no leaves are
    leaves = -(3.0 * np.arange(1, extra + 1) + strewn) / METRES_PER_NS
    ghost = np.where(rng.random(pulses) < ghosts, 12.0, 0.0)
    deep = 15.0 / METRES_PER_NS
    waveforms = [
        digitise(gaussian(samples, [(h, t, 4.0), (g, t + deep, 4.0), *((12.0, t + d, 4.0) for d in leaf)], 12.0) + q)
        for h, t, g, q, leaf in zip(height, at, ghost, quiet, leaves, strict=True)
    ]
    options.setdefault("descriptors", {1: Descriptor(8, samples, 1000)})
    return write_las(
        path,
        np.column_stack([500000.0 + x, 5400000.0 + y, z]),
        waveforms=waveforms,
        pulse=row,
        location=at,
        gps_time=1000.0 + 1e-5 * row,
        classification=np.where(row % 5, 2, 5),
        **options,
    )
