"""He 2023: what its page shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.publish.parameter_curves import draw_curves
from fwclass.publish.report import data_uri

TITLES = {
    "slope": "slope (Vosselman 2000)",
    "smrf": "SMRF (Pingel 2013)",
    "moving-surface": "moving surface",
    "ptd": "TIN densification (Axelsson 2000)",
    "csf": "CSF (Zhang 2016)",
    "csf+smrf": "CSF, then SMRF (He 2023)",
    "reference": "reference",
}
KINDS = ("start", "best", "held_out")
FIGURES = ("type_i", "type_ii", "total_error", "kappa")


def he_view(facts: Mapping[str, Any]) -> dict[str, Any]:
    """What the template shows besides what all papers have; ``reliefs``: pictures by sample."""
    means, methods = facts["means"], facts["methods"]
    best = min(methods, key=lambda m: means[m]["held_out"]["total_error"])
    ours = means["csf+smrf"]["held_out"]
    return {
        "facts": [
            ("samples", str(len(facts["samples"]))),
            (f"least total error, held out ({best})", f"{100 * means[best]['held_out']['total_error']:.2f} %"),
            ("CSF, then SMRF, held out", f"{100 * ours['total_error']:.2f} %"),
            ("its Type II", f"{100 * ours['type_ii']:.2f} %"),
            ("its kappa", f"{100 * ours['kappa']:.1f} %"),
            ("filters", str(len(methods))),
        ],
        "samples": [
            {
                "name": name,
                "points": f"{a['points']:,}".replace(",", " "),
                "ground": f"{100 * a['ground']:.0f}",
                "density": f"{a['density']:.2f}",
                "slope": f"{100 * a['slope']:.0f}",
                "relief": f"{a['relief']:.0f}",
                "steep": name in facts["steep"],
            }
            for name, a in facts["samples"].items()
        ],
        "means": [_row(m, means[m], m == best) | {"speed": f"{means[m]['speed'] / 1e6:.2f}"} for m in methods],
        "by_sample": [
            {"name": name, "rows": _rows(methods, results), "span": len(methods)}
            for name, results in facts["by_sample"].items()
        ],
        "optima": [
            {
                "name": name.removeprefix("csf."),
                "paper": ", ".join(f"{v:g}" for v in values),
                "ours": ", ".join(
                    f"{r['csf']['best']['parameters'][name.removeprefix('csf.')]:g}"
                    for r in facts["by_sample"].values()
                ),
            }
            for name, values in facts["printed"]["optima"].items()
        ],
        "curves": [
            {"name": name, "uri": data_uri(_curves(results["csf"]))} for name, results in facts["by_sample"].items()
        ],
        "reliefs": [
            {"name": name, "pictures": [{"name": TITLES.get(m, m), "uri": data_uri(png)} for m, png in pictures]}
            for name, pictures in facts["reliefs"].items()
        ],
    }


def _rows(methods: list[str], results: Mapping[str, Any]) -> list[dict[str, Any]]:
    best = min(methods, key=lambda m: results[m]["held_out"]["total_error"])
    return [_row(m, results[m], m == best) for m in methods]


def _row(method: str, result: Mapping[str, Any], chosen: bool) -> dict[str, Any]:
    figures = {k: {f: f"{100 * result[k][f]:.2f}" for f in FIGURES} for k in KINDS}
    return {"name": TITLES.get(method, method), "chosen": chosen, **figures}


def _curves(result: Mapping[str, Any]) -> bytes:
    """Kappa over each parameter of CSF (figure 4)."""
    return draw_curves(result["curves"], result["best"]["parameters"], "csf", result["held_out"]["kappa"])
