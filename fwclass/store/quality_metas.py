"""What the stages that judge a survey's flight tell in their receipts: its quality, check points, calibration."""

from __future__ import annotations

from fwclass.store.shapes import COUNT, FIGURE, FLAG, NUMBER, PAIR, PLANE, REMARKS, TEXT, TIMES, WHOLE, Maybe, Related

_VOIDS = [{"area": NUMBER, "bounds": PLANE}]
_HEIGHTS = Maybe(
    {
        "count": COUNT,
        **dict.fromkeys(("mean", "rmse", "accuracy_95", "percentile_95", "lowest", "highest"), NUMBER),
        "sd": FIGURE,
        "rmse_interval": PAIR,
    }
)
CHECKED = {
    "given": COUNT,
    "repeated?": COUNT,
    "blunders?": {"count": COUNT, "points": [PLANE]},
    "nearest_echo": FIGURE,
    **dict.fromkeys(("all", "open", "vegetated"), _HEIGHTS),
}
_MOVED = ("height", "roll", "pitch")
_STRIP = Related(
    {
        **{"name": TEXT, "files": [TEXT], "echoes": COUNT, "pairs": COUNT, "group": WHOLE},
        **{"times": Maybe(TIMES), "timed": FLAG, "azimuth": FIGURE, "centre": PAIR, "width": NUMBER, "length": NUMBER},
        **{f"{n}{end}": FIGURE for n in _MOVED for end in ("", "_error")},
    },
    "an error of what is adjusted, and of nothing else",
    lambda strip: all((strip[n] is None) == (strip[f"{n}_error"] is None) for n in _MOVED),
)
QUALITY = {
    **{"survey": TEXT, "echoes": COUNT, "noise": COUNT, "noise_share": FIGURE, "pulses": COUNT},
    "density": {
        **dict.fromkeys(("cell", "area"), NUMBER),
        **dict.fromkeys(("echoes", "pulses", "spacing"), FIGURE),
        "percentiles": Maybe(dict.fromkeys(("p5", "p50", "p95"), NUMBER)),
    },
    "voids": {"area": NUMBER, "count": COUNT, "least": NUMBER, "share": FIGURE, "largest": _VOIDS},
    "strips": {
        **{"by": TEXT, "pairs": COUNT, "adjusted": COUNT, "apart": COUNT},
        **dict.fromkeys(("rms", "left", "sigma"), FIGURE),
        "strips": [_STRIP],
        "between": [
            {
                **dict.fromkeys(("first", "second", "pairs"), COUNT),
                **dict.fromkeys(("mean", "rms"), NUMBER),
                "offset?": Maybe({**dict.fromkeys(("east", "north", "distance", "error"), NUMBER), "slopes": COUNT}),
            }
        ],
        "roughness?": {"places": COUNT, "smoothest": FIGURE, "median": FIGURE},
        "lifted?": [{"by": TEXT, "first": COUNT, "second": COUNT, "places": COUNT, "step": NUMBER}],
        "borders?": {
            **dict.fromkeys(("places", "borders"), COUNT),
            "stepped": [{"first": TEXT, "second": TEXT, "places": COUNT, "step": NUMBER}],
        },
    },
    "coverage": Maybe({"area": NUMBER, "share": FIGURE, "gaps": COUNT, "largest": _VOIDS}),
    "check_points": Maybe(CHECKED),
    "remarks": REMARKS,
}
CALIBRATION = {
    **{"constant": NUMBER, "source": TEXT, "target_echoes": COUNT, "others": FLAG},
    **dict.fromkeys(("error", "unit_error", "target_spread?"), FIGURE),
    "strips": [{"strip": COUNT, "gain": NUMBER, "error": FIGURE, "echoes": COUNT, "group": COUNT, "tied": FLAG}],
    "pairs": [
        {"first": COUNT, "second": COUNT, "cells": COUNT, **dict.fromkeys(("log_ratio", "error", "residual"), NUMBER)}
    ],
    "target_levels?": [(COUNT, NUMBER)],
}
