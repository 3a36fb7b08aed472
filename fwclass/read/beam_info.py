"""What a file of waveforms with a beam each holds and what is wrong; the pass that opened it counted all."""

from __future__ import annotations

from typing import Any

import numpy as np

from fwclass.formats.area_of_use import place_faults, time_faults
from fwclass.formats.crs import describe_crs
from fwclass.formats.flat import flat_faults
from fwclass.read.beam_source import FAULTS, BeamSource
from fwclass.read.beams import beam_fault
from fwclass.read.quantities import quantities_of, words_of

FEW = 8
"""A waveform of fewer samples shows no noise beside an echo."""


def beam_rows_info(source: BeamSource) -> dict[str, Any]:
    """As `info.info`: the same keys, where they have a meaning, and ``rows``, ``pulses``, ``outgoing``, ``format``."""
    census, crs, scaling = source.census, source.crs, source.scaling
    flat = bool(np.isfinite(source.bounds).all())
    return {
        "path": str(source.path),
        "size": source.size,
        "version": "",
        "format": source.kind,
        "point_format": None,
        "compressed": False,
        "copc": False,
        "system": "",
        "software": "",
        "points": 0,
        "rows": census.rows,
        "pulses": census.pulses,
        "scales": list(source.scales),
        "offsets": list(source.offsets),
        "crs": describe_crs(crs),
        "bounds": list(source.bounds) if flat else None,
        "header_bounds": None,
        "gps_time": list(census.gps) if np.isfinite(census.gps).all() else None,
        "returns": {},
        "numbers_of_returns": {},
        "classes": {},
        "flags": {},
        "intensity": None,
        "extra_bytes": [],
        "quantities": quantities_of(source)._asdict(),
        "outgoing": census.outgoing,
        "channels": sorted(census.channels),
        "notes": [list(note) for note in source.notes],
        "waveforms": {
            "where": source.waves.kind,
            "path": str(source.waves.path),
            "bytes": source.waves.available,
            "why_not": "",
            "usable": int(census.faults[0]),
            "unusable": {FAULTS[i]: int(n) for i, n in enumerate(census.faults) if n and i},
            "samples": list(census.lengths) if census.samples else None,
            "spacing_ns": list(census.spacing) if census.samples else None,
            "values": list(census.values) if census.samples else None,
            "saturation": scaling.top * scaling.step + scaling.low,
        },
        "faults": [
            *source.faults,
            *(flat_faults(source, source.bounds[:3], source.bounds[3:]) if flat else []),
            *place_faults(crs, source.bounds[:3], source.bounds[3:]),
            *time_faults(*census.gps),
            *_faults(source),
            *filter(None, [beam_fault(source)]),
        ],
    }


def _faults(source: BeamSource) -> list[str]:
    census = source.census
    faults = [f"{n} of {census.rows} rows: {FAULTS[i]}" for i, n in enumerate(census.faults) if n and i]
    if census.rows and not census.faults[0]:
        faults.insert(0, "NO WAVEFORM CAN BE READ")
    if census.samples and census.lengths[1] < FEW:
        faults.append(f"no waveform has more than {census.lengths[1]} samples: nothing tells its noise")
    if census.samples and census.values[0] == census.values[1]:
        faults.append(f"every sample is {census.values[0]:g}")
    return faults


def describe_beam_rows(info: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows of `info.describe` that tell of waveforms."""
    waves = info["waveforms"]
    rows = [
        ("rows", f"{info['rows']:,} of {info['pulses']:,} pulses, {waves['usable']:,} with a usable waveform"),
        ("outgoing", f"{info['outgoing']:,} rows with a recorded outgoing pulse"),
    ]
    if waves["samples"]:
        ends = {name: "{:g} to {:g}".format(*waves[name]) for name in ("samples", "spacing_ns", "values")}
        rows.append(("waveforms", f"{ends['samples']} samples every {ends['spacing_ns']} ns, of {ends['values']}"))
        rows.append(("saturation", f"{waves['saturation']:g}"))
    if len(info["channels"]) > 1:
        rows.append(("channels", ", ".join(map(str, info["channels"]))))
    rows += [(name, text) for name, text in info["notes"]]
    return [*rows, ("amplitudes", words_of(info["quantities"]["amplitude"]))]
