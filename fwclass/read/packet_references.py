"""The wave packet blocks of points, and which points share a packet or are returns of one pulse."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.las_header import EVLR_HEADER
from fwclass.read.packet_kernels import join_heads, number_pulses, pulse_heads

OWN = np.uint64(2**64 - 1)
"""Key of a point that shares its packet with no other: it is a pulse of its own."""

MAX_RETURNS = 255
"""A packet that more returns than this refer to is a writer's constant, not a pulse."""


@dataclass(frozen=True)
class References:
    """The wave packet block of points: descriptor, offset [byte], size [byte], location [ns], step [m/ns]."""

    descriptor: NDArray[np.uint8]
    offset: NDArray[np.uint64]
    size: NDArray[np.uint32]
    location: NDArray[np.float64]
    step: NDArray[np.float64]

    @classmethod
    def of(cls, points: Any, mirrored: bool = False) -> References:
        """From a laspy record of point format 4, 5, 9 or 10; `mirrored`: with the horizontal parts turned round."""
        a = points.array
        with np.errstate(invalid="ignore"):  # a NaN that signals stays a NaN: no packet of it is usable
            step = np.stack([np.asarray(a[n], np.float64) for n in ("x_t", "y_t", "z_t")], axis=1)
            location = a["return_point_wave_location"].astype(np.float64)
        if mirrored:
            step[:, :2] *= -1.0
        return cls(a["wavepacket_index"], a["wavepacket_offset"], a["wavepacket_size"], location * 1e-3, step * 1e3)

    def take(self, index: Any) -> References:
        """Those of an index or a mask."""
        return References(*(getattr(self, f.name)[index] for f in fields(self)))


def packet_keys(points: Any) -> NDArray[np.uint64]:
    """What the returns of one pulse share: descriptor in the high byte, packet offset below; or `OWN`."""
    index = points.array["wavepacket_index"]
    offset = points.array["wavepacket_offset"]
    refers = (index != 0) & (offset >= EVLR_HEADER) & (offset < np.uint64((1 << 56) - 1))
    return np.where(refers, (index.astype(np.uint64) << np.uint64(56)) | offset, OWN)


def pulses_of(
    keys: NDArray[np.uint64], shared: tuple[int, ...], link: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Packet and pulse of every point, each counted from 0 by first appearance.

    Points of one key share a packet; a pulse has several where `link` ties a point to the one before it.
    `shared` are the keys that too many points of the whole file share.
    """
    if shared:
        keys = np.where(np.isin(keys, np.array(shared, np.uint64)), OWN, keys)
    head = np.empty(len(keys), np.int64)
    pulse_heads(keys, np.argsort(keys, kind="stable"), OWN, MAX_RETURNS, head)
    packet = np.empty(len(keys), np.int64)
    number_pulses(head, packet)
    if link is None or not link.any():
        return packet, packet
    join_heads(head, sound_links(keys, link))
    pulse = np.empty(len(keys), np.int64)
    number_pulses(head, pulse)
    return packet, pulse


def sound_links(keys: NDArray[np.uint64], link: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """`link` without the points whose packet is no pulse's (key `OWN`)."""
    own = keys == OWN
    sound = link & ~own
    sound[1:] &= ~own[:-1]
    return sound
