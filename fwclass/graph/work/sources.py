"""Work of the parts that read: index, read, decompose, split; and the digests of foreign files."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.decompose.envelope import Envelope
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.plausible import UNKNOWN, Surroundings
from fwclass.decompose.pulse_estimate import PulseParams, describe, estimate_pulse, join_samples, sample_pulses
from fwclass.decompose.quiet import QuietNoise, quiet_noise
from fwclass.decompose.stage import decompose
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.errors import DamagedError
from fwclass.grid import TileGrid, quantised
from fwclass.read.source import open_source
from fwclass.read.spans import Span
from fwclass.read.stage import ReadParams, index_source, read_cloud, read_span
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.schema import Table
from fwclass.store.arrays import write_arrays
from fwclass.store.atomic import read_json, write_json
from fwclass.store.cells import CELLS, by_name, by_place
from fwclass.store.external_file import ExternalFile, digested
from fwclass.store.remote_file import Location, RemoteFile, seen_as
from fwclass.store.run_store import Store
from fwclass.store.tables import write_groups, write_table
from fwclass.tile.stage import assemble, assemble_points, split
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

PULSE = "pulse.json"
ENVELOPE = "envelope.zarr"
CLOUD_ROWS = 2_000_000
"""Points of a reference cloud read at a time."""

_ARRAYS = ("samples", "offsets", "outgoing", "outgoing_offsets")
"""What of `Waveforms` is stored as arrays."""


_INPUTS = "inputs.json"
_SAVED_EVERY = 30.0
"""s of digests that an interruption may cost."""


class Digests:
    """Digests of foreign files, remembered by what they look like (`seen_as`) in ``store/inputs.json``.

    For a store that is only read, a file of a size that it has not under this name is not read: it is another one.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._known = _remembered(store)
        self._read_only, self._changed, self._saved = store.read_only, False, time.monotonic()
        self._sizes = {(Path(path).name, seen[0]) for path, seen in self._known.items()}

    def of(self, paths: Iterable[Path], place: Location | None = None) -> tuple[ExternalFile, ...]:
        """Every path with the digest of its bytes; files that look unchanged are not read again.

        `place`, if it is on object storage, is where the paths are copies from: who fetches them looks at their e-tags.
        """
        found = []
        for path in paths:
            name, now = seen_as(path, place)
            seen = self._known.get(name)
            if seen is None or seen[:-1] != now:
                seen = [*now, self._digest(path, int(now[0]))]
                self._known[name], self._changed = seen, True
            if isinstance(place, RemoteFile):
                found.append(ExternalFile(path.name, str(seen[-1])))
            else:
                size, changed, entered = (int(n) for n in now)
                found.append(ExternalFile(path.name, str(seen[-1]), path, (size, changed, entered)))
        if time.monotonic() - self._saved > _SAVED_EVERY:
            self.save()
        return tuple(found)

    def save(self) -> None:
        """Remember what is new; called when all files are known, and now and then before."""
        if self._changed and not self._read_only:
            self._store.keep(_INPUTS, self._known)
        self._changed, self._saved = False, time.monotonic()

    def _digest(self, path: Path, size: int) -> str:
        if self._read_only and (path.name, size) not in self._sizes:
            return f"not read: {path}"
        return digested(path)


def _remembered(store: Store) -> dict[str, Any]:
    """What was remembered; nothing where that is damaged, and all files are read again."""
    try:
        known = store.recall(_INPUTS)
    except DamagedError:
        return {}
    usable = isinstance(known, dict) and all(isinstance(v, list) and len(v) >= 3 for v in known.values())
    return known if usable else {}


def index(path: Location, params: ReadParams, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """Cut a source file into spans that no pulse straddles."""
    source = open_source(inputs.local(path))
    spans = index_source(source, params)
    return {
        "spans": [[s.first_point, s.last_point, s.first_pulse, s.n_pulses, list(s.shared)] for s in spans],
        "points": source.n_points,
        "pulses": sum(s.n_pulses for s in spans) if source.has_waves else 0,
        "point_format": source.point_format,
    }


def read(path: Location, span: Span, params: ReadParams, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """Pulses, returns and waveforms of one span."""
    waves = read_span(open_source(inputs.local(path)), span, params)
    write_table(directory / "returns.parquet", waves.returns)
    if waves.pulses.rows:
        write_table(directory / "pulses.parquet", waves.pulses)
        write_arrays(directory / "waveforms.zarr", {name: getattr(waves, name) for name in _ARRAYS})
    return _facts(waves)


def _facts(waves: Waveforms) -> dict[str, Any]:
    """What was read, for a receipt."""
    return {
        "returns": waves.returns.rows,
        "waveforms": waves.pulses.rows,
        "returns_without_packet": int((~waves.returns["has_packet"]).sum()),
        "faults": {k: int(v) for k, v in sorted(waves.faults.items()) if v},
    }


def _waveforms(part: str, inputs: PartInputs, returns: bool = True) -> Waveforms:
    """A chunk as it was read; on request without its returns."""
    points = inputs.table("read", part, name="returns.parquet") if returns else Table.empty(RETURN_COLUMNS)
    if not inputs.meta("read", part)["waveforms"]:
        return Waveforms(Table.empty(PULSE_COLUMNS), points, np.empty(0, np.uint8), np.zeros(1, np.int64))
    arrays, _ = inputs.arrays("read", part, "waveforms.zarr")
    pulses = inputs.table("read", part, name="pulses.parquet")
    return Waveforms(
        pulses,
        points,
        arrays["samples"],
        arrays["offsets"],
        outgoing=arrays["outgoing"],
        outgoing_offsets=arrays["outgoing_offsets"],
    )


def measured_pulse(
    strip: int,
    pulses: int,
    parts: tuple[str, ...],
    params: PulseParams,
    cell: float,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """The system's pulse and the receiver of a strip, from a sample of its waveforms; the envelope of its returns."""
    samples = [sample_pulses(_waveforms(part, inputs, returns=False), strip, pulses, params) for part in parts]
    sampled, noise, pulse = (
        sum(s.pulses.rows for s in samples),
        UNKNOWN.noise,
        SystemPulse.gaussian(params.fallback_width),
    )
    if samples:
        sample = join_samples(samples)
        pulse = estimate_pulse(sample, params)
    write_json(directory / PULSE, pulse.to_json())
    if sampled:
        noise = quiet_noise(sample, pulse, params.tail)
        returns = (inputs.table("read", part, "xyz", "returns.parquet") for part in parts)
        envelope = Envelope.of(returns, cell)
        ends = {n: v if np.isfinite(v) else None for n, v in (("bottom", envelope.bottom), ("top", envelope.top))}
        attributes = {"cell": cell, **ends, **asdict(noise)}
        write_arrays(directory / ENVELOPE, {"keys": envelope.keys, "lowest": envelope.lowest}, attributes)
    return {
        "pulse": describe(pulse),
        "noise": max((c.noise for c in pulse.channels), default=None),
        "sampled": sampled,
        **noise.told,
    }


def pulse_of(strip: int, inputs: PartInputs) -> SystemPulse:
    """The system's pulse of a strip, as `measured_pulse` stored it."""
    return SystemPulse.from_json(read_json(inputs.path("pulse", f"{strip:05d}", PULSE)))


def surroundings_of(strip: int, inputs: PartInputs) -> Surroundings:
    """What the echoes of a strip are held against, as `measured_pulse` stored it."""
    part = f"{strip:05d}"
    if not inputs.meta("pulse", part)["sampled"]:
        return UNKNOWN
    arrays, facts = inputs.arrays("pulse", part, ENVELOPE)
    bottom, top = (np.nan if facts[n] is None else facts[n] for n in ("bottom", "top"))
    envelope = Envelope(facts["cell"], arrays["keys"], arrays["lowest"], bottom, top)
    return Surroundings(envelope, QuietNoise(facts["lag1"], facts["inflation"], facts["samples"]))


def decomposed(part: str, strip: int, params: DecomposeParams, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """Echoes of a chunk, and the echo of every return."""
    waves = _waveforms(part, inputs)
    return _write_echoes(
        decompose(waves, strip, params, pulse_of(strip, inputs), surroundings_of(strip, inputs)), directory
    )


def returned(
    path: Location,
    strip: int,
    span: Span,
    reading: ReadParams,
    width: float,
    params: DecomposeParams,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """`read` and `decomposed` of a span without waveforms: its returns are its echoes.

    `width`: of a pulse [ns] that nothing is fitted with.
    """
    waves = read_span(open_source(inputs.local(path)), span, reading)
    made = decompose(waves, strip, params, SystemPulse.gaussian(width), UNKNOWN)
    return {**_facts(waves), **_write_echoes(made, directory)}


def _write_echoes(made: tuple[Table, Table, Mapping[str, int]], directory: Path) -> dict[str, Any]:
    echoes, links, counts = made
    write_table(directory / TABLE, echoes)
    write_table(directory / "links.parquet", links)
    origin = echoes["origin"]
    return {
        "returns_without_echo": counts["returns_without_echo"],
        "plausibility": counts,
        "echoes": echoes.rows,
        "fitted": int((origin == 0).sum()),
        "kept_returns": int((origin == 1).sum()),
        "read_as_echoes": int((origin == 2).sum()),
        "without_width": int(np.isnan(echoes["width"]).sum()),
    }


def scattered(part: str, grid: TileGrid, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """Echoes of a chunk in tile order, one row group a tile."""
    return _write_split(inputs.table("decompose", part), grid, directory)


def scattered_cloud(
    path: Location, first: int, last: int, grid: TileGrid, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """Reference points of part of a file, in tile order."""
    cloud = read_cloud(inputs.local(path), first, last)
    return _write_split(cloud.with_columns({n: quantised(cloud[n]) for n in "xyz"}), grid, directory)


def _write_split(table: Table, grid: TileGrid, directory: Path) -> dict[str, Any]:
    result = split(table, grid)
    write_groups(directory / TABLE, result.table, result.offsets)
    rows = (result.offsets[1:] - result.offsets[:-1]).tolist()
    return {
        "tiles": {k: [i, n] for i, (k, n) in enumerate(zip(result.keys, rows, strict=True))},
        "rows": sum(rows),
        CELLS: by_name(result.table, result.keys, result.offsets),
    }


def tiled(
    key: str, fragments: tuple[tuple[str, int], ...], blocks: tuple[float, ...], inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """A tile's echoes from all chunks, in final row order; tells which blocks of each size [m] own one of them."""
    table = assemble([inputs.fragment("split", part, group) for part, group in fragments], f"tile {key}")
    write_table(directory / TABLE, table)
    return {
        "rows": table.rows,
        "blocks": {str(size): _occupied(table, size) for size in blocks},
        "bounds": [float(f(table[n])) for f in (min_of, max_of) for n in "xyz"],
        "strips": sorted({int(s) for s in set(table["strip"].tolist())}),
        "times": _passes(table),
        CELLS: by_place(table, table["x"], table["y"]),
    }


def _occupied(table: Table, size: float) -> list[str]:
    ix, iy = TileGrid(size).indices(table["x"], table["y"])
    return sorted({f"{a}_{b}" for a, b in set(zip(ix.tolist(), iy.tolist(), strict=True))})


def _passes(table: Table) -> list[list[float]]:
    """(strip, first, last) of the known times of every strip that has some."""
    times, strips = table["gps_time"], table["strip"]
    known = np.isfinite(times)
    found = []
    for strip in np.unique(strips[known]).tolist():
        own = times[known & (strips == strip)]
        found.append([int(strip), float(own.min()), float(own.max())])
    return found


def min_of(values: Any) -> float:
    return float(values.min())


def max_of(values: Any) -> float:
    return float(values.max())


def tiled_cloud(fragments: tuple[tuple[str, int], ...], inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """A tile's reference points."""
    table = assemble_points([inputs.fragment("reference-split", part, group) for part, group in fragments])
    write_table(directory / TABLE, table)
    return {"rows": table.rows, CELLS: by_place(table, table["x"], table["y"])}


def link_table(inputs: PartInputs, part: str) -> Table:
    """Pulse and echo number of every return of a chunk, in file order."""
    return inputs.table("decompose", part, ("pulse", "echo_number"), "links.parquet")


def counted(metas: Iterable[Mapping[str, Any]], name: str) -> int:
    """Sum of a count over parts."""
    return sum(int(m[name]) for m in metas)
