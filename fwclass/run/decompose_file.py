"""`fwclass decompose`: the waveforms of one file to echoes in one LAZ file, without a run directory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fwclass import conf
from fwclass.decompose.pulse_estimate import PulseParams, describe, estimate_pulse, join_samples, sample_pulses
from fwclass.decompose.stage import VENDOR_KEPT, decompose
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.errors import ConfigError, InputError
from fwclass.features.stage import NORMAL, FeaturesParams, features
from fwclass.grid import Tile
from fwclass.publish.laz import write_tile_laz
from fwclass.radiometry.stage import RadiometryParams, calibrate, overlap, pointing_error, radiometry
from fwclass.read.source import Source, open_source
from fwclass.read.spans import Span
from fwclass.read.stage import ReadParams, check_source, index_source, read_span
from fwclass.read.trajectory import in_survey_time, read_trajectory
from fwclass.schema import Table
from fwclass.stage import Chunk

SECTIONS = ("read", "pulse", "decompose", "features", "radiometry", "publish")
"""Sections of the configuration that the command obeys."""

EVERYTHING = 1e9
"""Edge of the one tile [m]."""


def refuse_existing(output: Path, overwrite: bool) -> None:
    """`ConfigError` if `output` is not a LAZ file that may be written."""
    if output.suffix.lower() != ".laz":
        raise ConfigError(
            "the output is a LAZ file", where=output, expected="a name that ends in .laz", got=output.suffix or "none"
        )
    if output.exists() and not output.is_file():
        raise ConfigError("the output is not a file", where=output, do="choose another name")
    if not output.parent.is_dir():
        raise ConfigError("the output's directory does not exist", where=output.parent, do="make it first")
    if output.exists() and not overwrite:
        raise ConfigError("the output exists", where=output, do="choose another name, or add --overwrite")


def decompose_file(
    source: Path, output: Path, settings: tuple[str, ...], overwrite: bool, trajectory: Path | None = None
) -> str:
    """Waveforms of one file to echoes in one LAZ file; returns the summary.

    `settings` are ``section.key=value`` of `SECTIONS`. The echoes of the whole file are held in memory. Where
    something tells how far the sensor was (`trajectory`, ``radiometry.platform_altitude``, the format itself), the
    echoes carry range, incidence, cross-section, backscatter and reflectance.
    """
    refuse_existing(output, overwrite)
    params = _params(settings)
    opened = open_source(source)
    check_source(opened, params["read"])
    spans = index_source(opened, params["read"])
    pulse = pulse_of_file(opened, spans, params["read"], params["pulse"])
    tables, faults = [], dict[str, int]()
    for span in spans:
        waves = read_span(opened, span, params["read"])
        tables.append(decompose(waves, 0, params["decompose"], pulse)[0])
        for name, count in waves.faults.items():
            faults[name] = faults.get(name, 0) + int(count)
    if not tables:
        raise InputError(
            "the file has no points and no pulses",
            where=source,
            do="check the delivery; there is nothing to decompose",
        )
    table = Table.concat(tables)
    ranged, notes = _ranged(table, opened, trajectory, params)
    delivered = ranged.with_columns({"classification": table["source_class"]})
    write_tile_laz(delivered, output, opened.crs, params["publish"], standard_time=opened.standard_gps_time)
    pulses = sum(s.n_pulses for s in spans)
    read_from = f"{opened.n_points:,} returns" if opened.n_points else f"{pulses:,} pulses"
    rows = [
        *_told(table, read_from),
        *([_pulse_words(pulse)] if opened.has_waves else []),
        *notes,
        *(f"fault: {name}: {count:,}" for name, count in sorted(faults.items()) if count),
        f"written: {output}",
    ]
    return "\n".join(rows)


def _params(settings: tuple[str, ...]) -> dict[str, Any]:
    """The sections that the command obeys, changed by `settings`."""
    for text in settings:
        if text.split(".")[0].strip() not in SECTIONS:
            raise ConfigError(
                "this setting has no effect here", where=f"--set {text}", expected=f"a key of {', '.join(SECTIONS)}",
                got=text.split("=")[0], do="leave it out, or use `fwclass run`",
            )  # fmt: skip
    return {name: conf.section(name, settings) for name in SECTIONS}


def _told(table: Table, read_from: str) -> list[str]:
    """What became of the file, in words."""
    unseen = int((table["fit_flags"] & VENDOR_KEPT > 0).sum())
    fitted, kept, read = (int(n) for n in np.bincount(table["origin"], minlength=3)[:3])
    parts = (
        (fitted - unseen, "fitted"),
        (unseen, "returns kept whose waveform shows no echo"),
        (kept, "returns kept without waveform"),
        (read, "read as echoes"),
    )
    return [f"{table.rows:,} echoes from {read_from}: " + ", ".join(f"{n:,} {what}" for n, what in parts if n)]


def _pulse_words(pulse: SystemPulse) -> str:
    facts = describe(pulse)
    origin = f"from {pulse.echoes:,} echoes" if pulse.echoes else "given"
    noise = ", ".join(f"{c.noise:.2f}" for c in pulse.channels)
    told = f"system pulse: {pulse.shape}, {pulse.fwhm:.2f} ns wide ({origin}), shape error {facts['shape_error']:.2%}"
    return told + (f"; noise {noise} DN" if noise else "")


def _ranged(table: Table, source: Source, trajectory: Path | None, params: dict[str, Any]) -> tuple[Table, list[str]]:
    """`table` with the radiometric columns, and what is to be said of them; as it is where no range is known."""
    settings: RadiometryParams = params["radiometry"]
    known = np.isfinite(table["beam_range"]).any()
    if trajectory is None and settings.platform_altitude is None and not known:
        return table, []
    flown = _flown(table, source, trajectory) if trajectory is not None else None
    chunk = Chunk(table, np.arange(table.rows), Tile(0, 0, EVERYTHING))
    shape: FeaturesParams = params["features"]
    chunk = Chunk(table.with_columns(features(chunk, shape).select(NORMAL)), chunk.core, chunk.tile)
    compared = [overlap(chunk, flown, settings)] if settings.target is not None else []
    found = calibrate(compared, settings)
    made = radiometry(chunk, flown, found, settings)
    without = int(np.isnan(made["range"]).sum())
    notes = [f"radiometry: C_cal {found.constant:.4g} ({found.source}), {without:,} echoes without a range"]
    if flown is not None:
        angle = pointing_error(chunk.table, flown, settings)
        notes.append(f"trajectory: beams point at it to {angle:.3f} degrees (median)")
    return table.with_columns(made), notes


def _flown(table: Table, source: Source, path: Path) -> Table:
    times = table["gps_time"][np.isfinite(table["gps_time"])]
    ends = (float(times.min()), float(times.max())) if len(times) else (np.nan, np.nan)
    return in_survey_time(read_trajectory(path, source.crs), *ends, where=path)


def pulse_of_file(source: Source, spans: Sequence[Span], read: ReadParams, params: PulseParams) -> SystemPulse:
    """The system's pulse as a file's own waveforms show it; a first pass over the file."""
    total = sum(s.n_pulses for s in spans)
    samples = [sample_pulses(read_span(source, s, read), 0, total, params) for s in spans]
    if not samples:
        return SystemPulse.gaussian(params.fallback_width)
    return estimate_pulse(join_samples(samples), params)
