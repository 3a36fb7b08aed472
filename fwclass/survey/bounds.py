"""Where source files lie: as their headers say, or as their points do."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fwclass.formats.projected import project
from fwclass.grid import Box
from fwclass.read.pls_read import pulse_bounds
from fwclass.read.pulsewaves import PulseSource
from fwclass.read.source import BeamSource, Source, open_source
from fwclass.read.stage import read_cloud
from fwclass.survey.files import joint_bounds
from fwclass.survey.systems import system_of

CLOUD_ROWS = 2_000_000
"""Points of a cloud read at a time."""

EDGE_POINTS = 5
"""Along each edge of a box that is brought into another system."""


LOOKED_AT = 100_000
"""Points at the start of a file that its header is held against."""


def header_box(path: Path) -> Box | None:
    """Where a source file says that it lies, None where it says nothing; `FwclassError` where it cannot be read."""
    source = open_source(path)
    return joint_bounds([_true_bounds(source)]) if source.n_records else None


def _true_bounds(source: Source) -> tuple[float, ...]:
    """The header's bounds, or the points' own where the first points disagree: some writers leave them empty."""
    if isinstance(source, PulseSource):
        bounds = np.array(source.bounds)
        return source.bounds if np.isfinite(bounds).all() and (bounds[3:5] > bounds[:2]).any() else pulse_bounds(source)
    if isinstance(source, BeamSource):
        return source.bounds
    low, high = source.bounds[:3], source.bounds[3:]
    cloud = read_cloud(source.path, 0, min(source.n_points, LOOKED_AT))
    points = [cloud[n] for n in "xyz"]
    wrong = any(p.min() < a - 1.0 or p.max() > b + 1.0 for p, a, b in zip(points, low, high, strict=True))
    if not wrong:
        return source.bounds
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for first in range(0, source.n_points, CLOUD_ROWS):
        cloud = read_cloud(source.path, first, min(source.n_points, first + CLOUD_ROWS))
        least = np.minimum(least, [cloud[n].min() for n in "xyz"])
        most = np.maximum(most, [cloud[n].max() for n in "xyz"])
    return (*least.tolist(), *most.tolist())


def flat_bounds(source: Source) -> tuple[float, ...]:
    """Where a file's points lie in the system that it is read in, `_true_bounds`; of one that is brought into another
    the box around its box, with what curves between."""
    bounds, system = _true_bounds(source), system_of(source)
    if source.target is None or system is None:
        return bounds
    sides = [np.linspace(bounds[k], bounds[k + 3], EDGE_POINTS) for k in range(3)]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    there = project(source.crs, system, grid, source.path)
    return (*there.min(axis=0).tolist(), *there.max(axis=0).tolist())
