"""Density of even and random pulses, dense and sparse, with a void and an odd outline; stripes change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.grid import Window
from fwclass.quality.covered import CoveredArea
from fwclass.quality.density import Density, density_remarks

CELL, SPACINGS = 2.0, 4.0


def raster(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pulses of the cells of a square of 400 m."""
    counts = np.zeros((220, 220), np.uint32)
    np.add.at(counts, ((y // CELL).astype(int) + 10, (x // CELL).astype(int) + 10), 1)
    return counts


def facts(counts: np.ndarray, stripe: int = 64) -> dict:
    density = Density(CELL)
    for first in range(0, len(counts), stripe):
        rows = counts[first : first + stripe]
        density.add(Window(CELL, -10, 7 + first, 220, len(rows)), rows, rows)
    return density.facts(SPACINGS)


@pytest.mark.parametrize(("per_m2", "within"), [(8.0, 0.002), (1.0, 0.01), (0.3, 0.03), (0.1, 0.05), (0.02, 0.1)])
def test_random_pulses_have_the_density_that_they_were_drawn_with(per_m2: float, within: float) -> None:
    rng = np.random.default_rng(int(10 * per_m2))
    told = facts(raster(*rng.uniform(0, 400, (2, int(per_m2 * 160_000)))))
    assert told["pulses"] == pytest.approx(per_m2, rel=within) and told["area"] == pytest.approx(160_000, rel=within)
    assert told["spacing"] == pytest.approx(per_m2**-0.5, rel=within)


def test_a_void_and_what_lies_outside_are_no_area() -> None:
    x, y = np.random.default_rng(1).uniform(0, 400, (2, 64_000))  # 0.4 pulses/m2
    there = ~((abs(x - 200) < 50) & (abs(y - 200) < 40)) & (x + y < 700)
    told = facts(raster(x[there], y[there]))
    area = 160_000 - 100 * 80 - 100 * 100 / 2
    assert told["area"] == pytest.approx(area, rel=0.02) and told["pulses"] == pytest.approx(0.4, rel=0.02)


def test_cells_of_the_area_without_a_pulse_count_in_the_percentiles() -> None:
    x, y = np.random.default_rng(2).uniform(0, 400, (2, 48_000))
    assert facts(raster(x, y))["percentiles"]["p5"] == 0.0
    even = np.zeros((220, 220), np.uint32)
    even[10:210, 10:210] = 3
    assert facts(even)["percentiles"] == {"p5": 0.75, "p50": 0.75, "p95": 0.75} and facts(even)["area"] == 160_000


def test_neither_stripes_nor_places_change_it() -> None:
    counts = raster(*np.random.default_rng(3).uniform(0, 400, (2, 30_000)))
    assert facts(counts, 1) == facts(counts, 7) == facts(counts, 220)
    one, other, both = (CoveredArea(CELL) for _ in range(3))
    far = Window(CELL, 5000, 3, 220, 220)
    both.add(Window(CELL, 0, 0, 220, 220), counts > 0), one.add(Window(CELL, 0, 0, 220, 220), counts > 0)
    both.add(far, counts > 1), other.add(far, counts > 1)
    joined = CoveredArea.joined(CELL, [one.plain(), other.plain()])
    assert joined.plain() == both.plain() and joined.of(30_000, SPACINGS) == both.of(30_000, SPACINGS)


def test_nothing_is_nothing() -> None:
    told = facts(np.zeros((5, 220), np.uint32))
    assert told["area"] == 0 and told["pulses"] is None and told["percentiles"] is None
    assert CoveredArea.joined(CELL, []).of(0, SPACINGS) == 0


def test_cells_that_chance_leaves_empty_are_told() -> None:
    rng = np.random.default_rng(4)
    (said,) = density_remarks(facts(raster(*rng.uniform(0, 400, (2, 48_000)))))
    assert "pulses lie 1.8" in said and "quality.cell=4" in said
    assert not density_remarks(facts(raster(*rng.uniform(0, 400, (2, 160_000))))) and not density_remarks(
        facts(np.zeros((5, 220), np.uint32))
    )
