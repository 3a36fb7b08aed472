"""How the echoes of a strip are placed: what of a fitted time is the vendor's constant and range walk, and whether
times count from the recorded outgoing pulse."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.fitting import Fits
from fwclass.decompose.recurring import Recurring
from fwclass.schema import Table

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OffsetCurve:
    """Fitted time less the vendor's location in one channel of the receiver.

    Attributes
    ----------
    sample_spacing, saturation, receivers : what the channel is told by [ns, DN].
    heights, offsets : nodes of the curve [DN, ns], lowest first; straight over log height between, level beyond.
    constant, scatter : median of all, and robust standard deviation about the curve [ns].
    echoes : that it was made of.
    phase : locations lack the phase of the digitiser's clock.
    astray : share of the echoes whose time is not where the curve has it, by more than 0.1 m and their error; 0 where
        locations lack the phase.
    alike : locations walk with the height, and places go with them: nothing is taken off.
    stretch : share by which fitted times grow faster than locations, of all the strip, or else of its worst quarter; 0
        where that is not sure.
    drift : by how much the constant differs between two quarters of the strip [ns], later less earlier; 0 where that is
        not sure or below 0.05 m, and where echoes are placed by their own returns.
    slipped : share of the echoes that lie whole samples off the curve, more than lie between; 0 where that is not sure
        or below 2 %, and where echoes are placed by their own returns.
    """

    sample_spacing: float
    saturation: float
    heights: tuple[float, ...]
    offsets: tuple[float, ...]
    constant: float
    scatter: float
    echoes: int
    phase: bool
    astray: float = 0.0
    receivers: tuple[int, ...] = ()
    alike: bool = False
    stretch: float = 0.0
    drift: float = 0.0
    slipped: float = 0.0

    def at(self, amplitude: Floats) -> Floats:
        """Offset of echoes of these heights [ns]."""
        return np.interp(np.log(np.maximum(amplitude, 1e-9)), np.log(self.heights), self.offsets)


@dataclass(frozen=True)
class Placement:
    """How the echoes of a strip are placed.

    Attributes
    ----------
    curves : of the channels that showed one; none where `decompose.vendor_offset` is ``keep``.
    from_outgoing, range_from_outgoing : for places, and for the distance from the sensor, times count from the
        recorded outgoing pulse, whose own time is taken off. The two differ where a converter has put that time into
        the anchors.
    evidence : why, in words; empty where nothing was recorded.
    places, ranges : roughness along the line as stored, and less the outgoing pulse's time [m]; None unknown.
    outgoing : pulses of the sample with a recorded outgoing pulse.
    recurring : echoes of the sample that no scene makes.
    followed : shares of the waveforms whose highest echo saturates, and nearly does, that another echo follows; (0, 0)
        where these are as they should be (`followed_echoes`).
    alternate : how many times as high the echoes of odd pulses are as those of even ones, of the strip or of
        one quarter of it; 1 where that is not sure.
    descriptors : waveform descriptors whose echoes are surely higher or lower than those of the commonest one, and how
        many times as high.
    spacing : how many times as far apart samples are as the file says (`spacing_ratio`); 1 where that is not sure.
    uneven : echoes of the sample that the length of their beam vector moves (`uneven_echoes`), and all of them.
    """

    curves: tuple[OffsetCurve, ...] = ()
    from_outgoing: bool = True
    range_from_outgoing: bool = True
    evidence: str = ""
    places: tuple[float, float] | None = None
    ranges: tuple[float, float] | None = None
    outgoing: int = 0
    recurring: tuple[Recurring, ...] = ()
    followed: tuple[float, float] = (0.0, 0.0)
    uneven: tuple[int, int] = (0, 0)
    alternate: float = 1.0
    descriptors: tuple[tuple[int, float], ...] = ()
    spacing: float = 1.0

    def to_json(self) -> dict[str, Any]:
        """Plain data that `from_json` reads."""
        return asdict(self)

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Placement:
        """The placement that `to_json` wrote."""
        curves = tuple(
            OffsetCurve(**{**c, **{name: tuple(c[name]) for name in ("heights", "offsets", "receivers")}})
            for c in plain["curves"]
        )
        pairs = {name: None if plain[name] is None else tuple(plain[name]) for name in ("places", "ranges")}
        recurring = tuple(Recurring(**one) for one in plain["recurring"])
        descriptors = tuple((k, ratio) for k, ratio in plain["descriptors"])
        more = {"curves": curves, "recurring": recurring, "descriptors": descriptors}
        more |= {name: tuple(plain[name]) for name in ("followed", "uneven")}
        return cls(**{**plain, **pairs, **more})


AS_STORED = Placement()
"""Nothing known of the strip: locations are taken as they are, outgoing pulses are taken off."""


def offsets_of(fits: Fits, pulses: Table, placement: Placement) -> Floats:
    """How much later than its vendor would have it every echo was fitted [ns]; 0 in channels without a curve."""
    return offsets_at(fits.amplitude, channel_rows(placement.curves, pulses)[fits.row], placement)


def offsets_at(height: Floats, channel: NDArray[np.int64], placement: Placement) -> Floats:
    """Offset [ns] of echoes of `height` [DN] by curve number `channel` of the placement, (n,) each; 0 without one."""
    late = np.zeros(len(height))
    for k, curve in enumerate(placement.curves):
        mine = channel == k
        late[mine] = curve.at(height[mine])
    return late


def phases_of(pulses: Table, placement: Placement) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Two masks, bool (rows,): locations known to lack the clock's phase, and rows of which nothing is known."""
    channel = channel_rows(placement.curves, pulses)
    return np.array([*(c.phase for c in placement.curves), False])[channel], channel == len(placement.curves)


def describe_placement(placement: Placement) -> dict[str, Any]:
    """Facts for receipts and reports: ``vendor_offset``, channels with a curve, ``outgoing_time``, or None,
    ``recurring``, ``followed`` and ``uneven`` echoes, `alternate`, `spacing`, and `descriptors`."""
    lists = ("heights", "offsets", "receivers")
    channels = [{**asdict(c), **{name: list(getattr(c, name)) for name in lists}} for c in placement.curves]
    recorded = {
        "from_outgoing": placement.from_outgoing,
        "range_from_outgoing": placement.range_from_outgoing,
        "evidence": placement.evidence,
        "places_m": list(placement.places or ()),
        "ranges_m": list(placement.ranges or ()),
        "pulses": placement.outgoing,
    }
    return {
        "vendor_offset": channels,
        "outgoing_time": recorded if placement.outgoing else None,
        "recurring": [asdict(one) for one in placement.recurring],
        "followed": list(placement.followed),
        "uneven": list(placement.uneven),
        "alternate": placement.alternate,
        "spacing": placement.spacing,
        "descriptors": [list(one) for one in placement.descriptors],
    }
