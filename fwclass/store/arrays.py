"""Arrays as Zarr v3: one array per field, sharded; written into a staged directory, never in place."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.cost import counted
from fwclass.formats.shards import KINDS, read_shard, write_node, write_shard

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
    plain = all(v.ndim and v.dtype.isnative and v.dtype.name in KINDS for v in arrays.values())
    if plain:
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir(parents=True)
        for name, array in arrays.items():
            write_shard(path / name, array, *_layout(array))
        write_node(path, {"attributes": dict(attributes or {}), "zarr_format": 3, "node_type": "group"})
        return
    import zarr
    from zarr.codecs import BloscCodec

    group = zarr.open_group(str(path), mode="w", zarr_format=3, attributes=dict(attributes or {}))
    codec = BloscCodec(cname="zstd", clevel=3, shuffle="shuffle")
    for name, array in arrays.items():
        chunks, shards = _layout(array)
        group.create_array(name, data=np.ascontiguousarray(array), chunks=chunks, shards=shards, compressors=codec)


@counted("reading")
def read_arrays(path: Path, names: Iterable[str] | None = None) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """The named arrays (all) of the group at `path`, and its attributes."""
    found = _read_shards(path, names)
    if found is not None:
        return found
    import zarr

    group = zarr.open_group(str(path), mode="r", zarr_format=3)
    wanted = list(names) if names is not None else sorted(group.array_keys())
    return {n: np.asarray(group[n][...]) for n in wanted}, dict(group.attrs)


def _read_shards(path: Path, names: Iterable[str] | None) -> tuple[dict[str, NDArray], dict[str, Any]] | None:
    """As `read_arrays`; None unless all arrays are as `write_arrays` writes them."""
    try:
        group = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
        attributes = dict(group["attributes"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    if set(group) != {"attributes", "zarr_format", "node_type"} or group["node_type"] != "group":
        return None
    wanted = sorted(p.parent.name for p in path.glob("*/zarr.json")) if names is None else list(names)
    arrays = {name: read_shard(path / name) for name in wanted}
    whole = {name: array for name, array in arrays.items() if array is not None}
    return (whole, attributes) if len(whole) == len(wanted) else None
