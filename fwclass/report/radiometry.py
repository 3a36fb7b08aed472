"""Whether a run's trajectory and calibration can be those of its echoes: told, and judged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fwclass.errors import refuse_unsound
from fwclass.radiometry.calibration import Calibration
from fwclass.radiometry.params import RadiometryParams
from fwclass.radiometry.soundness import altitude_faults, by_strip, faults
from fwclass.survey.layout import Strip


def radiometry_facts(
    metas: Iterable[Mapping[str, Any]],
    calibration: Mapping[str, Any] | None,
    strips: Iterable[Strip],
    params: RadiometryParams,
    flown: bool,
    sensors: Mapping[str, tuple[float, float]],
) -> dict[str, Any] | None:
    """``implausible``: what no sound survey shows (`soundness.faults`); None without radiometry.

    `metas`: of the parts `radiometry`. `calibration`: of the part `calibrate`. `flown`: a trajectory, or an altitude,
    is given. `sensors`: by name of the strip, what `altitude_faults` holds the altitude against [m].
    """
    total = by_strip(meta["sums"] for meta in metas)
    if not total:
        return None
    calibrated = Calibration.from_json(calibration) if calibration is not None else Calibration()
    said = faults(total, calibrated, {s.number: s.path.name for s in strips}, params.sound, flown)
    return {"implausible": said + altitude_faults(sensors, params)}


def judge_radiometry(said: Sequence[str], accepted: bool, where: object) -> None:
    """`QualityError` of what is ``implausible``; nothing where there is none, or the user accepts it."""
    refuse_unsound(
        said,
        accepted,
        "trajectory or calibration are not those of the echoes",
        where,
        expected="what radiometry.sound allows (docs/radiometry.md)",
        do="mend them",
    )
