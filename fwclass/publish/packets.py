"""Waveform packets of a source strip, copied beside its published copy."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from fwclass.formats.las_bytes import (
    BLOCK,
    EXTERNAL,
    INTERNAL,
    WAVEFORM_PACKETS,
    LasHead,
    copy_bytes,
    differs,
    extended_records,
    read_extended,
)
from fwclass.formats.las_header import EVLR_HEADER, PACKET_ENDINGS, Record, packet_endings
from fwclass.publish.files import written_whole

WAVE_FORMATS = (4, 5, 9, 10)


@dataclass(frozen=True)
class Packets:
    """Where a strip's packets are.

    Attributes
    ----------
    internal : they are a record of the LAS file itself, `start` to `start + length` (record header included).
    sidecar : path of the `.wdp`, or `.wdz`, beside the source, or None.
    truncated : the record says that it is longer than the file.
    notes : what a user should know.
    """

    internal: bool = False
    start: int = -1
    length: int = 0
    sidecar: Path | None = None
    truncated: bool = False
    notes: tuple[str, ...] = ()


def find_packets(head: LasHead) -> Packets:
    """The packets of a strip; a point format without packets has none."""
    if head.point_format not in WAVE_FORMATS:
        return Packets()
    inside = head.encoding & INTERNAL or not head.encoding & EXTERNAL  # a start beside the external bit is stale
    if inside and (internal := _internal(head)) is not None:
        return internal
    endings = packet_endings(head.records)
    sidecar = _beside(head.path, endings)
    if sidecar is None:
        place = "an internal record" if head.encoding & INTERNAL else f"{head.path.stem}{endings[0]}"
        return Packets(notes=(f"waveform packets are missing: no {place}",))
    return Packets(sidecar=sidecar)


def _beside(path: Path, endings: tuple[str, ...]) -> Path | None:
    stems = {path.stem, path.stem.removesuffix(".copc")}
    there = [p for p in sorted(path.parent.iterdir()) if p.stem in stems]
    return next((p for ending in endings for p in there if p.suffix.lower() == ending), None)


def _internal(head: LasHead) -> Packets | None:
    with head.path.open("rb") as file:
        listed = extended_records(file, head)
        here = head.least_end <= head.packets_start <= head.file_size - EVLR_HEADER
        records = [read_extended(file, head, head.packets_start), *listed] if here else listed
        packets = [r for r in records if r.number == WAVEFORM_PACKETS]
    if not packets:
        return None
    record = packets[0]
    end = record.end
    if record.length == 0:  # some writers leave the length open: to the next record, or the file's end
        end = min((r.start for r in listed if r.start > record.start), default=head.file_size)
    truncated = end > head.file_size
    notes = (f"the packet record ends {end - head.file_size} bytes past the file",) if truncated else ()
    return Packets(True, record.start, min(end, head.file_size) - record.start, None, truncated, notes)


def is_copied(record: Record, packets: Packets) -> bool:
    """Whether an extended record goes into the copy: neither packets nor an octree."""
    return record.user != "copc" and not (packets.internal and record.start == packets.start)


def publish_packets(head: LasHead, packets: Packets, output: Path) -> tuple[str, Path | None]:
    """Put the packets beside `output`; what was done, and the path if something is there."""
    target = output.with_suffix(packets.sidecar.suffix.lower() if packets.sidecar is not None else PACKET_ENDINGS[0])
    if packets.internal:
        with head.path.open("rb") as source, written_whole(target) as beside, beside.open("wb") as file:
            copy_bytes(source, file, packets.start, packets.length)
            file.flush()
            _compare(head.path, packets.start, packets.length, beside)
        return ("truncated" if packets.truncated else "extracted"), target
    if packets.sidecar is None:
        return ("missing" if head.point_format in WAVE_FORMATS else "none"), None
    if target.exists() and target.samefile(packets.sidecar):
        return "copied", target  # the output lies beside its source, under its name
    # never a link: a delivery that is edited must not change the client's raw data
    with written_whole(target) as beside:
        shutil.copyfile(packets.sidecar, beside)
        _compare(packets.sidecar, 0, packets.sidecar.stat().st_size, beside)
    return "copied", target


def _compare(source: Path, start: int, length: int, copy: Path) -> None:
    """`StoreError` unless `copy` holds the `length` bytes of `source` from `start`, and no more."""
    if copy.stat().st_size != length:
        raise differs(copy, "the length of the packets", length, copy.stat().st_size)
    with source.open("rb") as old, copy.open("rb") as new:
        old.seek(start)
        for at in range(0, length, BLOCK):
            size = min(BLOCK, length - at)
            if old.read(size) != new.read(size):
                raise differs(copy, f"a packet after byte {at}", "the source's samples", "others")
