"""Where source files lie: as their headers say, or as their points do."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fwclass.grid import Box
from fwclass.read.pls_read import pulse_bounds
from fwclass.read.projection import box_brought
from fwclass.read.pulsewaves import PulseSource
from fwclass.read.source import BeamSource, Source, open_source
from fwclass.read.stage import read_cloud
from fwclass.survey.files import joint_bounds

CLOUD_ROWS = 2_000_000
"""Points of a cloud read at a time."""

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
    """Where a file's points lie, `_true_bounds`, in the system that it is read in."""
    return box_brought(source, _true_bounds(source))
