"""What a report tells of waveforms: the system's pulse, how plausible the echoes are, a few pulses to draw."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from fwclass.conf import Config
from fwclass.decompose.plausible import add_counts
from fwclass.graph.sources import waveforms_of
from fwclass.report.facts import metas_of_run, receipts_of_run
from fwclass.report.plausibility import UNREADABLE, receiver_facts, strip_plausibility
from fwclass.report.plausibility_remarks import plausibility_remarks
from fwclass.report.radiometry import radiometry_facts
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner
from fwclass.store.receipts import Receipt
from fwclass.survey.layout import Survey
from fwclass.waveforms import IMPLAUSIBLE

WAVES = 6
"""So many pulses are drawn."""

SHOWN_SAMPLES = 400
"""Of a long waveform so many are drawn."""


def waveform_facts(runner: Runner, survey: Survey) -> dict[str, Any] | None:
    """The system's pulse of every strip with waveforms, and how radiometry was calibrated."""
    pulses = {r.part: r.meta for r in receipts_of_run(runner, "pulse") if r.meta["sampled"]}
    calibration: dict[str, Any] | None = next(iter(metas_of_run(runner, "calibrate", "calibration")), None)
    balanced = {s["strip"]: s["gain"] for s in (calibration or {}).get("strips", ()) if s["error"] is not None}
    strips = [
        {"name": s.path.stem, **pulses[f"{s.number:05d}"], "gain": balanced.get(s.number)}
        for s in survey.strips
        if f"{s.number:05d}" in pulses
    ]
    if not strips:
        return None
    metas = [r.meta for r in receipts_of_run(runner, "radiometry")]
    angles = [m["pointing_error"] for m in metas if m["pointing_error"] is not None]
    return {
        "strips": strips,
        "calibration": calibration,
        "without_range": sum(m["without_range"] for m in metas),
        "pointing_error": max(angles, default=None),
    }


def plausibility_of_run(runner: Runner, survey: Survey, config: Config) -> dict[str, Any] | None:
    """What the echoes of every strip with waveforms look like beside its returns; None without waveforms."""
    noise = {r.part: r.meta for r in receipts_of_run(runner, "pulse") if r.meta["sampled"]}
    places = {r.part: r.meta["places"] for r in receipts_of_run(runner, "places")}
    counts: dict[str, list[dict[str, int]]] = {}
    for receipt in receipts_of_run(runner, "decompose"):
        counts.setdefault(receipt.part.split("-")[0], []).append(receipt.meta["plausibility"])
    returns, pulses, faults = Counter[str](), Counter[str](), dict[str, Counter[str]]()
    for receipt in receipts_of_run(runner, "read"):
        part = receipt.part.split("-")[0]
        returns[part] += receipt.meta["returns"]
        pulses[part] += receipt.meta["waveforms"] + sum(receipt.meta["faults"].get(name, 0) for name in UNREADABLE)
        faults.setdefault(part, Counter()).update(receipt.meta["faults"])
    parts = [(s.path.stem, f"{s.number:05d}") for s in survey.strips]
    strips = [
        strip_plausibility(
            name,
            returns[part],
            add_counts(counts[part]),
            receiver_facts(noise[part]),
            places.get(part),
            faults.get(part),
            pulses[part],
        )
        for name, part in parts
        if part in noise and part in counts
    ]
    if not strips:
        return None
    return {
        "strips": strips,
        "remarks": plausibility_remarks(strips, config.decompose),
        "accepted": config.plausibility.accept,
    }


def radiometry_of_run(runner: Runner, survey: Survey, config: Config) -> dict[str, Any] | None:
    """What no sound radiometry shows (`radiometry_facts`); None without radiometry."""
    trajectory = bool(config.survey.trajectory.files)
    return radiometry_facts(
        (r.meta for r in receipts_of_run(runner, "radiometry")),
        next(iter(metas_of_run(runner, "calibrate", "calibration")), None),
        survey.strips,
        config.radiometry,
        trajectory or config.radiometry.platform_altitude is not None,
        {} if trajectory else _sensors(runner, survey),
    )


def _sensors(runner: Runner, survey: Survey) -> dict[str, tuple[float, float]]:
    """Heights of the sensor and of what it saw [m], by strip that tells them."""
    indexed = {r.part: sensor for r in receipts_of_run(runner, "index") if (sensor := r.meta.get("sensor"))}
    return {s.path.name: (indexed[s.key][0], indexed[s.key][1]) for s in survey.strips if s.key in indexed}


def some_waves(reads: Sequence[Receipt], decomposed: set[str], inputs: PartInputs) -> list[dict[str, Any]]:
    """A few pulses of the first span with waveforms, from simple ones to those with most echoes.

    Returns dicts with ``strip, pulse``; ``start, spacing`` of the samples [ns]; ``samples`` [DN]; ``baseline`` [DN];
    ``echoes``: (time [ns], amplitude [DN], width [ns]) each.
    """
    span = next((r.part for r in reads if r.meta.get("waveforms") and r.part in decomposed), None)
    if span is None:
        return []
    waves = waveforms_of(span, inputs, returns=False)
    columns = ("pulse", "time", "amplitude", "width", "baseline", "fit_flags")
    echoes = inputs.table("decompose", span, columns)
    whole = np.logical_and.reduce([np.isfinite(echoes[n]) for n in columns[1:5]])  # an echo without a fit has no curve
    fitted = np.flatnonzero(whole & (echoes["fit_flags"] & IMPLAUSIBLE == 0))
    numbers, counts = np.unique(echoes["pulse"][fitted], return_counts=True)
    single = np.isin(numbers, waves.pulses["pulse"])
    numbers, counts = numbers[single], counts[single]
    order = np.lexsort((numbers, counts))
    if not len(order):
        return []
    places = np.unique(np.linspace(0, len(order) - 1, WAVES).round().astype(int))
    pulses = []
    for pulse in numbers[order[places]].tolist():
        row = int(np.searchsorted(waves.pulses["pulse"], pulse))
        mine = fitted[echoes["pulse"][fitted] == pulse]
        samples = waves.samples[waves.offsets[row] : waves.offsets[row + 1]][:SHOWN_SAMPLES]
        pulses.append(
            {
                "strip": int(span.split("-")[0]),
                "pulse": pulse,
                "start": float(waves.pulses["segment_start"][row]),
                "spacing": float(waves.pulses["sample_spacing"][row]),
                "samples": samples.tolist(),
                "baseline": round(float(echoes["baseline"][mine[0]]), 2),
                "echoes": [[round(float(echoes[c][k]), 3) for c in ("time", "amplitude", "width")] for k in mine],
            }
        )
    return pulses
