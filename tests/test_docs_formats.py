"""The tables of docs/formats.md are those of the declarations."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path

import numpy as np

from fwclass.formats.extra_bytes import extra_bytes
from fwclass.graph.outputs import TILE_COLUMNS
from fwclass.graph.raster_outputs import _TERRAIN
from fwclass.publish.copc import copc_columns
from fwclass.publish.raster_styles import STYLED
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.schema import Column, column

PAGE = Path(__file__).resolve().parents[1] / "docs" / "formats.md"
OTHER_RASTERS = {
    "hillshade": ("uint8", "0", "shaded relief, 1 to 255"),
    "dtm_mask": (
        "uint8",
        "0",
        "what the terrain comes from: measured, interpolated, extrapolated, flattened water or breaklines",
    ),
    "classes": ("uint8", "0", "class of the highest echo"),
    "confidence": ("uint8", "255", "confidence of the class of the highest echo [%]"),
    "density": ("float32", "NaN", "echoes per square metre"),
}


def columns() -> list[Column]:
    return [column(n) for n in dict.fromkeys((*TILE_COLUMNS, *RADIOMETRY.writes))]


def _extra_byte(col: Column) -> str:
    (extra,) = extra_bytes([col], {col.name: np.zeros(0, col.dtype)})
    no_data = "" if extra.no_data is None else extra.no_data
    return f"| {extra.las} | `{col.name}` | {extra.dtype.name} | {extra.scale:g} {col.unit} | {no_data} |"


def _null(col: Column) -> str:
    return "" if col.null is None else "NaN" if math.isnan(col.null) else f"{col.null:g}"


def tables() -> dict[str, str]:
    """The generated tables, by name."""
    las = [column(n) for n in copc_columns([c.name for c in columns()])]
    rasters = {n: ("float32", "NaN", what) for n, what in _TERRAIN.items()} | OTHER_RASTERS
    return {
        "extra bytes": "\n".join(
            ["| extra byte | column | stored as | step | no data |", "|---|---|---|---|---|", *map(_extra_byte, las)]
        ),
        "columns": "\n".join(
            ["| column | type | unit | no value | meaning |", "|---|---|---|---|---|"]
            + [f"| `{c.name}` | {np.dtype(c.dtype).name} | {c.unit} | {_null(c)} | {c.meaning} |" for c in columns()]
        ),
        "rasters": "\n".join(
            ["| raster | type | no data | |", "|---|---|---|---|"]
            + [f"| `{n}.tif` | {' | '.join(rasters[n])} |" for n in STYLED]
        ),
    }


def filled(text: str) -> str:
    for name, table in tables().items():
        text = re.sub(
            rf"(<!-- table: {name} -->\n).*?(<!-- end -->)",
            lambda m, t=table: f"{m[1]}\n{t}\n\n{m[2]}",
            text,
            flags=re.S,
        )
    return text


def test_the_page_shows_what_is_declared() -> None:
    """`python tests/test_docs_formats.py write` brings the page up to date."""
    text = PAGE.read_text(encoding="utf-8")
    assert text == filled(text)


if __name__ == "__main__" and sys.argv[1:] == ["write"]:
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
