"""Radiometry as stages: statistics of every tile, one calibration, the columns of every tile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.radiometry.calibration import Calibration
from fwclass.radiometry.formulas import backscatter, beam_area, cross_section, reflectance
from fwclass.radiometry.overlap import READS, incidence_cosine
from fwclass.radiometry.params import RADIOMETRIC, RadiometryParams
from fwclass.radiometry.ranges import ranges, with_beams
from fwclass.schema import Table, require
from fwclass.stage import Chunk, Computation
from fwclass.waveforms import SATURATED as FIT_SATURATED

ONE_OF_SEVERAL, NO_RANGE, NO_NORMAL, CLIPPED, SATURATED, UNCALIBRATED = 1, 2, 4, 8, 16, 32
"""Values of `radiometry_flags`."""


def radiometry(chunk: Chunk, trajectory: Table | None, calibration: Calibration, params: RadiometryParams) -> Table:
    """Radiometric columns of the core rows; the formulas stand in `fwclass.radiometry.formulas`.

    ``range`` [m] as in `ranges`. ``incidence`` [deg], angle between beam and normal, whichever way the normal points;
    above ``grazing`` the normal is none.
    ``cross_section`` σ = C_cal R⁴ E / (η g) [m²], E the echo's energy, g the strip's gain. ``backscatter``
    γ = σ / (A_i cos θ), θ taken at no more than ``max_incidence``; 4 × its reflectance on a matt surface larger than
    the beam. ``reflectance`` [dB] over a white surface that faces the beam, where C_cal holds.

    Every value is NaN where something it needs is missing. `radiometry_flags`:

    1 one of several echoes of its pulse (γ and reflectance hold only where the whole beam meets one surface);
    2 no range; 4 no normal or no beam direction; 8 incidence above `max_incidence`; 16 saturated (a fit to the samples
    that are not); 32 C_cal is not known for the strip, σ and γ are relative.
    """
    require(chunk.table, READS, chunk.tile.key)
    echoes = with_beams(chunk.table.select(READS).take(chunk.core), trajectory, params)
    range_ = ranges(echoes, trajectory, params)
    cosine = incidence_cosine(echoes)
    cosine[cosine < np.cos(np.radians(params.grazing))] = np.nan
    lowest = np.cos(np.radians(params.max_incidence))
    energy = echoes["energy"].astype(np.float64)
    energy[~(np.isfinite(energy) & (energy >= 0.0))] = np.nan
    raw = cross_section(energy, range_, params.extinction)
    sigma = calibration.constant * raw / calibration.gains(echoes["strip"])
    area = beam_area(range_, params.divergence)
    known = calibration.calibrated(echoes["strip"])
    return Table(
        {
            "range": range_,
            "incidence": np.degrees(np.arccos(cosine)),
            "cross_section": sigma,
            "backscatter": backscatter(sigma, area, np.maximum(cosine, lowest)),
            "reflectance": np.where(known, reflectance(sigma, area), np.nan),
            "radiometry_flags": _flags(echoes, range_, cosine, lowest, known),
        }
    )


def _flags(
    echoes: Table, range_: NDArray[np.float64], cosine: NDArray[np.float64], lowest: float, known: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    flags = np.zeros(echoes.rows, np.uint8)
    for flag, where in (
        (ONE_OF_SEVERAL, echoes["number_of_echoes"] > 1),
        (NO_RANGE, np.isnan(range_)),
        (NO_NORMAL, np.isnan(cosine)),
        (CLIPPED, cosine < lowest),
        (SATURATED, (echoes["fit_flags"] & FIT_SATURATED) > 0),
        (UNCALIBRATED, ~known),
    ):
        flags[where] |= flag
    return flags


OVERLAP = Computation(name="overlap", version=2, reads=READS, halo=lambda params: float(params.overlap.cell))
CALIBRATE = Computation(name="calibrate", version=2)
RADIOMETRY = Computation(name="radiometry", version=3, reads=READS, writes=RADIOMETRIC)
