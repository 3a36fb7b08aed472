"""The report's words about labels: how many of which class, where, and how far the tested ones are from the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.publish.palette import colours, css
from fwclass.publish.sections import number, percent

LISTED = 12
"""Training boxes, and tiles, that the table lists; all of them are in report.json."""

KINDS = {
    "source": "the files' own classes",
    "cloud": "the nearest point of another cloud",
    "polygons": "the polygon that an echo lies in",
    "echoes": "strip, pulse and number of the echo",
}


def sampling(made: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Rows of classes and training boxes, facts and remarks; None without a census."""
    if not made or not made.get("classes"):
        return None
    classes = made["classes"]
    dots = colours(classes)
    return {
        "kind": KINDS.get(made["reference"], made["reference"]),
        "facts": _facts(made),
        "rows": [
            {"name": c["name"], "dot": css(dots[int(c["code"])])}
            | {key: number(c[key]) for key in ("labelled", "train", "taken", "test")}
            for c in classes
        ],
        "boxes": [_box(i + 1, b, classes) for i, b in enumerate(made["boxes"][:LISTED])],
        "more": max(len(made["boxes"]) - LISTED, 0),
        "names": [c["name"] for c in classes],
        "remarks": list(made["remarks"]),
    }


def _facts(made: Mapping[str, Any]) -> list[tuple[str, str]]:
    echoes = max(int(made["echoes"]), 1)
    gap = made["gap"]
    found = "no tested echo" if gap["found"] is None else f"{gap['found']:.2f} m from a training area at least"
    rows = [
        (
            "labelled",
            f"{number(made['labelled'])} of {number(made['echoes'])} echoes, {percent(made['labelled'] / echoes)} %",
        ),
        ("tested echoes", f"{found} (areas.gap {gap['asked']:g} m)"),
    ]
    if made["other_codes"]:
        others = ", ".join(f"{code}: {number(n)}" for code, n in made["other_codes"].items())
        rows.append(("codes of no class", others))
    if made["ambiguous"]:
        rows.append(("in polygons of different classes", f"{number(made['ambiguous'])} echoes, not labelled"))
    if corrected := made.get("corrections"):
        back = f", {number(corrected['taken_back'])} taken back" if corrected["taken_back"] else ""
        rows.append(("corrections", f"{number(corrected['applied'])} of {number(corrected['standing'])} applied{back}"))
    return rows


def _box(place: int, box: Mapping[str, Any], classes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    corners = ", ".join(f"{v:.0f}" for v in box["box"])
    cells = [f"{number(t)} of {number(n)}" for t, n in zip(box["taken"], box["labelled"], strict=True)]
    return {"place": place, "corners": corners, "cells": cells, "empty": not any(box["labelled"])}
