"""A small maker of LAS files with waveform packets, byte by byte, and tables of echoes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fwclass.publish.params import PublishParams
from fwclass.schema import Table

SIZES = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}
PACKET_AT = {4: 28, 5: 34, 9: 30, 10: 38}
SAMPLES = 12


@dataclass
class Made:
    """What was written: raw point records, and the samples of each point's packet (None without one)."""

    path: Path
    points: np.ndarray
    samples: list[np.ndarray | None]
    vlrs: bytes
    evlrs: bytes


def record(user: bytes, number: int, data: bytes, long: bool = False) -> bytes:
    return struct.pack("<H16sHQ32s" if long else "<H16sHH32s", 0, user, number, len(data), b"made") + data


def packet_record(rng: np.random.Generator, n: int) -> tuple[bytes, list[tuple[int, int]], list[np.ndarray]]:
    """The packet record with its header, (offset, size) per packet and the samples; 8 and 16 bit in turn."""
    body, places, samples = b"", [], []
    for k in range(n):
        kind = "<u2" if k % 2 else "u1"
        values = rng.integers(0, 250, SAMPLES).astype(kind)
        places.append((60 + len(body), values.nbytes))
        body += values.tobytes()
        samples.append(values)
    return record(b"LASF_Spec", 65535, body, long=True), places, samples


@pytest.fixture
def make_las(tmp_path: Path) -> Callable[..., Made]:
    def make(
        fmt: int,
        n: int = 50,
        storage: str = "none",
        minor: int | None = None,
        extra: int = 0,
        described: bytes = b"",
        vlrs: bytes = b"",
        n_vlrs: int = 0,
        evlrs: tuple[bytes, ...] = (),
        gap: bytes = b"",
        user: bytes = b"",
        listed: bool = True,
        name: str = "strip.las",
        seed: int = 0,
    ) -> Made:
        rng = np.random.default_rng(seed + fmt)
        minor = minor if minor is not None else 4 if fmt >= 6 else 3 if fmt in PACKET_AT else 2
        points = rng.integers(0, 256, (n, SIZES[fmt] + extra), dtype=np.uint8)
        samples: list[np.ndarray | None] = [None] * n
        head_size = {2: 227, 3: 235, 4: 375}[minor] + len(user)
        if fmt in PACKET_AT:
            for number, bits in ((100, 8), (101, 16)):
                data = struct.pack("<BBIIdd", bits, 0, SAMPLES, 1000, 1.0, 0.0)
                vlrs += record(b"LASF_Spec", number, data)
            n_vlrs += 2
        if described:
            vlrs, n_vlrs = vlrs + record(b"LASF_Spec", 4, described), n_vlrs + 1
        packets = b""
        if storage != "none":
            packets, places, values = packet_record(rng, n - n // 10)
            at = PACKET_AT[fmt]
            for i in range(n):
                has = i < len(places)
                offset, size = places[i] if has else (0, 0)
                block = struct.pack("<BQIffff", 1 + i % 2 if has else 0, offset, size, 10.5 * i, 0.1, -0.2, 0.3)
                points[i, at : at + 29] = np.frombuffer(block, np.uint8)
                samples[i] = values[i] if has else None
        offset = head_size + len(vlrs) + len(gap)
        end = offset + points.nbytes
        head = bytearray(head_size)
        head[:4], head[24], head[25] = b"LASF", 1, minor
        encoding = 1 | {"none": 0, "internal": 2, "external": 4}[storage] | (16 if fmt >= 6 else 0)
        struct.pack_into("<HH", head, 4, 4711, encoding)
        head[8:24] = bytes(range(16))
        struct.pack_into("<32s32s", head, 26, b"A SENSOR", b"A WRITER 1.2")
        struct.pack_into("<HHHIIBH", head, 90, 17, 2012, head_size, offset, n_vlrs, fmt, points.shape[1])
        struct.pack_into("<I", head, 107, n if fmt < 6 else 0)
        struct.pack_into("<12d", head, 131, 0.01, 0.01, 0.01, 5e5, 5e6, 0, 3, 1, 4, 2, 6, 5)
        inside = packets if storage == "internal" else b""
        if minor >= 3:
            struct.pack_into("<Q", head, 227, end if inside else 0)
        if minor >= 4:
            number = len(evlrs) + (1 if inside and listed else 0)
            start = end + (0 if listed else len(inside))
            struct.pack_into("<QIQ", head, 235, start if number else 0, number, n)
        head[head_size - len(user) :] = user
        path = tmp_path / name
        path.write_bytes(bytes(head) + vlrs + gap + points.tobytes() + inside + b"".join(evlrs))
        if storage == "external":
            path.with_suffix(".wdp").write_bytes(packets)
        return Made(path, points, samples, vlrs, b"".join(evlrs))

    return make


@pytest.fixture(scope="session")
def params(base: dict[str, Any]) -> PublishParams:
    return PublishParams(**base["publish"])


@pytest.fixture
def echoes() -> Callable[..., Table]:
    """Made-up echoes of a 100 m tile far from the origin of the CRS."""

    def make(n: int = 500, seed: int = 0) -> Table:
        rng = np.random.default_rng(seed)
        count = rng.integers(1, 5, n)
        return Table(
            {
                "strip": rng.integers(0, 3, n),
                "pulse": np.arange(n),
                "echo_number": rng.integers(1, count + 1),
                "number_of_echoes": count,
                "x": np.round(rng.uniform(770_000, 770_100, n), 3),
                "y": np.round(rng.uniform(6_277_000, 6_277_100, n), 3),
                "z": np.round(rng.uniform(-2, 60, n), 3),
                "gps_time": np.where(rng.random(n) < 0.1, np.nan, rng.uniform(1e5, 2e5, n)),
                "intensity": rng.integers(0, 65536, n),
                "amplitude": np.where(rng.random(n) < 0.2, np.nan, rng.uniform(1, 900, n)),
                "echo_ratio_r100": rng.random(n),
                "height_above_ground": rng.normal(0, 3, n),
                "classification": rng.choice([2, 5, 6, 64], n),
                "confidence": rng.random(n),
            }
        )

    return make
