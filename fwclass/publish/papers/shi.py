"""Shi 2019: what its page shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.publish.papers.scene import draw_fscores, draw_scene
from fwclass.publish.papers.tables import difference, matrices, ours, rows_table, seconds_of, share
from fwclass.publish.report import data_uri
from fwclass.publish.sections import number

TITLES = {
    "without_heights": "SVM without a ground filter, no heights",
    "iptd": "ground by the filter, SVM of the others",
    "iptd_heights": "the same with heights above the ground",
    "svm_all": "SVM of all classes, all features",
    "svm": "SVM, the features kept",
    "nn_svm": "NN-SVM (trimmed rows), the features kept",
    "coarse": "the run's first layer",
    "fine": "both layers",
}


def shi_view(facts: Mapping[str, Any]) -> dict[str, Any]:
    """What the template shows besides what all papers have."""
    names = [c["name"] for c in facts["classes"]]
    layers = facts["layers"]
    kept = {n for n, _ in facts["fscores"] if _base(n) in facts["printed"]["fscore"]["kept"]}
    return {
        "facts": _facts(facts),
        "names": names,
        "rows": rows_table(facts["rows"]),
        "remarks": (facts["whole"] or {}).get("remarks", ()),
        "learned": _notes(facts),
        "second": _second(facts),
        "refine": facts["refine"],
        "ground": facts["ground"],
        "heights": facts["heights"],
        "scaling": facts["scaling"],
        "ladder": [_step(k, v, names, facts) for k, v in facts["steps"].items()]
        + [_layer(k, names, facts) for k in ("coarse", "fine") if layers[k]],
        "paper_table": [{"name": k, **v} for k, v in facts["printed"]["combinations"].items()],
        "boundary": _boundary(facts),
        "algorithms": [_algorithm(k, v) for k, v in facts["printed"]["algorithms"].items()],
        "fscores": [(n, f"{v:.3f}", "kept" if n in kept else "dropped") for n, v in facts["fscores"]],
        "fscore_plot": data_uri(draw_fscores(facts["fscores"], kept)),
        "scenes": [_scene(one, facts["classes"]) for one in facts["scenes"]],
        "tables": [
            {"title": TITLES[k], **matrices(layers[k], facts["classes"], None)} for k in ("coarse", "fine") if layers[k]
        ],
        "blocks": layers["blocks"],
        "gains": {k: _gain(v) for k, v in layers["gains"].items()},
        "whole": facts["whole"] and {**ours(facts["whole"]), "area": facts["whole"]["area"]},
    }


def _base(name: str) -> str:
    head, _, end = name.rpartition("_r")
    return head if end.isdigit() else name


def _scene(scene: Mapping[str, Any], classes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    xmin, ymin, edge = scene["place"]
    return {
        "uri": data_uri(draw_scene(scene["echoes"], scene["place"], classes)),
        "place": f"{xmin:.0f} E, {ymin:.0f} N, {edge:g} m",
        "echoes": number(len(scene["echoes"]["x"])),
        "boundary": number(int(scene["echoes"]["boundary"].sum())),
    }


def _facts(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    printed, fine = facts["printed"]["algorithms"]["proposed"], facts["layers"]["fine"]
    first, second = facts["layers"]["coarse_boundary"], facts["layers"]["fine_boundary"]
    rows = [("overall, ours", "–" if fine is None else f"{ours(fine)['overall_accuracy']} %")]
    rows.append(("overall, Shi 2019", f"{printed['overall']} %"))
    for name in facts["refine"]["between"]:
        k = None if first is None else first["classes"].index(name)
        value = "–" if k is None else f"{share(first['iou'][k])} → {share(second['iou'][k])}"
        rows.append((f"{name} at the boundary, IoU %", value))
    return rows


def _classes(result: Mapping[str, Any], names: Sequence[str]) -> list[dict[str, str]]:
    return [
        {"iou": share(result["iou"][k]), "producers": share(result["producers_accuracy"][k])} for k in range(len(names))
    ]


def _step(key: str, result: Mapping[str, Any], names: Sequence[str], facts: Mapping[str, Any]) -> dict[str, Any]:
    times = facts["times"][key]
    pair = next((p for p in facts["differences"] if p.startswith(f"{key}/")), None)
    gain = difference(facts["differences"][pair]) if pair else None
    return {
        "title": TITLES[key],
        **ours(result),
        "features": len(result["features"]),
        "vectors": number(result["vectors"]),
        "machine": "C {c:g}, γ {gamma:g}".format(**result["params"]),
        "classes": _classes(result, names),
        "gain": gain["overall_accuracy"] if gain else "",
        "gain_span": gain["overall_accuracy_span"] if gain else "",
        "train": seconds_of(times["train"]),
        "test": seconds_of(times["test"]),
    }


def _layer(key: str, names: Sequence[str], facts: Mapping[str, Any]) -> dict[str, Any]:
    result, gain = facts["layers"][key], facts["layers"]["gains"]["all"]
    gain_texts = difference(gain) if key == "fine" and gain else None
    return {
        "title": TITLES[key],
        **ours(result),
        "features": "–",
        "vectors": "–",
        "machine": "",
        "classes": _classes(result, names),
        "gain": gain_texts["overall_accuracy"] if gain_texts else "",
        "gain_span": gain_texts["overall_accuracy_span"] if gain_texts else "",
        "train": "–",
        "test": "–",
    }


def _points(gain: Mapping[str, float]) -> str:
    """A difference of fractions in points, with its interval."""
    value, low, high = (f"{100 * gain[k]:+.1f}".replace("-", "−") for k in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def _notes(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What training remarked on, and in which steps."""
    steps: dict[str, list[str]] = {}
    for key, result in facts["steps"].items():
        for note in result["notes"]:
            if not note.startswith("class "):  # rows of a class: the table has them
                steps.setdefault(note, []).append(TITLES[key])
    notes = [(note, "; ".join(of)) for note, of in steps.items()]
    layer = facts["second_layer"] or {}
    return [*notes, *((note, "second layer") for note in layer.get("notes", ()) if not note.startswith("class "))]


def _second(facts: Mapping[str, Any]) -> str:
    """What the second layer learned from, and what it costs in the run."""
    layer, seconds = facts["second_layer"], facts["seconds"]
    learned = f"The second layer learned from {number(layer['samples'])} rows. " if layer else ""
    first, second = seconds.get("coarse", 0.0), seconds.get("refine", 0.0) + seconds.get("classify", 0.0)
    return (
        f"{learned}In the run the answers of the first layer took {first:.1f} s of one worker, finding the boundary, "
        f"its wide features and the answers there {second:.1f} s."
    )


def _boundary(facts: Mapping[str, Any]) -> dict[str, Any] | None:
    """Table 2: both layers at the boundary, by class."""
    first, second = facts["layers"]["coarse_boundary"], facts["layers"]["fine_boundary"]
    if first is None:
        return None
    total, every = sum(map(sum, second["confusion"])), sum(map(sum, facts["layers"]["fine"]["confusion"]))
    rows = []
    for name in facts["refine"]["between"]:
        k = first["classes"].index(name)
        printed = [facts["printed"]["boundary"][layer].get(name, "–") for layer in ("coarse", "fine")]
        values = [[share(one[key][k]) for one in (first, second)] for key in ("iou", "producers_accuracy")]
        gain = (facts["layers"]["class_gains"] or {}).get(name)
        span = "" if not gain or gain["low"] is None else _points(gain)
        rows.append({"name": name, "iou": values[0], "producers": values[1], "paper": printed, "span": span})
    return {"echoes": number(total), "share": share(total / max(1, every)), "rows": rows}


def _algorithm(key: str, printed: Mapping[str, Any]) -> dict[str, Any]:
    titles = {"svm": "SVM", "nn_svm": "NN-SVM", "proposed": "proposed"}
    return {"title": titles[key], **printed}


def _gain(comparison: Mapping[str, Any] | None) -> dict[str, Any] | None:
    return (
        {**difference(comparison), "blocks": comparison["blocks"], "caution": comparison["caution"]}
        if comparison
        else None
    )
