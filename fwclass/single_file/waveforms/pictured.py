"""One pulse of a file or a run as a picture and as plain data."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.fitted_echoes import EDGE, OVERLAPPING, POOR, SATURATED
from fwclass.decompose.fitting import model_of, pulses_of, sample_limits
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.publish.wave_picture import WavePicture
from fwclass.single_file.waveforms.shown import WaveformView

FINER, FINE_SAMPLES = 8, 4000
"""Points of a fitted curve per sample, and the waveform's length from which one has to do."""

WORDS = {SATURATED: "saturated", OVERLAPPING: "overlapping", POOR: "poor fit", EDGE: "at the edge"}


Shown = tuple[WavePicture, dict[str, Any]]
"""One pulse as a picture and as plain data."""


def pulse_picture(seen: WaveformView, at: int, system: SystemPulse) -> Shown:
    """Pulse `at` of `seen` as a picture and as plain data."""
    rows, echoes = np.flatnonzero(seen.of_row == at), np.flatnonzero(seen.pulse == at)
    fits, pulses = seen.fits, seen.waves.pulses
    vendor = np.sort(seen.return_time[seen.return_pulse == at])
    misfit = [float(v) for v in fits.misfit[rows] if np.isfinite(v)]
    facts = {
        "pulse": int(seen.ids[at]),
        "why": "",
        "gps_time": float(pulses["gps_time"][rows[0]]),
        "segments": len(rows),
        "samples": int(np.diff(seen.waves.offsets)[rows].sum()),
        "baseline": float(fits.baseline[rows[0]]),
        "noise": float(fits.noise[rows[0]]),
        "misfit": max(misfit, default=math.nan),
        "returns": vendor.tolist(),
        "echoes": [echo_facts(seen, e) for e in echoes.tolist()],
    }
    parts = [_segment(seen, int(row), system) for row in rows]
    k = sum(len(p["curves"]) for p in parts)
    curves, first = [], 0
    for p in parts:
        mine_only = np.full((k, p["fine"].shape[0]), np.nan)
        mine_only[first : first + len(p["curves"])] = p["curves"]
        first += len(p["curves"])
        curves.append(mine_only)
    joined = {n: np.concatenate([p[n] for p in parts]) for n in parts[0] if n != "curves"}
    by_row = echoes[np.argsort(fits.row[echoes], kind="stable")]
    time = f"GPS time {facts['gps_time']:.6f} s" if np.isfinite(facts["gps_time"]) else "no GPS time"
    fit = f"misfit {facts['misfit']:.2f}" if misfit else "no echo fitted"
    picture = WavePicture(
        title=f"pulse {facts['pulse']}, {time}, {fit}",
        subtitle=f"baseline {facts['baseline']:.2f}, noise {facts['noise']:.2f} DN",
        **joined,
        curves=np.concatenate(curves, axis=1),
        echoes=seen.time[by_row],
        heights=fits.baseline[fits.row[by_row]] + fits.amplitude[by_row],
        new=seen.missed[by_row],
        vendor=vendor,
    )
    return picture, facts


def _segment(seen: WaveformView, row: int, system: SystemPulse) -> dict[str, NDArray]:
    """One row of a pulse for `WavePicture`; a NaN ends its curves."""
    pulses, fits = seen.waves.pulses, seen.fits
    samples = seen.waves.samples[seen.waves.offsets[row] : seen.waves.offsets[row + 1]].astype(np.float64)
    spacing, start = float(pulses["sample_spacing"][row]), float(pulses["segment_start"][row])
    n, finer = len(samples), FINER if len(samples) <= FINE_SAMPLES else 1
    kinds, _, kind = pulses_of(seen.waves, system)
    total, curves = model_of(fits, row, (n - 1) * finer + 1 if n else 0, spacing / finer, kinds[kind[row]])
    end = np.full(1, np.nan)
    return {
        "time": start + np.arange(n) * spacing,
        "samples": samples,
        "clipped": samples >= sample_limits(seen.waves, system)[row],
        "model": total[::finer],
        "sigma": np.full(n, fits.noise[row]),
        "fine": np.append(start + np.arange(len(total)) * spacing / finer, end),
        "total": np.append(total, end),
        "curves": np.concatenate([curves + fits.baseline[row], np.full((len(curves), 1), np.nan)], axis=1),
    }


def echo_facts(seen: WaveformView, e: int) -> dict[str, Any]:
    """One echo as plain data."""
    fits = seen.fits
    names = ("amplitude", "amplitude_sigma", "width", "width_sigma", "time_sigma")
    back = int(seen.matched[e])
    return {
        "time": float(seen.time[e]),
        **{name: float(getattr(fits, name)[e]) for name in names},
        "significance": float(seen.significance[e]),
        "flags": [word for bit, word in WORDS.items() if fits.flags[e] & bit],
        "return": int(seen.waves.returns["return_number"][back]) if back >= 0 else None,
        "from_return": float(seen.time[e]) - float(seen.waves.returns["location"][back]) if back >= 0 else None,
        "missed": bool(seen.missed[e]),
        "noise_chance": float(seen.chance[e]),
        "nearest_return": float(seen.gap[e]),
    }
