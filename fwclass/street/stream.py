"""Frames as bytes, one after the other: what `fwclass street run` reads from standard input and from a socket.

A frame is a head of 68 bytes and a float32 a beam [m], all little-endian: ``FWS1``, number of beams (u4), frame number
(u8), time [s], speed [m/s], place [m], angle_min [rad], angle_increment [rad] (f8 each; NaN: no value), range_min,
range_max [m] (f4 each), and the CRC-32 of the head before it and of what follows (u4). ``FWS2`` has a float32 a beam
more, its intensity.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections import Counter
from collections.abc import Iterator

import numpy as np

from fwclass.street.frames import Frame, Scan
from fwclass.street.recording_columns import FULL

MAGIC, LIT = b"FWS1", b"FWS2"
"""How a frame begins: of ranges alone, and with intensities."""

_BEGIN = b"FWS"
"""What both begin with."""
HEAD = struct.Struct("<4sIQdddddffI")
_BEFORE = HEAD.size - 4
"""Bytes of the head that the sum counts."""

FAULTS = ("garbage bytes", "bad sum", "impossible frame", "cut frame")


def encode_frame(frame: Frame) -> bytes:
    """A frame as it is sent."""
    scan = frame.scan
    head = HEAD.pack(
        *(
            MAGIC if frame.intensities is None else LIT,
            len(frame.ranges),
            max(frame.number, 0),
            frame.time,
            frame.speed,
            frame.place,
        ),
        *(scan.first, scan.step, scan.range_min, scan.range_max, 0),
    )[:_BEFORE]
    body = np.ascontiguousarray(frame.ranges, "<f4").tobytes()
    if frame.intensities is not None:
        body += np.ascontiguousarray(frame.intensities, "<f4").tobytes()
    return head + struct.pack("<I", zlib.crc32(body, zlib.crc32(head))) + body


class Decoder:
    """Takes bytes as they come and gives frames; what is none is passed over and counted.

    Holds no more than one frame of `most_beams` and what was fed last.
    """

    def __init__(self, most_beams: int) -> None:
        self.most_beams = most_beams
        self.faults: Counter[str] = Counter()
        self._held = bytearray()

    def feed(self, data: bytes) -> Iterator[Frame]:
        """The frames that `data` completes."""
        self._held += data
        while True:
            self._to_magic()
            if len(self._held) < HEAD.size:
                return
            magic, beams, number, time, speed, place, first, step, low, high, crc = HEAD.unpack_from(self._held)
            sane = (
                magic in (MAGIC, LIT)
                and 0 < beams <= self.most_beams
                and math.isfinite(time)
                and 0 < step <= math.pi
                and step * (beams - 1) <= FULL * 2.0 * math.pi
            )
            if not sane or not math.isfinite(first) or not 0 <= low < high or number >= 1 << 63:
                self._skip("impossible frame")
                continue
            size = HEAD.size + 4 * beams * (1 + (magic == LIT))
            if len(self._held) < size:
                return
            body = bytes(self._held[HEAD.size : size])
            if zlib.crc32(body, zlib.crc32(bytes(self._held[:_BEFORE]))) != crc:
                self._skip("bad sum")
                continue
            del self._held[:size]
            values = np.frombuffer(body, "<f4").astype(np.float32)
            ranges, light = values[:beams], values[beams:] if magic == LIT else None
            yield Frame(number, time, Scan(beams, first, step, low, high), ranges, speed, place, None, light)

    def end(self) -> None:
        """No more bytes come: what is held is a frame that was cut."""
        if self._held:
            self.faults["cut frame"] += 1
            self._held.clear()

    def _skip(self, cause: str) -> None:
        self.faults[cause] += 1
        del self._held[: len(_BEGIN)]

    def _to_magic(self) -> None:
        """Drop what stands before the next magic, or all that cannot be the begin of one."""
        at = self._held.find(_BEGIN)
        if at < 0:
            kept = next((k for k in range(len(_BEGIN) - 1, 0, -1) if self._held.endswith(_BEGIN[:k])), 0)
            at = len(self._held) - kept
        self.faults["garbage bytes"] += at
        del self._held[:at]
