"""What a Pulse file and its Waves file hold and what is wrong with them, in one streaming pass."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.area_of_use import place_faults, time_faults
from fwclass.formats.crs import describe_crs
from fwclass.formats.flat import flat_faults
from fwclass.read.beams import beam_fault
from fwclass.read.pls_stated import misfit_of
from fwclass.read.pls_waves import FAULTS, SILENT, Pulses, Samplings, blocks_of, reach, waves_fault
from fwclass.read.pulsewaves import OUTGOING, RETURNING, PulseDescriptor, PulseSource
from fwclass.read.quantities import quantities_of, words_of
from fwclass.units import finite_or_none

_MOST_COUNTED = 16


@dataclass
class _Tally:
    """What the pass over the pulses adds up."""

    faults: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(FAULTS), np.int64))
    descriptors: NDArray[np.int64] = field(default_factory=lambda: np.zeros(256, np.int64))
    segments: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_MOST_COUNTED + 1, np.int64))
    low: NDArray[np.float64] = field(default_factory=lambda: np.full(3, np.inf))
    high: NDArray[np.float64] = field(default_factory=lambda: np.full(3, -np.inf))
    gps: tuple[float, float] = (np.inf, -np.inf)
    outgoing: int = 0
    misfit: str = ""

    def add(self, records: NDArray[Any], pulses: Pulses, kinds: Samplings) -> None:
        self.faults += np.bincount(pulses.fault, minlength=len(FAULTS))
        self.descriptors += np.bincount(records["bits"] & 0xFF, minlength=256)
        self.gps = min(self.gps[0], float(pulses.time.min())), max(self.gps[1], float(pulses.time.max()))
        parts = pulses.segments
        kind = kinds.kind[parts.sampling]
        self.outgoing += len(np.unique(parts.pulse[kind == OUTGOING]))
        parts = parts.take(kind == RETURNING)
        counts = np.bincount(parts.pulse, minlength=len(records))[(pulses.fault == 0) | (pulses.fault == SILENT)]
        self.segments += np.bincount(np.minimum(counts, _MOST_COUNTED), minlength=_MOST_COUNTED + 1)
        low, high = reach(pulses, kinds)
        self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)


def pulse_info(source: PulseSource) -> dict[str, Any]:
    """As `info.info`, of a file of pulses: the same keys, where they have a meaning, and ``pulses``, ``segments``,
    ``outgoing``. `bounds` are those of the first and last samples of all segments."""
    tally, kinds = _Tally(), Samplings.of(source)
    for records, pulses in blocks_of(source):
        tally.add(records, pulses, kinds)
        tally.misfit = tally.misfit or waves_fault(source, records["waves"], pulses)
        tally.misfit = tally.misfit or misfit_of(source, records, pulses, kinds)
    crs, header = source.crs, source.header
    return {
        "path": str(source.path),
        "size": source.size,
        "version": "{}.{}".format(*source.version),
        "point_format": None,
        "compressed": source.compressed,
        "copc": False,
        "system": header.system,
        "software": header.software,
        "points": 0,
        "pulses": source.n_records,
        "scales": list(source.scales),
        "offsets": list(source.offsets),
        "crs": describe_crs(crs),
        "bounds": [*tally.low.tolist(), *tally.high.tolist()] if np.isfinite(tally.low).all() else None,
        "header_bounds": [finite_or_none(v) for v in source.bounds],
        "gps_time": list(tally.gps) if np.isfinite(tally.gps).all() else None,
        "returns": {},
        "numbers_of_returns": {},
        "classes": {},
        "flags": {},
        "intensity": None,
        "extra_bytes": [],
        "quantities": quantities_of(source)._asdict(),
        "segments": {str(i): int(n) for i, n in enumerate(tally.segments) if n},
        "outgoing": tally.outgoing,
        "waveforms": {
            "where": source.waves.kind,
            "path": str(source.waves.path) if source.waves.path else None,
            "bytes": source.waves.available,
            "why_not": source.waves.why_not,
            "usable": int(tally.faults[0]),
            "unusable": {FAULTS[i]: int(n) for i, n in enumerate(tally.faults) if n and i},
            "descriptors": [
                {
                    "index": i,
                    "pulses": int(tally.descriptors[i]),
                    "unit_ns": finite_or_none(d.unit_ns),
                    "optical_centre_ns": finite_or_none(d.centre * d.unit_ns),
                    "samplings": _samplings(d),
                }
                for i, d in sorted(source.descriptors.items())
            ],
        },
        "faults": [
            *source.faults,
            *flat_faults(source, tally.low.tolist(), tally.high.tolist()),
            *place_faults(crs, tally.low.tolist(), tally.high.tolist()),
            *time_faults(*tally.gps),
            *_faults(source, tally),
            *filter(None, [tally.misfit]),
            *filter(None, [beam_fault(source)]),
        ],
    }


def _samplings(descriptor: PulseDescriptor) -> list[dict[str, Any]]:
    names = {OUTGOING: "outgoing", RETURNING: "returning"}
    return [
        {
            "type": names.get(s.kind, "unknown"),
            "channel": s.channel,
            "bits": s.bits,
            "spacing_ns": finite_or_none(s.spacing_ns),
            "samples": "varies" if s.length_bits else s.samples,
            "segments": "varies" if s.segment_bits else s.segments,
            "lookup_table": s.table,
        }
        for s in descriptor.samplings
    ]


def _faults(source: PulseSource, tally: _Tally) -> list[str]:
    n = source.n_records
    faults = [f"{c} of {n} pulses: {FAULTS[i]}" for i, c in enumerate(tally.faults) if c and 0 < i < SILENT]
    if n and not tally.faults[0]:
        faults.insert(0, "NO WAVEFORM CAN BE READ")
    if n and tally.faults[0] and not _inside(source, tally):
        faults.append("the header's bounds disagree with the samples")
    return faults


def _inside(source: PulseSource, tally: _Tally) -> bool:
    """The header's bounds hold all samples, to a metre."""
    low, high = np.array(source.bounds[:3]), np.array(source.bounds[3:])
    return bool((tally.low >= low - 1.0).all() and (tally.high <= high + 1.0).all())


def _outgoing_text(outgoing: int) -> str:
    """That a header does not tell whether times count from the outgoing pulse."""
    return "; whether times count from it the echoes tell (info --waveforms, decompose)" if outgoing else ""


def describe_pulses(info: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows of `info.describe` that tell of pulses."""
    waves = info["waveforms"]
    where = f"{waves['where']}, {waves['bytes']:,} bytes" if waves["where"] != "none" else waves["why_not"]
    counts = ", ".join(f"{key}: {n:,}" for key, n in info["segments"].items()) or "none"
    rows = [
        ("pulses", f"{info['pulses']:,}, {waves['usable']:,} with a usable returning waveform"),
        ("outgoing", f"{info['outgoing']:,} pulses with a recorded outgoing pulse{_outgoing_text(info['outgoing'])}"),
        ("segments", f"{counts}  (of a pulse)"),
        ("waveforms", where),
        ("amplitudes", words_of(info["quantities"]["amplitude"])),
        ("echo widths", words_of(info["quantities"]["width"])),
    ]
    for d in waves["descriptors"]:
        anchors = ", anchors at no fixed distance from the optical centre" if d["optical_centre_ns"] is None else ""
        rows.append(("descriptor", f"{d['index']}: {d['pulses']:,} pulses{anchors}"))
        for s in d["samplings"]:
            text = f"{s['type']}, {s['segments']} segments of {s['samples']} samples of {s['bits']} bits"
            rows.append(("", f"{text} every {s['spacing_ns']} ns"))
    return rows
