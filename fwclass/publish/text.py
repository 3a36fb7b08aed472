"""Points with their classes as plain text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from fwclass.publish.files import written_whole


def write_text(
    path: Path, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], classes: NDArray[np.uint8]
) -> dict[str, Any]:
    """Write ``x y z classification``, one point a line, under a header line; commas in a ``.csv``, tabs in a
    ``.tsv``, else spaces.

    A coordinate has as many digits as it takes to read the same number back; NaN is written as ``nan``.

    Returns a dict with ``path, points, bytes``.
    """
    table = pa.table({"x": x, "y": y, "z": z, "classification": classes})
    comma = path.suffix.lower() == ".csv"
    delimiter = "," if comma else "\t" if path.suffix.lower() == ".tsv" else " "
    options = csv.WriteOptions(delimiter=delimiter, quoting_style="none", quoting_header="none")
    with written_whole(path) as beside:
        csv.write_csv(table, beside, options)
        size = beside.stat().st_size
    return {"path": str(path), "points": len(x), "bytes": size}
