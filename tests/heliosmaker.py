"""Full waveforms as HELIOS++ writes them, from its published rules, with their truth: independent of the reader."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

C = 0.299792458
PULSE_NS = 4.0


def outgoing(bin_ns: float) -> tuple[np.ndarray, int]:
    """HELIOS's pulse: (t / tau)^2 exp(-t / tau) with tau = length / 7, and the bin of its peak."""
    t = np.arange(int(PULSE_NS / bin_ns)) * bin_ns
    tau = PULSE_NS * 0.5 / 3.5
    wave = (t / tau) ** 2 * np.exp(-t / tau)
    return wave, int(np.argmax(wave))


def line(number: int, origin, away, hits: list[tuple[float, float]], bin_ns: float, gps: float, digits: int) -> str:
    """`hits` are (distance [m], intensity)."""
    wave, peak = outgoing(bin_ns)
    near, far = min(d for d, _ in hits), max(d for d, _ in hits)
    first, last = near / C - peak * bin_ns, far / C + PULSE_NS - peak * bin_ns + bin_ns
    full = np.zeros(math.ceil(last / bin_ns) - math.ceil(first / bin_ns))
    for distance, intensity in hits:
        at = max(int((distance / C - first) / bin_ns + 1e-9) - peak, 0)
        part = wave[: len(full) - at]
        full[at : at + len(part)] += intensity * part
    head = " ".join(f"{v:.4f}" for v in (*origin, *away, first, last))
    return f"{number} {head} {gps:.{digits}f} " + " ".join(f"{v:.{digits}f}" for v in full) + "\n"


def survey(path: Path, pulses=300, bin_ns=0.2, tilt=0.0, digits=9, ground=50.0, tree=True, seed=3):
    """Every third pulse has a crown above the ground. Gives places of ground and crown (NaN: none), and times."""
    r = np.random.default_rng(seed)
    lines, low, high, times = [], [], [], []
    for k in range(pulses):
        swing, lean = math.radians(10.0 * math.sin(k / 9.0)), math.radians(tilt)
        away = np.array([math.sin(swing), math.cos(swing) * math.sin(lean), -math.cos(swing) * math.cos(lean)])
        origin = np.array([1000.0, 2000.0 + 0.1 * k, 450.0])
        distance = (origin[2] - ground) / -away[2]
        hits = [(distance, 40.0 * r.uniform(0.5, 1.0))]
        crown = tree and k % 3 == 0
        if crown:
            bins = round(6.0 / C / bin_ns)
            hits.append((distance - bins * bin_ns * C, 30.0))
        times.append(100.0 + 1e-3 * k)
        lines.append(line(k, origin, away, hits, bin_ns, times[-1], digits))
        low.append(origin + distance * away)
        high.append(origin + hits[-1][0] * away if crown else np.full(3, np.nan))
    path.write_text("".join(lines))
    return np.array(low), np.array(high), np.array(times)
