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


def sampling(census: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Rows of classes and training boxes, facts and remarks; None without a census."""
    if not census or not census.get("classes"):
        return None
    classes = census["classes"]
    dots = colours(classes)
    return {
        "kind": KINDS.get(census["reference"], census["reference"]),
        "facts": _facts(census),
        "rows": [
            {"name": c["name"], "dot": css(dots[int(c["code"])])}
            | {key: number(c[key]) for key in ("labelled", "train", "taken", "test")}
            for c in classes
        ],
        "boxes": [_box(i + 1, b) for i, b in enumerate(census["boxes"][:LISTED])],
        "more": max(len(census["boxes"]) - LISTED, 0),
        "names": [c["name"] for c in classes],
        "remarks": list(census["remarks"]),
    }


def _facts(census: Mapping[str, Any]) -> list[tuple[str, str]]:
    labelled, share = census["labelled"], percent(census["labelled"] / max(int(census["echoes"]), 1))
    gap = census["gap"]
    nearest = "no tested echo" if gap["found"] is None else f"{gap['found']:.2f} m from a training area at least"
    rows = [
        ("labelled", f"{number(labelled)} of {number(census['echoes'])} echoes, {share} %"),
        ("tested echoes", f"{nearest} (areas.gap {gap['asked']:g} m)"),
    ]
    if census["other_codes"]:
        others = ", ".join(f"{code}: {number(n)}" for code, n in census["other_codes"].items())
        rows.append(("codes of no class", others))
    if census["ambiguous"]:
        rows.append(("in polygons of different classes", f"{number(census['ambiguous'])} echoes, not labelled"))
    if corrected := census.get("corrections"):
        back = f", {number(corrected['taken_back'])} taken back" if corrected["taken_back"] else ""
        rows.append(("corrections", f"{number(corrected['applied'])} of {number(corrected['standing'])} applied{back}"))
    return rows


def _box(place: int, box: Mapping[str, Any]) -> dict[str, Any]:
    corners = ", ".join(f"{v:.0f}" for v in box["box"])
    cells = [f"{number(t)} of {number(n)}" for t, n in zip(box["taken"], box["labelled"], strict=True)]
    return {"place": place, "corners": corners, "cells": cells, "empty": not any(box["labelled"])}
