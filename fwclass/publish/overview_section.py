"""The report's first screen and what leads on: verdict, map layers, curves, waveforms, what to look at next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.classes import STANDARD
from fwclass.errors import first_few, several
from fwclass.publish.figures import SURE, TINTS, WRONG
from fwclass.publish.palette import colours, css
from fwclass.publish.quality_section import threshold_words
from fwclass.publish.sections import number, percent

LAYERS = {
    "map": ("Classes", "class of the highest echo in every cell, shaded by the terrain"),
    "confidence": ("Confidence", "how sure the class of the highest echo is"),
    "errors": ("Errors", "share of wrong echoes among the test echoes of every block"),
    "relief": ("Terrain", "shaded relief of the terrain model, tinted by height"),
}
WITHOUT_CLASSIFIER = {1, 2, 7, 18}
"""Codes that a ground filter gives: unclassified, ground, low and high noise."""
FRAMED = ("map", "confidence", "errors")
"""Layers that the training and test areas are drawn on."""
WORTH_A_LOOK = 0.95
"""Mean confidence from which on a tile is no work."""
WIDTH, HEIGHT = 420.0, 190.0
"""Of the drawing of a waveform [user units of its SVG]."""
FOUR_LN2 = 2.772588722239781
"""4 ln 2: exp(-4 ln 2 (t / w)^2) is a Gaussian of full width w at half its height."""
STEPS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Confidences whose share and accuracy stand in the table."""


def subject(report: Mapping[str, Any]) -> str:
    """What a run is about: ``classification``, or without a classifier ``terrain``, ``quality`` where that is not
    delivered either."""
    model = report.get("model") or {}
    codes = {int(c["code"]) for c in model.get("classes") or ()}
    if not codes or model.get("features") or not codes <= WITHOUT_CLASSIFIER:
        return "classification"
    return "terrain" if (report.get("outputs") or {}).get("laz") else "quality"


def class_key(classes: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Colour, name and code of every class, and the standard's name where it has another."""
    shown = colours(classes)
    out = []
    for one in classes:
        code, name = int(one["code"]), str(one["name"])
        standard = STANDARD.get(code, "")
        other = standard if standard != name.lower().replace("_", " ") else ""
        out.append({"dot": css(shown[code]), "name": name, "code": str(code), "standard": other})
    return out


def layers(
    pictures: Mapping[str, str], classes: Sequence[Mapping[str, Any]], heights: tuple[float, float] | None = None
) -> list[dict[str, Any]]:
    """The layers of the map that there are, each with its legend as text; `heights` of the lowest and highest tint."""
    low, high = heights or (0.0, 0.0)
    tints = [f"{low + share * (high - low):.1f} m" for share, _ in TINTS]
    keys = {
        "map": [{"dot": k["dot"], "text": k["name"]} for k in class_key(classes)],
        "confidence": _steps(SURE, ("0 %", "50 %", "100 %")),
        "errors": _steps(WRONG, ("none wrong", "20 %", "60 %", "all")),
        "relief": _steps(TINTS, tints) if heights else [],
    }
    return [
        {"key": key, "title": title, "caption": caption, "uri": pictures[key], "legend": keys[key]}
        for key, (title, caption) in LAYERS.items()
        if key in pictures
    ]


def _steps(ramp: Sequence[tuple[float, tuple[int, int, int]]], texts: Sequence[str]) -> list[dict[str, str]]:
    return [{"dot": css(colour), "text": text} for (_, colour), text in zip(ramp, texts, strict=True)]


def verdict(report: Mapping[str, Any]) -> list[str]:
    """What the figures say, in sentences."""
    accuracy, sentences = report.get("accuracy") or {}, []
    overall, sure = accuracy.get("overall_accuracy"), (report.get("sureness") or {}).get("classes") or []
    if overall is not None:
        text = f"{percent(overall)} % of the test echoes have the right class"
        span = (accuracy.get("intervals") or {}).get("overall_accuracy")
        if span:
            level = f"{100 * accuracy['intervals']['level']:.0f} %"
            text += f" ({level} interval {percent(span[0])} to {percent(span[1])} %)"
        sentences.append(f"{text}, tested on {accuracy.get('area') or 'the test areas'}.")
        named = [
            (i, n)
            for i, n in zip(accuracy.get("iou") or (), accuracy.get("classes") or (), strict=False)
            if i is not None
        ]
        if named:
            iou, name = min(named)
            sentences.append(f"The weakest class is {_name(name)}: IoU {percent(iou)} %.")
    elif sure:
        sentences.append(
            "Nothing was tested: no reference lies in a test area. Confidence is how sure the model is, not how right."
        )
    unsure = [c for c in sure if c.get("confidence") is not None]
    if unsure:
        least = min(unsure, key=lambda c: c["confidence"])
        learned = "" if (report.get("model") or {}).get("path") else ", those that it learned from among them"
        share = percent(least["confidence"])
        sentences.append(f"The model is least sure of {least['name']}: {share} % on average of its echoes{learned}.")
    return [*sentences, *_thresholds(report.get("thresholds") or ())]


def _thresholds(asked: Sequence[Mapping[str, Any]]) -> list[str]:
    """Whether the survey's quality is as was asked."""
    missed = [f"{one['what']}: {threshold_words(one)}" for one in asked if not one["met"]]
    if missed:
        return [
            f"The survey's quality misses {len(missed)} of {several(len(asked), 'threshold')}: {'; '.join(missed)}."
        ]
    return [f"The survey's quality meets {several(len(asked), 'threshold')} of {len(asked)}."] if asked else []


def _name(item: Any) -> str:
    return str(item["name"] if isinstance(item, Mapping) else item)


def next_steps(report: Mapping[str, Any]) -> list[dict[str, str]]:
    """What to look at next: a text, the path of a file beside the report or "", a command to type or "".

    RUN in a command is the run directory, where the page lies.
    """
    tiles = (report.get("sureness") or {}).get("tiles") or ()
    failed, outputs = report.get("failed") or (), report.get("outputs") or {}
    steps = []
    if failed:
        steps.append((f"{several(len(failed), 'part')} failed: mend the cause and run again", "", "fwclass status RUN"))
    if outputs.get("laz"):
        waves = ", at an echo's waveform" if (report.get("counts") or {}).get("pulses") else ""
        why = ", and why an echo has its class" if subject(report) == "classification" else ""
        steps.append((f"Look at the cloud in the browser{waves}{why}", "", "fwclass view RUN"))
    if outputs.get("gis"):
        more = "; its work list has the least sure tiles" if tiles else ""
        steps.append((f"Open the project in QGIS{more}", "survey.qgz", ""))
    if tiles and outputs.get("laz"):
        steps.append(("List the least sure places", "", "fwclass view RUN --worklist unsure.gpkg"))
        text = "Correct classes in the least sure tiles; the next run learns from it"
        steps.append((text, "", "fwclass label checkout RUN mend --least-sure 3"))
        steps.append(("Find the places whose labels teach most", "", "fwclass suggest RUN places.gpkg"))
    for tile in (t for t in tiles if t["confidence"] < WORTH_A_LOOK):
        text = f"Tile {tile['tile']}: {number(tile['echoes'])} echoes, {percent(tile['confidence'])} % sure"
        steps.append((text, tile["file"], ""))
    return [{"text": text, "path": path, "command": command} for text, path, command in steps]


def survey_rows(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Where, when, how large, by what: (label, text) of what is known."""
    place, model = report.get("place") or {}, report.get("model") or {}
    rows = []
    if place:
        code = f" ({place['code']})" if place.get("code") else ""
        rows.append(("coordinates", f"{place['crs']}{code}" if place.get("crs") else "in no known system"))
        if place.get("flown"):
            first, last = place["flown"]
            rows.append(("flown", first if first == last else f"{first} to {last}"))
        if place.get("area"):
            cell = ((report.get("config") or {}).get("publish") or {}).get("class_cell")
            by = f", by cells of {cell:g} m" if cell else ""
            rows.append(("area with echoes", f"{place['area'] / 1e6:.3f} km²{by}"))
            rows.append(("density", f"{place['density']:.1f} echoes per m² of this area, noise among them"))
    files = (report.get("input") or {}).get("files") or ()
    if files:
        rows.append(("input", first_few([str(f["path"]) for f in files], 3)))
    if model.get("path"):
        rows.append(("model", f"{model['path']}, {len(model.get('features') or ())} features"))
    elif report.get("training"):
        base = f", from the survey's labels and rows of {model['base']}" if model.get("base") else ""
        rows.append(("model", f"trained in this run{base}, {len(model.get('features') or ())} features"))
    if legacy := report.get("legacy_codes"):
        rows.append(("classes in strips", _legacy(legacy, report.get("classes") or ())))
    if report.get("fwclass"):
        rows.append(("made with", f"fwclass {report['fwclass']}"))
    return rows


def _legacy(legacy: Mapping[str, Any], classes: Sequence[Mapping[str, Any]]) -> str:
    """Which codes strips have in place of others."""
    names = {str(c["code"]): c["name"] for c in classes}
    codes = ", ".join(f"{to} for {names.get(code, 'class')} {code}" for code, to in legacy["written"].items())
    one = len(legacy["strips"]) == 1
    return (
        f"{first_few(legacy['strips'], 3)} {'has' if one else 'have'} {codes}, as {'its' if one else 'their'} points "
        "hold codes up to 31; tiles and Parquet have the code itself"
    )


def sure_rows(report: Mapping[str, Any]) -> list[dict[str, str]]:
    """Echoes and mean confidence by class."""
    classes = (report.get("sureness") or {}).get("classes") or ()
    shown = colours(classes)
    return [
        {
            "dot": css(shown[int(c["code"])]),
            "name": str(c["name"]),
            "echoes": number(c["echoes"]),
            "confidence": percent(c["confidence"]) or "–",
        }
        for c in classes
    ]


SEEN = 0.001
"""Share of the test echoes that a step of the confidence needs to be told."""


def reliability_rows(reliability: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """A sentence, and a row for each step of the confidence: its mean, shares of test echoes and of right ones."""
    if not reliability:
        return None
    rows = [
        {"confidence": percent(c), "share": percent(s), "right": percent(r)}
        for c, s, r in reliability["steps"]
        if s >= SEEN
    ]
    mean, right, error = (percent(reliability[n]) for n in ("confidence", "right", "error"))
    with_class = " that have a class" if reliability["without_class"] else ""
    text = (
        f"The confidence of the test echoes{with_class} is {mean} % on average, and {right} % of them are right; over "
        f"steps of a tenth both differ by {error} % (expected calibration error)."
    )
    return {"text": text, "rows": rows}


def curve(levels: Sequence[Sequence[float]] | None) -> dict[str, Any] | None:
    """Accuracy of the echoes that are left to the model, over their share: a path, ends of the scale, a small table."""
    if not levels or len(levels) < 2:
        return None
    low = min(0.99, min(right for _, _, right in levels))
    points = [(WIDTH * share, HEIGHT * (1 - (right - low) / (1 - low))) for _, share, right in levels]
    rows = []
    for step in STEPS:
        reached = [row for row in levels if row[0] >= step - 1e-9]
        if reached:
            rows.append({"least": f"{step:.2f}", "share": percent(reached[0][1]), "right": percent(reached[0][2])})
    path = "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    return {"path": path, "low": percent(low), "rows": rows, "width": WIDTH, "height": HEIGHT}


def selection_curve(selection: Mapping[str, Any] | None, chosen: int) -> dict[str, Any] | None:
    """Accuracy over the number of features, as `fwclass select` tried them: a path, bars of the spread over the folds,
    and the place of the set of `chosen` features."""
    if not selection:
        return None
    steps = sorted(selection["steps"], key=lambda s: s["size"])
    spread = [s["accuracy_std"] or 0.0 for s in steps]
    low = min(s["accuracy"] - d for s, d in zip(steps, spread, strict=True))
    high = max(s["accuracy"] + d for s, d in zip(steps, spread, strict=True))
    most, rise = max(1, steps[-1]["size"]), max(high - low, 1e-3)

    def x(step: Mapping[str, Any]) -> float:
        return WIDTH * float(step["size"]) / most

    def y(value: float) -> float:
        return HEIGHT * (1.0 - (value - low) / rise)

    path = "M" + " L".join(f"{x(s):.1f} {y(s['accuracy']):.1f}" for s in steps)
    bars = " ".join(
        f"M{x(s):.1f} {y(s['accuracy'] - d):.1f} V{y(s['accuracy'] + d):.1f}"
        for s, d in zip(steps, spread, strict=True)
    )
    here = next((s for s in steps if s["size"] == chosen), None)
    return {
        "path": path,
        "bars": bars,
        "dot": (round(x(here), 1), round(y(here["accuracy"]), 1)) if here else None,
        "low": percent(low),
        "high": percent(high),
        "most": most,
        "chosen": chosen,
        "what": f"{selection['method']}, {selection['pick']} set, on {selection['survey']}",
        "width": WIDTH,
        "height": HEIGHT,
    }


def importance(training: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """The ten most important features with bars; the others by name."""
    values = (training or {}).get("importance")
    if not values:
        return None
    pairs = _pairs(values, list((training or {}).get("features") or ()))
    if not pairs:
        return None
    pairs.sort(key=lambda item: (-item[1], item[0]))
    most = max(pairs[0][1], 1e-12)
    rows = [{"name": n, "value": f"{v:.4f}", "bar": round(100 * max(v, 0) / most, 1)} for n, v in pairs[:10]]
    return {"rows": rows, "more": [n for n, _ in pairs[10:]]}


def _pairs(values: Any, features: list[str]) -> list[tuple[str, float]]:
    """(feature, importance) of whatever form a model's card has."""
    if isinstance(values, Mapping):
        values = values.get("mean", values.get("drop", values.get("values", values)))
    if isinstance(values, Sequence) and len(values) == len(features):
        values = dict(zip(features, values, strict=True))
    if not isinstance(values, Mapping):
        return []
    return [(str(k), float(v)) for k, v in values.items() if isinstance(v, (int, float))]


def waves(pulses: Sequence[Mapping[str, Any]] | None) -> list[dict[str, Any]]:
    """A panel a pulse: the samples, the fitted sum, a line at every echo."""
    return [_wave(pulse) for pulse in pulses or ()]


def _wave(pulse: Mapping[str, Any]) -> dict[str, Any]:
    wide, tall = 300.0, 130.0
    samples, start, step = pulse["samples"], float(pulse["start"]), float(pulse["spacing"])
    base = float(pulse["baseline"])
    low, high = min([*samples, base]), max([*samples, base + 1])
    last = start + step * max(1, len(samples) - 1)

    def x(time: float) -> float:
        return wide * (time - start) / (last - start)

    def y(value: float) -> float:
        return tall - (tall - 8) * (value - low) / (high - low)

    dots = " ".join(f"{x(start + step * k):.1f},{y(v):.1f}" for k, v in enumerate(samples))
    fine = [start + (last - start) * k / 240 for k in range(241)]
    total = [base + sum(_gaussian(t, *echo) for echo in pulse["echoes"]) for t in fine]
    fitted = " ".join(f"{x(t):.1f},{y(min(v, high)):.1f}" for t, v in zip(fine, total, strict=True))
    places = [f"{x(float(echo[0])):.1f}" for echo in pulse["echoes"]]
    several = f"{len(places)} echo{'es' * (len(places) != 1)}"
    title = f"strip {pulse['strip']}, pulse {pulse['pulse']}: {several}"
    return {"title": title, "dots": dots, "fitted": fitted, "echoes": places, "width": wide, "height": tall}


def _gaussian(time: float, middle: float, height: float, width: float) -> float:
    from math import exp

    return float(height * exp(-FOUR_LN2 * ((time - middle) / max(width, 1e-6)) ** 2))
