"""Stages that read: the index of every strip, its system pulse, and the echoes of its spans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from fwclass.decompose.copies import estimate_single_pulse, of_sure_copies
from fwclass.decompose.envelope import Envelope
from fwclass.decompose.params import BathymetryParams, DecomposeParams, PulseParams
from fwclass.decompose.place_estimate import join_runs, measure_placement, sample_runs
from fwclass.decompose.placement import Placement, describe_placement
from fwclass.decompose.plausible import UNKNOWN, Surroundings
from fwclass.decompose.pulse_channels import noise_drift
from fwclass.decompose.pulse_estimate import describe
from fwclass.decompose.pulse_sample import join_samples, outgoing_of, sample_pulses, with_signal
from fwclass.decompose.quiet import QuietNoise, quiet_noise, with_correlated_noise
from fwclass.decompose.recorded_pulse import channel_pulses, recorded_pulse
from fwclass.decompose.recovery import recovered, with_recovery
from fwclass.decompose.sample_parity import even_gains
from fwclass.decompose.signal_noise import with_misfit, with_signal_noise
from fwclass.decompose.stage import DECOMPOSE, LINK_COLUMNS, PLACES, PULSE, decompose
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.decompose.water_column import water_counts
from fwclass.decompose.width_walk import bright_widths, width_drift, width_walk
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.read.base import Source
from fwclass.read.beams import sensor_height
from fwclass.read.las import LasSource
from fwclass.read.params import ReadParams
from fwclass.read.return_counts import count_returns
from fwclass.read.source import PulseSource, open_source
from fwclass.read.spans import Span
from fwclass.read.stage import READ, index_source, read_span, with_settings
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.run.part import Name
from fwclass.schema import Table
from fwclass.store.arrays import write_arrays
from fwclass.store.atomic import read_json, write_json
from fwclass.store.remote_file import Location
from fwclass.store.tables import write_table
from fwclass.survey.layout import FileDigests, Strip
from fwclass.tile.stage import count_times
from fwclass.waveforms import BATHYMETRY_COLUMNS, PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

RETURNS = "returns.parquet"
"""Of a span as it was read, in the order of the file."""

PULSE_FILE = "pulse.json"
PLACES_FILE = "places.json"
ENVELOPE = "envelope"

_ARRAYS = ("samples", "offsets", "outgoing", "outgoing_offsets")
"""What of `Waveforms` is stored as arrays."""


@dataclass(frozen=True)
class StripSpan:
    """A span of a strip, the `number`-th: `declared` to have waveforms, and with echoes that come of them (`waves`)."""

    strip: Strip
    number: int
    span: Span
    declared: bool
    waves: bool

    @property
    def key(self) -> str:
        """The name of its parts."""
        return span_name(self.strip.number, self.number)


def span_name(strip: int, span: int) -> str:
    """The name of a part for the `span`-th span of a strip."""
    return f"{strip:05d}-{span:05d}"


def index_name(strip: Strip) -> Name:
    """The part that indexes a strip."""
    return "index", strip.key


def spans_of(plan: Plan, strip: Strip) -> list[StripSpan]:
    """The spans that a strip's index cuts it into."""
    meta = plan.indexed[index_name(strip)].meta
    cut = [Span(a, b, first, pulses, tuple(shared)) for a, b, first, pulses, shared in meta["spans"]]
    declared = bool(meta["pulses"])
    return [StripSpan(strip, k, span, declared, declared and not plan.returns) for k, span in enumerate(cut)]


def _spans(plan: Plan) -> list[StripSpan]:
    return [span for strip in plan.survey.strips for span in spans_of(plan, strip)]


def _with_waves(plan: Plan) -> list[StripSpan]:
    return [s for s in _spans(plan) if s.waves]


def _strips_with_waves(plan: Plan) -> list[Strip]:
    return [] if plan.returns else strips_declared(plan)


def strips_declared(plan: Plan) -> list[Strip]:
    """The strips whose files have waveforms."""
    return [s for s in plan.survey.strips if plan.indexed[index_name(s)].meta["pulses"]]


def _decomposed(plan: Plan) -> bool:
    return not plan.returns


def _file(plan: Plan, part: Strip | StripSpan) -> tuple[Location, FileDigests]:
    strip = part if isinstance(part, Strip) else part.strip
    return strip.path, strip.digests


def index_strip(here: StageInputs, params: ReadParams) -> Result:
    """Cut a source file into spans that no pulse straddles."""
    source = open_source(here.file())
    spans = index_source(source, params)
    return {
        "spans": [[s.first_point, s.last_point, s.first_pulse, s.n_pulses, list(s.shared)] for s in spans],
        "points": source.n_points,
        "pulses": sum(s.n_pulses for s in spans) if source.has_waves else 0,
        "point_format": source.point_format,
        "from_outgoing": isinstance(source, PulseSource),
        "sensor": sensor_height(with_settings(source, params)),
        "stated": [list(counts) for counts in source.header.stated] if isinstance(source, LasSource) else [],
    }


def store_span(here: StageInputs, params: ReadParams, span: Span) -> Result:
    """Pulses, returns and waveforms of one span."""
    source = open_source(here.file())
    waves = read_span(source, span, params)
    write_table(here.directory / RETURNS, waves.returns)
    if waves.pulses.rows:
        write_table(here.directory / "pulses.parquet", waves.pulses)
        write_arrays(here.directory / "waveforms", {name: getattr(waves, name) for name in _ARRAYS})
    return _facts(waves, source)


def _facts(waves: Waveforms, source: Source) -> dict[str, Any]:
    """What was read, for a receipt."""
    return {
        "returns": waves.returns.rows,
        "withheld": int(waves.returns["withheld"].sum()),
        "waveforms": waves.pulses.rows,
        "returns_without_packet": int((~waves.returns["has_packet"]).sum()),
        "faults": {k: int(v) for k, v in sorted(waves.faults.items()) if v},
        "values": count_returns(waves.returns, waves.scan_angle, isinstance(source, LasSource) and source.is_copc),
    }


def waveforms_of(part: str, inputs: PartInputs, returns: bool = True) -> Waveforms:
    """A span as it was read; on request without its returns."""
    points = inputs.table("read", part, name=RETURNS) if returns else Table.empty(RETURN_COLUMNS)
    if not inputs.meta("read", part)["waveforms"]:
        return Waveforms(Table.empty(PULSE_COLUMNS), points, np.empty(0, np.uint8), np.zeros(1, np.int64))
    arrays, _ = inputs.arrays("read", part, "waveforms")
    pulses = inputs.table("read", part, name="pulses.parquet")
    return Waveforms(
        pulses,
        points,
        arrays["samples"],
        arrays["offsets"],
        outgoing=arrays["outgoing"],
        outgoing_offsets=arrays["outgoing_offsets"],
    )


def measure_pulse(here: StageInputs, params: PulseParams, fit: DecomposeParams) -> Result:
    """The system's pulse and the receiver of a strip, from a sample of its waveforms; the envelope of its returns."""
    parts, inputs, directory = here.parts("read"), here.inputs, here.directory
    strip, pulses = int(here.part), int(inputs.meta("index", here.part)["pulses"])
    samples, outgoing = [], []
    for part in parts:
        waves = waveforms_of(part, inputs, returns=False)
        samples.append(sample_pulses(waves, strip, pulses, params))
        sent = np.isin(waves.pulses["pulse"], samples[-1].pulses["pulse"]) & (np.diff(waves.outgoing_offsets) > 0)
        outgoing.append(outgoing_of(waves, np.flatnonzero(sent)))
    sampled, noise = sum(s.pulses.rows for s in samples), UNKNOWN.noise
    pulse, recorded, unsettled = SystemPulse.gaussian(params.fallback_width), None, 0.0
    if samples:
        sample = with_signal(join_samples(samples))
        recorded = recorded_pulse(join_samples(outgoing), params)
        pulse = with_recovery(estimate_single_pulse(sample, params, fit, recorded), sample, fit)
        level, _ = recovered(of_sure_copies(sample, pulse), fit, pulse)
        pulse = with_correlated_noise(pulse, level, fit)
        pulse, unsettled = with_signal_noise(pulse, level, fit)
        pulse = with_misfit(pulse, level, fit)
    write_json(directory / PULSE_FILE, pulse.to_json())
    if sampled:
        noise = quiet_noise(level, pulse, fit)
        bright = bright_widths(even_gains(sample, pulse), params, pulse.channels)
        returns = (inputs.table("read", part, "xyz", RETURNS) for part in parts)
        envelope = Envelope.of(returns, fit.envelope_cell)
        ends = {n: v if np.isfinite(v) else None for n, v in (("bottom", envelope.bottom), ("top", envelope.top))}
        attributes = {"cell": fit.envelope_cell, **ends, **asdict(noise)}
        write_arrays(directory / ENVELOPE, {"keys": envelope.keys, "lowest": envelope.lowest}, attributes)
    return {
        "pulse": describe(pulse),
        "noise": max((c.noise for c in pulse.channels), default=None),
        "channels": channel_pulses(pulse, recorded, fit),
        "widths": width_walk(bright, params) if sampled else [],
        "drift": width_drift(bright, params) if sampled else [],
        "noise_drift": noise_drift(sample) if sampled else [],
        "sampled": sampled,
        "unsettled": unsettled,
        **noise.facts,
    }


def pulse_of(strip: int, inputs: PartInputs) -> SystemPulse:
    """The system's pulse of a strip, as `measure_pulse` stored it."""
    return SystemPulse.from_json(read_json(inputs.path("pulse", f"{strip:05d}", PULSE_FILE)))


def measure_places(here: StageInputs, params: DecomposeParams, sample: int) -> Result:
    """What a strip tells of its places, from runs of about `sample` of its pulses."""
    inputs, index = here.inputs, here.inputs.meta("index", here.part)
    parts = here.parts("read")
    runs = join_runs(sample_runs(waveforms_of(p, inputs, returns=False), int(index["pulses"]), sample) for p in parts)
    pulse = pulse_of(int(here.part), inputs)
    placement = measure_placement(runs, index["points"] > 0, params, pulse, index["from_outgoing"])
    write_json(here.directory / PLACES_FILE, placement.to_json())
    return {"places": describe_placement(placement), "sampled": runs.pulses.rows}


def placement_of(strip: int, inputs: PartInputs) -> Placement:
    """How the echoes of a strip are placed, as `measure_places` stored it."""
    return Placement.from_json(read_json(inputs.path("places", f"{strip:05d}", PLACES_FILE)))


def surroundings_of(strip: int, inputs: PartInputs) -> Surroundings:
    """What the echoes of a strip are held against, as `measure_pulse` stored it."""
    part = f"{strip:05d}"
    if not inputs.meta("pulse", part)["sampled"]:
        return UNKNOWN
    arrays, facts = inputs.arrays("pulse", part, ENVELOPE)
    bottom, top = (np.nan if facts[n] is None else facts[n] for n in ("bottom", "top"))
    envelope = Envelope(facts["cell"], arrays["keys"], arrays["lowest"], bottom, top)
    return Surroundings(envelope, QuietNoise(**{f.name: facts[f.name] for f in fields(QuietNoise)}))


def strip_of(span: str) -> int:
    """The number of the strip that a span is of, as `span_name` has it."""
    return int(span.split("-")[0])


def asked_for_water(plan: Plan) -> dict[str, Any]:
    """The argument `bathymetry`, where the survey is asked for water."""
    return {"bathymetry": plan.config.bathymetry} if plan.config.bathymetry.enabled else {}


def water_columns(plan: Plan) -> tuple[str, ...]:
    """The columns that tell of water, where the survey is asked for it."""
    return BATHYMETRY_COLUMNS if plan.config.bathymetry.enabled else ()


def decompose_span(here: StageInputs, params: DecomposeParams, bathymetry: BathymetryParams | None = None) -> Result:
    """Echoes of a span, and the echo of every return."""
    strip = strip_of(here.part)
    waves = waveforms_of(here.part, here.inputs)
    pulse, around = pulse_of(strip, here.inputs), surroundings_of(strip, here.inputs)
    placement = placement_of(strip, here.inputs)
    return _write_echoes(here, decompose(waves, strip, params, pulse, around, placement, bathymetry))


def read_returns(
    here: StageInputs,
    params: DecomposeParams,
    reading: ReadParams,
    width: float,
    span: Span,
    left_aside: bool = False,
    bathymetry: BathymetryParams | None = None,
) -> Result:
    """As `store_span` and `decompose_span`, of a span without waveforms, or whose waveforms are `left_aside`: its
    returns are its echoes.

    `width`: of a pulse [ns] that nothing is fitted with.
    """
    source = open_source(here.file())
    waves = read_span(source, span, reading, waves=not left_aside)
    pulse = SystemPulse.gaussian(width)
    result = decompose(waves, strip_of(here.part), params, pulse, UNKNOWN, bathymetry=bathymetry)
    return {**_facts(waves, source), **_write_echoes(here, result)}


def _write_echoes(here: StageInputs, result: tuple[Table, Table, Mapping[str, int]]) -> dict[str, Any]:
    echoes, links, counts = result
    write_table(here.directory / TABLE, echoes)
    write_table(here.directory / "links.parquet", links)
    origin = echoes["origin"]
    return {
        "returns_without_echo": counts["returns_without_echo"],
        "plausibility": counts,
        "echoes": echoes.rows,
        "fitted": int((origin == 0).sum()),
        "kept_returns": int((origin == 1).sum()),
        "read_as_echoes": int((origin == 2).sum()),
        "times": count_times(echoes),
        "without_width": int(np.isnan(echoes["width"]).sum()),
        **({"water": water_counts(echoes)} if "water" in echoes else {}),
    }


def link_table(inputs: PartInputs, part: str) -> Table:
    """Pulse and echo number of every return of a span, in file order."""
    return inputs.table("decompose", part, LINK_COLUMNS, "links.parquet")


INDEX = Stage(
    "index",
    5,
    "strip",
    "point",
    index_strip,
    parts=lambda plan: plan.survey.strips,
    source=_file,
    arguments=lambda plan: {"params": plan.config.read},
)
READ_SPAN = Stage(
    READ.name,
    READ.version,
    "chunk",
    "pulse",
    store_span,
    parts=_with_waves,
    waves=True,
    source=_file,
    arguments=lambda plan: {"params": plan.config.read},
    each=lambda plan, part: {"span": part.span},
    when=_decomposed,
    after=("index",),
)
MEASURE_PULSE = Stage(
    PULSE.name,
    PULSE.version,
    "strip",
    "pulse",
    measure_pulse,
    parts=_strips_with_waves,
    waves=True,
    arguments=lambda plan: {"params": plan.config.pulse, "fit": plan.config.decompose},
    when=_decomposed,
    after=("index", "read"),
    needs=lambda plan, strip: [index_name(strip), *(("read", s.key) for s in spans_of(plan, strip))],
)
MEASURE_PLACES = Stage(
    PLACES.name,
    PLACES.version,
    "strip",
    "pulse",
    measure_places,
    parts=_strips_with_waves,
    waves=True,
    arguments=lambda plan: {"params": plan.config.decompose, "sample": plan.config.pulse.sample},
    when=_decomposed,
    after=("index", "read", "pulse"),
    needs=lambda plan, strip: [
        index_name(strip),
        ("pulse", strip.key),
        *(("read", s.key) for s in spans_of(plan, strip)),
    ],
)
DECOMPOSE_WAVES = Stage(
    DECOMPOSE.name,
    DECOMPOSE.version,
    "chunk",
    "pulse",
    decompose_span,
    parts=_with_waves,
    waves=True,
    when=_decomposed,
    arguments=lambda plan: {"params": plan.config.decompose, **asked_for_water(plan)},
    after=("read", "pulse", "places"),
    needs=lambda plan, part: (("read", part.key), ("pulse", part.strip.key), ("places", part.strip.key)),
)
DECOMPOSE_RETURNS = Stage(
    DECOMPOSE.name,
    DECOMPOSE.version,
    "chunk",
    "pulse",
    read_returns,
    parts=lambda plan: [s for s in _spans(plan) if not s.waves],
    waves=False,
    source=_file,
    arguments=lambda plan: {
        "params": plan.config.decompose,
        "reading": plan.config.read,
        "width": plan.config.pulse.width or plan.config.pulse.fallback_width,
        **asked_for_water(plan),
    },
    each=lambda plan, part: {"span": part.span, **({"left_aside": True} if part.declared else {})},
    after=("index",),
)
