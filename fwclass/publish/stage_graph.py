"""The stages of a run and what each reads of the others, as SVG: a row for every stage, an arc for every edge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
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


def reduced(edges: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """`edges` (stages that each reads) without those that follow from others; stages in the order of the run."""
    reach: dict[str, set[str]] = {}
    kept: dict[str, list[str]] = {}
    for name, sources in edges.items():
        behind = set().union(*(reach.get(s, set()) for s in sources)) if sources else set()
        kept[name] = [s for s in sources if s not in behind]
        reach[name] = behind | set(sources)
    return kept


def stage_graph(stages: Sequence[Mapping[str, Any]]) -> str:
    """An inline SVG of ``{name, over, reads}`` for every stage in the order of the run; empty for none."""
    if not stages:
        return ""
    row = {str(s["name"]): k for k, s in enumerate(stages)}
    edges = reduced({str(s["name"]): [str(r) for r in s["reads"] if str(r) in row] for s in stages})
    height = ROW * len(stages) + 8
    furthest = max((abs(row[n] - row[s]) for n, some in edges.items() for s in some), default=1)
    lines = [
        f'<svg class="graph" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" role="img" '
        'aria-label="Stages of the run and what they read">'
    ]
    for name, some in edges.items():
        for source in some:
            a, b = (4 + ROW * row[n] + ROW / 2 for n in (source, name))
            bulge = 26 + (LEFT - 40) * abs(row[name] - row[source]) / furthest
            x, colour = LEFT - 8, COLOURS.get(str(stages[row[source]]["over"]), "#5b6a77")
            curve = f"M{x} {a:g} C{x - bulge:.0f} {a:g} {x - bulge:.0f} {b:g} {x} {b:g}"
            lines.append(
                f'<path d="{curve}" fill="none" stroke="{colour}" stroke-width="1.3" opacity="0.6">'
                f"<title>{escape(source)} to {escape(name)}</title></path>"
            )
    for name, k in row.items():
        y, over = 4 + ROW * k + ROW / 2, str(stages[k]["over"])
        colour = COLOURS.get(over, "#5b6a77")
        lines.append(f'<circle cx="{LEFT - 4}" cy="{y:g}" r="4" fill="{colour}"/>')
        lines.append(f'<text x="{LEFT + 8}" y="{y + 4.5:g}" font-size="13.5" fill="#1d2a35">{escape(name)}</text>')
        what = "of the whole survey" if over == "survey" else f"one part for every {escape(over)}"
        lines.append(f'<text x="{LEFT + 150}" y="{y + 4.5:g}" font-size="12" fill="{colour}">{what}</text>')
    return "\n".join([*lines, "</svg>"])
