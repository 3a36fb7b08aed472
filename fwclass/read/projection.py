"""Sources in degrees, in feet, or counted from the middle of the earth, brought into a projected system as they are
read."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from pyproj import CRS

from fwclass.formats.crs import units_of
from fwclass.formats.flat import GEOCENTRIC, HIGHEST, LONGEST, not_flat
from fwclass.formats.projected import Floats, height_unit, metric_twin, project, project_beams
from fwclass.read.base import Source
from fwclass.waveforms import Waveforms

AXES = "xyz"

EDGE_POINTS = 5
"""Along each edge of a box that is brought into another system."""


def to_project(source: Source, crs: Any) -> bool:
    """Whether `source` names a system that is not flat, and `crs`, which the user names, is one that is.

    Where its header's bounds cannot be of the system that it names, the user corrects it.
    """
    own = source.crs
    if own is None or crs is None or not crs.is_projected or not (own.is_geographic or own.is_geocentric):
        return False
    low, high = source.bounds[:3], source.bounds[3:]
    if not np.isfinite(source.bounds).all():
        return True
    if own.is_geocentric:
        return not_flat(None, low, high) == GEOCENTRIC
    return max(map(abs, (low[0], high[0]))) <= LONGEST and max(map(abs, (low[1], high[1]))) <= HIGHEST


def is_brought(crs: Any) -> bool:
    """Whether places of the system are none of metres on a plane, so that ``read.project_to`` brings them into one."""
    return crs is not None and bool(crs.is_geocentric or units_of(crs))


def at_its_word(source: Source) -> Source:
    """`source` as it is read where it is in feet, as its system says, and the same projection in metres is known."""
    twin = metric_twin(source.crs) if is_brought(source.crs) else ""
    return replace(source, target=twin) if twin else source


def metres_of(source: Source) -> tuple[float, float, float]:
    """Metres in a unit of x, y and z of a `source` that is brought into another projected system; 1 of all others."""
    if source.target is None or not source.crs.is_projected:
        return 1.0, 1.0, 1.0
    flat = float(source.crs.axis_info[0].unit_conversion_factor)
    return flat, flat, height_unit(source.crs)


def project_places(source: Source, xyz: tuple[Floats, ...]) -> tuple[Floats, ...]:
    """Coordinates x, y, z (n,) of `source` in the system that it is read in."""
    if source.target is None:
        return xyz
    there = project(source.crs, CRS.from_user_input(source.target), np.stack(xyz, axis=1), source.path)
    return tuple(np.ascontiguousarray(there.T))


def box_brought(source: Source, bounds: tuple[float, ...]) -> tuple[float, ...]:
    """`bounds` (xmin, ymin, zmin, xmax, ymax, zmax) of `source` in the system that it is read in: those of the box
    around its box, with what curves between."""
    if source.target is None:
        return bounds
    sides = [np.linspace(bounds[k], bounds[k + 3], EDGE_POINTS) for k in range(3)]
    there = project_places(source, tuple(axis.ravel() for axis in np.meshgrid(*sides, indexing="ij")))
    return (*(float(axis.min()) for axis in there), *(float(axis.max()) for axis in there))


def project_waveforms(waves: Waveforms, source: Source, target: str) -> Waveforms:
    """`waves` of `source` in the system `target` (`project` says what becomes of heights).

    Beams are turned where their first sample lies, near what they hit: from the sensor on, the earth curves.
    """
    crs, pulses, returns = CRS.from_user_input(target), waves.pulses, waves.returns
    anchor, step = (np.stack([pulses[f"{n}_{a}"] for a in AXES], axis=1).astype(float) for n in ("anchor", "step"))
    late = (pulses["anchor_time"].astype(np.float64) - pulses["segment_start"])[:, None]
    place, turned = project_beams(source.crs, crs, anchor + late * step, step, source.path)
    anchor = place - late * turned
    there = project(source.crs, crs, np.stack([returns[a] for a in AXES], axis=1), source.path)
    columns = {f"anchor_{a}": anchor[:, k] for k, a in enumerate(AXES)}
    columns |= {f"step_{a}": turned[:, k] for k, a in enumerate(AXES)}
    return replace(
        waves,
        pulses=pulses.with_columns(columns),
        returns=returns.with_columns({a: there[:, k] for k, a in enumerate(AXES)}),
    )
