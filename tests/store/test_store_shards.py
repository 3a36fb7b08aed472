"""Arrays are written and read without the zarr library as with it, and a damaged one is told."""

import json

import numpy as np
import pytest
import zarr
from zarr.codecs import BloscCodec

from fwclass.errors import DamagedError
from fwclass.formats import shards
from fwclass.store import arrays

SHAPES = [(0,), (1,), (1000,), (arrays.CHUNK,), (arrays.CHUNK + 1,), (3, 4), (256, 256), (300, 700), (0, 5)]


def some(shape, kind, seed=0):
    r = np.random.default_rng(seed)
    values = (
        r.integers(0, 200, shape) if kind != "float32" else np.where(r.random(shape) < 0.1, np.nan, r.random(shape))
    )
    return values.astype(kind)


def by_library(path, named, attributes):
    group = zarr.open_group(str(path), mode="w", zarr_format=3, attributes=attributes)
    codec = BloscCodec(cname="zstd", clevel=3, shuffle="shuffle")
    for name, array in named.items():
        chunks, shard = arrays._layout(array)
        group.create_array(name, data=array, chunks=chunks, shards=shard, compressors=codec)


@pytest.mark.parametrize("kind", ["bool", "uint8", "uint16", "int64", "float32"])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_library_reads_what_is_written_and_its_own_is_read(tmp_path, shape, kind, monkeypatch):
    named, attributes = {"v": some(shape, kind), "zeros": np.zeros(shape, kind)}, {"cell": 0.5, "none": None}
    arrays.write_arrays(tmp_path / "ours", named, attributes)
    by_library(tmp_path / "theirs", named, attributes)
    for name in named:
        node = json.loads((tmp_path / "theirs" / name / "zarr.json").read_text())
        assert json.loads((tmp_path / "ours" / name / "zarr.json").read_text()) == node
        told = zarr.open_group(str(tmp_path / "ours"), mode="r")[name][...]
        assert told.dtype == named[name].dtype and told.tobytes() == named[name].tobytes()
    assert dict(zarr.open_group(str(tmp_path / "ours"), mode="r").attrs) == attributes
    monkeypatch.setattr(zarr, "open_group", None)  # neither is left to the library
    for where in ("ours", "theirs"):
        back, said = arrays.read_arrays(tmp_path / where)
        assert list(back) == sorted(named) and said == attributes
        for name, array in back.items():
            assert array.dtype == named[name].dtype and array.tobytes() == named[name].tobytes()
            assert array.flags.writeable


def test_another_layout_is_left_to_the_library(tmp_path):
    group = zarr.open_group(str(tmp_path / "a"), mode="w", zarr_format=3)
    group.create_array("v", data=np.arange(10), chunks=(5,))
    group.create_array("w", data=np.arange(10), chunks=(2,), shards=(4,))
    assert shards.read_shard(tmp_path / "a" / "v") is None
    back, _ = arrays.read_arrays(tmp_path / "a")
    assert back["v"].tolist() == back["w"].tolist() == list(range(10))


def test_another_byte_order_is_left_to_the_library(tmp_path):
    odd = {"v": np.arange(6).astype(">i4")}
    arrays.write_arrays(tmp_path / "a", odd)
    assert arrays.read_arrays(tmp_path / "a")[0]["v"].tolist() == list(range(6))


def test_a_shard_that_is_cut_off_or_changed_is_told(tmp_path):
    path = tmp_path / "a"
    arrays.write_arrays(path, {"v": some((300, 300), "uint16")})
    file = path / "v" / "c" / "0" / "0"
    whole = file.read_bytes()
    r = np.random.default_rng(5)
    for cut in [1, 3, 4, 20, 67, 68, 69, *r.integers(1, len(whole), 50).tolist()]:
        file.write_bytes(whole[:-cut])
        with pytest.raises(DamagedError):
            arrays.read_arrays(path)
    for at in range(len(whole) - 68, len(whole)):  # the index and its checksum
        file.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(DamagedError):
            arrays.read_arrays(path)
    for at in range(4, 8):  # what a chunk says of its size
        file.write_bytes(whole[:at] + bytes([whole[at] ^ 0x40]) + whole[at + 1 :])
        with pytest.raises(DamagedError):
            arrays.read_arrays(path)


def test_a_shape_that_no_writer_writes_takes_no_memory(tmp_path):
    path = tmp_path / "v"
    shards.write_shard(path, np.arange(10), (10,), (10,))
    for shape, chunks, shard in (((1 << 40,), (1 << 40,), (1 << 40,)), ((10,), (3,), (10,)), ((20,), (10,), (10,))):
        shards.write_node(path, shards.metadata(shape, "int64", chunks, shard))
        assert shards.read_shard(path) is None
