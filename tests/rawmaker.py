"""Raw waveforms of plane ground, with their truth, written by nothing of the program: Parquet by pyarrow, text by hand.

>>> truth = scene(pulses=500, tilt=20.0)
>>> write_parquet(path, truth.columns(), {"crs": "EPSG:32632", "spacing_ns": "1.0"})
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

HALF_LIGHT = 0.299792458 / 2.0 / 1.000273
GROUND, SLOPE = 120.0, (0.03, -0.02)
SIGMA = 4.0 / 2.354820045
LISTS = ("samples", "outgoing")


@dataclass
class Truth:
    """Beams from `origin` (n, 3) along `away` (n, 3) that hit the ground at `place` (n, 3); waveforms (n, m)."""

    origin: np.ndarray
    away: np.ndarray
    place: np.ndarray
    first: np.ndarray
    samples: np.ndarray
    spacing: float
    time: np.ndarray

    def columns(self, per: str = "ns", at: str = "first") -> dict:
        """A table as users write it: direction `per` ns, sample or unit; place of the first sample or of the sensor."""
        length = {"ns": HALF_LIGHT, "unit": 1.0, "sample": HALF_LIGHT * self.spacing}[per]
        begin = np.linalg.norm(self.first - self.origin, axis=1) / HALF_LIGHT
        place = self.first if at == "first" else self.origin
        found = dict(zip("xyz", place.T, strict=True))
        found |= dict(zip(("dx", "dy", "dz"), (self.away * length).T, strict=True))
        if at != "first":
            found |= {"begin_ns": begin, "range_m": np.zeros(len(begin))}
        return found | {"gps_time": self.time, "samples": list(self.samples)}


def scene(
    pulses=600, tilt=0.0, spacing=1.0, noise=1.0, level=12.0, seed=1, n=80, scale=1.0, origin=(512_000.0, 5_400_000.0)
):
    """Ground of a given slope under a scanner that swings across the line; `tilt` leans all beams forward [degrees]."""
    r = np.random.default_rng(seed)
    k = np.arange(pulses)
    sensor = np.stack([origin[0] + np.zeros(pulses), origin[1] + 0.02 * k, np.full(pulses, GROUND + 600.0)], axis=1)
    swing = np.radians(8.0 * np.sin(2 * np.pi * k / 97.0))
    lean = np.radians(tilt)
    away = np.stack([np.sin(swing), np.cos(swing) * np.sin(lean), -np.cos(swing) * np.cos(lean)], axis=1)
    normal = np.array([-SLOPE[0], -SLOPE[1], 1.0])
    base = np.array([*origin, GROUND])
    distance = ((base - sensor) @ normal) / (away @ normal)
    place = sensor + distance[:, None] * away
    phase = r.uniform(25.0, 26.0, pulses) * spacing
    first = place - (phase * HALF_LIGHT)[:, None] * away
    t = np.arange(n) * spacing
    height = r.uniform(60.0, 120.0, pulses)
    y = height[:, None] * np.exp(-0.5 * ((t - phase[:, None]) / SIGMA) ** 2) + level
    y = np.rint(y + r.normal(0.0, noise, y.shape)).clip(0, 255) * scale
    return Truth(
        sensor, away, place, first, y.astype(np.uint16 if scale == 1.0 else np.float32), spacing, 1000.0 + k * 1e-5
    )


def write_parquet(path: Path, columns: dict, told: dict | None = None, **options) -> Path:
    arrays = {}
    for name, values in columns.items():
        if name in LISTS:
            ends = np.concatenate([[0], np.cumsum([len(v) for v in values])]).astype(np.int32)
            flat = np.concatenate([*values]) if len(values) else np.empty(0, np.uint16)
            arrays[name] = pa.ListArray.from_arrays(pa.array(ends), pa.array(flat))
        else:
            arrays[name] = pa.array(np.asarray(values))
    pq.write_table(pa.table(arrays).replace_schema_metadata(told or {}), path, **options)
    return path


def write_csv(path: Path, columns: dict, told: dict | None = None, mark: str = ",") -> Path:
    lines = [f"# {key}: {value}" for key, value in (told or {}).items()]
    lines.append(mark.join(columns))
    for row in zip(*columns.values(), strict=True):
        cells = []
        for name, cell in zip(columns, row, strict=True):
            cells.append(" ".join(f"{v:g}" for v in cell) if name in LISTS else repr(float(cell)))
        lines.append(mark.join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path
