"""The stages of a run and what each reads of the others, as a drawing: a row for every stage, an arc for every edge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

ROW, LEFT, WIDTH = 22, 250, 640
"""px: height of a row, room for the arcs, width."""

COLOURS = {
    "file": "#7b8a96",
    "strip": "#8a6d3b",
    "chunk": "#b07d2b",
    "tile": "#17697a",
    "block": "#4d7c3f",
    "survey": "#b3402a",
}
"""Of a stage by what a part of it is."""


def drop_implied(edges: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """`edges` (stages that each reads) without those that follow from others; stages in the order of the run."""
    reach: dict[str, set[str]] = {}
    direct: dict[str, list[str]] = {}
    for name, sources in edges.items():
        behind = set().union(*(reach.get(s, set()) for s in sources)) if sources else set()
        direct[name] = [s for s in sources if s not in behind]
        reach[name] = behind | set(sources)
    return direct


def stage_graph(stages: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """What the template draws of ``{name, over, reads}`` for every stage in the order of the run; None for none.

    Returns a dict with ``width, height, x`` (of the dots), ``arcs {d, colour, title}`` and ``rows {y, name, what,
    colour}`` [px].
    """
    if not stages:
        return None
    row = {str(s["name"]): k for k, s in enumerate(stages)}
    colours = [COLOURS.get(str(s["over"]), "#5b6a77") for s in stages]
    edges = drop_implied({str(s["name"]): [str(r) for r in s["reads"] if str(r) in row] for s in stages})
    furthest = max((abs(row[n] - row[s]) for n, some in edges.items() for s in some), default=1)
    arcs = []
    for name, some in edges.items():
        for source in some:
            a, b = (4 + ROW * row[n] + ROW // 2 for n in (source, name))
            bulge = LEFT - 34 - (LEFT - 40) * abs(row[name] - row[source]) // furthest
            curve = f"M{LEFT - 8} {a} C{bulge} {a} {bulge} {b} {LEFT - 8} {b}"
            arcs.append({"d": curve, "colour": colours[row[source]], "title": f"{source} to {name}"})
    rows = []
    for k, stage in enumerate(stages):
        over = str(stage["over"])
        what = "of the whole survey" if over == "survey" else f"one part for every {over}"
        rows.append({"y": 4 + ROW * k + ROW // 2, "name": str(stage["name"]), "what": what, "colour": colours[k]})
    return {"width": WIDTH, "height": ROW * len(stages) + 8, "x": LEFT - 4, "arcs": arcs, "rows": rows}
