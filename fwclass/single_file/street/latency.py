"""How long answers take: counts in bins of 10 µs, so that an hour takes no more memory than a second."""

from __future__ import annotations

import numpy as np

BIN = 1e-5
"""s"""

BINS = 200_000
"""Two seconds; the last bin holds what is longer."""


class Latency:
    """Counts of times by bins of `BIN` seconds."""

    def __init__(self) -> None:
        self._counts = np.zeros(BINS, np.int64)
        self._most = 0.0

    def add(self, seconds: float) -> None:
        """Count one time [s]."""
        self._counts[min(int(seconds / BIN), BINS - 1)] += 1
        self._most = max(self._most, seconds)

    def summary(self) -> dict[str, float | int | None]:
        """Frames, median, 99 and 99.9 %, and the most [ms]; upper ends of bins."""
        total = int(self._counts.sum())
        sums = np.cumsum(self._counts)

        def quantile(share: float) -> float | None:
            return 1e3 * BIN * (int(np.searchsorted(sums, share * total)) + 1) if total else None

        return {
            "frames": total,
            "median_ms": quantile(0.5),
            "p99_ms": quantile(0.99),
            "p999_ms": quantile(0.999),
            "most_ms": round(1e3 * self._most, 3) if total else None,
        }
