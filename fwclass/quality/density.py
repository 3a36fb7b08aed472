"""Density of echoes and pulses, counted cell by cell in pieces of a raster."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.quality.covered import WIDE, CoveredArea

PERCENTILES = (5, 50, 95)


def density_remarks(facts: Mapping[str, Any]) -> list[str]:
    """That cells are so small for the spacing of the pulses that chance leaves many empty; `facts` of `Density`."""
    cell, spacing = facts["cell"], facts["spacing"]
    if spacing is None or cell >= WIDE * spacing:
        return []
    return [
        f"pulses lie {spacing:.2f} m apart, and cells of {cell:g} m are empty by chance: voids and the lower "
        f"percentiles of the density are theirs; --set quality.cell={math.ceil(2 * spacing):g}"
    ]


class Density:
    """Counts of cells of edge `cell` [m] that hold so many pulses; stripes of the raster come one beside the other."""

    def __init__(self, cell: float) -> None:
        self.cell, self.echoes, self.pulses = cell, 0, 0
        self._covered = CoveredArea(cell)
        self._by_pulses = np.zeros(1, np.int64)

    def add(self, stripe: Window, echoes: NDArray[np.uint32], pulses: NDArray[np.uint32]) -> None:
        """Take in the next `stripe` of the raster: number of echoes and of pulses, (rows, columns), in its cells."""
        there = echoes > 0
        self._covered.add(stripe, there)
        self.echoes += int(echoes.sum(dtype=np.int64))
        self.pulses += int(pulses.sum(dtype=np.int64))
        some = np.bincount(pulses[there])
        self._by_pulses = np.pad(self._by_pulses, (0, max(0, len(some) - len(self._by_pulses))))
        self._by_pulses[: len(some)] += some

    def facts(self, spacings: float) -> dict[str, Any]:
        """``cell`` [m], ``area`` that is covered [m²] (`CoveredArea`), ``echoes`` and ``pulses`` per m² of it,
        ``spacing`` of pulses [m], ``percentiles`` of its cells' pulses per m²; None for what nothing tells. Gaps wider
        than so many `spacings` are not covered."""
        area = self._covered.of(self.pulses, spacings)
        occupied, cells = int(self._by_pulses.sum()), round(area / self.cell**2)
        order = np.cumsum(self._by_pulses) + max(0, cells - occupied)
        ranks = [max(1, math.ceil(p / 100 * cells)) for p in PERCENTILES]
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
