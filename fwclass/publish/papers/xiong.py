"""Xiong 2018: what its page shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.publish.papers.plots import draw_elimination, draw_importance, draw_radii
from fwclass.publish.papers.tables import difference, matrices, ours, rows_table, seconds_of, share
from fwclass.publish.report import data_uri
from fwclass.publish.sections import number
from fwclass.publish.selection_curves import draw_rates
from fwclass.schema import split_name

SHOWN = 30
"""Features of the importance chart."""

COLOURS = {
    "normalised height": "#1d2a35",
    "height statistics": "#5f8fb4",
    "surface": "#17697a",
    "spatial distribution": "#8a6bb0",
    "echoes": "#d0742e",
    "intensity": "#c2a83e",
    "other": "#9aa5ae",
}
SIGNS = {
    "height_above_ground": "NH",
    "height_range": "Hr",
    "height_std": "H std",
    "height_skewness": "H skewness",
    "height_kurtosis": "H kurtosis",
    "roughness": "roughness N",
    "plane_range": "S range",
    "plane_std": "S std",
    "inclination": "Sn",
    "eigenvalue_1": "λ1",
    "eigenvalue_2": "λ2",
    "eigenvalue_3": "λ3",
    "egi": "EGI",
    "ebi": "EBI",
    "evi": "EVI",
    "intensity_mean": "AI",
}


def xiong_view(facts: Mapping[str, Any]) -> dict[str, Any]:
    """What the template shows besides what all papers have."""
    names = [c["name"] for c in facts["classes"]]
    strategies = [_strategy(k, v, facts) for k, v in facts["strategies"].items()]
    return {
        "facts": _facts(facts),
        "names": names,
        "settings": facts["settings"],
        "candidates": len(facts["candidates"]),
        "chosen": [sign(n) for n in facts["chosen"]],
        "samples": {k: number(v) for k, v in facts["printed"]["samples"].items()},
        "rows": rows_table(facts["rows"]),
        "strategies": strategies,
        "tables": [
            {"title": s["title"], **matrices(facts["strategies"][s["key"]], facts["classes"], None)} for s in strategies
        ],
        "differences": [_difference(k, v, facts) for k, v in facts["differences"].items()],
        "selection": _selection(facts),
        "selection_plot": data_uri(_elimination(facts)),
        "importance_plot": data_uri(_importance(facts)),
        "importance": _important(facts),
        "radii": [_radius(r) for r in facts["radii"]],
        "radii_plot": data_uri(_radii(facts)),
        "thinning": _thinning(facts),
        "thinning_plot": data_uri(draw_rates(facts["thinning"]["steps"], facts["thinning"]["lowest"], "")),
        "whole": facts["whole"] and {**ours(facts["whole"]), "area": facts["whole"]["area"]},
    }


def sign(name: str) -> str:
    """A feature in the paper's signs, with its radius."""
    try:
        base, scale = split_name(name)
    except KeyError:
        return name
    symbol = SIGNS.get(base, base.replace("_", " "))
    return f"{symbol} {scale.metres:g} m" if scale else symbol


def _facts(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    one, printed = ours(facts["strategies"]["rf_selected"]), facts["printed"]["strategies"]["rf_selected"]
    return [
        ("overall, ours", f"{one['overall_accuracy']} %"),
        ("overall, Xiong 2018", f"{printed['overall']} %"),
        ("kappa, ours", one["kappa"]),
        ("kappa, Xiong 2018", f"{printed['kappa']:.3f}"),
        ("features kept", f"{len(facts['chosen'])} of {len(facts['candidates'])}"),
        (
            "kept by Xiong 2018",
            f"{facts['printed']['selection']['chosen']} of {facts['printed']['selection']['candidates']}",
        ),
    ]


def _strategy(key: str, result: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    paper, times = facts["printed"]["strategies"][key], facts["times"][key]
    return {
        "key": key,
        "title": paper["title"],
        **ours(result),
        "features": result["features"],
        "paper": {"overall": paper["overall"], "kappa": f"{paper['kappa']:.3f}"},
        "errors": [
            {
                "name": n,
                "omission": share(result["omission"][n]),
                "commission": share(result["commission"][n]),
                "paper_omission": paper["omission"].get(n, "–"),
                "paper_commission": paper["commission"].get(n, "–"),
            }
            for n in result["omission"]
        ],
        "train": seconds_of(times["train"]),
        "test": seconds_of(times["test"]),
        "paper_train": seconds_of(paper["train"]),
        "paper_test": seconds_of(paper["test"]),
        "train_rows": number(times["train_rows"]),
        "test_rows": number(times["test_rows"]),
        "notes": result["notes"],
    }


def _difference(key: str, comparison: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    first, second = key.split("/")
    printed = facts["printed"]["strategies"]
    return {
        "first": printed[first]["title"],
        "second": printed[second]["title"],
        **difference(comparison),
        "blocks": comparison["blocks"],
        "caution": comparison.get("caution"),
        "paper": f"{printed[first]['overall'] - printed[second]['overall']:+.1f}",
    }


def _selection(facts: Mapping[str, Any]) -> dict[str, Any]:
    selection = facts["selection"]
    return {
        "echoes": number(selection["sample"]["rows"]),
        "blocks": selection["sample"]["blocks"],
        "folds": selection["params"]["folds"],
        "edge": f"{selection['params']['block']:g}",
        "drop": f"{100 * selection['params']['drop']:g}",
        "accuracy": share(selection["best"]["accuracy"]),
        "all": share(selection["steps"][0]["accuracy"]),
        "smallest": [sign(n) for n in selection["smallest"]["features"]],
        "smallest_accuracy": share(selection["smallest"]["accuracy"]),
        "microseconds": f"{selection['best']['microseconds']:.1f}",
        "all_microseconds": f"{selection['steps'][0]['microseconds']:.1f}",
    }


def _elimination(facts: Mapping[str, Any]) -> bytes:
    steps = [(len(s["features"]), 100 * s["accuracy"], 100 * s["accuracy_std"]) for s in facts["selection"]["steps"]]
    printed = facts["printed"]["selection"]
    return draw_elimination(steps, len(facts["chosen"]), (printed["chosen"], printed["accuracy"]))


def _importance(facts: Mapping[str, Any]) -> bytes:
    bars = [(sign(r["name"]), r["score"], r["std"], r["group"]) for r in facts["importance"]["rows"][:SHOWN]]
    return draw_importance(bars, COLOURS)


def _important(facts: Mapping[str, Any]) -> dict[str, Any]:
    importance = facts["importance"]
    total = sum(importance["groups"].values()) or 1.0
    rows = [
        {
            "group": g,
            "colour": COLOURS[g],
            "sum": f"{v:.0f}",
            "share": f"{100 * v / total:.0f}",
            "bar": round(100 * max(v, 0) / total, 1),
        }
        for g, v in sorted(importance["groups"].items(), key=lambda item: -item[1])
    ]
    return {
        "repeats": importance["repeats"],
        "groups": rows,
        "shown": min(SHOWN, len(importance["rows"])),
        "of": len(importance["rows"]),
    }


def _radius(row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "radius": f"{row['radius']:g}",
        "ours": ", ".join(SIGNS.get(n, n) for n in row["ours"]) or "–",
        "count": len(row["ours"]),
        "of": row["of"],
        "paper": "–" if row["paper"] is None else ", ".join(SIGNS.get(n, n) for n in row["paper"]) or "none",
        "paper_count": "–" if row["paper"] is None else len(row["paper"]),
    }


def _radii(facts: Mapping[str, Any]) -> bytes:
    rows = facts["radii"]
    return draw_radii(
        [r["radius"] for r in rows], [len(r["ours"]) for r in rows], [len(r["paper"] or ()) for r in rows]
    )


def _thinning(facts: Mapping[str, Any]) -> dict[str, Any]:
    rows = [
        {
            "rate": f"{100 * s['rate']:g}",
            "kept": number(s["kept"]),
            "trained": number(s["trained"]),
            "accuracy": share(s["accuracy"]),
            "std": share(s["accuracy_std"]),
            "kappa": f"{s['kappa']:.3f}",
            "train": seconds_of(s["train_seconds"]),
            "micro": f"{s['microseconds']['total']:.2f}",
            "features": f"{s['microseconds']['features']:.2f}",
            "vote": f"{s['microseconds']['vote']:.2f}",
            "chosen": s["rate"] == facts["thinning"]["lowest"],
        }
        for s in facts["thinning"]["steps"]
    ]
    return {"rows": rows, "lowest": f"{100 * facts['thinning']['lowest']:g}"}
