"""RIEGL's sample data (.sdf), by the vendor's own library (RiWaveLIB, `libsdfifc.so`) where the user has it.

`FWCLASS_SDFIFC` names the library; nothing is looked for. A record is a laser shot: its blocks of samples are rows of
one pulse, the reference block is its outgoing pulse and the origin of its times. Records without a reference block have
no times. Beams must be in a projected system: in the scanner's own frame they have no place.

Source: fwifc.h of the library, version 2. No file and no library were at hand: the tests have one that pretends.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import ConfigError, InputError
from fwclass.read.beam_source import LONGEST, BeamRows, Census, Ints, Layout, Ragged

LIBRARY = "FWCLASS_SDFIFC"
ENDING = ".sdf"
BLOCK = 2_000
"""Rows that are held at a time."""

HIGH, LOW, REFERENCE = 0, 1, 3
"""Channels of a record's blocks: high and low power, and the emitted pulse; that of saturation is left out."""

MOST_BLOCKS = 1_000
"""Blocks of a record at most."""

LEVER = 100.0
"""No projected system has a sensor nearer to its origin than this; in the scanner's own frame none is farther [m]."""

_END, _NO_INDEX = -1, 3


class _SampleBlock(ctypes.Structure):
    _fields_ = (
        ("time", ctypes.c_double),
        ("channel", ctypes.c_uint32),
        ("count", ctypes.c_uint32),
        ("size", ctypes.c_uint32),
        ("samples", ctypes.POINTER(ctypes.c_uint16)),
    )


@dataclass(frozen=True)
class SdfLayout(Layout):
    """``starts[i]`` is the first row of record i, and behind the last one their number; `speed` of light [m/ns] and
    `spacing` [ns] are of the whole file."""

    path: Path
    speed: float
    spacing: float
    starts: Ints = field(compare=False, repr=False)

    @property
    def n_rows(self) -> int:
        return int(self.starts[-1])

    def blocks(self) -> Iterator[BeamRows]:
        with _opened(self.path) as (library, file):
            yield from _blocks(_shots(self.path, library, file, 0), self.speed, self.spacing)

    def read(self, first: int, last: int) -> BeamRows:
        record = max(0, int(np.searchsorted(self.starts, first, "right")) - 1)
        with _opened(self.path) as (library, file):
            rows = []
            for number, shot in enumerate(_shots(self.path, library, file, record), record):
                if self.starts[number] >= last:
                    break
                own = [(number, shot, block) for block in shot.received]
                rows += own[max(first - int(self.starts[number]), 0) : last - int(self.starts[number])]
            return _rows(rows, self.speed, self.spacing)


@dataclass(frozen=True)
class _Block:
    time: float
    channel: int
    samples: np.ndarray[Any, np.dtype[np.uint16]]


@dataclass(frozen=True)
class _Shot:
    time: float
    origin: tuple[float, ...]
    direction: tuple[float, ...]
    received: tuple[_Block, ...]
    emitted: _Block | None


_NOTHING = np.empty(0, np.uint16)


def _ragged(lists: list[Any]) -> Ragged:
    ends = np.concatenate([[0], np.cumsum([len(v) for v in lists])]).astype(np.int64)
    return Ragged(np.concatenate([_NOTHING, *lists]), ends)


def _blocks(shots: Iterable[_Shot], speed: float, spacing: float) -> Iterator[BeamRows]:
    """All rows of `shots`, those of about `BLOCK` rows at a time."""
    rows: list[tuple[int, _Shot, _Block]] = []
    for number, shot in enumerate(shots):
        rows += [(number, shot, block) for block in shot.received]
        if len(rows) >= BLOCK:
            yield _rows(rows, speed, spacing)
            rows = []
    if rows:
        yield _rows(rows, speed, spacing)


def _rows(rows: list[tuple[int, _Shot, _Block]], speed: float, spacing: float) -> BeamRows:
    shots, blocks = [s for _, s, _ in rows], [b for _, _, b in rows]
    away = np.array([s.direction for s in shots]).reshape(-1, 3)
    with np.errstate(all="ignore"):
        away = away / np.linalg.norm(away, axis=1, keepdims=True)
    emitted = np.array([np.nan if s.emitted is None else s.emitted.time for s in shots])
    return BeamRows(
        pulse=np.array([number for number, _, _ in rows], np.int64),
        anchor=np.array([s.origin for s in shots]).reshape(-1, 3),
        step=-away * speed / 2.0,
        begin=(np.array([b.time for b in blocks]) - emitted) * 1e9,
        anchor_range=np.zeros(len(rows)),
        spacing=np.full(len(rows), spacing),
        time=np.array([s.time for s in shots]),
        channel=np.array([b.channel for b in blocks], np.int64),
        samples=_ragged([b.samples for b in blocks]),
        outgoing=_ragged([s.emitted.samples if s.emitted is not None else _NOTHING for s in shots]),
        outgoing_begin=np.zeros(len(rows)),
        unusable=np.zeros(len(rows), np.bool_),
    )


def is_sdf(path: Path) -> bool:
    """Its name says so; what is in it only the vendor's library knows."""
    return path.suffix.lower() == ENDING


def open_sdf(path: Path) -> tuple[SdfLayout, list[tuple[str, str]], Census]:
    """The layout, what is to be told of the file, and what one pass over all records adds up, once in a process.

    `ConfigError`: the library is not named, or cannot be loaded. `InputError`: the library refuses the file, or its
    beams are in the scanner's own frame.
    """
    facts = path.stat()
    return _look(path, (facts.st_size, facts.st_mtime_ns), library_path())


@lru_cache(maxsize=16)
def _look(path: Path, mark: tuple[int, int], named: Path) -> tuple[SdfLayout, list[tuple[str, str]], Census]:
    texts, values = [ctypes.c_char_p() for _ in range(3)], [ctypes.c_double() for _ in range(2)]
    counts = [ctypes.c_uint16() for _ in range(2)]
    facts = (*texts, *values, *counts)
    counted, nearest, census = [0], np.inf, Census()

    def count(shots: Iterable[_Shot]) -> Iterator[_Shot]:
        nonlocal nearest
        for shot in shots:
            counted.append(counted[-1] + len(shot.received))
            place = np.abs(shot.origin).max()
            nearest = min(nearest, float(place)) if np.isfinite(place) else nearest
            yield shot

    with _opened(path) as (library, file):
        _ask(path, library, library.fwifc_get_info(file, *map(ctypes.byref, facts)))
        instrument, serial, epoch = ((t.value or b"").decode("utf-8", "replace") for t in texts)
        speed, spacing = values[0].value * 1e-9, values[1].value * 1e9
        for rows in _blocks(count(_shots(path, library, file, 0)), speed, spacing):
            census.add(rows)
    if nearest < LEVER:
        raise InputError(
            "the beams are in the scanner's own frame",
            where=path,
            expected=f"sensors farther than {LEVER:g} m from the origin of a projected system",
            got=f"{nearest:.3g} m",
            do="georeference it with RIEGL's software, or export LAS 1.4 with waveforms from there",
        )
    layout = SdfLayout(path, speed, spacing, np.array(counted, np.int64))
    return layout, [("instrument", f"{instrument}, {serial}"), ("times", f"seconds from {epoch}")], census


def _shots(path: Path, library: Any, file: Any, first: int) -> Iterator[_Shot]:
    """Records from `first` on; without an index those before it are read and forgotten."""
    skipped = 0
    if first:
        answer = library.fwifc_seek(file, ctypes.c_uint32(first + 1))
        if answer == _NO_INDEX:
            skipped = first
        else:
            _ask(path, library, answer)
    gate, time = ctypes.c_double(), ctypes.c_double()
    origin, direction = (ctypes.c_double * 3)(), (ctypes.c_double * 3)()
    flags, facet = ctypes.c_uint16(), ctypes.c_uint16()
    count, size = ctypes.c_uint32(), ctypes.c_uint32()
    blocks = ctypes.POINTER(_SampleBlock)()
    answers = tuple(map(ctypes.byref, (gate, time, origin, direction, flags, facet, count, size, blocks)))
    while (answer := library.fwifc_read(file, *answers)) != _END:
        _ask(path, library, answer)
        if skipped:
            skipped -= 1
            continue
        if count.value > MOST_BLOCKS:
            raise InputError("a record with too many blocks", where=path, expected=MOST_BLOCKS, got=count.value)
        own = [_block(path, blocks[k]) for k in range(count.value)]
        emitted = next((b for b in own if b.channel == REFERENCE), None)
        received = tuple(b for b in own if b.channel in (HIGH, LOW))
        yield _Shot(time.value, tuple(origin), tuple(direction), received, emitted)


def _block(path: Path, block: Any) -> _Block:
    if block.count > LONGEST:
        raise InputError("a block with too many samples", where=path, expected=LONGEST, got=block.count)
    samples = np.ctypeslib.as_array(block.samples, (block.count,)).copy() if block.count else _NOTHING
    return _Block(block.time, block.channel, samples)


def library_path() -> Path:
    """The vendor's library, as the user names it."""
    return Path(os.environ.get(LIBRARY, ""))


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    library, file = library_of(os.environ.get(LIBRARY, "")), ctypes.c_void_p()
    _ask(path, library, library.fwifc_open(ctypes.c_char_p(os.fsencode(path)), ctypes.byref(file)))
    try:
        _ask(path, library, library.fwifc_set_sosbl_relative(file, ctypes.c_int32(1)))
        yield library, file
    finally:
        library.fwifc_close(file)


@lru_cache(maxsize=1)
def library_of(name: str) -> Any:
    """The vendor's library."""
    try:
        if not Path(name).is_absolute():
            raise OSError("not named by a whole path" if name else "not named")
        return ctypes.CDLL(name)
    except OSError as fault:
        raise ConfigError(
            "RIEGL's .sdf is read by the vendor's library alone, and it cannot be loaded",
            where=f"environment variable {LIBRARY}",
            expected="the whole path of libsdfifc.so (RiWaveLIB, from RIEGL)",
            got=str(fault)[:200],
            do="get it from RIEGL and name it, or export LAS 1.4 with waveforms from RIEGL's software",
        ) from None


def _ask(path: Path, library: Any, answer: int) -> None:
    """`InputError` in the library's words unless it answered 0."""
    if answer == 0:
        return
    message = ctypes.c_char_p()
    library.fwifc_get_last_error(ctypes.byref(message))
    raise InputError(
        "RIEGL's library cannot read the file",
        where=path,
        got=(message.value or b"").decode("utf-8", "replace")[:200] or f"error {answer}",
        do="copy the file again, or look at it with RIEGL's software",
    )
