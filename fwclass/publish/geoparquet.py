"""Echoes and vectors as GeoParquet 1.1: WKB with a covering box per row."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyproj
from numpy.typing import NDArray

from fwclass.cost import counted
from fwclass.formats.arrow import arrow_array, file_to_write, repeats
from fwclass.lazy_module import LazyModule
from fwclass.publish.files import written_whole
from fwclass.publish.palette import colours, css
from fwclass.publish.params import PublishParams
from fwclass.schema import PLACE, Column, Table, column, require
from fwclass.units import QUANTUM

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
else:
    pa, pq = LazyModule("pyarrow"), LazyModule("pyarrow.parquet")

POINT_Z = np.dtype([("order", "u1"), ("kind", "<u4"), ("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
"""ISO WKB of a point with height: 29 bytes."""

ISO_POINT_Z = 1001
ROUNDING = 1e-6
"""Coordinates that are nearer than this to a whole millimetre are meant to be one [m]."""

SIDES = ("xmin", "ymin", "xmax", "ymax")


Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Least and greatest x, y, z [m]."""


def write_geoparquet(
    table: Table, path: Path, crs: pyproj.CRS | None, params: PublishParams, about: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Write every column of `table` and a `geometry`, in the table's row order.

    The same rows give the same bytes. Units and meanings of the schema stand as metadata of the fields. An
    unknown CRS is written as null: leaving it out would mean longitude and latitude (GeoParquet 1.1). NaN
    stays NaN.

    `table`: at least x, y, z. `crs`: None where it is unknown. `about`: plain data for the file's metadata, under the
    key ``fwclass``; see `about_delivery`.

    Returns a dict with ``path, rows, row_groups, bytes``.

    `InputError`: x, y or z is missing.
    """
    require(table, ("x", "y", "z"), path)
    table = short_coordinates(table)
    bounds, size = bounds_of(table) if table.rows else None, sum(values.nbytes for values in table.values())
    return write_geoparquet_parts([table], bounds, path, crs, params, about, size)


def about_delivery(names: Mapping[int, str], bits: int) -> dict[str, Any]:
    """What the metadata of a delivered tile tell besides units and meanings: classes with colours, the rounding."""
    shown = colours([{"name": name, "code": code} for code, name in names.items()])
    classes = [{"code": code, "name": names[code], "color": css(colour)} for code, colour in sorted(shown.items())]
    return {"classes": classes, "relative_step": 2.0**-bits}


@counted("writing")
def write_geoparquet_parts(
    parts: Iterable[Table],
    bounds: Bounds | None,
    path: Path,
    crs: pyproj.CRS | None,
    params: PublishParams,
    about: Mapping[str, Any] | None = None,
    size: float = math.inf,
) -> dict[str, Any]:
    """As `write_geoparquet`, of tables with the same columns one after another, each in row groups of its own.

    `parts`: at least one; `bounds` of all their points, None without any. `size`: bytes of them all, where that is
    known.
    """
    rest = iter(parts)
    first = next(rest)
    fields = [_field(column(name)) for name in first]
    fields += [pa.field("geometry", pa.binary(), nullable=False), pa.field("bbox", _box_type(), nullable=False)]
    more = {b"fwclass": json.dumps(about, sort_keys=True).encode()} if about else {}
    schema, rows = pa.schema(fields, metadata={b"geo": _geo(bounds, crs), **more}), 0
    with written_whole(path) as beside:
        footers: list[pq.FileMetaData] = []
        with (
            file_to_write(beside, size) as file,
            pq.ParquetWriter(file, schema, metadata_collector=footers, **_options(first, params)) as writer,
        ):
            for table in map(short_coordinates, chain([first], rest)):
                arrays = [arrow_array(table[name]) for name in first]
                arrays += [wkb_points(table["x"], table["y"], table["z"]), _boxes(table["x"], table["y"])]
                writer.write_table(pa.Table.from_arrays(arrays, schema=schema), row_group_size=params.row_group)
                rows += table.rows
        size, groups = beside.stat().st_size, footers[0].num_row_groups
    return {"path": str(path), "rows": rows, "row_groups": groups, "bytes": size}


@counted("writing")
def write_shape_parquet(
    fields: Mapping[str, NDArray[Any] | Sequence[str]],
    geometry: Sequence[bytes],
    boxes: NDArray[np.float64],
    path: Path,
    crs: pyproj.CRS | None,
    params: PublishParams,
    kind: Literal["Polygon", "Point"] = "Polygon",
    units: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """Write shapes with their `fields` (texts as lists, numbers as arrays); the same ones give the same bytes.

    `geometry`: well-known binary, one a row. `boxes`: (rows, 4), xmin, ymin, xmax, ymax of each. `units`: of fields
    that have one.

    Returns a dict with ``path, rows, bytes``.
    """
    arrays = {n: pa.array(v, None if isinstance(v, np.ndarray) else pa.string()) for n, v in fields.items()}
    arrays["geometry"] = pa.array(list(geometry), pa.binary())
    low, high = boxes[:, :2], boxes[:, 2:]
    sides = [*(_outwards(v, -np.inf) for v in low.T), *(_outwards(v, np.inf) for v in high.T)]
    arrays["bbox"] = pa.StructArray.from_arrays([arrow_array(side) for side in sides], fields=list(_box_type()))
    about = [pa.field(n, a.type, metadata={"unit": units[n]} if n in units else None) for n, a in arrays.items()]
    ends = (tuple(low.min(axis=0).tolist()), tuple(high.max(axis=0).tolist())) if len(boxes) else None
    schema = pa.schema(about, metadata={b"geo": _geo(ends, crs, kind)})
    with written_whole(path) as beside:
        pq.write_table(
            pa.Table.from_arrays(list(arrays.values()), schema=schema),
            beside,
            row_group_size=params.row_group,
            compression="zstd",
            compression_level=params.zstd_level,
        )
        size = beside.stat().st_size
    return {"path": str(path), "rows": len(geometry), "bytes": size}


def short_coordinates(table: Table) -> Table:
    """`table` with `shortened` coordinates."""
    return table.with_columns({name: shortened(table[name]) for name in ("x", "y", "z")})


def shortened(metres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Whole millimetres [m] as the numbers nearest to them: other programs show 309.013, and not what the store has,
    309.01300000000003."""
    near = np.rint(metres / QUANTUM) / 1000.0
    return np.where(np.abs(near - metres) < ROUNDING, near, metres)


def bounds_of(table: Table) -> Bounds:
    """Least and greatest x, y, z of a table with rows."""
    axes = [table[a] for a in ("x", "y", "z")]
    low, high = [float(a.min()) for a in axes], [float(a.max()) for a in axes]
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def wkb_points(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> pa.Array:
    """Points as an Arrow array of little-endian ISO WKB, built at once."""
    wkb = np.empty(len(x), POINT_Z)
    wkb["order"], wkb["kind"], wkb["x"], wkb["y"], wkb["z"] = 1, ISO_POINT_Z, x, y, z
    offsets = np.arange(len(x) + 1, dtype=np.int32) * POINT_Z.itemsize
    return pa.Array.from_buffers(pa.binary(), len(x), [None, pa.py_buffer(offsets), pa.py_buffer(wkb.tobytes())])


def _box_type() -> pa.DataType:
    return pa.struct([pa.field(side, pa.float32(), nullable=False) for side in SIDES])


def _boxes(x: NDArray[np.float64], y: NDArray[np.float64]) -> pa.Array:
    """A box around every point, rounded outwards: it serves to leave out, never to place."""
    sides = [_outwards(x, -np.inf), _outwards(y, -np.inf), _outwards(x, np.inf), _outwards(y, np.inf)]
    return pa.StructArray.from_arrays([arrow_array(side) for side in sides], fields=list(_box_type()))


def _outwards(values: NDArray[np.float64], towards: float) -> NDArray[np.float32]:
    near = values.astype(np.float32)
    beyond = near < values if towards > 0 else near > values
    return np.where(beyond, np.nextafter(near, np.float32(towards)), near).astype(np.float32)


def round_floats(table: Table, bits: int, exact: Iterable[str] = ()) -> Table:
    """`table` with every float32 column, besides those that are `exact`, rounded to a relative step of 2^-`bits`.

    What is dropped is no information where it lies below the value's standard error, and it does not compress. NaN and
    infinity stay.
    """
    exempt = set(exact)
    names = [n for n in table if table[n].dtype == np.float32 and n not in exempt]
    return table.with_columns({n: _round_to_bits(table[n], bits) for n in names}) if names else table


def _round_to_bits(values: NDArray[np.float32], bits: int) -> NDArray[np.float32]:
    """To the nearest number with `bits` bits behind the leading one, half to even."""
    drop = 23 - bits
    if drop <= 0:
        return values
    whole = values.view(np.uint32)
    half = np.uint32((1 << (drop - 1)) - 1)
    near = (whole + half + ((whole >> np.uint32(drop)) & np.uint32(1))) & np.uint32(~((1 << drop) - 1) & 0xFFFFFFFF)
    result = near.view(np.float32)
    return np.where(np.isfinite(values) & np.isfinite(result), result, values).astype(np.float32)


def _field(col: Column) -> pa.Field:
    kind = pa.from_numpy_dtype(np.dtype(col.dtype))
    about = {"unit": col.unit, "meaning": col.meaning, "source": col.source, "las": col.las}
    if col.null is not None:
        about["null"] = "NaN" if np.isnan(col.null) else str(col.null)
    return pa.field(col.name, kind, nullable=False, metadata={k: v for k, v in about.items() if v})


def _geo(
    bounds: tuple[Sequence[float], Sequence[float]] | None, crs: pyproj.CRS | None, kind: str = "Point Z"
) -> bytes:
    """The `geo` entry of the file's metadata."""
    about: dict[str, Any] = {
        "encoding": "WKB",
        "geometry_types": [kind] if bounds else [],
        "crs": crs.to_json_dict() if crs is not None else None,
        "covering": {"bbox": {side: ["bbox", side] for side in SIDES}},
    }
    if bounds:
        about["bbox"] = [*bounds[0], *bounds[1]]
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": about}}
    return json.dumps(geo).encode()


def _options(table: Table, params: PublishParams) -> dict[str, Any]:
    """Zstandard; measurements by byte planes, which compress twice as well, whole numbers by their differences, codes,
    heights and measurements that repeat by dictionary; places as they are: of decimals the bytes repeat, and planes of
    them do not."""
    measured = [name for name in table if table[name].dtype.kind == "f" and name not in PLACE]
    repeating = [name for name in measured if repeats(table[name])]
    planes = {name: "BYTE_STREAM_SPLIT" for name in measured if name not in repeating}
    planes |= {f"bbox.{side}": "BYTE_STREAM_SPLIT" for side in SIDES}
    whole = [name for name in table if table[name].dtype.kind in "iu"]
    codes = [name for name in whole if table[name].dtype.itemsize <= 2]
    return {
        "compression": "zstd",
        "compression_level": params.zstd_level,
        "use_dictionary": [*codes, *repeating, "z"],
        "column_encoding": planes | {name: "DELTA_BINARY_PACKED" for name in whole if name not in codes},
        "write_statistics": [*table, *(f"bbox.{side}" for side in SIDES)],
    }
