"""What the echoes of every strip look like beside its returns: counted and judged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from fwclass.assess.remarks import percent_words
from fwclass.decompose.params import PlausibilityParams
from fwclass.decompose.plausible import UNKNOWN
from fwclass.errors import refuse_unsound
from fwclass.read import beam_source, pls_waves
from fwclass.report.recurring import ADVICE, recurring_facts

UNREADABLE = (
    *("packet past the end", "packet cut short", "packet shared by too many returns"),
    "compressed packet damaged, or another file's",
    *pls_waves.DAMAGED,
    *beam_source.DAMAGED,
)
"""Faults of reading that a file shows which is cut off, damaged, another's, or exported wrongly."""

# what to do where a bound is passed

WHOLE = (
    "copy the waveforms again, or take those that belong to these points; fwclass info --waveforms counts the faults"
)
LOOK = (
    "look at the waveforms (fwclass info --waveforms); a higher decompose.detection leaves weak echoes out, and "
    "samples that no pulse explains may be stored wrongly"
)
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

LATE = "what begins behind its peak is not found: export records from some samples before the first echo on"

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
    **dict.fromkeys(("blank", "downward", "floored", "swapped", "doubled", "stuck", "late"), "waveforms"),
    "unlike": "compared",
    "misplaced": "paired",
}
"""Counts of a strip that are told as a share, and of which other count."""


def receiver_facts(meta: Mapping[str, Any]) -> dict[str, Any]:
    """What the receipt of a strip's pulse says of its noise, of every channel's pulse (`channel_pulses`), and how
    wide echoes are at every height and along the strip (`width_walk`, `width_drift`)."""
    walks = {name: meta.get(name, []) for name in ("widths", "drift", "noise_drift")}
    return {
        **{name: meta.get(name, value) for name, value in UNKNOWN.noise.facts.items()},
        "channels": meta["channels"],
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
        ("late", "late", "waveforms begin behind the peak of an echo", LATE),
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
