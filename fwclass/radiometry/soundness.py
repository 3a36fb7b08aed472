"""Whether trajectory, altitude and calibration can be those of the echoes: sums by strip, over any tiles, and what they
say."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.radiometry.calibration import Calibration
from fwclass.radiometry.params import RadiometryParams, RadiometrySoundParams
from fwclass.radiometry.ranges import BEAM, offsets
from fwclass.schema import Table

FARTHEST = 10_000.0
"""m; no airborne scanner that decomposes echoes flies as high above them."""

STEEPEST = 70.0
"""deg off the plumb line; scanners look to 60 at most."""

COUNTS = ("rows", "without_range", "astray", "judged", "bright", "dark", "placed")

WELL_KNOWN = 1e-5
"""Least share of the best determined direction from which one counts as determined; beams of a scan of 1 degree."""


def strip_sums(
    echoes: Table, trajectory: Table | None, columns: Table, beams: NDArray[np.bool_], params: RadiometryParams
) -> dict[str, list[float]]:
    """What the echoes of a tile tell, by strip: numbers that are added up over tiles (`RadiometrySound.of`).

    Parameters
    ----------
    echoes : strip, x, y, z, gps_time, beam_x, beam_y, beam_z. columns : what `radiometry` gave for them.
    beams : (rows,) which have a beam of their source's own.

    Returns
    -------
    By strip `COUNTS`, then the sums of the normal equations of where the sensor was against the trajectory (6, 3).
    """
    range_, level = columns["range"], columns["reflectance"]
    judged = np.isfinite(level) & (columns["radiometry_flags"] == 0)
    sound = params.sound
    away = np.full((echoes.rows, 3), np.nan)
    if trajectory is not None:
        away = offsets(echoes, trajectory, np.arange(echoes.rows), params.max_time_gap)
    with np.errstate(invalid="ignore"):
        length = np.sqrt((away**2).sum(axis=1))
        flat = -away[:, 2] < math.cos(math.radians(STEEPEST)) * length
        astray = (range_ > FARTHEST) | flat
    beam = np.stack([echoes[name] for name in BEAM], axis=1).astype(np.float64)
    placed = beams & np.isfinite(length) & np.isfinite(beam).all(axis=1)
    sums: dict[str, list[float]] = {}
    for strip in np.unique(echoes["strip"]).tolist():
        mine = echoes["strip"] == strip
        counts = (
            mine,
            mine & np.isnan(range_),
            mine & astray,
            mine & judged,
            mine & judged & (level > sound.brightest),
            mine & judged & (level < sound.darkest),
            mine & placed,
        )
        sums[str(strip)] = [float(c.sum()) for c in counts] + _normal_equations(
            beam[mine & placed], away[mine & placed]
        )
    return sums


def _normal_equations(beam: NDArray[np.float64], away: NDArray[np.float64]) -> list[float]:
    """Sums of the projections across the beams, and of the lines from the trajectory projected so."""
    across = np.eye(3) - beam[:, :, None] * beam[:, None, :]
    whole, lines = across.sum(axis=0), (across @ away[..., None]).sum(axis=0)[:, 0]
    return [*whole[np.triu_indices(3)].tolist(), *lines.tolist()]


def by_strip(parts: Iterable[Mapping[str, Sequence[float]]]) -> dict[int, NDArray[np.float64]]:
    """The sums of all `parts` (`strip_sums`) by number of the strip, float64 (16,): `COUNTS` [echoes], then
    the normal equations [m]."""
    total: dict[int, NDArray[np.float64]] = {}
    for part in parts:
        for strip, sums in part.items():
            total[int(strip)] = total.get(int(strip), 0.0) + np.asarray(sums, np.float64)
    return dict(sorted(total.items()))


def displacement(sums: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Where the trajectory lies from where the beams come from (3,) [m]; 0 in directions that they do not tell, None of
    fewer than 100 beams."""
    at = len(COUNTS)
    if sums[COUNTS.index("placed")] < 100:
        return None
    whole = np.zeros((3, 3))
    whole[np.triu_indices(3)] = sums[at : at + 6]
    whole = whole + np.triu(whole, 1).T
    return -np.linalg.pinv(whole, rcond=WELL_KNOWN, hermitian=True) @ sums[at + 6 : at + 9]


def faults(
    total: Mapping[int, NDArray[np.float64]],
    calibration: Calibration,
    names: Mapping[int, str],
    sound: RadiometrySoundParams,
    flown: bool,
) -> list[str]:
    """What no sound survey shows, a sentence each.

    Parameters
    ----------
    total : of `by_strip`, float64 (16,) a strip. names : of the strips, by number.
    flown : there is a trajectory or an altitude, so that every echo should have a range [m].
    """
    said = []

    def name(strip: int) -> str:
        return names.get(strip, str(strip))

    for strip, sums in total.items():
        rows, without, astray, judged, bright, dark, _ = sums[: len(COUNTS)].tolist()
        if flown and without > sound.max_without_range * rows:
            said.append(
                f"{name(strip)}: {without:,.0f} of {rows:,.0f} echoes have no range: no fix of the trajectory is "
                "at their times (radiometry.max_time_gap), or the platform lies below them"
            )
        if astray > sound.max_astray * rows:
            said.append(
                f"{name(strip)}: {astray:,.0f} of {rows:,.0f} echoes are more than {FARTHEST / 1000:g} km from "
                f"the trajectory, or {STEEPEST:g}° and more off its plumb line: its system, axes, unit or heights"
            )
        elif (away := displacement(sums)) is not None and float(np.linalg.norm(away)) > sound.displaced:
            x, y, z = away.tolist()
            said.append(
                f"{name(strip)}: the trajectory lies {x:+.1f}, {y:+.1f}, {z:+.1f} m (x, y, z) from where the beams "
                "come from: its heights (undulation), its clock, or its coordinate system"
            )
        for count, words in ((bright, f"above {sound.brightest:g}"), (dark, f"below {sound.darkest:g}")):
            if judged and count > sound.max_impossible * judged:
                said.append(
                    f"{name(strip)}: {100 * count / judged:.0f} % of the reflectances are {words} dB, which no surface "
                    "has: the target's reflectance, radiometry.calibration or divergence (mrad)"
                )
    for pair in calibration.pairs:
        if abs(pair.residual) > sound.max_residual:
            said.append(
                f"{name(pair.first)} and {name(pair.second)} differ by a factor {math.exp(abs(pair.residual)):.2f} "
                "after their gains were taken off: did a gain change within a strip (AGC)?"
            )
    return said + _target_faults(calibration, name, sound)


def altitude_faults(sensors: Mapping[str, tuple[float, float]], params: RadiometryParams) -> list[str]:
    """Where `platform_altitude` is not the height that beams come from, a sentence each.

    `sensors`: by name of the strip, the height of the sensor as its beams tell, and of what it saw [m].
    """
    altitude, most = params.platform_altitude, params.sound.max_altitude_ratio
    if altitude is None:
        return []
    return [
        f"{name}: the beams of neighbouring pulses meet at {height:,.0f} m, {height - seen:,.0f} m above the first "
        f"samples, where the sensor was; radiometry.platform_altitude is {altitude:,.0f} m: it is a height in the "
        "survey's system, in metres, and none above ground"
        for name, (height, seen) in sensors.items()
        if not (height - seen) / most <= altitude - seen <= (height - seen) * most
    ]


def _target_faults(calibration: Calibration, name: Any, sound: RadiometrySoundParams) -> list[str]:
    """What the echoes on the target say against each other."""
    said = []
    if calibration.target_spread is not None and calibration.target_spread > sound.max_target_spread:
        said.append(
            f"the echoes on the target scatter by a factor {math.exp(calibration.target_spread):.2f}: it is no single "
            "surface (radiometry.target)"
        )
    levels = dict(calibration.target_levels)
    if len(levels) > 1:
        low, high = min(levels, key=levels.__getitem__), max(levels, key=levels.__getitem__)
        if levels[high] - levels[low] > sound.max_residual:
            said.append(
                f"the target is {math.exp(levels[high] - levels[low]):.2f} times as bright in {name(high)} as in "
                f"{name(low)}: bring the strips to one gain (radiometry.balance)"
            )
    return said
