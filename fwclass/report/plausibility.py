"""What the echoes of every strip look like beside its returns: counted, told, and judged."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fwclass.assess.remarks import percent_words
from fwclass.decompose.params import DecomposeParams, PlausibilityParams
from fwclass.decompose.plausible import UNKNOWN
from fwclass.errors import refuse_unsound
from fwclass.read import beam_source, pls_waves
from fwclass.report.pulse_remarks import channel_words, names_of, pulse_remarks, strips_once
from fwclass.report.recurring import ADVICE, recurring_facts, recurring_remarks
from fwclass.units import LAND, METRES_PER_NS

TOLD_FROM = 0.1
"""Share of the echoes without a return, or of the returns without an echo, from which a remark tells it."""

RARE = 0.001
"""Share of the echoes, or of the waveforms, up to which implausible ones are counted, and not worth a remark."""

DAMAGED = 0.02
"""Share of the waveforms from which it is told that samples are damaged; up to 0.006 of sound ones look like it."""

UNEVEN = 0.01
"""Share of the echoes moved by their beam vectors from which it is told; none on the receivers measured."""

INFLATED = 1.1
"""From so many times the noise that was reckoned with on, it is told."""

UNSETTLED = 0.01
"""Share of a variance that fits which settled leave unknown, too; from there on it is told."""

PERIODIC = 0.2
"""Share of the noise's variance that comes back, from which it is told; at most 0.02 on the receivers measured."""

OFFSET = 0.05
"""ns between fitted times and the vendor's locations from which it is told: 7 mm."""

SCATTERED = 0.15
"""Share of the echoes off their returns from which it is told; 0.05 and less on the receivers measured."""

UNREADABLE = (
    *("packet past the end", "packet cut short", "packet shared by too many returns"),
    "compressed packet damaged, or another file's",
    *pls_waves.DAMAGED,
    *beam_source.DAMAGED,
)
"""Faults of reading that a file shows which is cut off, damaged, another's, or exported wrongly."""

WHOLE = (
    "copy the waveforms again, or take those that belong to these points; fwclass info --waveforms counts the faults"
)
LOOK = (
    "look at the waveforms (fwclass info --waveforms); a higher decompose.detection leaves weak echoes out, and "
    "samples that no pulse explains may be stored wrongly"
)
"""What to do where a bound is passed."""

SHAPES = (
    f"{LOOK}; detectors with pulses of their own count as one where no descriptor tells them apart: give each a file "
    "of its own"
)

FLOOR = (
    "their level was taken off, and what lay below it cut, so that noise and false echoes cannot be told: export them "
    "with their level"
)

TURN = "samples grow with the light here: turn the sign of a receiver that counts down (largest value less sample)"

SWAP = "samples of 16 bits were written with the high byte first, or are no samples; export them low byte first"

TWICE = "export one of both, with twice the sample spacing: as they are, a pulse has steps, which are taken for echoes"

BITS = "digitiser or converter lose it, and steps of noise and pulses are taken for echoes; export the samples again"

MIXED = (
    "packets are those of other returns, or intensities no measure of strength; export points and waveforms together"
)
LENGTHS = (
    "write vectors with more digits (7 decimals of metres a nanosecond), all as long as light's way; of a file put "
    "together of others, in one unit"
)

UNITS = (
    "locations and beam vectors count the light's way there and back, in picoseconds, and vectors point from the "
    "return to the sensor; where they do, packets are those of other returns"
)

SHARES = {
    "poor": "fitted",
    **dict.fromkeys(("blank", "downward", "floored", "swapped", "doubled", "stuck"), "waveforms"),
    "unlike": "compared",
    "misplaced": "paired",
}
"""Counts of a strip that are told as a share, and of which other count."""

DOUBTFUL, DOUBTED = 0.3, 20
"""Share of neighbouring returns, and number, from which their strengths are told: chance makes a half."""


def receiver_facts(meta: Mapping[str, Any]) -> dict[str, Any]:
    """What the receipt of a strip's pulse says of its noise, of every channel's pulse (`channel_pulses`), and how
    wide echoes are at every height and along the strip (`width_walk`, `width_drift`)."""
    walks = {name: meta.get(name, []) for name in ("widths", "drift")}
    return {
        **{name: meta[name] for name in (*UNKNOWN.noise.facts, "channels")},
        **walks,
        "unsettled": meta.get("unsettled", 0.0),
    }


def strip_plausibility(
    name: str,
    returns: int,
    counts: Mapping[str, int],
    noise: Mapping[str, Any],
    places: Mapping[str, Any] | None = None,
    faults: Mapping[str, int] | None = None,
    pulses: int = 0,
) -> dict[str, Any]:
    """One strip for report.json: counts of echoes and returns, shares of them, what its noise is like, how its echoes
    were placed (`placement.describe_placement`), and how many of its packets cannot be read, of its `faults`: a share
    of its `pulses` where it has no returns."""
    checked = counts["checked"] if returns else 0
    compared = checked or (counts["fitted"] if counts["off_earth"] else 0)  # places tell without any return
    unreadable = sum((faults or {}).get(name, 0) for name in UNREADABLE)
    return {
        "name": name,
        "returns": returns,
        **counts,
        "unexplained_share": counts["unexplained"] / checked if checked else None,
        "implausible_share": counts["implausible"] / compared if compared else None,
        "unmatched_returns_share": counts["returns_without_echo"] / returns if returns else None,
        **noise,
        "places": places,
        **recurring_facts(places, counts, checked),
        **uneven_facts(places),
        **{f"{name}_share": counts[name] / counts[of] if counts[of] else None for name, of in SHARES.items()},
        "unreadable_packets": unreadable,
        "unreadable_share": unreadable / (returns or pulses) if returns or pulses else None,
        "pulses": pulses,
    }


def uneven_facts(places: Mapping[str, Any] | None) -> dict[str, Any]:
    """``uneven`` echoes of a strip's sample, moved by the length of their beam vector, of ``uneven_asked``, and their
    ``uneven_share``, None where none was asked."""
    some, asked = (places or {}).get("uneven", (0, 0))
    return {"uneven": some, "uneven_asked": asked, "uneven_share": some / asked if asked else None}


def plausibility_remarks(strips: Sequence[Mapping[str, Any]], params: DecomposeParams) -> list[str]:
    """What is worth telling of strips (`strip_plausibility`): one line for each kind, whatever their number."""
    lines = []
    if some := [s for s in strips if s["implausible"] > RARE * s["fitted"]]:
        below, weak = _sums(some, "below", "weak")
        lines.append(
            f"{_part(some, 'implausible', 'fitted', 'echoes')} are implausible, and neither ground filter nor terrain "
            f"sees them: {below:,} more than {params.envelope_margin:g} m below all returns around, {weak:,} after all "
            f"else of their pulse, or above all returns, and no stronger than the noise ({names_of(some)})"
        )
    if some := [s for s in strips if (s["unexplained_share"] or 0.0) >= TOLD_FROM]:
        lines.append(
            f"{_part(some, 'unexplained', 'checked', 'echoes')} have no return within "
            f"{params.vendor_tolerance:g} ns, {sum(s['outside'] for s in some):,} of them lie outside of the returns' "
            f"heights ({names_of(some)})"
        )
    if some := [s for s in strips if (s["unmatched_returns_share"] or 0.0) >= TOLD_FROM]:
        lines.append(
            f"{_part(some, 'returns_without_echo', 'returns', 'returns')} have no echo within "
            f"{params.vendor_tolerance:g} ns ({names_of(some)})"
        )
    lines += _sample_remarks(strips)
    if some := [s for s in strips if (s["unlike_share"] or 0.0) > DOUBTFUL and s["unlike"] >= DOUBTED]:
        lines.append(
            f"{_part(some, 'unlike', 'compared', 'neighbouring returns')} are the other way round in strength than "
            f"their echoes: {MIXED} ({names_of(some)})"
        )
    words = f"do not lie as far apart as light goes between their locations, or beside their beam: {UNITS}"
    lines += _above(strips, "misplaced", TOLD_FROM, "neighbouring returns of one pulse", words)
    if some := [s for s in strips if (s["uneven_share"] or 0.0) > UNEVEN]:
        lines.append(
            f"{_part(some, 'uneven', 'uneven_asked', 'echoes')} of a sample lie more than "
            f"{params.beam_lengths.moved:g} m off along their beam, as beam vectors are not as long as light's way, or "
            f"not all of them, or are rounded: {LENGTHS} ({names_of(some)})"
        )
    if some := [s for s in strips if s["off_earth"]]:
        lines.append(
            f"{_part(some, 'off_earth', 'fitted', 'echoes')} lie below {LAND[0]:g} m or above {LAND[1]:g} m, "
            f"where no land is: are times in nanoseconds, and directions in metres? ({names_of(some)})"
        )
    words = "the samples are not what the pulse and the noise explain"
    lines += _above(
        strips, "poor", TOLD_FROM, "echoes", f"are poorly fitted, misfit above {params.poor_misfit:g}: {words}"
    )
    lines += [*recurring_remarks(strips), *pulse_remarks(strips)]
    lines += _noise_remarks(strips, params)
    return [*filter(None, lines), *place_remarks(strips)]


def _sample_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of packets that cannot be read, and of samples that no receiver records; empty ones among them."""
    lines = []
    if some := [s for s in strips if (s["unreadable_share"] or 0.0) > TOLD_FROM]:
        lines += [
            _unreadable_words([s for s in some if s["returns"]], "returns"),
            _unreadable_words([s for s in some if not s["returns"]], "pulses"),
        ]
    for kind, bound, what, words in (
        (
            *("blank", RARE, "pulses"),
            "have nothing but zeros, or the digitiser's limit, for a waveform, which no receiver records: is the "
            "packet file whole?",
        ),
        ("downward", RARE, "waveforms", f"have echoes that point down, and are not found: {TURN}"),
        ("floored", TOLD_FROM, "waveforms", f"have more than a quarter of their samples at 0: {FLOOR}"),
        ("swapped", RARE, "waveforms", f"are smooth only with the two bytes of every sample exchanged: {SWAP}"),
        ("doubled", DAMAGED, "waveforms", f"have every sample twice: {TWICE}"),
        ("stuck", DAMAGED, "waveforms", f"have a bit that never changes, though higher and lower ones do: {BITS}"),
    ):
        lines += _above(strips, kind, bound, what, words)
    return lines


def _noise_remarks(strips: Sequence[Mapping[str, Any]], params: DecomposeParams) -> list[str]:
    """Of noise that is correlated, comes back, or is not known under echoes."""
    lines = []
    if some := [s for s in strips if s.get("unsettled", 0.0) > UNSETTLED]:
        lines.append(
            "fits that weigh samples by what they show of the noise under bright echoes did not settle: its variance "
            f"is known to {percent_words(max(s['unsettled'] for s in some))}, and so are squared errors of such echoes "
            f"({names_of(some)})"
        )
    if some := [s for s in strips if (s["lag1"] or 0.0) > params.white_noise and s["inflation"] >= INFLATED]:
        worst = max(some, key=lambda s: s["lag1"])
        lines.append(
            f"the noise is correlated (neighbouring samples by {worst['lag1']:.2f}): decompose.detection of "
            f"{params.detection:g} standard deviations is in truth {params.detection / worst['inflation']:.1f} "
            f"({names_of(some)})"
        )
    if some := [s for s in strips if (s.get("noise_periodic") or 0.0) > PERIODIC]:
        worst = max(some, key=lambda s: s["noise_periodic"])
        lines.append(
            f"{percent_words(worst['noise_periodic'])} of the noise's variance comes back every "
            f"{worst['noise_period']} samples, as what a receiver picks up: "
            f"errors of echoes are larger than they say ({names_of(some)})"
        )
    return lines


def place_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    """How the echoes of strips were placed, where that is not as the file has it: of ``name`` and ``places``."""
    offsets = [(s, c) for s in strips for c in (s["places"] or {}).get("vendor_offset", ())]
    lines = []
    some = [(s, c) for s, c in offsets if max(map(abs, c["offsets"])) >= OFFSET]
    if some:
        worst = max((c for _, c in some), key=lambda c: abs(c["constant"]))
        low, high, metres = worst["offsets"][0], worst["offsets"][-1], abs(worst["constant"]) * METRES_PER_NS
        walk = ""
        if len(worst["offsets"]) > 1:
            walk = f", from {low:.2f} at {worst['heights'][0]:.0f} DN to {high:.2f} at {worst['heights'][-1]:.0f} DN"
        lines.append(
            f"fitted times lie {worst['constant']:+.2f} ns ({metres:.2f} m) from the vendor's locations{walk}; this is "
            f"taken off (decompose.vendor_offset; {names_of(strips_once(s for s, _ in some))})"
        )
    some = [(s, c) for s, c in offsets if c.get("alike")]
    if some:
        worst = max((c for _, c in some), key=lambda c: abs(c["constant"]))
        lines.append(
            f"fitted times lie {worst['constant']:+.2f} ns (median) from the vendor's locations, which walk with the "
            "height, and his places go with them: echoes lie where their pulses peak, "
            f"{abs(worst['constant']) * METRES_PER_NS:.2f} m off his returns "
            f"({names_of(strips_once(s for s, _ in some))})"
        )
    some = [(s, c) for s, c in offsets if c.get("stretch")]
    if some:
        _, worst = max(some, key=lambda one: abs(one[1]["stretch"]))
        lines.append(
            f"fitted times grow by {worst['stretch']:+.1%} against the vendor's locations{channel_words(worst)}, in a "
            "quarter of the strip or all of it: "
            "samples are not as far apart as the file says, or locations are not, and echoes lie too far from their "
            f"pulse's first return, or too near, by that share ({names_of(strips_once(s for s, _ in some))})"
        )
    some = [(s, c) for s, c in offsets if c.get("drift")]
    if some:
        _, worst = max(some, key=lambda one: abs(one[1]["drift"]))
        lines.append(
            f"fitted times drift by {worst['drift']:+.2f} ns ({abs(worst['drift']) * METRES_PER_NS:.2f} m) against the "
            f"vendor's locations between two quarters of the strip{channel_words(worst)}: a clock that drifts, or two "
            "receivers in one file; one constant is taken off, so that echoes lie off by up to as much; write the "
            f"parts to files of their own ({names_of(strips_once(s for s, _ in some))})"
        )
    some = [(s, c) for s, c in offsets if c.get("astray", 0.0) > SCATTERED and not c.get("slipped")]
    if some:
        _, worst = max(some, key=lambda one: one[1]["astray"])
        lines.append(
            f"{percent_words(worst['astray'])} of the echoes lie more than 0.1 m off the returns that place them"
            f"{channel_words(worst)}: locations or samples of some pulses are not where they say, by a sample "
            f"perhaps, and their echoes are off by as much ({names_of(strips_once(s for s, _ in some))})"
        )
    some = [(s, c) for s, c in offsets if c.get("slipped")]
    if some:
        _, worst = max(some, key=lambda one: one[1]["slipped"])
        lines.append(
            f"{percent_words(worst['slipped'])} of the echoes lie whole samples off the returns that place them"
            f"{channel_words(worst)}: samples were lost before them, or locations are of other samples, and their "
            f"echoes are off by {worst['sample_spacing'] * METRES_PER_NS:.2f} m or more "
            f"({names_of(strips_once(s for s, _ in some))})"
        )
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
    if spaced := [s for s in strips if (s["places"] or {}).get("spacing", 1.0) != 1.0]:
        worst = max((s["places"]["spacing"] for s in spaced), key=lambda ratio: abs(math.log(ratio)))
        lines.append(
            f"samples are {worst:.2f} times as far apart as the file says, by how echoes of the ground move in the "
            "record as it begins earlier or later: echoes lie off by as much of their way from the first sample; name "
            f"the spacing that is right ({names_of(spaced)})"
        )
    some = [(s, c) for s, c in offsets if c["phase"]]
    if some:
        lines.append(
            "the vendor's locations lack the phase of the digitiser's clock, half a sample: every pulse is placed by "
            f"its own return (decompose.register_within; {names_of(strips_once(s for s, _ in some))})"
        )
    for way in (True, False):
        times = [s for s in strips if ((s["places"] or {}).get("outgoing_time") or {}).get("from_outgoing") is way]
        if times:
            evidence = times[0]["places"]["outgoing_time"]["evidence"]
            what = "is taken off" if way else "is not taken off"
            lines.append(
                f"the time of the recorded outgoing pulse {what}: {evidence} "
                f"(decompose.outgoing_time; {names_of(times)})"
            )
    return lines


def _unreadable_words(strips: Sequence[Mapping[str, Any]], what: str) -> str:
    """`what` : "returns" or "pulses", of `strips` that all have such."""
    if not strips:
        return ""
    then = "lie where their vendor has them: is the packet file whole?" if what == "returns" else "are left out"
    return (
        f"{_part(strips, 'unreadable_packets', what, what)} have a waveform that cannot be read, and {then} "
        f"({names_of(strips)})"
    )


def _above(strips: Sequence[Mapping[str, Any]], kind: str, bound: float, what: str, words: str) -> list[str]:
    """That `words` hold of so many of `what`, where their share (of `SHARES`) is above `bound`."""
    some = [s for s in strips if (s[f"{kind}_share"] or 0.0) > bound]
    return [f"{_part(some, kind, SHARES[kind], what)} {words} ({names_of(some)})"] if some else []


def _part(strips: Sequence[Mapping[str, Any]], part: str, whole: str, what: str) -> str:
    """``3 of 1,000 echoes (0.3 %)``, of all `strips` together."""
    some, every = _sums(strips, part, whole)
    return f"{some:,} of {every:,} {what} ({percent_words(some / every)})"


def _sums(strips: Iterable[Mapping[str, Any]], *keys: str) -> list[int]:
    return [sum(s[key] for s in strips) for key in keys]


def judge_plausibility(strips: Iterable[Mapping[str, Any]], params: PlausibilityParams) -> None:
    """`QualityError` naming the strip that is furthest beyond a bound; nothing where the user accepts it."""
    bounds = (
        ("unreadable", "unreadable_packets", "waveforms cannot be read", WHOLE),
        ("blank", "blank", "waveforms are nothing but zeros or the limit", WHOLE),
        ("downward", "downward", "waveforms have echoes that point down", TURN),
        ("floored", "floored", "waveforms stand at 0", FLOOR),
        ("unlike", "unlike", "returns have the strength of other echoes", MIXED),
        ("misplaced", "misplaced", "returns do not lie where their times say", UNITS),
        ("uneven", "uneven", "echoes lie off by the length of their beam vector", LENGTHS),
        ("swapped", "swapped", "waveforms have their samples' bytes exchanged", SWAP),
        ("doubled", "doubled", "waveforms have every sample twice", TWICE),
        ("stuck", "stuck", "waveforms have a bit that never changes", BITS),
        ("poor", "poor", "fitted echoes fit poorly", SHAPES),
        ("recurring", "recurring", "waveforms have an echo that no scene makes", ADVICE),
        ("implausible", "implausible", "echoes are implausible", LOOK),
        ("unmatched_returns", "returns_without_echo", "returns have no echo", LOOK),
    )
    listed = list(strips)
    for kind, count, words, hint in bounds:
        share, most = f"{kind}_share", getattr(params, f"max_{kind}")
        beyond = [s for s in listed if s[share] is not None and s[share] > most and s[count] >= params.least]
        if beyond:
            worst = max(beyond, key=lambda s: s[share])
            others = f" (and {len(beyond) - 1} more strips)" if len(beyond) > 1 else ""
            refuse_unsound(
                [f"{worst[count]:,}, {percent_words(worst[share])}"],
                params.accept,
                f"more {words} than a sound survey has",
                where=f"{worst['name']}{others}",
                expected=f"at most {percent_words(most)} (plausibility.max_{kind})",
                do=hint,
            )
    if unsettled := [s for s in listed if s.get("unsettled", 0.0) > params.max_unsettled]:
        worst = max(unsettled, key=lambda s: s["unsettled"])
        refuse_unsound(
            [f"variances that differ by {percent_words(worst['unsettled'])}"],
            params.accept,
            "the noise under bright echoes does not settle",
            where=worst["name"],
            expected=f"at most {percent_words(params.max_unsettled)} (plausibility.max_unsettled)",
            do=SHAPES,
        )
