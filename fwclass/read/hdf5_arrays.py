"""Arrays of HDF5 files of strangers, by `h5py`: in the file itself, not larger than it can be, packed in a known way.

HDF5 opens what links name, runs what filters it has, and unpacks a chunk whatever comes out of it; here all of that is
refused before it is read.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError, first_line

TIMES = 200
"""Bytes of a data set over those of its file: compressed waveforms reach 10."""

CHUNK = 64 << 20
"""Bytes of a chunk, which is unpacked again for every block of shots; writers make chunks of up to a few MiB."""

SUMS = 1024
"""Bytes that a chunk may hold besides its numbers, for sums of filters."""

PIECE = 1 << 20
"""Bytes that are unpacked at a time to count them."""

DEFLATE, SHUFFLE, FLETCHER32 = 1, 2, 3
PACKINGS = {DEFLATE: "deflate", 4: "szip", 5: "nbit", 6: "scaleoffset", 32000: "lzf"}
"""HDF5's numbers of filters, and h5py's; one of these may have packed a chunk, once."""
VIRTUAL = 3
"""HDF5's number of a data set that is put together from others."""


def array_in(path: Path, group: Any, name: str, dimensions: int = 0) -> Any:
    """A data set of numbers in this very file, not larger than it can be."""
    data = reach(path, group, name)
    layout: Any = data.id.get_create_plist() if hasattr(data, "chunks") else None
    virtual = layout is not None and layout.get_layout() == VIRTUAL  # whose shape is asked of other files
    shape = None if layout is None or virtual else data.shape
    sound = shape is not None and data.dtype.kind in "iuf" and len(shape) in ((dimensions,) if dimensions else (1, 2))
    if not sound or data.external:
        raise InputError(
            "this is no array of numbers",
            where=f"{path}: {name}",
            expected=f"numbers in {dimensions or 'one or two'} dimensions, in the file itself",
            got="a data set of other files" if virtual else f"{getattr(data, 'dtype', type(data).__name__)} {shape}",
        )
    if data.nbytes > TIMES * path.stat().st_size:
        raise overstated(f"{path}: {name}", data.nbytes, f"at most {TIMES * path.stat().st_size} bytes")
    filters = [layout.get_filter(k)[0] for k in range(layout.get_nfilters())]
    packings = [f for f in filters if f not in (SHUFFLE, FLETCHER32)]
    if len(packings) > 1 or not set(packings) <= set(PACKINGS):
        raise InputError(
            "a data set is packed in another way",
            where=f"{path}: {name}",
            expected=f"once, by one of {', '.join(PACKINGS.values())}",
            got=", ".join(PACKINGS.get(f, f"filter {f}") for f in packings),
            do="repack it, for example with h5repack -f GZIP=4",
        )
    if data.chunks and math.prod(data.chunks) * data.dtype.itemsize > CHUNK:
        raise InputError(
            "the chunks of a data set are too large",
            where=f"{path}: {name}",
            expected=f"at most {CHUNK} bytes",
            got=math.prod(data.chunks) * data.dtype.itemsize,
            do="repack it, for example with h5repack",
        )
    return data


def rows_of(path: Path, data: Any, first: int, last: int) -> NDArray[Any]:
    """Rows [first, last) of an array that `array_in` gave, as stored.

    `InputError`: a chunk holds more than its numbers once it is unpacked: deflate swells a thousand times, and HDF5
    makes room for whatever comes.
    """
    if data.chunks and last > first:
        plan = data.id.get_create_plist()
        order = [plan.get_filter(k)[0] for k in range(plan.get_nfilters())]
        if DEFLATE in order:
            _check_chunks(path, data, first, last, 1 << order.index(DEFLATE))
    return np.asarray(data[first:last])


def _check_chunks(path: Path, data: Any, first: int, last: int, skipped: int) -> None:
    """Every chunk of rows [first, last) unpacks to no more than its numbers; `skipped`: the bit of a chunk's mask that
    says that it is not packed."""
    most = math.prod(data.chunks) * data.dtype.itemsize + SUMS
    rows, size = data.chunks[0], path.stat().st_size
    places = [range(first - first % rows, last, rows)]
    places += [range(0, n, step) for n, step in zip(data.shape[1:], data.chunks[1:], strict=True)]
    for place in product(*places):
        chunk = data.id.get_chunk_info_by_coord(place)
        if chunk.byte_offset is None or chunk.filter_mask & skipped:
            continue
        if chunk.size > size:
            raise overstated(f"{path}: {data.name}", f"a chunk of {chunk.size} bytes", f"at most {size} bytes")
        packed, stream, unpacked = data.id.read_direct_chunk(place)[1], zlib.decompressobj(), 0
        while packed and not stream.eof and unpacked <= most:
            try:
                unpacked += len(stream.decompress(packed, PIECE))
            except zlib.error as fault:
                raise OSError(f"{data.name}: {fault}") from None
            packed = stream.unconsumed_tail
        if unpacked > most:
            raise overstated(f"{path}: {data.name}", f"more in the chunk at {place}", f"at most {most} bytes unpacked")


def overstated(where: object, got: object, expected: str) -> InputError:
    return InputError(
        "a data set counts more than the file can hold",
        where=where,
        expected=expected,
        got=got,
        do="the file is damaged or cut short; download it again",
    )


def reach(path: Path, group: Any, name: str) -> Any:
    """What `name` is below `group`, None for nothing; `InputError` where a link on the way leads elsewhere, maybe to
    another file, which HDF5 would open whatever it is."""
    import h5py

    for part in name.split("/"):
        link = group.get(part, getlink=True) if isinstance(group, h5py.Group) else None
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise InputError(
                "a link leads elsewhere",
                where=f"{path}: {name}",
                expected="data in the file itself",
                got=f"{type(link).__name__} {getattr(link, 'filename', '')} {link.path}",
                do="repack it, for example with h5repack, or copy what it leads to",
            )
        group = group[part]
    return group


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    try:
        import h5py
    except ImportError:
        raise InputError(
            "HDF5 cannot be read: the package h5py is not installed", where=path, do="pip install 'fwclass[hdf5]'"
        ) from None
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as fault:
        raise InputError(
            "the HDF5 file cannot be read",
            where=path,
            got=first_line(fault),
            do="it is cut short or damaged; download it again",
        ) from None
