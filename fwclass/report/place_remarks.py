"""What is told of how the echoes of strips were placed, where that is not as the file has it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fwclass.assess.remarks import percent_words
from fwclass.report.pulse_remarks import channel_words, names_of, strips_once
from fwclass.units import METRES_PER_NS

OFFSET = 0.05
"""ns between fitted times and the vendor's locations from which it is told: 7 mm."""

SCATTERED = 0.15
"""Share of the echoes off their returns from which it is told; 0.05 and less on the receivers measured."""

Strip = Mapping[str, Any]
Channel = Mapping[str, Any]


def place_remarks(strips: Sequence[Strip]) -> list[str]:
    """How the echoes of strips were placed, where that is not as the file has it: of ``name`` and ``places``."""
    channels = [(s, c) for s in strips for c in (s["places"] or {}).get("vendor_offset", ())]
    return [
        *_constant_remarks(channels),
        *_clock_remarks(channels),
        *_stray_remarks(channels),
        *_unlike_remarks(strips),
        *_spacing_remarks(strips),
        *_phase_remarks(channels),
        *_outgoing_remarks(strips),
    ]


def _names(some: Sequence[tuple[Strip, Channel]]) -> str:
    return names_of(strips_once(strip for strip, _ in some))


def _worst(some: Sequence[tuple[Strip, Channel]], size: Callable[[Channel], float]) -> Channel:
    return max((channel for _, channel in some), key=size)


def _constant_remarks(channels: Sequence[tuple[Strip, Channel]]) -> list[str]:
    """Of a constant between fitted times and the vendor's locations, taken off or gone with."""
    lines = []
    if some := [(s, c) for s, c in channels if max(map(abs, c["offsets"])) >= OFFSET]:
        worst = _worst(some, lambda c: abs(c["constant"]))
        low, high, metres = worst["offsets"][0], worst["offsets"][-1], abs(worst["constant"]) * METRES_PER_NS
        walk = ""
        if len(worst["offsets"]) > 1:
            walk = f", from {low:.2f} at {worst['heights'][0]:.0f} DN to {high:.2f} at {worst['heights'][-1]:.0f} DN"
        lines.append(
            f"fitted times lie {worst['constant']:+.2f} ns ({metres:.2f} m) from the vendor's locations{walk}; this is "
            f"taken off (decompose.vendor_offset; {_names(some)})"
        )
    if some := [(s, c) for s, c in channels if c.get("alike")]:
        worst = _worst(some, lambda c: abs(c["constant"]))
        lines.append(
            f"fitted times lie {worst['constant']:+.2f} ns (median) from the vendor's locations, which walk with the "
            "height, and his places go with them: echoes lie where their pulses peak, "
            f"{abs(worst['constant']) * METRES_PER_NS:.2f} m off his returns ({_names(some)})"
        )
    return lines


def _clock_remarks(channels: Sequence[tuple[Strip, Channel]]) -> list[str]:
    """Of times that grow or drift against the vendor's locations."""
    lines = []
    if some := [(s, c) for s, c in channels if c.get("stretch")]:
        worst = _worst(some, lambda c: abs(c["stretch"]))
        lines.append(
            f"fitted times grow by {worst['stretch']:+.1%} against the vendor's locations{channel_words(worst)}, in a "
            "quarter of the strip or all of it: "
            "samples are not as far apart as the file says, or locations are not, and echoes lie too far from their "
            f"pulse's first return, or too near, by that share ({_names(some)})"
        )
    if some := [(s, c) for s, c in channels if c.get("drift")]:
        worst = _worst(some, lambda c: abs(c["drift"]))
        lines.append(
            f"fitted times drift by {worst['drift']:+.2f} ns ({abs(worst['drift']) * METRES_PER_NS:.2f} m) against the "
            f"vendor's locations between two quarters of the strip{channel_words(worst)}: a clock that drifts, or two "
            "receivers in one file; one constant is taken off, so that echoes lie off by up to as much; write the "
            f"parts to files of their own ({_names(some)})"
        )
    return lines


def _stray_remarks(channels: Sequence[tuple[Strip, Channel]]) -> list[str]:
    """Of echoes that lie off the returns which place them, by whole samples or otherwise."""
    lines = []
    if some := [(s, c) for s, c in channels if c.get("astray", 0.0) > SCATTERED and not c.get("slipped")]:
        worst = _worst(some, lambda c: c["astray"])
        lines.append(
            f"{percent_words(worst['astray'])} of the echoes lie more than 0.1 m off the returns that place them"
            f"{channel_words(worst)}: locations or samples of some pulses are not where they say, by a sample "
            f"perhaps, and their echoes are off by as much ({_names(some)})"
        )
    if some := [(s, c) for s, c in channels if c.get("slipped")]:
        worst = _worst(some, lambda c: c["slipped"])
        lines.append(
            f"{percent_words(worst['slipped'])} of the echoes lie whole samples off the returns that place them"
            f"{channel_words(worst)}: samples were lost before them, or locations are of other samples, and their "
            f"echoes are off by {worst['sample_spacing'] * METRES_PER_NS:.2f} m or more ({_names(some)})"
        )
    return lines


def _unlike_remarks(strips: Sequence[Strip]) -> list[str]:
    """Of lasers or receivers of one strip that are not alike."""
    lines = []
    if unlike := [(s, one) for s in strips for one in (s["places"] or {}).get("descriptors", ())]:
        _, (kind, ratio) = max(unlike, key=lambda one: abs(one[1][1] - 1.0))
        lines.append(
            f"echoes of waveform descriptor {kind} are {ratio:.3f} times as high as those of the commonest one in the "
            "pulses beside: lasers or receivers that are not alike; their heights do not compare, and their energies "
            f"only where the descriptors' gains say so ({names_of(strips_once(s for s, _ in unlike))})"
        )
    if in_turn := [
        s for s in strips if (p := s["places"] or {}).get("alternate", 1.0) != 1.0 and not p.get("descriptors")
    ]:
        worst = max((s["places"]["alternate"] for s in in_turn), key=lambda ratio: abs(ratio - 1.0))
        lines.append(
            f"echoes of every other pulse are {max(worst, 1.0 / worst):.3f} times as high as those between: two "
            f"lasers, facets or receivers in turn; their heights and energies do not compare ({names_of(in_turn)})"
        )
    return lines


def _spacing_remarks(strips: Sequence[Strip]) -> list[str]:
    spaced = [s for s in strips if (s["places"] or {}).get("spacing", 1.0) != 1.0]
    if not spaced:
        return []
    worst = max((s["places"]["spacing"] for s in spaced), key=lambda ratio: abs(math.log(ratio)))
    return [
        f"samples are {worst:.2f} times as far apart as the file says, by how echoes of the ground move in the "
        "record as it begins earlier or later: echoes lie off by as much of their way from the first sample; name "
        f"the spacing that is right ({names_of(spaced)})"
    ]


def _phase_remarks(channels: Sequence[tuple[Strip, Channel]]) -> list[str]:
    some = [(s, c) for s, c in channels if c["phase"]]
    if not some:
        return []
    return [
        "the vendor's locations lack the phase of the digitiser's clock, half a sample: every pulse is placed by "
        f"its own return (decompose.register_within; {_names(some)})"
    ]


def _outgoing_remarks(strips: Sequence[Strip]) -> list[str]:
    lines = []
    for from_outgoing, what in ((True, "is taken off"), (False, "is not taken off")):
        times = [(s, ((s["places"] or {}).get("outgoing_time") or {})) for s in strips]
        some = [(s, time) for s, time in times if time.get("from_outgoing") is from_outgoing]
        if some:
            lines.append(
                f"the time of the recorded outgoing pulse {what}: {some[0][1]['evidence']} "
                f"(decompose.outgoing_time; {names_of([s for s, _ in some])})"
            )
    return lines
