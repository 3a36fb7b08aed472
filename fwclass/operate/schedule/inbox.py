"""What an inbox holds: deliveries that are complete, and what the others wait for."""

from __future__ import annotations

import os
import stat
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fwclass.conf.schedule import ScheduleSection
from fwclass.errors import InputError
from fwclass.formats.las_header import Header
from fwclass.operate.schedule.source_directories import WAVES, SourceDirectories
from fwclass.operate.schedule.ticks import Now
from fwclass.operate.schedule.watch import writers
from fwclass.paths import WAVEFORM_ENDINGS, name_fault

if TYPE_CHECKING:
    from fwclass.read.las import LasSource
    from fwclass.read.pulsewaves import PulseSource

EXTERNAL, INTERNAL = 4, 2
"""Bits of a LAS file's global encoding: its waveforms lie beside it, or in it."""

PAGE = 4096
"""Bytes at the end of a file of waveforms that are nothing but zeros only where nobody has written yet."""

LAST = 1000
"""Points at the end of a file that are looked at before it is taken."""

Mark = tuple[int, int, int]
"""Size [bytes], time of change [ns] and inode of a file."""


@dataclass(frozen=True)
class InboxDelivery:
    """A complete file and the waveforms that go with it. `files`: in the order in which they are moved."""

    name: str
    files: tuple[Path, ...]
    markers: tuple[Path, ...]
    target: Path


@dataclass(frozen=True)
class WaitingFile:
    """A file that is not taken yet, or never. `changing`: complete ones wait for it."""

    name: str
    why: str
    changing: bool = False


@dataclass(frozen=True)
class InboxState:
    """Files of the inbox that can be moved, and those that cannot."""

    complete: tuple[InboxDelivery, ...]
    waiting: tuple[WaitingFile, ...]


@dataclass
class Inbox:
    """A directory where strips arrive; only files directly in it are looked at, no links and no hidden ones.

    How long a file has not changed is measured by what earlier looks saw, never by the times that the file carries.
    """

    directory: Path
    sources: SourceDirectories
    params: ScheduleSection
    _since: dict[Path, tuple[Mark, float]] = field(default_factory=dict)
    _judged: dict[Path, tuple[tuple[Mark, ...], str]] = field(default_factory=dict)
    _waiting_since: float | None = None

    def look(self, now: Now) -> InboxState:
        """All files as they stand. A directory that cannot be read raises `OSError`."""
        marks = _marks(self.directory)
        self._since = {p: self._first_seen(p, mark, now) for p, mark in marks.items()}
        self._judged = {p: known for p, known in self._judged.items() if p in marks}
        complete: list[InboxDelivery] = []
        waiting: list[WaitingFile] = []
        for path in sorted(marks):
            if path.suffix in self.params.markers:
                continue
            if path.suffix.lower() in WAVES:
                if not any(_goes_with(head, path) for head in marks):
                    waiting.append(WaitingFile(path.name, "its file of points or pulses is not there"))
                continue
            file = self._judge(path, marks, now)
            if isinstance(file, InboxDelivery):
                complete.append(file)
            else:
                waiting.append(file)
        open_ones = writers(p for delivery in complete if not delivery.markers for p in delivery.files)
        busy = {d.name: open_ones[p] for d in complete for p in d.files if p in open_ones}
        waiting += [WaitingFile(n, f"process {pid} has it open for writing", changing=True) for n, pid in busy.items()]
        return InboxState(tuple(d for d in complete if d.name not in busy), tuple(waiting))

    def ready(self, look: InboxState, now: Now) -> tuple[InboxDelivery, ...]:
        """The complete ones, once no other is on its way, or after `hold` seconds at most."""
        if not look.complete:
            self._waiting_since = None
            return ()
        self._waiting_since = now.steady if self._waiting_since is None else self._waiting_since
        if any(w.changing for w in look.waiting) and now.steady - self._waiting_since < self.params.hold:
            return ()
        return look.complete

    def _first_seen(self, path: Path, mark: Mark, now: Now) -> tuple[Mark, float]:
        known = self._since.get(path)
        return known if known is not None and known[0] == mark else (mark, now.steady)

    def _judge(self, head: Path, marks: dict[Path, Mark], now: Now) -> InboxDelivery | WaitingFile:
        if head.suffix.lower() in self.params.partial:
            return WaitingFile(head.name, "it has the name of an upload that goes on (schedule.partial)")
        target = self.sources.of(head.name)
        if target is None:
            return WaitingFile(head.name, "survey.sources finds no file of this name; it stays here")
        if fault := name_fault(head.stem):  # every run after it would be refused
            return WaitingFile(head.name, f"no strip can have its name: {fault}; it stays here")
        beside = tuple(p for p in marks if _goes_with(head, p))
        files = (*beside, head)  # the points last: without them the survey does not see the strip
        markers = tuple(p for p in marks if p.suffix in self.params.markers and p.stem in (head.name, head.stem))
        settled = all(now.steady - self._since[p][1] >= self.params.settle for p in files)
        by = self.params.complete
        if by == "marker" and not markers:
            return WaitingFile(head.name, f"no {' or '.join(self.params.markers)} stands beside it")
        if not settled and (by == "settled" or not markers):
            return WaitingFile(head.name, f"it has not stayed unchanged for {self.params.settle:g} s", changing=True)
        state = tuple(marks[p] for p in files)
        known = self._judged.get(head)
        if known is None or known[0] != state or known[1]:  # a fault may pass without a change: waveforms in place
            self._judged[head] = (state, fault_of(head, beside, target, bool(markers)))
        fault = self._judged[head][1]
        if fault:
            return WaitingFile(head.name, fault)
        return InboxDelivery(head.name, files, markers, self.sources.home(head.name, target))


def _marks(directory: Path) -> dict[Path, Mark]:
    marks = {}
    with os.scandir(directory) as entries:
        for entry in entries:
            if entry.name.startswith("."):
                continue
            try:
                facts = entry.stat(follow_symlinks=False)
            except FileNotFoundError:
                continue
            if stat.S_ISREG(facts.st_mode):
                marks[Path(entry.path)] = (facts.st_size, facts.st_mtime_ns, facts.st_ino)
    return marks


def _goes_with(head: Path, path: Path) -> bool:
    """`path` holds the waveforms of `head`."""
    beside = WAVEFORM_ENDINGS.get(head.suffix.lower(), ())
    return path.suffix.lower() in beside and head.stem.lower() == path.stem.lower()


def fault_of(head: Path, beside: tuple[Path, ...], target: Path, marked: bool) -> str:
    """Why a file that does not change is still not whole, by its header; empty if it is.

    Unless it is `marked`, more bytes than the header tells of are the end of a file whose header was not written last,
    and zeros at the end of its waveforms are what nobody has written yet.
    """
    from fwclass.read.las import LasSource
    from fwclass.read.points import PointReader
    from fwclass.read.pulsewaves import PulseSource
    from fwclass.read.source import open_source

    try:
        source = open_source(head)
        faults = [f for f in source.faults if "cut short" in f or "extended records" in f]
        if isinstance(source, LasSource) and not marked:
            faults += _surplus(source.header)
        if isinstance(source, LasSource) and source.n_points:
            with PointReader(source) as reader:  # what was never written is zeros, mostly at the end
                points = reader.read(max(0, source.n_points - LAST), source.n_points)
            if source.has_waves and source.waves.kind != "none":
                faults += _short_packets(source, points)
        if faults:
            return faults[0]
        if source.has_waves and source.waves.kind == "none" and not _moved_ahead(head, target):
            named = not isinstance(source, LasSource) or source.header.global_encoding & (EXTERNAL | INTERNAL)
            return source.waves.why_not if named else ""
        if isinstance(source, PulseSource) and (short := _short_pulses(source)):
            return short
        return next((fault for path in beside if (fault := _short_waves(path, marked))), "")
    except InputError as fault:
        return f"{fault.what}: expected {fault.expected}, got {fault.got}" if fault.expected else fault.what
    except OSError as fault:
        return f"it cannot be read: {fault.strerror or type(fault).__name__}"


def _moved_ahead(head: Path, target: Path) -> bool:
    """The waveforms are in place, without any points: a move was cut off between the two."""
    if not target.is_dir():
        return False
    there = [p for p in target.iterdir() if p.stem.lower() == head.stem.lower()]
    return any(_goes_with(head, p) for p in there) and not any(p.suffix.lower() in WAVEFORM_ENDINGS for p in there)


def _surplus(header: Header) -> list[str]:
    """A complaint about points that the header does not count."""
    if header.compressed or header.evlrs or header.wave_start:
        return []
    counted = header.points_start + header.n_points * header.record_length
    if header.size - counted < header.record_length:
        return []
    return [f"its header counts {header.n_points} points, which end at byte {counted}, but the file has {header.size}"]


def _short_pulses(source: PulseSource) -> str:
    """The last pulses' waves lie behind the end of a Waves file that is still being written; they state no length."""
    from fwclass.read.pls_waves import FAULTS, Samplings, find, read_records

    last = max(0, source.n_records - LAST)
    records = read_records(source, last, source.n_records)
    fault = find(source, records, Samplings.of(source)).fault
    short = sum(FAULTS[code] in ("waves past the end", "waves cut short") for code in fault)
    if not short or source.waves.path is None:
        return ""
    return f"{source.waves.path.name} is cut short: it ends before the waves of {short} of the last {len(fault)} pulses"


def _short_packets(source: LasSource, points: Any) -> list[str]:
    """A complaint about packets of the last points that lie behind the end of the file that holds them."""
    from fwclass.read.packet_references import References
    from fwclass.read.packets import FAULTS, judge

    fault = judge(source, References.of(points))
    short = sum(FAULTS[code] in ("packet past the end", "packet cut short") for code in fault)
    if not short or source.waves.path is None:
        return []
    name = source.waves.path.name
    return [f"{name} is cut short: the packets of {short} of the last {len(fault)} points lie behind its end"]


def _short_waves(path: Path, marked: bool) -> str:
    """What was never written is zeros, unless it is `marked` as whole. A LAS sidecar states the length of its packets;
    some writers count the 60 bytes before them too."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(60)
        stream.seek(max(0, size - PAGE))
        if not marked and size > PAGE and not any(stream.read(PAGE)):
            return f"{path.name} ends in zeros: it is still being written, or a part of it was never"
    if path.suffix.lower() != ".wdp":
        return ""
    if len(head) < 60:
        return f"{path.name} ends inside its header"
    (length,) = struct.unpack_from("<Q", head, 20)
    if size >= 60 + length or size == length:
        return ""
    return f"{path.name} is cut short: 60 + {length} bytes stated, {size} there"
