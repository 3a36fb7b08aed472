"""What the report and the catalogue of a delivery tell, held to shapes before anything is made of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fwclass.errors import InputError
from fwclass.grid import FURTHEST
from fwclass.store.shapes import COUNT, NUMBER, TEXT, TILE, Kind, Maybe, Related, Shape, misfit, pattern

_CODE = Kind("a class code", lambda value: COUNT.fits(value) and value <= 255)
_PLACE = Kind("a coordinate on Earth [m]", lambda value: NUMBER.fits(value) and abs(value) <= FURTHEST)
_BOUNDS = Related((_PLACE,) * 6, "bounds, the least first", lambda b: all(b[k] <= b[k + 3] for k in range(3)))

REPORT: Shape = {
    "survey": TEXT,
    "classes": [{"name": TEXT, "code": _CODE}],
    "sureness?": Maybe({"tiles": [{"tile": TILE}]}),
}

TILES: Shape = {
    "features": [
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
            "a tile with its height",
            lambda tile: any(f["name"] == "Z" for f in tile["properties"]["pc:statistics"]),
        )
    ]
}
"""Of ``laz/survey.vpc``, which names files: none of them lies elsewhere."""


def held(value: Any, shape: Shape, path: Path) -> Any:
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
