"""The comparison of ground filters: one HTML file without any link to the network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.publish.drawing import PAPER, draw, frame, legend, png
from fwclass.publish.figures import downsample
from fwclass.publish.files import write_page
from fwclass.publish.palette import css
from fwclass.publish.params import PublishParams
from fwclass.publish.report import data_uri, environment, report_style
from fwclass.publish.sections import number, percent, quantity, seconds

TEMPLATE = "ground.html.j2"
DISAGREEMENT = "disagreement"
GROUND, OTHER = (214, 198, 160), (178, 194, 186)
"""Colours of cells on which all filters agree."""

FEW, MANY = (247, 178, 86), (176, 32, 38)
"""Colours of cells with a minority of one filter, and of half of them."""


def disagreement_map(
    split: NDArray[np.uint8], verdict: NDArray[np.uint8], filters: int, window: Window, params: PublishParams
) -> bytes:
    """PNG of where filters disagree.

    `split`: filters in the minority, the largest of the cell's points; row 0 in the south. `verdict`: 0 no point, 1 all
    points are other by the majority, 2 at least one is ground. `filters`: how many were asked.
    """
    stacked, view = downsample(
        np.where(verdict > 0, split.astype(np.int16) * 4 + verdict, 0), window, params.figure_pixels
    )
    most = max(filters // 2, 1)
    table = _colours(most)
    image = np.full((*stacked.shape, 3), 255.0)
    for code in np.unique(stacked):
        if code:
            image[stacked == code] = table[int(code) // 4] if code >= 4 else (GROUND if code == 2 else OTHER)
    figure, axes = frame(view)
    draw(axes, image, view)
    handles = [Patch(facecolor=css(GROUND), label="all: ground"), Patch(facecolor=css(OTHER), label="all: other")]
    handles += [
        Patch(facecolor=css(table[k]), label=f"{k} of {filters} differ{'s' * (k == 1)}") for k in range(1, most + 1)
    ]
    if (stacked == 0).any():
        handles.append(Patch(facecolor=PAPER, edgecolor="#00000060", label="no points"))
    legend(axes, handles, "Filters")
    return png(figure)


def _colours(most: int) -> dict[int, tuple[int, int, int]]:
    """Colour by size of the minority, 1 to `most`."""
    steps = np.linspace(0.0, 1.0, most) if most > 1 else np.array([1.0])
    mixed = np.rint(np.outer(1 - steps, FEW) + np.outer(steps, MANY)).astype(int)
    return {k + 1: (int(c[0]), int(c[1]), int(c[2])) for k, c in enumerate(mixed)}


def render_comparison(comparison: Mapping[str, Any], pictures: Mapping[str, bytes], path: Path) -> dict[str, Any]:
    """Write the comparison as one HTML file: styles inside, images as data, every text escaped.

    `comparison`: what `single_file.ground.compare` tells. `pictures`: PNG by filter, and ``disagreement``.

    Returns a dict with ``path, bytes``.
    """
    page = environment().get_template(TEMPLATE).render(_view(comparison, pictures))
    return {"path": str(path), "bytes": write_page(path, page)}


def _view(comparison: Mapping[str, Any], pictures: Mapping[str, bytes]) -> dict[str, Any]:
    names = list(comparison["methods"])
    rows = [_row(one) for one in comparison["filters"]]
    known = [r for r in rows if r["kappa_value"] is not None]
    best = max(known, key=lambda r: r["kappa_value"])["name"] if known else ""
    return {
        "style": report_style(),
        "name": Path(comparison["input"]).name,
        "version": comparison["fwclass"],
        "facts": _facts(comparison, len(names)),
        "summary": _summary(comparison, names, known, best),
        "labelled": comparison["labelled"],
        "rows": rows,
        "best": best,
        "names": names,
        "agreement": [[_cell(v, i == j) for j, v in enumerate(line)] for i, line in enumerate(comparison["agreement"])],
        "votes": _votes(comparison["votes"]),
        "disagreement": data_uri(pictures[DISAGREEMENT]) if DISAGREEMENT in pictures else "",
        "reliefs": [{"name": n, "uri": data_uri(p)} for n, p in pictures.items() if n != DISAGREEMENT],
        "without": [r["name"] for r in rows if r["name"] not in pictures],
        "parameters": [
            (one["method"], _parameters(one["parameters"])) for one in comparison["filters"] if one["parameters"]
        ],
    }


def _facts(comparison: Mapping[str, Any], n: int) -> list[tuple[str, str]]:
    measured, votes = comparison["measured"], comparison["votes"]
    same = (votes[0] + votes[-1]) / max(sum(votes), 1)
    return [
        ("points", quantity(comparison["points"])),
        ("points per m²", f"{measured['density']:.2f}"),
        ("slope, 90 % below", f"{measured['slope_steep']:.2f}"),
        ("widest building", f"{measured['building']:.0f} m"),
        ("filters", str(n)),
        ("all agree", f"{percent(same)} %"),
    ]


def _summary(comparison: Mapping[str, Any], names: list[str], known: list[dict[str, Any]], best: str) -> str:
    text = f"{len(names)} filters on {number(comparison['shown'])} points: {', '.join(names)}."
    if known:
        text += f" Measured by the labels of the input, {best} has the greatest kappa."
    return text


def _row(result: Mapping[str, Any]) -> dict[str, Any]:
    accuracy = result.get("accuracy") or {}
    speed = result["points_per_second"]
    kappa = accuracy.get("kappa")
    return {
        "name": result["method"],
        "seconds": "–"
        if result["seconds"] is None
        else seconds(result["seconds"])
        if result["seconds"] >= 10
        else f"{result['seconds']:.2f} s",
        "speed": (f"{speed / 1e6:.2f} M" if speed >= 1e6 else f"{speed / 1e3:.3g} k") if speed else "–",
        "ground": f"{percent(result['ground_share'])} %",
        "noise": number(result["noise"]),
        "kappa_value": kappa,
        "kappa": f"{kappa:.3f}" if kappa is not None else "–",
        **{k: _error(accuracy.get(k)) for k in ("type_i", "type_ii", "total_error")},
    }


def _error(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.2f} %"


def _cell(share: float, same: bool) -> dict[str, str]:
    """Text and colour of one pair; the deeper the less the two agree."""
    depth = 0.0 if same else min(1.0, (1.0 - share) * 6.0)
    mixed = [round(255 + (c - 255) * depth * 0.8) for c in (196, 78, 40)]
    return {
        "text": "" if same else f"{100 * share:.1f} %",
        "style": f"background:{css((mixed[0], mixed[1], mixed[2]))}",
    }


def _votes(votes: list[int]) -> list[dict[str, Any]]:
    total = max(sum(votes), 1)
    return [
        {"count": k, "points": number(n), "share": f"{percent(n / total)} %", "bar": round(100 * n / max(*votes, 1), 2)}
        for k, n in enumerate(votes)
    ]


def _parameters(parameters: Mapping[str, Any]) -> str:
    """``name=value`` of the filter's own parameters; noise and blocks are alike for all."""
    shared = ("noise", "block", "block_halo", "last_returns")
    return ", ".join(_pair(n, v) for n, v in parameters.items() if n not in shared)


def _pair(name: str, value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{name}: " + " ".join(_pair(n, v) for n, v in value.items())
    return f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
