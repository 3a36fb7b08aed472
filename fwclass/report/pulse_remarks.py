"""What is told of the pulse of a survey's echoes: where it is not the recorded one, not one at all heights or along the
strip, or not that of all receivers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fwclass.decompose.system_pulse import disagree
from fwclass.errors import first_few

NAMED = 3
"""Strips of a remark that are named."""


LOUDER = 3.0
"""Times that a part of a strip is noisier than another from which it is told."""


def _recovery_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    some = [(s, c) for s in strips for c in s.get("channels", ()) if c.get("recovery", 0.0) > 0.0]
    if not some:
        return []
    _, worst = max(some, key=lambda one: one[1]["recovery_depth"])
    return [
        f"behind saturated samples the receiver is {worst['recovery_depth']:.3g} DN below its level (median) and comes "
        f"back with a time constant of {worst['recovery']:.0f} ns{channel_words(worst)}: that is taken off; "
        f"saturated echoes may be off by more than their errors ({names_of(strips_once(s for s, _ in some))})"
    ]


def _copy_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    some = [(s, c) for s in strips for c in s.get("channels", ()) if c.get("copies")]
    if not some:
        return []
    _, worst = max(some, key=lambda one: max(share for _, share in one[1]["copies"]))
    copies = " and ".join(f"{delay:.1f} ns later, {share:.2g} times as high" for delay, share in worst["copies"])
    return [
        f"every echo is recorded once more {copies}{channel_words(worst)}, as by after-pulses of a detector or a "
        f"reflection inside of the instrument: that is taken off ({names_of(strips_once(s for s, _ in some))})"
    ]


def _parity_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = []
    walking = [(s, c) for s in strips for c in s.get("channels", ()) if c.get("parity_walk", 0.0)]
    if walking:
        _, worst = max(walking, key=lambda one: one[1]["parity_walk"])
        lines.append(
            f"gains of samples of even and of odd number are not in one ratio along the strip{channel_words(worst)}: "
            f"it changes by {2.0 * worst['parity_walk']:.1%}, as in a file joined of two receivers', and makes false "
            f"echoes; cut the file into parts of one receiver ({names_of(strips_once(s for s, _ in walking))})"
        )
    some = [(s, c) for s in strips for c in s.get("channels", ()) if c.get("parity", 0.0)]
    if not some:
        return lines
    _, worst = max(some, key=lambda one: abs(one[1]["parity"]))
    return [
        *lines,
        f"samples of even number have {(1.0 + worst['parity']) / (1.0 - worst['parity']):.3f} times the gain of those "
        f"of odd number{channel_words(worst)}, as of two digitisers in turn: that is taken off "
        f"({names_of(strips_once(s for s, _ in some))})",
    ]


def pulse_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    """Where the echoes' pulse is not the recorded one, not the echoes', or not one at all heights, along the strip or
    of all receivers: of ``name``, ``channels``, ``widths`` and ``drift``."""
    walking = [s for s in strips if _walks(s)]
    known = [(s, c) for s in strips if s not in walking for c in s.get("channels", ())]
    lines = []
    if steady := [s for s in walking if not _drifts(s)]:  # of two pulses one may be the brighter
        (low, wide), (high, narrow) = _walk_ends(steady[0])
        lines.append(
            f"echoes are {wide:.2f} ns wide at {low:.0f} DN and {narrow:.2f} ns at {high:.0f} DN, where flat targets "
            "have one width: samples do not grow in proportion to the light, by the receiver or a table that they went "
            f"through; heights and energies of bright echoes do not compare with others' ({names_of(steady)})"
        )
    some = [(s, c) for s, c in known if not c["outgoing"] and disagree(c["fwhm"], c["recorded_fwhm"])]
    if some:
        _, worst = max(some, key=lambda one: abs(math.log(one[1]["fwhm"] / one[1]["recorded_fwhm"])))
        lines.append(
            f"the system pulse is {worst['fwhm']:.2f} ns wide by the echoes, {worst['recorded_fwhm']:.2f} ns by the "
            f"recorded outgoing pulses{channel_words(worst)}: look at info --waveforms, and fix it by pulse.width, "
            f"a Gaussian's ({names_of(strips_once(s for s, _ in some))})"
        )
    lines += [*_drift_remarks(strips), *_noise_drift_remarks(strips)]
    lines += _receiver_remarks(strips)
    lines += [*_recovery_remarks(strips), *_copy_remarks(strips)]
    lines += _parity_remarks(strips)
    some = [(s, c) for s, c in known if c["outgoing"]]
    if some:
        one = some[0][1]
        lines.append(
            f"the echoes show no pulse that they share: the recorded outgoing one of {one['fwhm']:.2f} ns is taken"
            f"{channel_words(one)} ({names_of(strips_once(s for s, _ in some))})"
        )
    return lines


def _drifts(strip: Mapping[str, Any]) -> bool:
    """Whether the width of a strip's echoes is another in a part of it."""
    return bool(strip.get("drift")) and disagree(*(w for _, w in _extremes(strip["drift"])))


def _drift_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    some = [s for s in strips if _drifts(s)]
    if not some:
        return []
    (first, early), (last, late) = sorted(_extremes(some[0]["drift"]))
    return [
        f"echoes are {early:.2f} ns wide about pulse {first:,.0f} and {late:.2f} ns about pulse {last:,.0f}, where "
        "flat targets have one width: laser or receiver change along the strip, or two take turns, and one pulse "
        f"for all of it makes false echoes; cut the file into parts of one width ({names_of(some)})"
    ]


def _noise_drift_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    some = [(s, _extremes(s["noise_drift"])) for s in strips if s.get("noise_drift")]
    some = [(s, ends) for s, ends in some if ends[1][1] >= LOUDER * ends[0][1]]
    if not some:
        return []
    (quiet, least), (loud, most) = max((ends for _, ends in some), key=lambda ends: ends[1][1] / ends[0][1])
    return [
        f"the noise is {most / least:.1f} times as large about pulse {loud:,.0f} ({most:.2g} DN) as about pulse "
        f"{quiet:,.0f}: where heights are, too, gains or numbers of bits change along the strip, and neither heights "
        f"nor energies compare; cut the file there ({names_of([s for s, _ in some])})"
    ]


def _extremes(drift: Sequence[Sequence[float]]) -> list[tuple[float, float]]:
    """(number of the pulse, value) where it is least and most."""
    by_width = sorted(((number, width) for number, width in drift), key=lambda one: one[1])
    return [by_width[0], by_width[-1]]


def _receiver_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    some = [(s, c) for s in strips for c in s.get("channels", ()) if c.get("receivers")]
    if not some:
        return []
    strip, one = some[0]
    others = [c for c in strip["channels"] if not c["receivers"] and _kind(c) == _kind(one)]
    of = ", ".join(f"{c['fwhm']:.2f} ns wide, noise {c['noise']:.2f} DN" for c in (one, *others))
    of += " of the others" if others else ""  # whose samples may never have been quiet
    return [
        "waveform descriptors tell receivers of different pulses or noise apart: "
        f"{descriptor_words(one['receivers'])} ({of}); each is fitted with its own pulse and noise, and heights of one "
        "do not compare with another's "
        f"({names_of(strips_once(s for s, _ in some))})"
    ]


def _kind(channel: Mapping[str, Any]) -> tuple[float, float]:
    return channel["sample_spacing"], channel["saturation"]


def descriptor_words(receivers: Sequence[int]) -> str:
    """Which waveform descriptors stand for the receivers of a channel."""
    return f"descriptor {', '.join(map(str, receivers))}"


def _walks(strip: Mapping[str, Any]) -> bool:
    """Whether the widths of the strip's dimmest and brightest echoes are those of two receivers."""
    if len(strip.get("widths", ())) < 2:
        return False
    (_, dim), (_, bright) = _walk_ends(strip)
    return disagree(bright, dim)


def _walk_ends(strip: Mapping[str, Any]) -> tuple[tuple[float, float], tuple[float, float]]:
    """(height [DN], width [ns]) of the dimmest and the brightest class of echoes."""
    walk = strip["widths"]
    return tuple(walk[0]), tuple(walk[-1])


def channel_words(channel: Mapping[str, Any]) -> str:
    """Which channel, where one is known."""
    if channel["sample_spacing"] is None:
        return ""
    own = f", {descriptor_words(channel['receivers'])}" if channel.get("receivers") else ""
    return f" (channel of {channel['sample_spacing']:g} ns samples up to {channel['saturation']:g} DN{own})"


def strips_once(strips: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """`strips` by name, each once."""
    return list({s["name"]: s for s in strips}.values())


def names_of(strips: Sequence[Mapping[str, Any]]) -> str:
    """The names of the first few of `strips`, and how many more there are."""
    return first_few([str(s["name"]) for s in strips], NAMED)
