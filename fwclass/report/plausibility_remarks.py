"""What is worth telling of the echoes of strips beside their returns, of their samples and their noise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fwclass.assess.remarks import percent_words
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.quiet import NOISELESS
from fwclass.report.place_remarks import place_remarks
from fwclass.report.plausibility import BITS, FLOOR, LATE, LENGTHS, MIXED, SHARES, SWAP, TURN, TWICE, UNITS
from fwclass.report.pulse_remarks import names_of, pulse_remarks
from fwclass.report.recurring import recurring_remarks
from fwclass.units import LAND

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

ROUNDED = (
    "their rounding counts as noise, 0.29 of a step, so that thresholds, A/σ, standard errors and misfit tell nothing "
    "of a receiver"
)

DOUBTFUL, DOUBTED = 0.3, 20
"""Share of neighbouring returns, and number, from which their strengths are told: chance makes a half."""


def plausibility_remarks(strips: Sequence[Mapping[str, Any]], params: DecomposeParams) -> list[str]:
    """What is worth telling of strips (`plausibility.strip_plausibility`): one line for each kind, whatever their
    number."""
    words = f"are poorly fitted, misfit above {params.poor_misfit:g}: the samples are not what the pulse and the noise"
    return [
        *_echo_remarks(strips, params),
        *_sample_remarks(strips),
        *_beam_remarks(strips, params),
        *_above(strips, "poor", TOLD_FROM, "echoes", f"{words} explain"),
        *recurring_remarks(strips),
        *pulse_remarks(strips),
        *_noise_remarks(strips, params),
        *place_remarks(strips),
    ]


def _echo_remarks(strips: Sequence[Mapping[str, Any]], params: DecomposeParams) -> list[str]:
    """Of echoes that cannot be, of echoes without a return, and of returns without an echo."""
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
    return lines


def _beam_remarks(strips: Sequence[Mapping[str, Any]], params: DecomposeParams) -> list[str]:
    """Of returns that are not those of their waveforms, and of echoes that lie off along their beam or off the Earth's
    land."""
    lines = []
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
    return lines


def _sample_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of packets that cannot be read, and of samples that no receiver records."""
    lines = []
    if some := [s for s in strips if (s["unreadable_share"] or 0.0) > TOLD_FROM]:
        lines += _unreadable_words([s for s in some if s["returns"]], "returns")
        lines += _unreadable_words([s for s in some if not s["returns"]], "pulses")
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
        ("late", DAMAGED, "waveforms", f"begin behind the peak of an echo, which is lost: {LATE}"),
        ("stuck", DAMAGED, "waveforms", f"have a bit that never changes, though higher and lower ones do: {BITS}"),
    ):
        lines += _above(strips, kind, bound, what, words)
    return lines


def _noise_remarks(strips: Sequence[Mapping[str, Any]], params: DecomposeParams) -> list[str]:
    """Of noise that is none, is correlated, comes back, or is not known under echoes."""
    lines = []
    if some := [s for s in strips if s.get("noise_still", 0.0) >= NOISELESS]:
        lines.append(
            f"the samples have no noise ({percent_words(min(s['noise_still'] for s in some))} of the quiet ones are "
            f"one value), as simulated ones: {ROUNDED} ({names_of(some)})"
        )
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


def _unreadable_words(strips: Sequence[Mapping[str, Any]], what: str) -> list[str]:
    """`what`: "returns" or "pulses", of `strips` that all have such."""
    if not strips:
        return []
    then = "lie where their vendor has them: is the packet file whole?" if what == "returns" else "are left out"
    return [
        f"{_part(strips, 'unreadable_packets', what, what)} have a waveform that cannot be read, and {then} "
        f"({names_of(strips)})"
    ]


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
