"""What the echoes of every strip look like beside its returns: counted, told, and judged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fwclass.decompose.params import DecomposeParams, PlausibilityParams
from fwclass.errors import QualityError

TOLD_FROM = 0.1
"""Share of the echoes without a return, or of the returns without an echo, from which a remark tells it."""

RARE = 0.001
"""Share of the echoes up to which implausible ones are counted, and not worth a remark."""

INFLATED = 1.1
"""From so many times the noise that was reckoned with on, it is told."""

NAMED = 3
"""Strips of a remark that are named."""


def of_strip(name: str, returns: int, counts: Mapping[str, int], noise: Mapping[str, Any]) -> dict[str, Any]:
    """One strip for report.json: counts of echoes and returns, shares of them, and what its noise is like."""
    checked = counts["checked"] if returns else 0
    return {
        "name": name,
        "returns": returns,
        **counts,
        "unexplained_share": counts["unexplained"] / checked if checked else None,
        "implausible_share": counts["implausible"] / checked if checked else None,
        "unmatched_returns_share": counts["returns_without_echo"] / returns if returns else None,
        **noise,
    }


def remarks(strips: Sequence[Mapping[str, Any]], params: DecomposeParams) -> list[str]:
    """What is worth telling of `of_strip`s, in words; one line for each kind, whatever the number of strips."""
    lines = []
    some = [s for s in strips if s["implausible"] > RARE * s["fitted"]]
    if some:
        n = {key: sum(s[key] for s in some) for key in ("implausible", "fitted", "below", "weak")}
        share = _percent(n["implausible"] / n["fitted"])
        lines.append(
            f"{n['implausible']:,} of {n['fitted']:,} echoes ({share}) are implausible, and neither ground filter nor "
            f"terrain sees them: {n['below']:,} more than {params.envelope_margin:g} m below all returns around, "
            f"{n['weak']:,} after all else of their pulse, or above all returns, and no stronger than the noise "
            f"({_names(some)})"
        )
    some = [s for s in strips if (s["unexplained_share"] or 0.0) >= TOLD_FROM]
    if some:
        lone, checked = (sum(s[key] for s in some) for key in ("unexplained", "checked"))
        lines.append(
            f"{lone:,} of {checked:,} echoes ({_percent(lone / checked)}) have no return within "
            f"{params.vendor_tolerance:g} ns, {sum(s['outside'] for s in some):,} of them lie outside of the returns' "
            f"heights ({_names(some)})"
        )
    some = [s for s in strips if (s["unmatched_returns_share"] or 0.0) >= TOLD_FROM]
    if some:
        lone, returns = (sum(s[key] for s in some) for key in ("returns_without_echo", "returns"))
        lines.append(
            f"{lone:,} of {returns:,} returns ({_percent(lone / returns)}) have no echo within "
            f"{params.vendor_tolerance:g} ns ({_names(some)})"
        )
    some = [s for s in strips if (s["lag1"] or 0.0) > params.white_noise and s["inflation"] >= INFLATED]
    if some:
        worst = max(some, key=lambda s: s["lag1"])
        lines.append(
            f"the noise is correlated (neighbouring samples by {worst['lag1']:.2f}): decompose.detection of "
            f"{params.detection:g} standard deviations is in truth {params.detection / worst['inflation']:.1f} "
            f"({_names(some)})"
        )
    return lines


def judge(strips: Iterable[Mapping[str, Any]], params: PlausibilityParams) -> None:
    """`QualityError` naming the strip that is furthest beyond a bound; nothing where the user accepts it."""
    bounds = (
        ("implausible_share", "implausible", params.max_implausible, "implausible", "echoes are implausible"),
        (
            "unmatched_returns_share",
            "returns_without_echo",
            params.max_unmatched_returns,
            "unmatched_returns",
            "returns have no echo",
        ),
    )
    listed = list(strips)
    for share, count, most, key, words in bounds:
        beyond = [s for s in listed if s[share] is not None and s[share] > most and s[count] >= params.least]
        if beyond and not params.accept:
            worst = max(beyond, key=lambda s: s[share])
            others = f" (and {len(beyond) - 1} more strips)" if len(beyond) > 1 else ""
            raise QualityError(
                f"more {words} than a sound survey has",
                where=f"{worst['name']}{others}",
                expected=f"at most {_percent(most)} (plausibility.max_{key})",
                got=f"{worst[count]:,}, {_percent(worst[share])}",
                do="look at the waveforms (fwclass info --waveforms); a higher decompose.detection leaves weak echoes "
                "out; --accept-implausible (plausibility.accept=true) takes them as they are",
            )


def _names(strips: Sequence[Mapping[str, Any]]) -> str:
    names = [str(s["name"]) for s in strips]
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share >= 0.001 else f"{100 * share:.2g} %"
