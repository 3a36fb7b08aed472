"""What several files are together, by what `info` says of each."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fwclass.errors import several, visible
from fwclass.read.info import bounds_text, counts_text, format_text


def alike_faults(facts: Sequence[Mapping[str, Any]], most: int | None = None) -> list[str]:
    """Faults of files (`most` of each), those that differ in numbers alone once, with how many files have them."""
    alike: dict[str, list[str]] = {}
    for one in facts:
        path = Path(one["path"])
        for fault in map(str, (one.get("faults") or [])[:most]):
            kind = re.sub(rf"{re.escape(path.stem)}\.\w+|[\d.,]+", "0", fault)
            alike.setdefault(kind, []).append(f"{visible(path.name)}: {visible(fault)}")
    return [
        same[0] + (f" (alike in {several(len(same) - 1, 'other file')})" if len(same) > 1 else "")
        for same in alike.values()
    ]


def describe_together(facts: Sequence[Mapping[str, Any]]) -> str:
    """Points, formats, systems, bounds, classes and faults of all files of points or pulses, for a terminal; "" for
    fewer than two."""
    clouds = [f for f in facts if "crs" in f and "bounds" in f]
    if len(clouds) < 2:
        return ""
    points = sum(int(f.get("points") or f.get("pulses") or f.get("rows") or 0) for f in clouds)
    corners = [f["bounds"] for f in clouds if f["bounds"]]
    bounds = [*map(min, *(c[:3] for c in corners)), *map(max, *(c[3:] for c in corners))] if len(corners) > 1 else None
    classes = Counter[str]()
    for one in clouds:
        classes.update(one.get("classes") or {})
    rows = [
        ("together", f"{several(len(clouds), 'file')}, {points:,} points or pulses"),
        ("formats", _by_count(map(format_text, clouds))),
        ("CRS", _by_count("none" if not f["crs"] else _system(f["crs"]) for f in clouds)),
        ("bounds", bounds_text(bounds or (corners[0] if corners else None))),
        ("classes", counts_text(dict(sorted(classes.items(), key=lambda item: int(item[0]))))),
    ]
    lines = [f"{name:<12} {visible(text)}" for name, text in rows]
    return "\n".join([*lines, *(f"  ! {line}" for line in alike_faults(clouds))])


def _system(crs: Mapping[str, Any]) -> str:
    return f"{crs['name']}" + (f" (EPSG:{crs['epsg']})" if crs.get("epsg") else "")


def _by_count(words: Iterable[str]) -> str:
    """What all files are, or of how many files each is."""
    counted = Counter(words).most_common()
    return counted[0][0] if len(counted) == 1 else "; ".join(f"{word}: {several(n, 'file')}" for word, n in counted)
