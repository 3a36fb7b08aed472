"""What the stages tell in their receipts, by stage: the shapes that receipts are held to when they are written, and
when somebody reads what they tell. Other stages, as those of a user's own workflow, are held to `EVERY` alone."""

from __future__ import annotations

from typing import Any

from fwclass.store.quality_metas import CALIBRATION, CHECKED, QUALITY
from fwclass.store.shapes import (
    ANY,
    CODE,
    COUNT,
    DECIMAL,
    FIGURE,
    FINITE,
    FLAG,
    KEY,
    NUMBER,
    NUMERAL,
    PAIR,
    PLANE,
    POSITIVE,
    REMARKS,
    TEXT,
    TILE,
    TIMES,
    WHOLE,
    Maybe,
    Misfit,
    Related,
    Shape,
    misfit,
    square,
)

_TWO = ((COUNT, COUNT), (COUNT, COUNT))
_PERCENT = (COUNT,) * 101
_SPACE = (FINITE,) * 6
_FAULTS = {TEXT: COUNT}
_ROWS = {"rows": COUNT}
_OUTSIDE = {TEXT: (COUNT, COUNT)}
_OFFSET = Maybe({**dict.fromkeys(("x", "y"), FINITE), **dict.fromkeys(("cell", "explained", "unmoved"), NUMBER)})
_MOVES = ((COUNT,) * 11,) * 11
_TRIAL = {"rows": COUNT, "counts": [COUNT]}

EVERY: dict[str, Shape] = {"rows?": COUNT, "faults?": _FAULTS, "remarks?": REMARKS, "without_value?": _FAULTS}
"""Of any stage."""

_VALUES = {
    "numbers?": (COUNT,) * 16,
    "intensities": {TEXT: COUNT},
    "intensity": Maybe((COUNT, COUNT)),
    "times": Maybe(TIMES),
    "several": COUNT,
    "missing": COUNT,
    "following?": (COUNT, COUNT),
    "kept?": (COUNT, COUNT),
    "slants?": (COUNT,) * 62,
    "lattice": ((WHOLE, WHOLE, COUNT),) * 3,
}
_READ = {
    **dict.fromkeys(("returns", "withheld?", "waveforms", "returns_without_packet"), COUNT),
    "faults": _FAULTS,
    "values?": _VALUES,
}
_CUT = {"tiles": {TILE: (COUNT, COUNT)}, "rows": COUNT}
_FIGURES = {
    "classes": [TEXT],
    "confusion": square(),
    **dict.fromkeys(("overall_accuracy", "kappa", "mean_iou", "type_i?", "type_ii?", "total_error?"), FIGURE),
    **{name: [FIGURE] for name in ("producers_accuracy", "users_accuracy", "iou")},
    "unclassified?": [COUNT],
}
_BY_CLASS = ("confusion", "producers_accuracy", "users_accuracy", "iou", "unclassified")


def _of_one_length(*names: str, of: str) -> Any:
    """Whether the lists under `names` are as long as the one under `of`; where one is not there it says nothing."""
    return lambda value: all(len(value[name]) == len(value[of]) for name in names if name in value)


def _has_every_quantile(value: Any) -> bool:
    rows = (row for by_class in value["features"].values() for row in by_class.values())
    return all(len(row["quantiles"]) == len(value["shares"]) for row in rows)


def _by_class(shape: dict[str, Shape]) -> Related:
    return Related(shape, "as many of each as there are classes", _of_one_length(*_BY_CLASS, of="classes"))


_OBJECTS = {
    **dict.fromkeys(("reference", "found", "split", "predicted", "correct", "merged"), COUNT),
    **dict.fromkeys(("completeness", "correctness", "quality"), FIGURE),
}
_INTERVALS = {"level": NUMBER, "blocks": COUNT, "overall_accuracy": Maybe([FIGURE])}
_CARD = Related(
    {
        "classes": [{"name": TEXT, "code": COUNT, "codes": [COUNT]}],
        "samples": [COUNT],
        "features": [TEXT],
        "notes?": [TEXT],
        "method?": TEXT,
        "ranges?": {TEXT: PAIR},
        "context?": Maybe({"cells?": [NUMBER]}),
        "out_of_bag?": {"accuracy?": FIGURE},
        "importance?": Maybe({TEXT: ANY}),
    },
    "a number of samples for each class",
    _of_one_length("samples", of="classes"),
)
_CENSUS = {
    **dict.fromkeys(("echoes", "unlabelled"), COUNT),
    **{key: [COUNT] for key in ("labelled", "train", "test")},
    **{"other": {CODE: COUNT}, "boxes": [[COUNT]], "nearest": FIGURE},
}
_FULLEST = Maybe({"echoes": COUNT, "most": COUNT, "corner": [NUMBER]})
_PULSE = {
    "pulse": {
        **{"shape": TEXT, "echoes": COUNT, "outgoing": COUNT},
        **dict.fromkeys(("fwhm", "rise_time", "skew", "tail_share", "shape_error"), NUMBER),
    },
    "channels": [
        {
            **{"echoes": COUNT, "outgoing": COUNT, "fwhm": NUMBER, "further_detection?": NUMBER, "correlated?": FLAG},
            **dict.fromkeys(("sample_spacing", "saturation", "recorded_fwhm", "misfit?"), FIGURE),
        }
    ],
    **{key: [(NUMBER, NUMBER)] for key in ("widths?", "drift?", "noise_drift?")},
    **dict.fromkeys(("sampled", "quiet_samples", "noise_order", "noise_period?"), COUNT),
    **dict.fromkeys(("noise", "lag1"), FIGURE),
    **dict.fromkeys(("inflation", "noise_growth", "noise_periodic?", "noise_still?", "unsettled?"), NUMBER),
}
_PLACES = {
    "vendor_offset": [
        {
            **dict.fromkeys(
                ("sample_spacing", "saturation", "constant", "scatter", "stretch?", "drift?", "slipped?"), NUMBER
            ),
            **{"echoes": COUNT, "phase": FLAG, "alike?": FLAG, "heights": [NUMBER], "offsets": [NUMBER]},
        }
    ],
    "outgoing_time": Maybe(
        {
            **{"from_outgoing": FLAG, "range_from_outgoing": FLAG, "evidence": TEXT, "pulses": COUNT},
            **{key: [NUMBER] for key in ("places_m", "ranges_m")},
        }
    ),
}
_TILE_FACTS = {
    "points": COUNT,
    "bounds": _SPACE,
    "classes": {CODE: COUNT},
    "several?": {CODE: COUNT},
    "sure": {CODE: (COUNT, NUMBER)},
    "confidence": FIGURE,
    "times": Maybe(TIMES),
    "figures": {TEXT: {"count": COUNT, **dict.fromkeys(("minimum", "maximum", "mean", "stddev"), FINITE)}},
}

META: dict[str, Shape] = {
    "index": {
        "spans": [(COUNT, COUNT, COUNT, COUNT, [KEY])],
        **{"points": COUNT, "pulses": COUNT, "point_format": WHOLE, "from_outgoing?": FLAG},
        "sensor?": Maybe((FINITE, FINITE)),
        "stated?": [[KEY]],
    },
    "read": _READ,
    "pulse": _PULSE,
    "places": {"places": _PLACES, "sampled": COUNT},
    "decompose": {
        **{f"{name.removesuffix('?')}?": shape for name, shape in _READ.items()},
        "plausibility": {TEXT: COUNT},
        **dict.fromkeys(
            ("returns_without_echo", "echoes", "fitted", "kept_returns", "read_as_echoes", "without_width"), COUNT
        ),
        "water?": dict.fromkeys(("surfaces", "bottoms", "depth_mm"), COUNT),
    },
    "split": {**_CUT, "codes?": {CODE: COUNT}},
    "reference-split": _CUT,
    "tile": {
        "rows": COUNT,
        "blocks": {DECIMAL: [TILE]},
        "bounds": _SPACE,
        "strips": [COUNT],
        "times": [(COUNT, FINITE, FINITE)],
        "repeated?": [(COUNT, COUNT, COUNT)],
    },
    "reference": _ROWS,
    "trajectory": {"fixes": COUNT, "begins": Related([FINITE], "at least one", bool), "ends": FINITE},
    "calibrate": {"calibration": CALIBRATION},
    "radiometry": {"sums": {NUMERAL: (NUMBER,) * 16}, "without_range": COUNT, "pointing_error": FIGURE},
    "polygons": {
        **dict.fromkeys(("features", "polygons", "without_code", "without_polygon", "invalid"), COUNT),
        **{"file": TEXT, "reprojected": TEXT, "values": {TEXT: COUNT}, "bounds": Maybe(PLANE)},
    },
    "echo-labels": {"rows": COUNT, "taken_back": COUNT, "codes": {CODE: COUNT}, "tiles": {TILE: (COUNT, COUNT, FLAG)}},
    "corrections": {"rows": COUNT, "taken_back": COUNT, "codes": {CODE: COUNT}, "tiles": {TILE: (COUNT, COUNT, FLAG)}},
    "label": {
        "codes?": {CODE: COUNT},
        **dict.fromkeys(("ambiguous?", "corrected?", "by_echo?"), COUNT),
        "above?": (COUNT,) * 201,
        "moved?": {"sums": _MOVES, "counts": _MOVES},
    },
    "label-counts": _CENSUS,
    "sample-counts": {"train": [COUNT], "boxes": [[COUNT]]},
    "ground-auto": {
        "parameters": {"method": TEXT, "max_building_size": NUMBER, "values": {TEXT: NUMBER}},
        "occupied": COUNT,
        "evidence": Maybe({TEXT: FIGURE}),
    },
    "ground-filter": {
        **dict.fromkeys(("rows", "ground", "noise", "seen", "last"), COUNT),
        "pieces": [(TILE, COUNT)],
        "halls?": {"width": NUMBER, "ground": COUNT},  # this and pits: not of a filter of one's own
        "pits?": COUNT,
    },
    "noise-filter": {"rows": COUNT, "noise": COUNT, "pieces": [(TILE, COUNT)]},
    "terrain": {
        "without_terrain": COUNT,
        "pieces": [(TILE, COUNT)],
        "breaklines?": dict.fromkeys(("compared", "above", "below"), COUNT),
    },
    "seams": {
        **dict.fromkeys(("cells", "cells_off", "cells_one_sided", "echoes", "flags_differ", "left_out"), COUNT),
        **{"within": NUMBER, "dtm_p999": FIGURE, "dtm_worst": FIGURE},
        "across?": {"width": NUMBER, "echoes": COUNT, "flags_differ": COUNT},
    },
    "breaklines": dict.fromkeys(("lines", "outside", "knots"), COUNT),
    "water-levels": {
        "bodies": [
            {
                **dict.fromkeys(("feature", "echoes", "inside"), COUNT),
                **dict.fromkeys(("level", "shore_level", "inside_level", "lowest", "highest"), FIGURE),
                "level_enough": FLAG,
            }
        ],
        "remarks": REMARKS,
    },
    "features": {"dense?": {"cubes": _FULLEST, "columns": _FULLEST}},
    "echo-density": {"squares": {NUMERAL: COUNT}},
    "training-density": {"squares": {NUMERAL: COUNT}},
    "training": {**_TRIAL, "offset?": _OFFSET, "density?": Maybe((NUMBER, NUMBER, NUMBER))},
    "base-rows": {**_TRIAL, "remarks": REMARKS},
    "train": {"card": _CARD, "fine?": _CARD, "trees": Maybe(COUNT), "nodes?": COUNT, "tried?": TEXT},
    "train-coarse": {"card": _CARD, "trees": Maybe(COUNT), "nodes?": COUNT},
    "fold-models": {"rows": COUNT, "model": FLAG},
    "context-folds": {"rows": COUNT},
    "machine-search": {"right": COUNT, "judged": COUNT},
    "coarse": {"outside?": _OUTSIDE},
    "first-shares": {"outside?": _OUTSIDE},
    "classify": {
        "codes": {CODE: COUNT},
        "outside?": _OUTSIDE,
        "of_source?": {CODE: (COUNT, COUNT)},
        "lines?": (COUNT, COUNT),
        "too_sparse?": COUNT,
    },
    "confusion": Related(
        {"matrix": square(), "lost": [COUNT], "ground": _TWO, "sure": (_PERCENT, _PERCENT, _PERCENT), "kept?": COUNT},
        "as many lost as there are classes",
        _of_one_length("lost", of="matrix"),
    ),
    "assess": {
        "offset?": _OFFSET,
        "accuracy": Maybe(
            _by_class(
                {
                    **_FIGURES,
                    "blocks": COUNT,
                    "pure_share?": FIGURE,
                    "intervals": Maybe(_INTERVALS),
                    "kept?": COUNT,
                    "objects?": {
                        "cell": POSITIVE,
                        "classes": [{"name": TEXT, **_OBJECTS, "sizes": [{"from": POSITIVE, **_OBJECTS}]}],
                    },
                }
            )
        ),
        "distribution": Related(
            {
                "shares": [NUMBER],
                "features": {TEXT: {TEXT: {"rows": COUNT, "without_value": COUNT, "quantiles": [FIGURE]}}},
            },
            "a quantile of every share",
            _has_every_quantile,
        ),
        "ground": Maybe(_by_class(_FIGURES)),
        "automation": [(NUMBER, NUMBER, NUMBER)],
        "reliability?": Maybe(
            {
                **dict.fromkeys(("confidence", "right", "error"), NUMBER),
                "steps": [(NUMBER, NUMBER, NUMBER)],
                "without_class?": COUNT,
            }
        ),
    },
    "quality-block": dict.fromkeys(("echoes", "noise", "pairs", "between_files", "between_lines"), COUNT),
    "check-points": CHECKED,
    "publish-quality": {"quality": QUALITY, "layers?": [TEXT]},
    "publish-tile": {
        **dict.fromkeys(("rows", "clipped?", "without_time?"), COUNT),
        **{"beyond": {TEXT: COUNT}, "facts": _TILE_FACTS, "percent": Maybe([COUNT]), "of_files": {NUMERAL: [COUNT]}},
    },
    "publish-rasters": {
        "dtm_cells": COUNT,
        "ranges": {TEXT: PAIR},
        "covered": [{"count": COUNT, "gaps": {NUMERAL: COUNT}}],
    },
    "publish-overview": _ROWS,
    "contours": {"every": COUNT, "pieces": COUNT, "vertices": COUNT},
    "publish-contours": {"lines": COUNT, "vertices": COUNT, "remarks": REMARKS},
    "pulse-density": {"squares": {NUMERAL: COUNT}},
    "vector-cell": {"density": NUMBER, "cell": POSITIVE, "sparse": FLAG},
    "publish-vectors": {"density": NUMBER, "cell": POSITIVE, "sparse": FLAG},
    "samples": {**_CUT, "dropped": NUMBER, "energy": NUMBER},
    "voxels": {"layers": Maybe((WHOLE, WHOLE))},
    "profiles": {"cells": COUNT, "samples": COUNT},
}


_NOTHING: dict[str, Any] = {}


def misfit_of(stage: str, meta: Any) -> Misfit | None:
    """Where what a receipt of `stage` tells is not what the stage tells; None where it is."""
    return misfit(meta, EVERY, "meta") or misfit(meta, META.get(stage, _NOTHING), "meta")


def is_told(stage: str, name: str) -> bool:
    """Whether receipts of `stage` may tell something under `name`."""
    shape = META.get(stage, {})
    known = shape.shape if isinstance(shape, Related) else shape
    return not {name, f"{name}?"}.isdisjoint({*EVERY, *known})
