"""The page of a paper: one HTML file, styles inside, images as data, nothing from the network."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fwclass.publish.files import write_page
from fwclass.publish.papers.fan import fan_view
from fwclass.publish.papers.he import he_view
from fwclass.publish.papers.li import li_view
from fwclass.publish.papers.shi import shi_view
from fwclass.publish.papers.tables import VERDICTS
from fwclass.publish.papers.xiong import xiong_view
from fwclass.publish.report import data_uri, environment, report_style

VIEWS: dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
    "fan2013": fan_view,
    "he2023": he_view,
    "li2018": li_view,
    "shi2019": shi_view,
    "xiong2018": xiong_view,
}


def render_paper(facts: Mapping[str, Any], picture: bytes | None, path: Path) -> dict[str, Any]:
    """Write the page of ``facts["paper"]``; every text is escaped.

    `facts`: what the paper's file in `study.papers` gathers. `picture`: PNG of the class map, or None.

    Returns a dict with ``path, bytes``.
    """
    name = str(facts["paper"])
    view = {
        "style": report_style(),
        "survey": facts["survey"],
        "version": facts["fwclass"],
        "citation": facts["citation"],
        "doi": facts["doi"],
        "data": facts["data"],
        "notes": list(facts["notes"]),
        "claims": _claims(facts),
        "map": data_uri(picture) if picture else "",
        **VIEWS[name](facts),
    }
    page = environment().get_template(f"papers/{name}.html.j2").render(view)
    return {"path": str(path), "bytes": write_page(path, page)}


def _claims(facts: Mapping[str, Any]) -> dict[str, Any]:
    rows = [{**c, "badge": VERDICTS[c["verdict"]]} for c in facts["claims"]]
    count = {v: sum(r["verdict"] == v for r in rows) for v in VERDICTS}
    words = {
        "holds": ("holds", "hold"),
        "does not hold": ("does not hold", "do not hold"),
        "undecided": ("is undecided", "are undecided"),
        "not comparable": ("cannot be compared", "cannot be compared"),
    }
    summary = ", ".join(f"{n} {words[v][n > 1]}" for v, n in count.items() if n)
    return {"rows": rows, "told": summary}
