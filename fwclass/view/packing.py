"""Twelve bytes an echo, as planes of differences."""

from __future__ import annotations

import numpy as np

from fwclass.kernel import kernel

CONFIDENCE = 200.0
"""Steps of a confidence of 1; 255 for none."""

HEIGHT_STEP, HEIGHT_LOW = 0.01, -100.0
"""Height above ground [m]: step, and what 1 stands for; 0 stands for none."""


@kernel
def pack(x, y, z, code, confidence, height, intensity, rows, corner, step, rise, out):  # type: ignore[no-untyped-def]
    """Planes of low and high bytes. Places are differences to the echo before, their sign in the lowest bit, and so is
    what a height above ground differs from z: the terrain, which is smooth."""
    n = len(rows)
    before = np.zeros(4, np.int64)
    now = np.zeros(4, np.int64)
    for k in range(n):
        row = rows[k]
        now[0] = min(max(int((x[row] - corner[0]) / step), 0), 65535)
        now[1] = min(max(int((y[row] - corner[1]) / step), 0), 65535)
        now[2] = min(max(int(np.floor((z[row] - corner[2]) / rise + 0.5)), 0), 65535) if np.isfinite(z[row]) else 0
        h = np.float64(height[row])
        code_of_h = min(max(int(np.floor((h - HEIGHT_LOW) / HEIGHT_STEP + 1.5)), 1), 65535) if np.isfinite(h) else 0
        now[3] = code_of_h - int(now[2] * rise / HEIGHT_STEP)
        for axis in range(4):
            d = ((now[axis] - before[axis] + 32768) & 65535) - 32768
            d = ((d << 1) ^ (d >> 15)) & 65535
            out[2 * axis * n + k] = d & 255
            out[(2 * axis + 1) * n + k] = d >> 8
            before[axis] = now[axis]
        out[8 * n + k] = intensity[row] & 255
        out[9 * n + k] = (intensity[row] >> 8) & 255
        out[10 * n + k] = code[row]
        sure = np.float64(confidence[row])
        out[11 * n + k] = min(max(int(sure * CONFIDENCE + 0.5), 0), 200) if np.isfinite(sure) else 255
