"""The report's words about labels: how many of which class, where, and how far the tested ones are from the others."""

from __future__ import annotations

from collections.abc import Mapping
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
    "corrections": "corrections of an earlier delivery",
}


def sampling(counts: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Rows of classes and training boxes, facts and remarks; None without labels."""
    if not counts or not counts.get("classes"):
        return None
    classes = counts["classes"]
    dots = colours(classes)
    return {
        "kind": KINDS.get(counts["reference"], counts["reference"]),
        "facts": _facts(counts),
        "rows": [
            {"name": c["name"], "dot": css(dots[int(c["code"])])}
            | {key: number(c[key]) for key in ("labelled", "train", "taken", "test")}
            for c in classes
        ],
        "boxes": [_box(i + 1, b) for i, b in enumerate(counts["boxes"][:LISTED])],
        "more": max(len(counts["boxes"]) - LISTED, 0),
        "names": [c["name"] for c in classes],
        "remarks": list(counts["remarks"]),
    }


def _facts(counts: Mapping[str, Any]) -> list[tuple[str, str]]:
    labelled, share = counts["labelled"], percent(counts["labelled"] / max(int(counts["echoes"]), 1))
    gap = counts["gap"]
    nearest = "no tested echo" if gap["found"] is None else f"{gap['found']:.2f} m from a training area at least"
    rows = [
        ("labelled", f"{number(labelled)} of {number(counts['echoes'])} echoes, {share} %"),
        ("tested echoes", f"{nearest} (areas.gap {gap['asked']:g} m)"),
    ]
    if counts["other_codes"]:
        others = ", ".join(f"{code}: {number(n)}" for code, n in counts["other_codes"].items())
        rows.append(("codes of no class", others))
    if counts["ambiguous"]:
        rows.append(("in polygons of different classes", f"{number(counts['ambiguous'])} echoes, not labelled"))
    if corrected := counts.get("corrections"):
        back = f", {number(corrected['taken_back'])} taken back" if corrected["taken_back"] else ""
        rows.append(("corrections", f"{number(corrected['applied'])} of {number(corrected['standing'])} applied{back}"))
    return rows


def _box(place: int, box: Mapping[str, Any]) -> dict[str, Any]:
    corners = ", ".join(f"{v:.0f}" for v in box["box"])
    cells = [f"{number(t)} of {number(n)}" for t, n in zip(box["taken"], box["labelled"], strict=True)]
    return {"place": place, "corners": corners, "cells": cells, "empty": not any(box["labelled"])}
