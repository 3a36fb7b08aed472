"""Words and tables about a survey's quality, for its own page and for a section of every report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.publish.sections import number, percent

LISTED = 40
"""Strips, and pairs of strips, that a page lists; quality.json has all of them."""

NOTE = (
    "Height, roll and pitch tell how far a strip lies too high in its middle, and how much more at its right edge and "
    "at its far end along the line, with standard errors; taking that off brings the strips together best. Overlaps "
    "cannot see a lift or a tilt that all strips share: it is taken as none, and only check points show it. Pitch is a "
    "tilt along the line, whatever its cause. Errors take pairs for independent: where a strip is bent they are too "
    "small."
)


def quality(summary: Mapping[str, Any] | None, thresholds: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any] | None:
    """Rows (what, figure), remarks, and the tables of strips and of their pairs; None where it was not measured.

    `thresholds`: what was asked of it (`fwclass.quality.judge.thresholds`).
    """
    if not summary:
        return None
    density, strips = summary["density"], summary["strips"]
    worst = sorted(strips["between"], key=lambda b: -b["rms"])
    names = [s["name"] for s in strips["strips"]]
    return {
        "rows": [
            *_rows(summary, density, strips),
            *((f"threshold: {one['what']}", threshold_words(one)) for one in thresholds),
        ],
        "remarks": list(summary["remarks"]),
        "strips": [_strip(s) for s in strips["strips"][:LISTED]],
        "more_strips": max(0, len(names) - LISTED),
        "between": [
            {
                "names": f"{names[b['first']]} – {names[b['second']]}",
                "cells": [number(b["pairs"]), _cm(b["mean"]), _cm(b["rms"], sign=False), *_in_plan(b.get("offset"))],
            }
            for b in worst[:LISTED]
        ],
        "more_between": max(0, len(worst) - LISTED),
        "compared": bool(strips["pairs"]),
        "note": NOTE,
    }


def threshold_words(threshold: Mapping[str, Any]) -> str:
    """The figure that something is asked of, and whether it is met."""
    value = "nothing tells it" if threshold["value"] is None else f"{threshold['value']:.4g}"
    bound = f"at {'least' if threshold['least'] else 'most'} {threshold['bound']:g}"
    return f"{value}, {bound} asked for: {'met' if threshold['met'] else 'missed'}"


def _in_plan(offset: Mapping[str, Any] | None) -> list[str]:
    """Offset to the east and north and its standard error, dashes where slopes do not tell."""
    return [_cm(None if offset is None else offset[n], sign=n != "error") for n in ("east", "north", "error")]


def _rows(summary: Mapping[str, Any], density: Mapping[str, Any], strips: Mapping[str, Any]) -> list[tuple[str, str]]:
    share = summary["noise_share"]
    rows = [
        ("echoes", f"{number(summary['echoes'])}, of {number(summary['pulses'])} pulses"),
        ("noise", f"{number(summary['noise'])} echoes" + (f", {_share(share)}" if share is not None else "")),
        ("area with echoes", f"{density['area'] / 1e6:.3f} km², by cells of {density['cell']:g} m"),
    ]
    if density["pulses"] is not None:
        p = density["percentiles"]
        rows += [
            ("echoes per m²", f"{density['echoes']:.2f} of this area, without noise"),
            (
                "pulses per m²",
                f"{density['pulses']:.2f}; in 90 % of the cells {p['p5']:.2f} to {p['p95']:.2f}, median {p['p50']:.2f}",
            ),
        ]
    if density["spacing"] is not None:
        rows.append(("pulse spacing", f"{density['spacing']:.2f} m"))
    rough = strips["roughness"]
    if rough["smoothest"] is not None:
        text = f"{_cm(rough['smoothest'], sign=False)} cm at most in the smoothest tenth of {number(rough['places'])}"
        rows.append(("residual of level places", f"{text}, median {_cm(rough['median'], sign=False)} cm"))
    voids = summary["voids"]
    text = f"{number(voids['count'])} from {voids['least']:.3g} m² on"
    if voids["count"]:
        text += f", {number(voids['area'])} m² together ({_share(voids['share'])}), the largest "
        text += f"{number(voids['largest'][0]['area'])} m²; quality.gpkg has the boxes around them"
    rows.append(("voids inside the survey", text))
    rows.append(("strips", f"{number(len(strips['strips']))}, told by {strips['by']}"))
    if strips["pairs"]:
        rows += [
            (
                "differences of strips",
                f"{100 * strips['rms']:.1f} cm root mean square, in {number(strips['pairs'])} pairs of planes",
            ),
            ("without the strips' heights and tilts", f"{100 * strips['left']:.1f} cm root mean square"),
        ]
    known = [b for b in strips["between"] if b.get("offset")]
    if known:
        pair = max(known, key=lambda b: b["offset"]["distance"])
        names, offset = [s["name"] for s in strips["strips"]], pair["offset"]
        text = f"{_cm(offset['distance'], sign=False)} ± {_cm(offset['error'], sign=False)} cm at most, "
        rows.append(("apart in plan", f"{text}{names[pair['first']]} – {names[pair['second']]}"))
    if strips["apart"]:
        rows.append(("further apart", f"{number(strips['apart'])} pairs, taken for two surfaces"))
    covered = summary.get("coverage")
    if covered is not None:
        text = (
            f"{_share(covered['share'])} of {number(covered['area'])} m²" if covered["area"] else "no cell lies in it"
        )
        if covered["gaps"]:
            gaps = "one gap of" if covered["gaps"] == 1 else f"{number(covered['gaps'])} gaps, the largest"
            text += f"; {gaps} {number(covered['largest'][0]['area'])} m²"
        rows.append(("the area's coverage", text))
    return [*rows, *_check_rows(summary.get("check_points"))]


def _check_rows(checked: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """What check points say: root mean square of the heights' differences, on open land and under plants."""
    if checked is None:
        return []
    if checked["all"] is None:
        return [("check points", f"{number(checked['given'])}, none of them compared")]
    rows = [("check points", f"{number(checked['all']['count'])} of {number(checked['given'])} compared")]
    for name, what in (("all", "heights"), ("open", "heights of open land"), ("vegetated", "heights under plants")):
        figures = checked[name]
        if figures is not None and (name == "all" or checked["vegetated"] is not None):
            low, high = figures["rmse_interval"]
            text = f"{_cm(figures['rmse'], sign=False)} cm root mean square ({_cm(low, False)} to {_cm(high, False)}), "
            text += f"mean {_cm(figures['mean'])} cm, 95 % within {_cm(figures['percentile_95'], False)} cm"
            rows.append((what, text))
    return rows


def _share(share: float) -> str:
    return f"{percent(share)} %" if share >= 0.001 or not share else f"{100 * share:.2g} %"


def _strip(strip: Mapping[str, Any]) -> dict[str, Any]:
    figures = [
        f"{_cm(strip[name])}\u00a0±\u00a0{100 * strip[f'{name}_error']:.2f}" if strip[name] is not None else "–"
        for name in ("height", "roll", "pitch")
    ]
    flight = f"{round(strip['azimuth']) % 360}°" + ("" if strip["timed"] else " or back")
    size = f"{strip['width']:,.0f}\u00a0×\u00a0{strip['length']:,.0f}".replace(",", "\u202f")
    return {"name": strip["name"], "cells": [number(strip["echoes"]), flight, size, number(strip["pairs"]), *figures]}


def _cm(metres: float | None, sign: bool = True) -> str:
    return "–" if metres is None else f"{100 * metres:{'+' if sign else ''}.1f}"
