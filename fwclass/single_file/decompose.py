"""`fwclass decompose`: the waveforms of one file to echoes in one LAZ file, without a run directory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fwclass import conf
from fwclass.classes import LOW_NOISE
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.pulse_estimate import describe
from fwclass.decompose.stage import VENDOR_KEPT
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.decompose.water_column import water_counts, water_facts, water_words
from fwclass.errors import ConfigError, InputError, visible
from fwclass.features.params import NORMAL
from fwclass.formats.area_of_use import place_facts
from fwclass.formats.flat import refuse_source, refuse_unless_flat
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.graph.radiometry import flight_of
from fwclass.grid import Tile
from fwclass.publish.files import check_free
from fwclass.publish.laz import without, write_tile_laz
from fwclass.radiometry import soundness
from fwclass.radiometry.calibration import calibrate
from fwclass.radiometry.overlap import overlap
from fwclass.radiometry.params import RadiometryParams
from fwclass.radiometry.ranges import check_pointing, pointing_error
from fwclass.radiometry.soundness import altitude_faults
from fwclass.radiometry.stage import radiometry
from fwclass.read.beams import sensor_height
from fwclass.read.projection import is_brought, to_project
from fwclass.read.source import open_source, refuse_other_system
from fwclass.read.stage import check_source
from fwclass.report.plausibility import strip_plausibility
from fwclass.report.plausibility_remarks import plausibility_remarks
from fwclass.report.pulse_remarks import descriptor_words
from fwclass.report.repeated import repeated_in_file
from fwclass.schema import Table
from fwclass.single_file.strip import strip_of
from fwclass.single_file.tiles import FileConfig, FileTiles, with_noise_flags
from fwclass.stage import Chunk
from fwclass.store.unchanged import check_unchanged
from fwclass.survey.systems import given_crs
from fwclass.waveforms import IMPLAUSIBLE

SECTIONS = ("read", "pulse", "decompose", "bathymetry", "plausibility", "features", "radiometry", "publish")
"""Sections of the configuration that the command obeys."""

DOUBTFUL = 1.0
"""Angle between beams and trajectory [deg] that is told as a fault."""

EVERYTHING = 1e9
"""Edge of the one tile [m]."""


def refuse_existing(output: Path, overwrite: bool) -> None:
    """`ConfigError` if `output` is not a LAZ file that may be written."""
    if output.suffix.lower() != ".laz":
        raise ConfigError(
            "the output is a LAZ file", where=output, expected="a name that ends in .laz", got=output.suffix or "none"
        )
    if not output.parent.is_dir():
        raise ConfigError("the output's directory does not exist", where=output.parent, do="make it first")
    check_free(output, overwrite)


def decompose_file(
    source: Path,
    output: Path,
    settings: tuple[str, ...],
    overwrite: bool,
    trajectory: Path | None = None,
    undulation: float = 0.0,
    crs: str | None = None,
) -> tuple[str, dict[str, Any]]:
    """Waveforms of one file to echoes in one LAZ file; returns the summary, and what `judge_echoes` judges.

    `settings` are ``section.key=value`` of `SECTIONS`. The echoes of the whole file are held in memory. Where
    something tells how far the sensor was (`trajectory`, ``radiometry.platform_altitude``, the format itself), the
    echoes carry range, incidence, cross-section, backscatter and reflectance. `undulation` [m] is taken from the
    trajectory's heights; `crs` replaces the one that the file names, and is what its places and beams are brought into
    where that one is in degrees or geocentric.
    """
    refuse_existing(output, overwrite)
    params = _params(settings)
    with check_unchanged(source, trajectory):
        opened = open_source(source)
        if is_brought(opened.crs):
            crs = crs or params["read"].project_to
        system = given_crs(crs, "--crs") if crs is not None else opened.crs
        if to_project(opened, system):
            settings += (f"read.project_to={json.dumps(crs)}",)
            params = _params(settings)
        else:
            refuse_source(opened, system)
        refuse_other_system(opened, system)
        check_source(opened, params["read"])
        fit: DecomposeParams = params["decompose"]
        with strip_of(opened, settings) as strip:
            tables = list(strip.echoes())
            pulse, pulses, noise = strip.pulse(), strip.pulses, strip.noise()
            faults, counts, places = strip.faults(), strip.counts(), strip.places()
        if not tables:
            raise InputError(
                "the file has no points and no pulses",
                where=source,
                do="check the delivery; there is nothing to decompose",
            )
        table, place = Table.concat(tables), None
        if table.rows:
            ends = [[float(f(table[a])) for a in "xyz"] for f in (np.min, np.max)]
            refuse_unless_flat(system, ends[0], ends[1], source, max(opened.scales[:2]))
            place = place_facts(system, ends[0], ends[1], own=opened.crs, of_file=opened.faults)
        flown = read_flight(table, trajectory, system, undulation) if trajectory is not None else None
        whole, notes, odd_radiometry = add_radiometry(table, flown, params, trajectory)
    implausible = (table["fit_flags"] & IMPLAUSIBLE) > 0
    delivered = whole.with_columns({"classification": np.where(implausible, LOW_NOISE, table["source_class"])})
    shown = without(delivered, () if params["radiometry"].calibrates else ("reflectance",))
    write_tile_laz(shown, output, system, params["publish"], standard_time=opened.standard_gps_time)
    near, plausibility = (
        fit.vendor_tolerance,
        strip_plausibility(source.stem, opened.n_points, counts, noise, places, faults, opened.n_records),
    )
    if trajectory is None and (sensor := sensor_height(opened)) is not None:
        odd_radiometry += altitude_faults({source.name: sensor}, params["radiometry"])
    lone = plausibility["returns_without_echo"]
    read_from = f"{opened.n_points:,} returns" if opened.n_points else f"{pulses:,} pulses"
    repeated = repeated_in_file(table, source.name)
    water = water_facts(water_counts(table)) if "water" in table else None
    rows = [
        *_summary(table, read_from),
        *([_pulse_words(pulse)] if opened.has_waves else []),
        *([f"water: {water_words(water)}", *water["remarks"]] if water else []),
        *([f"{lone:,} returns have no echo within {near:g} ns (decompose.vendor_tolerance)"] if lone else []),
        *(f"plausibility: {text}" for text in plausibility_remarks([plausibility], fit)),
        *notes,
        *(f"fault: {text}" for text in odd_radiometry),
        *(place["remarks"] if place else ()),
        *(repeated["remarks"] if repeated else ()),
        *(f"fault: {name}: {count:,}" for name, count in sorted(faults.items()) if count),
        f"written: {visible(output)}",
    ]
    judged = {"plausibility": plausibility, "place": place, "repeated": repeated, "radiometry": odd_radiometry}
    return "\n".join(rows), judged


def _params(settings: tuple[str, ...]) -> dict[str, Any]:
    """The sections that the command obeys, changed by `settings`."""
    conf.check_settings(settings, SECTIONS)
    return {name: conf.section(name, settings) for name in SECTIONS}


def _summary(table: Table, read_from: str) -> list[str]:
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
    origin = f"from {pulse.echoes:,} echoes" if pulse.echoes else "not measured: too few bright single echoes"
    origin = f"from {pulse.outgoing:,} recorded outgoing pulses" if pulse.outgoing else origin
    noise = ", ".join(f"{c.noise:.2f}" for c in pulse.channels)
    error = f"{facts['shape_error']:.2%}" if pulse.shape_error > 0.0 else "below the noise"
    words = f"system pulse: {pulse.shape}, {pulse.fwhm:.2f} ns wide ({origin}), shape error {error}"
    own = "".join(
        f"; {c.pulse.fwhm:.2f} ns of samples up to {c.saturation:g} DN each {c.sample_spacing:g} ns"
        + (f", {descriptor_words(c.receivers)}" if c.receivers else "")
        for c in pulse.channels
        if c.pulse
    )
    steps = ", ".join(f"{step:g}" for step in sorted({c.step for c in pulse.channels if c.step > 1.0}))
    coarse = f"; samples are multiples of {steps} DN" if steps else ""
    return words + own + (f"; noise {noise} DN" if noise else "") + coarse


def add_radiometry(
    table: Table, flown: Table | None, params: dict[str, Any], where: Path | None
) -> tuple[Table, list[str], list[str]]:
    """`table` with the radiometric columns, what is to be said of them, and what no sound survey shows; as it is where
    no range is known."""
    settings: RadiometryParams = params["radiometry"]
    known = np.isfinite(table["beam_range"]).any()
    if flown is None and settings.platform_altitude is None and not known:
        return table, ["no radiometry: give --trajectory, or --set radiometry.platform_altitude=…, for ranges"], []
    config = FileConfig((), features=params["features"])
    tiles = FileTiles(with_noise_flags(table, config), config, (COMPUTE_FEATURES,), held=0)
    whole = table.with_columns(tiles.columns(COMPUTE_FEATURES, NORMAL))
    chunk = Chunk(whole, np.arange(table.rows), Tile(0, 0, EVERYTHING))
    compared = [overlap(chunk, flown, settings)] if settings.target is not None else []
    calibration = calibrate(compared, settings)
    columns = radiometry(chunk, flown, calibration, settings)
    without = int(np.isnan(columns["range"]).sum())
    if without == table.rows:
        raise ConfigError(
            "no echo has a range",
            where=where or "radiometry.platform_altitude",
            expected=f"an altitude above the echoes (z from {table['z'].min():.1f} to {table['z'].max():.1f} m)"
            if flown is None
            else "fixes at the echoes' times, not further apart than radiometry.max_time_gap",
            do="correct it, or leave it out to go without radiometry",
        )
    notes = [f"radiometry: C_cal {calibration.constant:.4g} ({calibration.source}), {without:,} echoes without a range"]
    if flown is not None:
        angle = pointing_error(chunk.table, flown, settings)
        check_pointing(angle, where)
        sentences = (
            f"{angle:.3f} degrees (median)"
            if np.isfinite(angle)
            else "an unknown angle: no echo has a position in time"
        )
        notes.append(f"trajectory: beams point at it to {sentences}")
        if angle > DOUBTFUL:
            notes.append("fault: that is too much: check the trajectory's clock (UTC is not GPS time) and heights")
    given = flown is not None or settings.platform_altitude is not None
    sums = soundness.by_strip([soundness.strip_sums(table, flown, columns, np.isfinite(table["beam_x"]), settings)])
    odd = soundness.faults(sums, calibration, dict.fromkeys(sums, "the file"), settings.sound, given)
    return table.with_columns(columns), notes, odd


def read_flight(table: Table, path: Path, crs: Any, undulation: float) -> Table:
    """The trajectory in the file at `path`, in the time of the pulses of `table`."""
    times = table["gps_time"][np.isfinite(table["gps_time"])]
    ends = (float(times.min()), float(times.max())) if len(times) else (np.nan, np.nan)
    return flight_of(path, crs, undulation, ends)
