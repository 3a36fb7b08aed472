"""A source strip with new classes: every other byte of every point, record and packet stays."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fwclass.cost import counted
from fwclass.errors import ConfigError, InputError
from fwclass.formats.extra_bytes import ExtraByte, extend_records, extra_bytes, extra_size, names_of, pack_columns
from fwclass.formats.las_bytes import (
    AT_ENCODING,
    AT_EVLRS,
    AT_FORMAT,
    AT_PACKETS,
    EXTERNAL,
    INTERNAL,
    LasHead,
    broken,
    chunk_rows,
    class_byte,
    copy_bytes,
    extended_records,
    kept_records,
    point_chunks,
    read_head,
)
from fwclass.formats.las_header import Record
from fwclass.formats.laz_writer import assemble, point_writer
from fwclass.publish.files import written_whole
from fwclass.publish.heights import Heights, store_heights, with_heights
from fwclass.publish.packets import Packets, find_packets, is_copied, publish_packets
from fwclass.publish.params import PublishParams
from fwclass.publish.verify import verify
from fwclass.schema import column

LEGACY_MAX = 31
"""Highest class code of point formats 0 to 5: five bits, beside three flags."""


@counted("writing")
def write_strip_laz(
    source: Path,
    output: Path,
    classes: NDArray[np.uint8],
    extra: Mapping[str, NDArray] | None,
    params: PublishParams,
    z: NDArray[np.float64] | None = None,
) -> dict[str, Any]:
    """Copy a strip in its original point order, with `classes` in place of its classification.

    All other fields, the flags beside a legacy class, the variable length records and the packet references stay byte
    for byte; the output is read back and compared. Waveform packets go with it as an external `.wdp` under the
    output's name: a source's own `.wdp` (or `.wdz`) is copied, internal packets are written out verbatim (offsets
    count from the record's header in both places). COPC comes out as plain LAZ.

    Parameters
    ----------
    source : LAS 1.0 to 1.4 or LAZ, point formats 0 to 10.
    output : path of the file: LAS without compression where it ends in ``.las``, else LAZ.
    classes : uint8 (points,), class code per point in file order; at most 31 for point formats 0 to 5.
    extra : columns of the schema by name, one value per point, added as extra bytes behind the source's own; None adds
        none. A name that the source has already gets ``fw`` before it: the source's `Amplitude` stays, and ours is
        `fw Amplitude`.
    z : new heights, one per point, in the file's unit; the header's scale, offset and range of z then follow them. None
        leaves the source's.

    Returns a dict with ``path, points, changed (points whose class differs), point_format, extra_bytes, beyond (values
    outside their extra byte's range, by name), waveforms, wdp (path or None), copc (bool), lacking (of its waveforms,
    list of text), notes (these and others), bytes``; waveforms is "none", "copied", "extracted", "missing" or
    "truncated".

    `InputError`: the source is damaged, or `classes` or `extra` are of another length. `ConfigError`: a class code does
    not fit the point format, or source and output are the same file. `StoreError`: what was read back differs from the
    source in more than its classification.
    """
    head = read_head(source)
    _check(head, output, classes, extra or {})
    extras = extra_bytes(map(column, extra or {}), extra or {}, names_of(kept_records(head)))
    packets = find_packets(head)
    heights = None if z is None else store_heights(head, z)
    head = head if heights is None else with_heights(head, heights)
    chunk = chunk_rows(params.chunk_points, head.point_size + extra_size(extras))
    with written_whole(output) as beside:
        with beside.open("w+b") as file:
            changed = _copy(head, file, output, classes, extras, extra or {}, packets, chunk, heights)
        verify(head, beside, classes, extras, extra or {}, packets, chunk, heights)
        size = beside.stat().st_size
        waveforms, wdp = publish_packets(head, packets, output)
    copc = any(r.user == "copc" for r in head.records)
    kind = "LAS" if output.suffix.lower() == ".las" else "LAZ"
    notes = list(packets.notes)
    if packets.internal and wdp is not None:
        notes.append(f"the waveforms were inside the input; they are in {wdp.name} beside the output now")
    if copc:
        notes.append(f"COPC written as plain {kind}, without its octree")
    return {
        "path": str(output),
        "points": head.points,
        "changed": changed,
        "point_format": head.point_format,
        "extra_bytes": [e.las for e in extras],
        "beyond": {e.las: e.beyond for e in extras if e.beyond},
        "waveforms": waveforms,
        "wdp": str(wdp) if wdp else None,
        "copc": copc,
        "lacking": list(packets.notes),
        "notes": notes,
        "bytes": size,
    }


def check_records(source: Path) -> None:
    """`InputError` where `write_strip_laz` would refuse the header of `source`, or one of its records; no point is
    read."""
    head = read_head(source)
    _whole_records(head, find_packets(head))


def _whole_records(head: LasHead, packets: Packets) -> list[Record]:
    """The extended records that go into a copy; `InputError` for one that the file ends in."""
    with head.path.open("rb") as file:
        copied = [r for r in extended_records(file, head) if is_copied(r, packets)]
    for record in copied:
        if record.end > head.file_size:
            raise broken(
                head.path,
                f"the file ends in its extended record {record.user} {record.number}",
                f"{record.end} bytes",
                head.file_size,
            )
    return copied


def _check(head: LasHead, output: Path, classes: NDArray[np.uint8], extra: Mapping[str, NDArray]) -> None:
    if output.exists() and output.samefile(head.path):
        raise ConfigError(
            "a strip cannot be written onto itself",
            where=output,
            do="name another output directory; the source is never changed",
        )
    for name, values in {"classes": classes, **extra}.items():
        if len(values) != head.points:
            raise InputError(
                f"{name} has another length than the strip",
                where=head.path,
                expected=f"{head.points} points",
                got=len(values),
                do="run the survey again: the source changed after it was read",
            )
    if head.point_format < 6 and len(classes) and int(classes.max()) > LEGACY_MAX:
        raise ConfigError(
            f"class code {int(classes.max())} does not fit point format {head.point_format}",
            where=head.path,
            expected=f"codes up to {LEGACY_MAX} in point formats 0 to 5",
            got=", ".join(str(c) for c in np.unique(classes[classes > LEGACY_MAX])),
            do="set legacy_code of that class in classes of the configuration to a code up to 31",
        )


def _copy(
    head: LasHead,
    file: BinaryIO,
    output: Path,
    classes: NDArray[np.uint8],
    extras: tuple[ExtraByte, ...],
    extra: Mapping[str, NDArray],
    packets: Packets,
    chunk: int,
    heights: Heights | None,
) -> int:
    """Write head, points and extended records; the number of points whose class differs."""
    block = _block(head, extras, packets)
    writer = point_writer(output, file, assemble(block, extend_records(kept_records(head), extras), head.gap))
    changed = first = 0
    for part in point_chunks(head, chunk):
        rows = slice(first, first + len(part))
        changed += _reclassify(head.point_format, part, classes[rows])
        if heights is not None:
            heights.put(part, rows)
        if extras:
            added = pack_columns(extras, {e.name: extra[e.name][rows] for e in extras})
            part = np.concatenate([part, added], axis=1)
        writer.write(part)
        first = rows.stop
    end = writer.finish(block)
    start, count = _copy_extended(head, file, end, packets)
    if head.minor >= 4:
        file.seek(AT_EVLRS)
        file.write(struct.pack("<QI", start, count))
    return changed


def _reclassify(point_format: int, part: NDArray[np.uint8], classes: NDArray[np.uint8]) -> int:
    """Put `classes` into the points; flags beside a legacy class stay."""
    at = class_byte(point_format)
    new = classes if point_format >= 6 else (part[:, at] & 0xE0) | classes
    changed = int(np.count_nonzero(part[:, at] != new))
    part[:, at] = new
    return changed


def _block(head: LasHead, extras: tuple[ExtraByte, ...], packets: Packets) -> bytes:
    """The source's header block, uncompressed, without extended records; packets are outside."""
    block = bytearray(head.block)
    block[AT_FORMAT] &= 0x3F
    struct.pack_into("<H", block, 105, head.point_size + extra_size(extras))
    if head.minor >= 3:
        struct.pack_into("<Q", block, AT_PACKETS, 0)
        if packets.internal:
            struct.pack_into("<H", block, AT_ENCODING, head.encoding & ~INTERNAL | EXTERNAL)
    if head.minor >= 4:
        struct.pack_into("<QI", block, AT_EVLRS, 0, 0)
    return bytes(block)


def _copy_extended(head: LasHead, file: BinaryIO, end: int, packets: Packets) -> tuple[int, int]:
    """Append the source's extended records verbatim, without packets and octree; their start and number."""
    records = _whole_records(head, packets)
    file.seek(end)
    with head.path.open("rb") as source:
        for rec in records:
            copy_bytes(source, file, rec.start, rec.end - rec.start)
    return (end if records else 0), len(records)
