"""A prescription as GeoParquet: a rectangle a segment, in metres along the road and to the left of the track."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from fwclass.street.prescription import Segment


def write_map(path: Path, segments: Sequence[Segment]) -> None:
    """Write GeoParquet 1.1 without a coordinate system: x is the place along the road, y the distance to the left."""
    columns: dict[str, pa.Array] = {
        name: pa.array([getattr(s, name) for s in segments], _kind(name)) for name in Segment.names()
    }
    boxes = [_box(s) for s in segments]
    columns["geometry"] = pa.array([_polygon(*b) for b in boxes], pa.binary())
    geo = {
        "version": "1.1.0",
        "primary_column": "geometry",
        "columns": {
            "geometry": {
                "encoding": "WKB",
                "geometry_types": ["Polygon"],
                "crs": None,
                "bbox": [
                    *(min((b[k] for b in boxes), default=0.0) for k in (0, 1)),
                    *(max((b[k] for b in boxes), default=0.0) for k in (2, 3)),
                ],
            }
        },
    }
    pq.write_table(pa.table(columns).replace_schema_metadata({"geo": json.dumps(geo)}), path, compression="zstd")


def _kind(name: str) -> pa.DataType:
    return {"side": pa.string(), "returns": pa.int64()}.get(name, pa.float64())


def _box(segment: Segment) -> tuple[float, float, float, float]:
    side = 1.0 if segment.side == "left" else -1.0
    low, high = sorted((side * segment.near, side * segment.far))
    return segment.begin, low, segment.end, high


def _polygon(x0: float, y0: float, x1: float, y1: float) -> bytes:
    """Well-known binary of a rectangle, anticlockwise."""
    ring = (x0, y0, x1, y0, x1, y1, x0, y1, x0, y0)
    return struct.pack("<BIII10d", 1, 3, 1, 5, *ring)
