"""Li 2018: what its page shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fwclass.publish.report import data_uri
from fwclass.publish.street_pictures import draw_grid

GOOD, WRONG, MISSED, REST = "#2f8f4e", "#c9502e", "#d9a92f", "#b9c4cc"
SIGNS = {
    "street_height_mean": "mean of z, μz",
    "street_road_height_mean": "mean of z above the road",
    "street_height_variance": "variance of z, δz",
    "street_height_range": "range of z, Δz",
    "street_depth_mean": "mean of y, μy",
    "street_depth_variance": "variance of y, δy",
    "street_depth_range": "range of y, Δy",
    "street_count": "number of points, d",
    "street_omnivariance": "omnivariance, o",
    "street_linearity": "linearity, a1D",
    "street_planarity": "planarity, a2D",
    "street_sphericity": "sphericity, a3D",
}
SPLITS = ("random", "other", "leafless")


def li_view(facts: Mapping[str, Any]) -> dict[str, Any]:
    """What the template shows besides what all papers have; ``grids``: answer and reference by feature."""
    best = next(r for r in facts["radii"] if r["radius"] == facts["best"])
    return {
        "facts": [
            ("error at random, best radius", _percent(min(r["random"]["error"] for r in facts["radii"]))),
            ("Li 2018, all radii", f"< {facts['printed']['bounds']['error']} %"),
            ("error on another street", _percent(best["other"]["error"])),
            ("the same without leaves", _percent(best["leafless"]["error"])),
            ("crowns among the returns", f"{100 * facts['crowns']:.1f} %"),
            ("the same, Li 2018", "59.4 %"),
        ],
        "drives": [{"name": n, **d} for n, d in facts["drives"].items()],
        "scene": facts["scene"],
        "method": facts["method"],
        "block": f"{facts['block']:g}",
        "radii": [_radius(r, facts) for r in facts["radii"]],
        "singles": [_single(s) for s in sorted(facts["singles"], key=lambda s: s["error"])],
        "single_radius": f"{facts['printed']['single']['radius']:g}",
        "guess": _percent(facts["guess"]),
        "grids": [
            {"name": SIGNS[_base(name)], "uri": data_uri(_picture(arrays))} for name, arrays in facts["grids"].items()
        ],
    }


def _base(name: str) -> str:
    return name if name in SIGNS else name.rsplit("_", 1)[0]


def _percent(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{100 * value:.{digits}f} %"


def _radius(result: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "radius": f"{result['radius']:g}",
        "chosen": result["radius"] == facts["best"],
        "lost": _percent(result["lost"], 1),
        "ms": f"{result['frame_ms']:.2f}",
        "vectors": result["vectors"] or "–",
    }
    for split in SPLITS:
        ends = result[split]["error_interval"]
        shown[split] = {k: f"{100 * result[split][k]:.2f}" for k in ("error", "detection", "false_alarm")}
        shown[split]["span"] = f"{100 * ends[0]:.2f}–{100 * ends[1]:.2f}" if ends else ""
        shown[split]["kappa"] = f"{result[split]['kappa']:.3f}"
        shown[split]["confusion"] = result[split]["confusion"]
    return shown


def _single(result: Mapping[str, Any]) -> dict[str, Any]:
    ends = result["interval"]
    return {
        "name": SIGNS[_base(result["name"])],
        **{k: f"{100 * result[k]:.1f}" for k in ("error", "detection", "false_alarm")},
        "span": f"{100 * ends[0]:.1f}–{100 * ends[1]:.1f}" if ends else "",
        "kappa": f"{result['kappa']:.3f}",
        "crown": f"{result['means'][0]:.3g}",
        "other": f"{result['means'][1]:.3g}",
    }


def _picture(arrays: Mapping[str, Any]) -> bytes:
    """Right crowns, false alarms, missed crowns, the rest (figure 10)."""
    answer, reference = arrays["answer"], arrays["reference"]
    kinds = np.where(answer == 0, np.where(reference == 0, 0, 1), np.where(reference == 0, 2, 3)).astype(np.uint8)
    kinds[answer == 255] = 255
    return draw_grid(kinds, ("crown", "false alarm", "missed", "other"), (GOOD, WRONG, MISSED, REST))
