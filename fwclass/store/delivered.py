"""What the report and the catalogue of a delivery tell, held to shapes before anything is made of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fwclass.errors import InputError
from fwclass.grid import FURTHEST
from fwclass.store.shapes import (
    ANY,
    COUNT,
    NUMBER,
    POSITIVE,
    TEXT,
    TILE,
    WHOLE,
    Kind,
    Maybe,
    Related,
    Shape,
    misfit,
    pattern,
    square,
)

_CODE = Kind("a class code", lambda value: COUNT.fits(value) and value <= 255)
_PLACE = Kind("a coordinate on Earth [m]", lambda value: NUMBER.fits(value) and abs(value) <= FURTHEST)
_BOUNDS = Related((_PLACE,) * 6, "bounds, the least first", lambda b: all(b[k] <= b[k + 3] for k in range(3)))

_CLASSES = [{"name": TEXT, "code": _CODE, "codes": [WHOLE]}]
_BOX = Related((NUMBER,) * 4, "a box, the least first", lambda box: box[0] <= box[2] and box[1] <= box[3])
_SHARE = Maybe(NUMBER)

REPORT: Shape = {
    "survey": TEXT,
    "classes": [{"name": TEXT, "code": _CODE}],
    "place": Maybe({"crs?": Maybe(TEXT)}),
    "model": {"features?": Maybe([TEXT]), "classes?": _CLASSES},
    "input": {"files": [{"path": TEXT, "strip": COUNT}]},
    "libraries": {"here": {TEXT: ANY}},
    "accuracy?": Maybe({"confusion": square(), "overall_accuracy": _SHARE, "kappa": _SHARE, "mean_iou": _SHARE}),
    "sureness?": Maybe({"tiles": [{"tile": TILE}]}),
    "areas": {"test": [_BOX], "train": [_BOX]},
    "config": {
        "tile": {"size": POSITIVE},
        "label": {"max_move": NUMBER},
        "areas": {"gap": NUMBER},
        "survey": {"model": Maybe(TEXT), "classes": _CLASSES, "reference": {"kind": TEXT, "corrections?": ANY}},
        "decompose": {TEXT: ANY},
    },
}

_TILES = [
    Related(
        {
            "id": TILE,
            "assets": {"data": {"href": pattern("a file of laz/tiles", r"(\./)?tiles/[0-9_-]{1,60}\.copc\.laz")}},
            "properties": {
                "pc:count": COUNT,
                "proj:bbox": _BOUNDS,
                "pc:statistics": [{"name": TEXT, "average": NUMBER}],
            },
        },
        "a tile with its height, in the file of its name",
        lambda tile: (
            any(f["name"] == "Z" for f in tile["properties"]["pc:statistics"])
            and tile["assets"]["data"]["href"].rpartition("/")[2] == f"{tile['id']}.copc.laz"
        ),
    )
]
TILES: Shape = {
    "features": Related(_TILES, "every tile once", lambda tiles: len({tile["id"] for tile in tiles}) == len(tiles))
}
"""Of ``laz/survey.vpc``, which names files: none of them lies elsewhere."""


def check_shape(value: Any, shape: Shape, path: Path) -> Any:
    """`value` as it is; `InputError` where no run has written it."""
    wrong = misfit(value, shape)
    if wrong is None:
        return value
    raise InputError(
        "a file of this delivery tells what no run writes",
        where=f"{path}: {wrong.at.lstrip('.') or 'all of it'}",
        expected=wrong.expected,
        got=wrong.got,
        do="ask who changed it for the delivery itself, or run the survey again with --verify",
    )
