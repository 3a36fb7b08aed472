"""Arrays as Zarr v3: one array per field, sharded; written into a staged directory, never in place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.cost import counted

CHUNK = 1 << 18
"""Values of a chunk of a flat array; a shard holds the whole array of a part."""

RASTER_CHUNK = 256
"""Cells along the edge of a chunk of a raster."""


def _layout(array: NDArray) -> tuple[tuple[int, ...], tuple[int, ...]]:
    edge = CHUNK if array.ndim == 1 else RASTER_CHUNK
    chunks = tuple(max(1, min(edge, n)) for n in array.shape)
    shards = tuple(-(-max(n, 1) // c) * c for n, c in zip(array.shape, chunks, strict=True))
    return chunks, shards


@counted("writing")
def write_arrays(path: Path, arrays: Mapping[str, NDArray], attributes: Mapping[str, Any] | None = None) -> None:
    """Write named arrays as one Zarr group at `path`."""
    import zarr
    from zarr.codecs import BloscCodec
    from zarr.storage import MemoryStore

    files: dict[str, Any] = {}  # zarr's own store hands each file to another thread: twice the time of a small group
    group = zarr.open_group(MemoryStore(files), mode="w", zarr_format=3, attributes=dict(attributes or {}))
    codec = BloscCodec(cname="zstd", clevel=3, shuffle="shuffle")
    for name, array in arrays.items():
        chunks, shards = _layout(array)
        group.create_array(name, data=np.ascontiguousarray(array), chunks=chunks, shards=shards, compressors=codec)
    for name, content in files.items():
        file = path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content.as_numpy_array())


@dataclass(frozen=True)
class Grid:
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
    grids: Mapping[str, Grid],
    attributes: Mapping[str, Any],
    pieces: Iterable[Mapping[str, tuple[tuple[slice, ...], NDArray]]],
) -> None:
    """Write arrays of a survey as one Zarr group at `path`, from pieces that begin at the edges of chunks."""
    import zarr
    from zarr.codecs import BloscCodec

    group = zarr.open_group(str(path), mode="w", zarr_format=3, attributes=dict(attributes))
    codec = BloscCodec(cname="zstd", clevel=3, shuffle="shuffle")
    made = {
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
            made[name][where] = values


@counted("reading")
def read_arrays(path: Path, names: Iterable[str] | None = None) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """The named arrays (all) of the group at `path`, and its attributes."""
    import zarr

    group = zarr.open_group(str(path), mode="r", zarr_format=3)
    wanted = list(names) if names is not None else sorted(group.array_keys())
    return {n: np.asarray(group[n][...]) for n in wanted}, dict(group.attrs)
