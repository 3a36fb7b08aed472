"""Echoes of a strip that no scene makes (`decompose.recurring`), in numbers and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.assess.remarks import percent_words
from fwclass.decompose.recurring import IN_RECORD, OVERLOADED
from fwclass.errors import first_few

TOLD_FROM = 0.02
"""Share of the waveforms with echoes from which it is told: 3e-4 of even scenes at most."""

NAMED = 3

ADVICE = (
    "look at the waveforms (fwclass info --waveforms); a higher decompose.tail_share and decompose.tail_reach leave "
    "out what follows every echo; what stands in the record whatever is seen is to be taken off the samples before"
)


def recurring_facts(places: Mapping[str, Any] | None, counts: Mapping[str, int], checked: int) -> dict[str, Any]:
    """``recurring``, how many waveforms of the sample have an echo that no scene makes, of the kind that has most, and
    their ``recurring_share``, None where nothing is known of it; the kind itself is ``recurring_kind``.

    Echoes that stand apart are the scene's, as the roofs of greenhouses, where the vendor has returns of them: there
    are no more than echoes without a return in `counts`, of the `checked` ones, 0 in formats without returns.
    """
    if places is None or "recurring" not in places:
        return {"recurring": 0, "recurring_share": None, "recurring_kind": None}
    most, kinds = 1.0, []
    if checked and counts["waveforms"]:
        most = counts["unexplained"] / checked * counts["fitted"] / counts["waveforms"]
    for kind in places["recurring"]:
        share = min(kind["share"], most) if kind["separate"] else kind["share"]
        kinds.append((share, int(kind["waveforms"] * share / kind["share"]), kind))
    if not kinds:
        return {"recurring": 0, "recurring_share": 0.0, "recurring_kind": None}
    share, waveforms, worst = max(kinds, key=lambda one: one[0])
    return {"recurring": waveforms, "recurring_share": share, "recurring_kind": worst}


def recurring_remarks(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    """What is worth telling of strips: of ``name``, `recurring_facts` and ``places``."""
    return [*_recurring(strips), *_overloaded(strips)]


def _overloaded(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    some = [(s, s["places"]["followed"]) for s in strips if any((s.get("places") or {}).get("followed", ()))]
    if not some:
        return []
    _, (behind, usual) = max(some, key=lambda one: one[1][0] - one[1][1])
    names = first_few([str(s["name"]) for s, _ in some], NAMED)
    return [
        f"another echo follows {percent_words(behind)} of the saturated ones, {percent_words(usual)} of those that "
        "nearly saturate: a receiver that swings to and fro when it is overloaded makes such echoes, and no scene; "
        f"take no echo behind a saturated one (flag 1) for a surface without others around ({names})"
    ]


def _recurring(strips: Sequence[Mapping[str, Any]]) -> list[str]:
    some = [s for s in strips if (s.get("recurring_share") or 0.0) > TOLD_FROM]
    if not some:
        return []
    worst = max(some, key=lambda s: s["recurring_share"])
    kind, share = worst["recurring_kind"], percent_words(worst["recurring_share"])
    names = first_few([str(s["name"]) for s in some], NAMED)
    if kind["of"] == IN_RECORD:
        where = f"{kind['time']:.1f} ns after the first sample, {kind['height']:.3g} DN high"
        cause = "crosstalk, or a level that is not straight, makes such echoes"
    else:
        full = kind["of"] == OVERLOADED
        high = ", which is saturated" if full else f", {kind['height']:.2g} times as high"
        where = f"{abs(kind['time']):.1f} ns {'behind' if kind['time'] > 0.0 else 'before'} the highest{high}"
        cause = (
            "a receiver that rings, is overloaded or does not grow with the light, or a pulse that is not the same in "
            "all waveforms, makes such echoes"
        )
    return [
        f"{share} of the waveforms with echoes have another one {where}: {cause}; of scenes only a crop, or water, of "
        f"one depth all over ({names})"
    ]
