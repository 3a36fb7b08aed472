"""Echoes that the sources have twice: counted by tile, told by pairs of files, and judged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fwclass.assess.remarks import percent_words
from fwclass.decompose.params import PlausibilityParams
from fwclass.errors import first_few, refuse_unsound
from fwclass.graph.sources import strip_of
from fwclass.schema import Table
from fwclass.store.receipts import Receipt
from fwclass.survey.layout import Strip
from fwclass.tile.stage import repeats

SAID_FROM = 0.001
"""Share of the echoes: between files of centimetres, without times, chance alone reaches a tenth of it at 10/m2."""

OWN_TIMES = 0.25
"""Times over first echoes of a strip, below which its times are coarse and tell no echo from another: 1 of sound ones,
a half where two channels fire at once."""

NAMED = 3
"""Pairs of files that are named."""

CAUSE = (
    "files with a common rim, or one file under two names: density, differences between strips and accuracy are wrong"
)


WITHIN = (
    "points that one file has twice, or packets for every return of a pulse that are not read as one waveform: density "
    "and accuracy are wrong"
)
"""Where most of them lie in one file."""


def repeated_facts(
    tiles: Iterable[Mapping[str, Any]], strips: Iterable[Strip], decomposed: Iterable[Receipt]
) -> dict[str, Any] | None:
    """Echoes with place and time of another, by what `tile.stage.repeats` counted in `tiles`, and those that were
    measured once and stand at two places (`tile.stage.twice_measured`); None for none.

    ``echoes``, their ``share``, ``files`` with [name, name, echoes], most first, ``pairs`` of two files each with
    ``first``, ``second``, ``echoes``, their share of those of the file that has fewer (``of_smaller``), how many of
    them were ``moved`` and by how much these are higher in the second (``higher`` [m], None without one), and
    ``remarks`` where `SAID_FROM` of the survey's echoes, or of a file's, are there twice.

    `decomposed`: the parts that made the strips' echoes.
    """
    exact, moved, lifted, rows = Counter[tuple[int, int]](), Counter[tuple[int, int]](), Counter[tuple[int, int]](), 0
    decomposed = list(decomposed)
    coarse = _coarsely_timed(decomposed)
    for meta in tiles:
        rows += meta["rows"]
        exact.update({(a, b): n for a, b, n in meta["repeated"]})
        finely = [pair for pair in meta.get("moved", ()) if not coarse.intersection(pair[:2])]
        moved.update({(a, b): n for a, b, n, _ in finely})
        lifted.update({(a, b): up for a, b, _, up in finely})
    counts = exact + moved
    if not counts:
        return None
    of_strip: Counter[int] = Counter()
    for receipt in decomposed:
        of_strip[strip_of(receipt.part)] += receipt.meta["echoes"]
    names = {s.number: s.path.name for s in strips}
    ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    pairs: list[dict[str, Any]] = [
        {
            "first": names[a],
            "second": names[b],
            "echoes": n,
            "of_smaller": n / smaller if (smaller := min(of_strip[a], of_strip[b])) else None,
            "moved": moved[a, b],
            "higher": 0.001 * lifted[a, b] / moved[a, b] if moved[a, b] else None,
        }
        for (a, b), n in ordered
        if a != b
    ]
    total = counts.total()
    files = [[names[a], names[b], n] for (a, b), n in ordered]
    share, remarks = total / rows, []
    if exact.total() > SAID_FROM * rows:
        alike = [[*pair[:2], n] for pair, (key, _) in zip(files, ordered, strict=True) if (n := exact[key])]
        remarks.append(
            f"{exact.total():,} echoes, {100 * exact.total() / rows:.1f} %, have place and time of another "
            f"({_pairs(alike, pairs)}): {WITHIN if _within(alike) else CAUSE}"
        )
    apart = [p for p in pairs if p["moved"] > SAID_FROM * p["echoes"] / (p["of_smaller"] or 1.0)]
    if apart:
        remarks.append(
            f"{sum(p['moved'] for p in apart):,} echoes have GPS time and number of another file's within half a metre "
            f"({first_few([_moved_words(p) for p in apart], NAMED, '; ')}): one flight "
            "delivered twice, or files with a common rim that were adjusted or converted apart"
        )
    return {"echoes": total, "share": share, "files": files, "pairs": pairs, "remarks": remarks}


def _coarsely_timed(decomposed: Iterable[Receipt]) -> set[int]:
    """The strips most of whose pulses share their time with others, by what `tile.stage.count_times` counted."""
    firsts, times = Counter[int](), Counter[int]()
    for receipt in decomposed:
        echoes, different = receipt.meta.get("times", (0, 0))
        firsts[strip_of(receipt.part)] += echoes
        times[strip_of(receipt.part)] += different
    return {strip for strip, n in firsts.items() if times[strip] < OWN_TIMES * n}


def repeated_in_file(table: Table, name: str) -> dict[str, Any] | None:
    """As `repeated_facts`, of the points or echoes of one file alone.

    table : x, y, z [m], and gps_time [s] where it is known.
    """
    rows = table.rows
    time = table["gps_time"] if "gps_time" in table else np.full(rows, np.nan)
    count = sum(n for _, _, n in repeats(table.with_columns({"gps_time": time, "strip": np.zeros(rows, np.int16)})))
    if not count:
        return None
    share, remarks = count / rows, []
    if share > SAID_FROM:
        of = "place and time of another" if np.isfinite(time).any() else "the place of another"
        remarks.append(f"{count:,} of {rows:,}, {100 * share:.1f} %, have {of}: {WITHIN}")
    return {"echoes": count, "share": share, "files": [[name, name, count]], "pairs": [], "remarks": remarks}


def judge_repeated(facts: Mapping[str, Any] | None, params: PlausibilityParams) -> None:
    """`QualityError` where too many echoes, or too many of one file, are there twice; nothing where the user accepts
    it."""
    if facts is None:
        return
    once = "take every file once, and cut rims that files have in common off"
    within = [p for p in facts.get("pairs", ()) if (p["of_smaller"] or 0.0) > params.max_shared]
    if within and within[0]["echoes"] >= params.least:
        refuse_unsound(
            [first_few([f"{p['echoes']:,}, {percent_words(p['of_smaller'])}" for p in within], NAMED, "; ")],
            params.accept,
            "the sources have a file twice",
            where=first_few([f"{p['first']} and {p['second']}" for p in within], NAMED, "; "),
            expected=f"at most {100 * params.max_shared:g} % of a file's echoes in another (plausibility.max_shared)",
            do=once,
        )
    if facts["share"] <= params.max_repeated:
        return
    advice = once
    if _within(facts["files"]):
        advice = (
            "take points that are there twice out; of waveforms, write the returns of a pulse one after the other, "
            "with one GPS time, and one packet for all of them"
        )
    refuse_unsound(
        [f"{facts['echoes']:,}, {100 * facts['share']:.1f} %"],
        params.accept,
        "the sources have too many echoes twice",
        where=_pairs(facts["files"], facts.get("pairs", ())),
        expected=f"at most {100 * params.max_repeated:g} % with place and time of another (plausibility.max_repeated)",
        do=advice,
    )


def _within(files: Iterable[list[Any]]) -> bool:
    """Whether most of [name, name, echoes] are of one file."""
    own = {True: 0, False: 0}
    for a, b, n in files:
        own[a == b] += n
    return own[True] > own[False]


def _pairs(files: Iterable[list[Any]], pairs: Iterable[Mapping[str, Any]]) -> str:
    """Files with their counts; of two files also the share of the smaller one's echoes that are there twice."""
    shares = {(p["first"], p["second"]): p["of_smaller"] for p in pairs}
    words = []
    for a, b, n in files:
        share = shares.get((a, b))
        of = f", {percent_words(share)} of the smaller one" if share else ""
        words.append(f"{a} and {b}: {n:,}{of}" if a != b else f"{a} itself: {n:,}")
    return first_few(words, NAMED, "; " if any(", " in w for w in words) else ", ")


def _moved_words(pair: Mapping[str, Any]) -> str:
    share = f", {percent_words(pair['of_smaller'])} of the smaller one" if pair["of_smaller"] else ""
    return f"{pair['first']} and {pair['second']}: {pair['moved']:,}{share}, {pair['higher']:+.3f} m on average"
