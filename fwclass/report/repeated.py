"""Echoes that the sources have twice: counted by tile, told by pairs of files, and judged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from fwclass.decompose.params import PlausibilityParams
from fwclass.errors import first_few, refuse_unsound
from fwclass.survey.layout import Strip

SAID_FROM = 0.001
"""Share of the echoes: between files of centimetres, without times, chance alone reaches a tenth of it at 10/m2."""

NAMED = 3
"""Pairs of files that are named."""

CAUSE = (
    "files with a common rim, or one file under two names: density, differences between strips and accuracy are wrong"
)


def repeated_facts(tiles: Iterable[Mapping[str, Any]], strips: Iterable[Strip]) -> dict[str, Any] | None:
    """Echoes with place and time of another, by what `tile.stage.repeats` counted in `tiles`; None for none.

    ``echoes``, their ``share``, ``files`` with [name, name, echoes], most first, and ``remarks`` from `SAID_FROM` on.
    """
    names, counts, rows = {s.number: s.path.name for s in strips}, Counter[tuple[int, int]](), 0
    for meta in tiles:
        rows += meta["rows"]
        counts.update({(a, b): n for a, b, n in meta["repeated"]})
    if not counts:
        return None
    total = sum(counts.values())
    files = [[names[a], names[b], n] for (a, b), n in sorted(counts.items(), key=lambda item: (-item[1], item[0]))]
    share, remarks = total / rows, []
    if share > SAID_FROM:
        remarks.append(
            f"{total:,} echoes, {100 * share:.1f} %, have place and time of another ({_pairs(files)}): {CAUSE}"
        )
    return {"echoes": total, "share": share, "files": files, "remarks": remarks}


def judge_repeated(facts: Mapping[str, Any] | None, params: PlausibilityParams) -> None:
    """`QualityError` where too many echoes are there twice; nothing where the user accepts it."""
    if facts is None or facts["share"] <= params.max_repeated:
        return
    refuse_unsound(
        [f"{facts['echoes']:,}, {100 * facts['share']:.1f} %"],
        params.accept,
        "the sources have too many echoes twice",
        where=_pairs(facts["files"]),
        expected=f"at most {100 * params.max_repeated:g} % with place and time of another (plausibility.max_repeated)",
        do="take every file once, and cut rims that files have in common off; --accept-implausible "
        "(plausibility.accept=true) takes them as they are",
    )


def _pairs(files: Iterable[list[Any]]) -> str:
    return first_few([f"{a} and {b}: {n:,}" if a != b else f"{a} itself: {n:,}" for a, b, n in files], NAMED)
