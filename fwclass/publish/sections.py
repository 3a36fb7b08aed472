"""Tables of the report, from figures to cells with colours."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fwclass.publish.palette import colours, css
from fwclass.schema import column

FAN_2013: dict[str, dict[str, str]] = {
    "zc": {"building": "3–10 m", "vegetation": "0.5–10 m", "ground": "≈ 0 m"},
    "inclination": {"building": "≤ 20°", "vegetation": "varies", "ground": "≤ 15°"},
    "echo_ratio": {"building": "100 %", "vegetation": "< 60 %", "ground": "100 %"},
    "amplitude": {"building": "high", "vegetation": "low", "ground": "high"},
    "width": {"building": "wide", "vegetation": "varies", "ground": "wide"},
    "echo_number": {"building": "one echo", "vegetation": "many", "ground": "one echo"},
    "backscatter": {"building": "slightly higher", "vegetation": "middle", "ground": "middle"},
}
"""Fan 2013, Table 1."""

_BASE = {"number_of_echoes": "echo_number"}
_CLASS = {"tree": "vegetation", "trees": "vegetation", "buildings": "building"}
TITLES = {
    "zc": "height in cell Zc",
    "inclination": "inclination A",
    "echo_ratio": "echo ratio ER",
    "amplitude": "amplitude",
    "width": "echo width",
    "echo_number": "echo number",
    "number_of_echoes": "number of echoes",
    "backscatter": "backscatter coefficient γ",
}
CLASSIFIERS = {
    "forest": "random forest",
    "linear-svm": "linear SVM",
    "rbf-svm": "RBF SVM",
    "sklearn-forest": "random forest of scikit-learn",
    "boosting": "gradient boosting",
}
PERCENTILES = ("p5", "p25", "p50", "p75", "p95")
OBJECTS = ("reference", "found", "split", "predicted", "correct", "merged", "completeness", "correctness", "quality")
"""What the page has of objects: six counts and three shares."""
PER_CLASS = ("producers_accuracy", "users_accuracy", "iou")
LEAST_ANGLE = 0.001
"""Angles are told to this [deg]."""
POINTING_LIMIT = 1.0
"""Angle between beams and the lines from the trajectory [deg] above which they do not belong together."""
RIGHT, WRONG = (23, 105, 122), (196, 78, 40)
"""Colours of the confusion matrix: on the diagonal and beside it."""


def number(value: Any) -> str:
    """``1 234 567`` with narrow spaces; a dash where there is none."""
    return "–" if value is None else f"{int(value):,}".replace(",", "\u202f")


def quantity(value: Any) -> str:
    """A count for a headline: ``5.91 M``; "" where there is none."""
    if value is None:
        return ""
    for limit, unit in ((1e9, "\u202fG"), (1e6, "\u202fM")):
        if value >= limit:
            return f"{value / limit:.3g}{unit}"
    return number(value)


def percent(value: Any) -> str:
    """A fraction in percent with one decimal; "" where there is none."""
    return "" if value is None or not math.isfinite(value) else f"{100 * value:.1f}"


def seconds(value: Any) -> str:
    """``12.3 s``, ``4 min 05 s`` or ``2 h 10 min``; "" where there is none."""
    if value is None:
        return ""
    if value < 59.95:
        return f"{value:.1f} s"
    whole = round(value)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def measure(value: Any) -> str:
    """A feature's value with three digits that count."""
    if value is None or not math.isfinite(value):
        return "–"
    size = abs(value)
    if size and (size >= 100_000 or size < 0.001):
        return f"{value:.2e}"
    digits = max(0, 2 - math.floor(math.log10(size))) if size else 0
    return f"{value:.{min(digits, 3)}f}"


def accuracy(
    assessment: Mapping[str, Any] | None, classes: Sequence[Mapping[str, Any]], before: Sequence[str] = ()
) -> dict[str, Any] | None:
    """The confusion matrix with a colour per cell, and the figures per class; None without an assessment.

    Its remarks are those that the page has not already.
    """
    if not assessment or not assessment.get("confusion"):
        return None
    names = [str(c["name"] if isinstance(c, Mapping) else c) for c in assessment["classes"]]
    lost = assessment.get("unclassified") or [0] * len(names)
    dots = _dots(names, classes)
    rows = []
    for i, (name, counts) in enumerate(zip(names, assessment["confusion"], strict=True)):
        total = sum(counts) + lost[i]
        cells = [_cell(n, total, i == j) for j, n in enumerate(counts)]
        rows.append(
            {"name": name, "dot": dots[name], "cells": cells, "total": number(total), "lost": number(lost[i])}
            | {key: percent(_of(assessment.get(key), i, name)) or "–" for key in PER_CLASS}
        )
    two = {"type I error": "type_i", "type II error": "type_ii", "total error": "total_error"}
    totals = (
        [("overall accuracy", percent(assessment.get("overall_accuracy")) + " %")]
        if assessment.get("overall_accuracy") is not None
        else []
    )
    totals += [("kappa", f"{assessment['kappa']:.3f}")] if assessment.get("kappa") is not None else []
    totals += [("mean IoU", percent(assessment["mean_iou"]) + " %")] if assessment.get("mean_iou") is not None else []
    totals += [
        (label, percent(assessment[key]) + " %") for label, key in two.items() if assessment.get(key) is not None
    ]
    return {
        "names": names,
        "rows": rows,
        "totals": totals,
        "intervals": _intervals(assessment.get("intervals")),
        "area": assessment.get("area") or "",
        "any_lost": any(lost),
        "remarks": [text for text in assessment.get("remarks") or () if text not in before],
        "count": number(sum(map(sum, assessment["confusion"])) + sum(lost)),
        "objects": _objects(assessment.get("objects"), dots),
    }


def _objects(objects: Mapping[str, Any] | None, dots: Mapping[str, str]) -> dict[str, Any] | None:
    """Counts and figures of objects by class and size; None without any."""
    if not objects or not objects["classes"]:
        return None
    counts, shares = OBJECTS[:6], OBJECTS[6:]
    rows = []
    for one in objects["classes"]:
        by_size = [(f"from {r['from']:g} m²", r) for r in one["sizes"]]
        for k, (size, row) in enumerate([("all", one), *by_size]):
            cells = [*(number(row[n]) for n in counts), *(percent(row[n]) or "–" for n in shares)]
            rows.append(
                {
                    "name": "" if k else one["name"],
                    "dot": "" if k else dots.get(one["name"], ""),
                    "size": size,
                    "cells": cells,
                }
            )
    return {"cell": f"{objects['cell']:g}", "rows": rows}


def _intervals(intervals: Mapping[str, Any] | None) -> str:
    """One sentence about how sure the figures are; empty without intervals."""
    if not intervals:
        return ""
    parts = []
    for label, key in (("overall accuracy", "overall_accuracy"), ("kappa", "kappa"), ("mean IoU", "mean_iou")):
        if intervals.get(key) is not None:
            low, high = intervals[key]
            share = f"{percent(low)} to {percent(high)} %"
            parts.append(f"{label} {low:.3f} to {high:.3f}" if key == "kappa" else f"{label} {share}")
    level, blocks = f"{100 * intervals['level']:.0f} %", intervals["blocks"]
    text = f"{level} intervals from {blocks} blocks drawn at random: {', '.join(parts)}."
    return f"{text} Caution: {intervals['caution']}." if intervals.get("caution") else text


def _of(values: Any, index: int, name: str) -> Any:
    if isinstance(values, Mapping):
        return values.get(name)
    return values[index] if values else None


def _cell(count: int, total: int, right: bool) -> dict[str, str]:
    """Count and share of the row; the deeper the colour the larger the share."""
    share = count / total if total else 0.0
    colour, strength = (RIGHT, share) if right else (WRONG, min(1.0, share * 2.5))
    mixed = [round(255 + (c - 255) * strength * 0.9) for c in colour]
    dark = 0.299 * mixed[0] + 0.587 * mixed[1] + 0.114 * mixed[2] < 140
    return {
        "count": number(count),
        "share": f"{percent(share)} %" if total else "–",
        "style": f"background:{css((mixed[0], mixed[1], mixed[2]))};color:{'#fff' if dark else '#1d2a35'}",
    }


def _dots(names: Iterable[str], classes: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    by_code = colours(classes)
    colour_of = {str(c["name"]): css(by_code[int(c["code"])]) for c in classes}
    return {n: colour_of.get(n, "#b8c1c9") for n in names}


def distribution(
    quantiles: Mapping[str, Any] | None, classes: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]] | None:
    """Per feature and class: quantiles, a box to draw [% of the feature's range], Fan 2013's words."""
    if not quantiles:
        return None
    out = []
    for feature, per_class in quantiles.items():
        low, high = _range(per_class.values())
        dots = _dots(per_class, classes)
        base = _base(feature)
        paper = FAN_2013.get(_BASE.get(base, base), {})
        rows = []
        for name, stats in per_class.items():
            texts = {p: measure(stats.get(p)) for p in PERCENTILES}
            word = _CLASS.get(name.lower(), name.lower())
            rows.append(
                {"name": name, "dot": dots[name], "n": number(stats.get("n")), "paper": paper.get(word, "–")}
                | texts
                | {"box": _box(stats, low, high)}
            )
        if rows:
            out.append({"feature": feature, "title": _title(feature), "unit": unit_of(feature), "rows": rows})
    return out or None


def classifier(facts: Mapping[str, Any]) -> str:
    """What learned, in words; "" where the report does not say."""
    name = f"random forest of {number(facts['trees'])} trees" if facts.get("trees") else ""
    name = name or CLASSIFIERS.get(str(facts.get("method")), "")
    return f"{name} with a second layer by the answers around every echo" if facts.get("in_context") else name


def training(facts: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What learned, from how many samples per class, the features in words."""
    if not facts:
        return None
    features = [_title(str(f)) for f in facts.get("features") or ()]
    return {
        "classifier": classifier(facts),
        "samples": dict(facts.get("samples") or {}),
        "features": features,
        "out_of_bag": percent(facts.get("out_of_bag")),
        "notes": [
            *map(str, facts.get("notes") or ()),
            *(f"second layer: {note}" for note in (facts.get("second_layer") or {}).get("notes", ())),
        ],
    }


def waveforms(facts: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """The system's pulse and gain of every strip in words, and where the calibration comes from."""
    if not facts or not facts.get("strips"):
        return None
    rows = []
    for strip in facts["strips"]:
        pulse = strip["pulse"]
        measured = pulse["shape"] == "measured"
        echoes = number(pulse["echoes"]) if pulse["echoes"] else "not measured"
        gain = strip.get("gain")
        rows.append(
            {
                "name": strip["name"],
                "shape": "measured" if measured else "Gaussian",
                "fwhm": f"{pulse['fwhm']:.2f}",
                "rise": f"{pulse['rise_time']:.2f}",
                "tail": percent(pulse["tail_share"]),
                "shape_error": percent(pulse["shape_error"]),
                "echoes": echoes,
                "noise": measure(strip.get("noise")),
                "gain": f"{gain:.3f}" if gain is not None else "–",
            }
        )
    return {"rows": rows, "gains": any(r["gain"] != "–" for r in rows), "notes": _calibration_notes(facts)}


def _calibration_notes(facts: Mapping[str, Any]) -> list[str]:
    """How ranges and radiometry came about, in sentences."""
    notes = []
    calibration = facts.get("calibration")
    if calibration:
        source = calibration["source"]
        if source == "none":
            notes.append("Cross-section and backscatter are relative: no calibration constant is given or measured.")
        else:
            error = (
                f", standard error {percent(calibration['error'])} %" if calibration.get("error") is not None else ""
            )
            origin = (
                f"{number(calibration['target_echoes'])} echoes on the target"
                if source == "target"
                else "configuration"
            )
            notes.append(f"Calibration constant {calibration['constant']:.4g} per m² DN ns, from {origin}{error}.")
    if facts.get("without_range"):
        notes.append(f"{number(facts['without_range'])} echoes have no range, and no radiometry.")
    angle = facts.get("pointing_error")
    if angle is not None:
        text = f"{angle:.3f}°" if angle >= LEAST_ANGLE else f"less than {LEAST_ANGLE}°"
        notes.append(f"Beams and trajectory agree to {text} (median of the worst tile).")
        if angle > POINTING_LIMIT:
            notes.append("That is too much: check the trajectory's time scale, height system and coordinate system.")
    return notes


def _base(feature: str) -> str:
    return re.sub(r"_r\d+$", "", feature)


def _title(feature: str) -> str:
    base = _base(feature)
    scale = re.search(r"_r(\d+)$", feature)
    title = TITLES.get(base, base.replace("_", " "))
    return f"{title}, r = {int(scale[1]) / 100:g} m" if scale else title


def unit_of(feature: str) -> str:
    """Unit of a feature as a page writes it (m², 1/m², °); nothing for an unknown one, and for a pure number."""
    try:
        return column(feature).unit.replace("2", "²").replace("deg", "°")
    except KeyError:
        return ""


def _range(stats: Iterable[Mapping[str, Any]]) -> tuple[float, float]:
    values = [s[p] for s in stats for p in PERCENTILES if s.get(p) is not None and math.isfinite(s[p])]
    return (min(values), max(values)) if values else (0.0, 1.0)


def _box(stats: Mapping[str, Any], low: float, high: float) -> dict[str, float] | None:
    """Places of the quantiles from 2 to 98, or None if one is unknown."""
    values = [stats.get(p) for p in PERCENTILES]
    if any(v is None or not math.isfinite(v) for v in values):
        return None
    span = max(high - low, 1e-12)
    return {p: round(2 + 96 * (float(v or 0) - low) / span, 2) for p, v in zip(PERCENTILES, values, strict=True)}


def stages(timings: Iterable[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Rows of the time table, with the length of each bar [% of the longest]."""
    rows = [dict(s) for s in timings]
    if not rows:
        return None
    longest = max((float(r.get("seconds") or 0) for r in rows), default=0) or 1.0
    total = sum(float(r.get("seconds") or 0) for r in rows)
    for row in rows:
        spent = float(row.get("seconds") or 0)
        row["bar"] = round(100 * spent / longest, 2)
        row["share"] = f"{100 * spent / total:.0f} %" if total else "–"
        row["time"] = f"{spent:.1f}"
        row.setdefault("failed", 0)
        row["peak"] = number(row["peak_mib"]) if row.get("peak_mib") else "–"
        for key in ("parts", "computed", "skipped", "rows"):
            row[key] = number(row[key]) if row.get(key) is not None else "–"
    return {"rows": rows, "total": f"{total:.1f}", "failed": sum(int(row.get("failed") or 0) for row in rows)}
