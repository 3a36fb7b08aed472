"""Arrays of a part, written into a staged directory, never in place: Zarr v3, one array per field, sharded; those of
a usual size together as one Parquet file, for Zarr takes two files and ten milliseconds of a processor for each."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fwclass.cost import counted
from fwclass.formats.arrow import file_to_write, numpy_values
from fwclass.lazy_module import LazyModule
from fwclass.paths import open_regular
from fwclass.store.legible import legible

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
else:
    pa, pq = LazyModule("pyarrow"), LazyModule("pyarrow.parquet")

CHUNK = 1 << 18
"""Values of a chunk of a flat or narrow array; a shard holds the whole array of a part."""

RASTER_CHUNK = 256
"""Cells along the edge of a chunk of a raster."""

SMALL = 1 << 24
"""Bytes: arrays of a part that are no more together are one Parquet file, as the rasters of a block are."""

LARGE = 1 << 16
"""Bytes of numbers above which a better compression pays."""

SHORT = 256
"""Bytes of numbers up to which none pays."""

LISTED = 16
"""Bytes that a shard takes for each chunk, also for one of nothing."""

_DOCUMENT = "zarr.json"
_CODECS = ["sharding_indexed", "bytes", "blosc", "bytes", "crc32c"]
"""Names of what a group's arrays are encoded by: the shard, the numbers of its chunks, and its list of chunks."""
_NUMBERS = {"bool", *(f"{kind}int{bits}" for kind in ("", "u") for bits in (8, 16, 32, 64)), "float32", "float64"}
"""Types of numbers that stages keep, as zarr names them."""

PARQUET, ZARR = ".parquet", ".zarr"
_SHAPE, _DTYPE, _ATTRIBUTES = b"shape", b"dtype", b"attributes"


def _layout(array: NDArray) -> tuple[tuple[int, ...], tuple[int, ...]]:
    edges = (CHUNK,) if array.ndim == 1 else (RASTER_CHUNK,) * array.ndim
    if array.ndim == 2 and 0 < array.shape[1] <= RASTER_CHUNK:  # features of rows, which are read whole
        edges = CHUNK // array.shape[1], array.shape[1]
    chunks = tuple(max(1, min(edge, n)) for edge, n in zip(edges, array.shape, strict=True))
    shards = tuple(-(-max(n, 1) // c) * c for n, c in zip(array.shape, chunks, strict=True))
    return chunks, shards


@counted("writing")
def write_arrays(base: Path, arrays: Mapping[str, NDArray], attributes: Mapping[str, Any] | None = None) -> None:
    """Write named arrays (of any shapes) and plain data beside them to `base`, whose ending tells how they are held:
    one Parquet file, or one Zarr group."""
    about = dict(attributes or {})
    if sum(a.nbytes for a in arrays.values()) <= SMALL:
        write_one_file(base.with_name(base.name + PARQUET), arrays, about)
    else:
        _write_group(base.with_name(base.name + ZARR), arrays, about)


def write_one_file(path: Path, arrays: Mapping[str, NDArray], attributes: Mapping[str, Any]) -> None:
    """One Parquet file, whatever they take; each may have 2 GiB. One row: of each array its bytes, with type and
    shape beside them. As lists of numbers they would take Parquet three to ten times as long."""
    fields = [
        pa.field(name, pa.large_binary(), metadata={_SHAPE: json.dumps(array.shape), _DTYPE: array.dtype.str})
        for name, array in arrays.items()
    ]
    columns = [_one_value(_planes(array)) for array in arrays.values()]
    about = {_ATTRIBUTES: json.dumps(attributes, allow_nan=False, sort_keys=True)}
    levels = {n: 3 if a.dtype.itemsize > 1 and a.nbytes > LARGE else 1 for n, a in arrays.items() if a.nbytes > SHORT}
    with file_to_write(path, sum(a.nbytes for a in arrays.values())) as file:
        pq.write_table(
            pa.Table.from_arrays(columns, schema=pa.schema(fields, about)),
            file,
            compression={name: "zstd" if name in levels else "none" for name in arrays},
            compression_level=levels or None,
            use_dictionary=False,
            write_statistics=False,
        )


def _one_value(data: bytes) -> pa.Array:
    """A column of one row of bytes; `pa.array` would load pandas."""
    ends = np.array([0, len(data)], np.int64)
    return pa.Array.from_buffers(pa.large_binary(), 1, [None, pa.py_buffer(ends), pa.py_buffer(data)])


def _planes(array: NDArray) -> bytes:
    """All first bytes of the values, then all second ones: they compress by a third better, as Blosc's shuffle."""
    bytes_of_each = np.ascontiguousarray(array).reshape(-1, 1).view(np.uint8)
    return bytes_of_each.T.tobytes()


def _array(planes: Any, dtype: np.dtype, shape: Sequence[int]) -> NDArray:
    """What `_planes` made bytes of."""
    here = np.frombuffer(planes, np.uint8).reshape(dtype.itemsize, math.prod(shape))
    array = np.empty(shape, dtype)
    values = array.reshape(-1, 1).view(np.uint8)
    for k, plane in enumerate(here):
        values[:, k] = plane
    return array


def _write_group(path: Path, arrays: Mapping[str, NDArray], attributes: Mapping[str, Any]) -> None:
    import zarr
    from zarr.codecs import BloscCodec
    from zarr.storage import MemoryStore

    files: dict[str, Any] = {}  # zarr's own store hands each file to another thread: twice the time of a small group
    group = zarr.open_group(MemoryStore(files), mode="w", zarr_format=3, attributes=dict(attributes))
    codec = BloscCodec(cname="zstd", clevel=1, shuffle="shuffle")  # 3: 7 % smaller for five times the time
    for name, array in arrays.items():
        chunks, shards = _layout(array)
        group.create_array(
            name,
            data=np.ascontiguousarray(array),
            chunks=chunks,
            shards=shards,
            compressors=codec,
            config={"write_empty_chunks": True},  # or what is all zeros holds nothing that tells how much it may be
        )
    for name, content in files.items():
        file = path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content.as_numpy_array())


@dataclass(frozen=True)
class SurveyArray:
    """An array of a whole survey that is written piece by piece.

    Attributes
    ----------
    shape, chunks : of the whole, and of the pieces that it is stored in; a piece of nothing is no file.
    dtype, fill : of its values, and what stands where none are written.
    axes : names of its dimensions.
    attributes : unit, meaning.
    """

    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: str
    fill: float
    axes: tuple[str, ...]
    attributes: Mapping[str, Any]


def write_grids(
    path: Path,
    grids: Mapping[str, SurveyArray],
    attributes: Mapping[str, Any],
    pieces: Iterable[Mapping[str, tuple[tuple[slice, ...], NDArray]]],
) -> None:
    """Write arrays of a survey as one Zarr group at `path`, from pieces that begin at the edges of chunks."""
    import zarr
    from zarr.codecs import BloscCodec

    group = zarr.open_group(str(path), mode="w", zarr_format=3, attributes=dict(attributes))
    codec = BloscCodec(cname="zstd", clevel=1, shuffle="shuffle")  # 3: 7 % smaller for five times the time
    arrays = {
        name: group.create_array(
            name,
            shape=g.shape,
            chunks=g.chunks,
            dtype=g.dtype,
            fill_value=g.fill,
            compressors=codec,
            dimension_names=g.axes,
            attributes=dict(g.attributes),
        )
        for name, g in grids.items()
    }
    for piece in pieces:
        for name, (where, values) in piece.items():
            arrays[name][where] = values


def arrays_at(base: Path) -> Path | None:
    """The file or directory that `write_arrays` made of `base`, None where it made none."""
    paths = (base.with_name(base.name + ending) for ending in (PARQUET, ZARR))
    return next((path for path in paths if path.exists()), None)


@counted("reading")
def read_arrays(path: Path, names: Iterable[str] | None = None) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """The named arrays (all) of what `write_arrays` made, and its attributes."""
    with legible(path, "arrays"):
        return _read_small(path, names) if path.suffix == PARQUET else _read_group(path, names)


def _read_small(path: Path, names: Iterable[str] | None) -> tuple[dict[str, NDArray], dict[str, Any]]:
    with pq.ParquetFile(path, pre_buffer=False) as file:
        arrow = file.read(None if names is None else list(names), use_threads=False)
    schema = arrow.schema
    wanted = sorted(schema.names) if names is None else list(names)
    about = {name: schema.field(name).metadata for name in wanted}
    arrays = {
        name: _array(arrow.column(name)[0].as_buffer(), np.dtype(of[_DTYPE].decode()), json.loads(of[_SHAPE]))
        if _DTYPE in of
        else numpy_values(pa.chunked_array([arrow.column(name).chunk(0).flatten()])).reshape(json.loads(of[_SHAPE]))
        for name, of in about.items()  # runs of before held lists of values
    }
    return arrays, json.loads(schema.metadata[_ATTRIBUTES])


def _read_group(path: Path, names: Iterable[str] | None) -> tuple[dict[str, NDArray], dict[str, Any]]:
    import zarr

    # each array by its own description, not by what the group's says of it, which zarr would believe
    about = _described(path)
    wanted = list(names) if names is not None else sorted(p.parent.name for p in path.glob(f"*/{_DOCUMENT}"))
    for name in wanted:
        _check_own(_described(path / name), name)
    arrays = {n: zarr.open_array(str(path / n), mode="r", zarr_format=3) for n in wanted}
    return {n: _held(array, path / n) for n, array in arrays.items()}, dict(about["attributes"])


def _described(path: Path) -> dict[str, Any]:
    """What the description of a group or an array says."""
    with open_regular(path / _DOCUMENT) as stream:
        about: dict[str, Any] = json.loads(stream.read())
    return about


def _check_own(about: Mapping[str, Any], name: str) -> None:
    """`ValueError` for numbers or codecs that `write_arrays` does not write: a description may name any codec that is
    installed, and among these are some that swell without bound, or unpickle."""
    (codec,) = about["codecs"]
    of = codec["configuration"]
    described = [
        [codec["name"], *(c["name"] for c in of["codecs"]), *(c["name"] for c in of["index_codecs"])],
        about["chunk_grid"]["name"],
        about["chunk_key_encoding"],
        about.get("storage_transformers") or [],
    ]
    written: list[Any] = [_CODECS, "regular", {"name": "default", "configuration": {"separator": "/"}}, []]
    if described != written or about["data_type"] not in _NUMBERS:
        raise ValueError(f"{name}: numbers of type {about['data_type']!r}, in codecs that are not those of a run")


def _held(array: Any, directory: Path) -> NDArray:
    """The values; `ValueError` for more chunks than its shards have room to list, or longer ones than are written: zarr
    sets aside and fills whatever the array's description says. Runs of before have no shard of zeros alone: as many of
    these are taken as a small part has."""
    held = sum(p.stat().st_size for p in (directory / "c").rglob("*") if p.is_file())
    if not held and not array.fill_value and array.nbytes <= SMALL:
        return np.zeros(array.shape, array.dtype)
    edge = CHUNK if array.ndim < 2 else RASTER_CHUNK
    for cells in (array.shape, array.shards or array.chunks):
        chunks = math.prod(-(-n // c) for n, c in zip(cells, array.chunks, strict=True))
        large = max(array.chunks, default=0) > edge and math.prod(array.chunks) > CHUNK
        if large or LISTED * chunks > held:
            raise ValueError(f"{directory.name}: shape {array.shape}, which {held} bytes do not hold")
    return np.asarray(array[...])
