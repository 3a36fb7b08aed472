"""Zarr v3 arrays of one shard each, written and read without the zarr library, which takes 20 ms for each of them.

Only what `store.arrays` writes: chunks of Blosc (Zstandard 3, shuffle) in one shard with its index at the end. Anything
else is left to the library.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import DamagedError

KINDS = ("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64")
LARGEST = 1 << 24
"""Values of a chunk that is read here."""

_ABSENT = (1 << 64) - 1
_HEADER = 16
"""Bytes before a chunk that Blosc has packed: its size unpacked stands at 4, packed at 12."""

Shape = tuple[int, ...]


def metadata(shape: Shape, kind: str, chunks: Shape, shard: Shape) -> dict[str, Any]:
    """``zarr.json`` of an array as the zarr library writes it; ``kind``: one of `KINDS`."""
    size = np.dtype(kind).itemsize
    little: dict[str, Any] = {"name": "bytes", "configuration": {"endian": "little"}}
    packing = {"typesize": size, "cname": "zstd", "clevel": 3, "shuffle": "shuffle", "blocksize": 0}
    sharding = {
        "chunk_shape": list(chunks),
        "codecs": [little if size > 1 else {"name": "bytes"}, {"name": "blosc", "configuration": packing}],
        "index_codecs": [little, {"name": "crc32c"}],
        "index_location": "end",
    }
    return {
        "shape": list(shape),
        "data_type": kind,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(shard)}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": np.zeros((), kind).item(),
        "codecs": [{"name": "sharding_indexed", "configuration": sharding}],
        "attributes": {},
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
    }


def write_shard(path: Path, array: NDArray, chunks: Shape, shard: Shape) -> None:
    """Write an array of one of `KINDS` into the new directory `path`; `shard` covers all of it in whole `chunks`."""
    path.mkdir()
    write_node(path, metadata(array.shape, array.dtype.name, chunks, shard))
    if not array.size:
        return
    target = _shard_file(path, array.ndim)
    target.parent.mkdir(parents=True)
    target.write_bytes(_packed(array, chunks, shard))


def write_node(path: Path, node: dict[str, Any]) -> None:
    """Write the ``zarr.json`` of an array or a group."""
    (path / "zarr.json").write_text(json.dumps(node, indent=2), encoding="utf-8")


def read_shard(path: Path) -> NDArray | None:
    """The array in `path`, None for none or one of another layout; `DamagedError` for a shard that does not hold it."""
    try:
        node = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
        shape, kind = tuple(map(int, node["shape"])), str(node["data_type"])
        chunks = tuple(map(int, node["codecs"][0]["configuration"]["chunk_shape"]))
        shard = tuple(map(int, node["chunk_grid"]["configuration"]["chunk_shape"]))
    except (OSError, ValueError, TypeError, KeyError, IndexError, RecursionError):
        return None
    if kind not in KINDS or node != metadata(shape, kind, chunks, shard) or not _fits(shape, chunks, shard):
        return None
    source = _shard_file(path, len(shape))
    data = source.read_bytes() if source.is_file() else b""
    try:
        return _unpacked(data, shape, np.dtype(kind), chunks, shard)
    except ValueError as fault:
        raise DamagedError(
            "an array of the store cannot be read", where=source, got=fault, do="remove its part and run again"
        ) from fault


def _fits(shape: Shape, chunks: Shape, shard: Shape) -> bool:
    """One shard of whole chunks covers the array, and no chunk is larger than any that is written."""
    if not len(shape) == len(chunks) == len(shard) > 0 or not 0 < math.prod(chunks) <= LARGEST:
        return False
    each = zip(shape, chunks, shard, strict=True)
    return all(n >= 0 and c > 0 and s >= n and s % c == 0 for n, c, s in each)


def _shard_file(path: Path, dimensions: int) -> Path:
    return path.joinpath("c", *["0"] * dimensions)


def _places(chunks: Shape, shard: Shape) -> Iterator[tuple[slice, ...]]:
    """Where each chunk of a shard lies in the array, in the order of the index."""
    firsts = (range(0, n, c) for n, c in zip(shard, chunks, strict=True))
    for first in itertools.product(*firsts):
        yield tuple(slice(k, k + c) for k, c in zip(first, chunks, strict=True))


def _packed(array: NDArray, chunks: Shape, shard: Shape) -> bytes:
    """A shard: its chunks, then where each begins and how long it is, then a checksum of that."""
    from numcodecs import blosc

    pieces, index, at = [], [], 0
    for place in _places(chunks, shard):
        part = array[place]
        if not part.size:
            index += [_ABSENT, _ABSENT]
            continue
        if part.shape != chunks:  # at the edge: a chunk is whole
            whole = np.zeros(chunks, array.dtype)
            whole[tuple(slice(n) for n in part.shape)] = part
            part = whole
        pieces.append(blosc.compress(np.ascontiguousarray(part), b"zstd", 3, blosc.SHUFFLE, 0))
        index += [at, len(pieces[-1])]
        at += len(pieces[-1])
    told = np.array(index, "<u8").tobytes()
    return b"".join([*pieces, told, _checksum(told)])


def _unpacked(data: bytes, shape: Shape, dtype: np.dtype[Any], chunks: Shape, shard: Shape) -> NDArray:
    """`ValueError` for what `_packed` did not write; nothing is taken for longer than the shard is."""
    from numcodecs import blosc

    if not data:  # zarr leaves out what is all zeros
        return np.zeros(shape, dtype)
    count = math.prod(s // c for s, c in zip(shard, chunks, strict=True))
    begin = len(data) - 16 * count - 4
    if begin < 0:
        raise ValueError(f"{len(data)} bytes are no shard of {count} chunks")
    told = data[begin:-4]
    if _checksum(told) != data[-4:]:
        raise ValueError("the checksum of its index")
    index = np.frombuffer(told, "<u8").reshape(-1, 2).tolist()
    size = math.prod(chunks) * dtype.itemsize
    out, buffer = np.zeros(shape, dtype), np.empty(chunks, dtype)
    for place, (first, length) in zip(_places(chunks, shard), index, strict=True):
        if first == length == _ABSENT:
            continue
        packed = data[first : first + length]
        sizes = np.frombuffer(packed[4:_HEADER], "<u4")
        if first + length > begin or len(sizes) != 3 or (int(sizes[0]), int(sizes[2])) != (size, length):
            raise ValueError(f"a chunk at {first} of {length} bytes")
        try:
            blosc.decompress(packed, buffer)
        except RuntimeError as fault:
            raise ValueError(str(fault)) from fault
        target = out[place]
        target[...] = buffer[tuple(slice(n) for n in target.shape)]
    return out


def _checksum(data: bytes) -> bytes:
    import google_crc32c

    return int(google_crc32c.value(data)).to_bytes(4, "little")
