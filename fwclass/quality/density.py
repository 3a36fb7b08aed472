"""Density of echoes and pulses, counted cell by cell in pieces of a raster."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

PERCENTILES = (5, 50, 95)


class Density:
    """Counts of cells of edge `cell` [m] that hold so many pulses; pieces of the raster come in any order."""

    def __init__(self, cell: float) -> None:
        self.cell, self.echoes, self.pulses, self.cells = cell, 0, 0, 0
        self._by_pulses = np.zeros(1, np.int64)

    def add(self, echoes: NDArray[np.uint32], pulses: NDArray[np.uint32]) -> None:
        """Take in a piece of the raster: echoes and pulses of its cells."""
        there = echoes > 0
        self.echoes += int(echoes.sum(dtype=np.int64))
        self.pulses += int(pulses.sum(dtype=np.int64))
        self.cells += int(there.sum())
        some = np.bincount(pulses[there])
        self._by_pulses = np.pad(self._by_pulses, (0, max(0, len(some) - len(self._by_pulses))))
        self._by_pulses[: len(some)] += some

    def facts(self) -> dict[str, Any]:
        """``cell`` [m], ``area`` of the cells with an echo [m²], ``echoes`` and ``pulses`` per m² of it, ``spacing`` of
        pulses [m], ``percentiles`` of the cells' pulses per m²; None for what nothing tells."""
        area = self.cells * self.cell**2
        order = np.cumsum(self._by_pulses)
        ranks = [max(1, math.ceil(p / 100 * self.cells)) for p in PERCENTILES]
        return {
            "cell": self.cell,
            "area": area,
            "echoes": self.echoes / area if area else None,
            "pulses": self.pulses / area if area else None,
            "spacing": math.sqrt(area / self.pulses) if self.pulses else None,
            "percentiles": {
                f"p{p}": int(np.searchsorted(order, rank)) / self.cell**2
                for p, rank in zip(PERCENTILES, ranks, strict=True)
            }
            if area
            else None,
        }
