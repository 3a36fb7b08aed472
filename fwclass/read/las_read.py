"""Reading LAS: pulses with their returns and waveforms out of points and their packets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError, first_few
from fwclass.formats.las_header import packet_endings
from fwclass.read.feet import in_metres
from fwclass.read.las import LasSource
from fwclass.read.packet_references import References, pulses_of
from fwclass.read.packets import DAMAGED, FAULTS, VECTOR_RANGE, Packets, gather_packets, looked_into
from fwclass.read.params import ReadParams
from fwclass.read.points import WAVE_FIELDS, PointReader, coordinates, flags_of, gps_times, scan_angles
from fwclass.read.projection import metres_of
from fwclass.read.return_counts import NUMBER_FAULTS
from fwclass.read.segments import Rows, segment_links
from fwclass.read.spans import Span, spans_by_points, spans_by_pulses
from fwclass.schema import Table
from fwclass.units import METRES_PER_NS
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

NAMED = 3
"""Waveform descriptors that a refusal names."""


def check_las(source: LasSource, params: ReadParams) -> None:
    """`InputError` if `source` declares waveforms, none can be read, and `missing_packets` is ``error``.

    Looks at packet references until the first usable one. Of compressed packets more must be sound than are not: a few
    of another file's happen to lie where the points look for them.
    """
    if params.missing_packets == "keep" or not source.has_waves or source.n_points == 0:
        return
    counts, times = np.zeros(len(FAULTS), np.int64), [1.0]
    if source.waves.kind != "none":
        with PointReader(source, WAVE_FIELDS) as reader:
            for _, points in reader.blocks():
                refs = References.of(points)
                counts += np.bincount(looked_into(source, refs), minlength=len(FAULTS))
                with np.errstate(invalid="ignore"):
                    steps = np.linalg.norm(refs.step * metres_of(source), axis=1)
                    times.append(float(np.median(steps)) / METRES_PER_NS)
                if counts[0] > counts[DAMAGED]:
                    return
    reasons = ", ".join(f"{n} returns: {FAULTS[i]}" for i, n in enumerate(counts) if n and i) or source.waves.why_not
    keep = f"or set read.missing_packets=keep to use its {source.n_points} returns without waveforms"
    wdp = source.path.with_suffix(packet_endings((*source.header.vlrs, *source.header.evlrs))[0]).name
    raise InputError(
        f"the file declares waveforms, but {'most cannot' if counts[0] else 'none can'} be read",
        where=source.path,
        expected=f"point format {source.point_format} with its waveforms in {source.waves.path or wdp}",
        got=reasons,
        do=f"{_descriptors_advice(source, counts) or _advice(source, wdp, times[-1])}, {keep}",
    )


def _descriptors_advice(source: LasSource, counts: NDArray[np.int64]) -> str:
    """What to do where the file's waveform descriptors are to blame; "" where the commonest fault is another."""
    name = FAULTS[int(np.argmax(counts))]
    used = [f"{d.n_samples} of {d.bits} bits" for _, d in sorted(source.descriptors.items()) if not d.empty]
    named = (
        f"its waveform descriptors name {first_few(used, NAMED)}" if used else "no waveform descriptor names samples"
    )
    if name == "unsupported samples":
        return f"{named}: export it with samples of 8 or 16 bits, or as a table of raw waveforms (docs/waveforms.md)"
    if name == "packet size too small":
        return f"{named}, more than packets hold: export it again with descriptors that fit"
    return ""


def _advice(source: LasSource, wdp: str, length: float) -> str:
    """Where usable waveforms could come from; `length` of the beam vectors, of what light travels both ways."""
    if not VECTOR_RANGE[0] <= length <= VECTOR_RANGE[1]:
        long = f"they are {length:.4g} times as long as light's way"
        return in_metres(length, "export it again with beam vectors in m/ps", source) + f" ({long})"
    if source.waves.kind == "none":
        return f"put {wdp} beside it"
    if source.waves.kind == "internal":
        return "ask for the file again: the waveforms inside it are cut off or damaged"
    return f"ask for {wdp} and the file again: they do not fit each other, or one is damaged"


def index_las(source: LasSource, params: ReadParams) -> list[Span]:
    """Cut `source` into spans of about `params.chunk_pulses` pulses without cutting a pulse.

    Returns of one pulse share descriptor and packet offset and need not be adjacent in the file. One streaming pass
    over the packet references, none for files without waveforms; at most 40 bytes of memory a point.

    `InputError`: points that cannot be read, or a file sorted so that it cannot be cut.
    """
    if not source.has_waves:
        return spans_by_points(source.n_points, params.chunk_pulses)
    return spans_by_pulses(source, params.chunk_pulses, params.max_span_points)


def read_las(source: LasSource, span: Span, use_flagged: bool = False, waves: bool = True) -> Waveforms:
    """Returns of `span` in file order, and the waveforms of its pulses that have a usable packet; none of them is
    `withheld` where what the file flags is to be used. Without `waves` every return is a pulse by itself, as in a file
    that declares none.

    `location` and `anchor_time` are in ns, `step` in m/ns up the beam. A return's location counts from the first sample
    of its pulse's first segment, an anchor time from the first sample of its own row. Returns without a
    usable packet are kept with `has_packet` False and counted in `faults` by reason. `location` is NaN only where the
    file declares no waveforms, or they are not asked for.
    """
    with PointReader(source) as reader:
        points = reader.read(span.first_point, span.last_point)
        columns: dict[str, NDArray] = {
            "vendor_amplitude": reader.extra_byte(points, "Amplitude"),
            "vendor_width": reader.extra_byte(points, "Pulse width", "echo width"),
            "vendor_deviation": reader.extra_byte(points, "Deviation"),
        }
    columns |= dict(zip("xyz", coordinates(source, points), strict=True))
    columns["gps_time"] = gps_times(source, points)
    columns["return_number"] = np.asarray(points["return_number"], np.uint8)
    columns["number_of_returns"] = np.asarray(points["number_of_returns"], np.uint8)
    columns["intensity"] = np.asarray(points["intensity"])
    columns["source_class"] = np.asarray(points["classification"], np.uint8)
    columns["withheld"] = flags_of(points) & (not use_flagged)
    angle = scan_angles(source, points)
    faults = _return_faults(columns)
    if not (source.has_waves and waves):
        pulse = np.arange(span.first_point, span.first_point + len(points))
        nothing = np.zeros(len(points), np.bool_)
        columns |= {"pulse": pulse, "has_packet": nothing, "location": np.full(len(points), np.nan)}
        none = np.empty(0, np.dtype(source.sample_dtype))
        returns = _returns(columns)
        return Waveforms(Table.empty(PULSE_COLUMNS), returns, none, np.zeros(1, np.int64), faults, scan_angle=angle)
    rows = Rows.of_points(source, points)
    refs = rows.refs
    packet, pulse = pulses_of(rows.key, span.shared, segment_links(source, rows))
    packets = gather_packets(source, refs, packet, pulse, rows.place, columns["return_number"], span.shared)
    columns["pulse"] = pulse + span.first_pulse
    columns["has_packet"] = packets.has_packet
    columns["location"] = np.where(np.isfinite(refs.location), refs.location, 0.0) + packets.shift
    pulses = _pulses(columns, refs, packets, span.first_pulse)
    faults |= packets.faults
    return Waveforms(pulses, _returns(columns), packets.samples, packets.offsets, faults, scan_angle=angle)


def _returns(columns: dict[str, NDArray]) -> Table:
    return Table({name: columns[name] for name in RETURN_COLUMNS})


def _return_faults(columns: dict[str, NDArray]) -> dict[str, int]:
    number, of = columns["return_number"], columns["number_of_returns"]
    counts = dict(zip(NUMBER_FAULTS, (int((number == 0).sum()), int((number > of).sum())), strict=True))
    return {name: n for name, n in counts.items() if n}


def _pulses(columns: dict[str, NDArray], refs: References, packets: Packets, first_pulse: int) -> Table:
    at = packets.anchor
    rows = {f"anchor_{axis}": columns[axis][at] for axis in "xyz"}
    rows |= {f"step_{axis}": refs.step[at, k] for k, axis in enumerate("xyz")}
    nothing = np.full(len(at), np.nan)
    rows |= {
        "segment_start": packets.start,
        "anchor_range": nothing,
        "outgoing_start": nothing,
        "pulse": packets.pulse + first_pulse,
        "gps_time": columns["gps_time"][at],
        "anchor_time": refs.location[at],
        "sample_spacing": packets.spacing,
        "saturation": packets.saturation,
        "gain": packets.gain,
        "receiver": packets.descriptor,
    }
    return Table({name: rows[name] for name in PULSE_COLUMNS})
