"""Arrays of a part come back as they were, whatever their size, in one file where they are of a usual size."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fwclass.errors import StoreError
from fwclass.store.arrays import PARQUET, SMALL, ZARR, _write_group, arrays_at, read_arrays, write_arrays


@pytest.mark.parametrize("edge", [3, 300, 1500])
def test_values_shapes_and_kinds_come_back(edge: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(edge)
    height = rng.normal(size=(edge, edge)).astype(np.float32)
    height[0, 0], height[0, 1], height[0, 2] = np.nan, -0.0, np.inf
    arrays = {
        "height": height,
        "mask": rng.integers(0, 4, (edge, edge), dtype=np.uint8),
        "key": rng.integers(0, 2**63, edge, dtype=np.uint64),
        "place": rng.integers(-(10**12), 10**12, (edge, 2)),
        "yes": rng.random(edge) < 0.5,
        "none": np.zeros((0, 4), np.float64),
        "nothing": np.zeros((edge, edge), np.int16),
        "one": np.array(7, np.int32),
    }
    write_arrays(tmp_path / "a", arrays, {"what": "a test"})
    path = arrays_at(tmp_path / "a")
    assert path is not None and path.suffix == (PARQUET if sum(a.nbytes for a in arrays.values()) <= SMALL else ZARR)
    back, about = read_arrays(path)
    assert about == {"what": "a test"} and set(back) == set(arrays)
    for name, values in arrays.items():
        assert back[name].dtype == values.dtype and back[name].shape == values.shape
        assert back[name].tobytes() == values.tobytes(), name
    some, _ = read_arrays(path, ["mask"])
    assert list(some) == ["mask"]


def test_arrays_of_an_older_run_are_read(tmp_path: Path) -> None:
    """Lists of values without their type."""
    rows = pa.schema([pa.field("z", pa.list_(pa.float32()), metadata={"shape": "[2, 2]"})], {"attributes": '{"a": 1}'})
    pq.write_table(pa.table({"z": [[1.0, 2.0, 3.0, 4.0]]}, schema=rows), tmp_path / "a.parquet")
    back, about = read_arrays(tmp_path / "a.parquet")
    assert about == {"a": 1} and np.array_equal(back["z"], np.array([[1, 2], [3, 4]], np.float32))


def test_a_block_of_rasters_is_one_file_no_larger_than_a_group_of_them(tmp_path: Path) -> None:
    x = np.tile(np.arange(256.0), (256, 1))
    rng = np.random.default_rng(2)
    rasters = {
        n: (np.sin(x / 30) * 5 + 0.01 * rng.normal(size=x.shape) + k).astype(np.float32) for k, n in enumerate("abc")
    }
    write_arrays(tmp_path / "a", rasters)
    (path,) = tmp_path.iterdir()
    _write_group(tmp_path / "group.zarr", rasters, {})
    group = sum(p.stat().st_size for p in (tmp_path / "group.zarr").rglob("*") if p.is_file())
    assert path.is_file() and path.stat().st_size < 1.05 * group


@pytest.mark.parametrize("what", ["shape", "chunks", "shards"])
def test_a_group_that_says_more_than_its_files_hold_is_refused(what: str, tmp_path: Path) -> None:
    """Zarr fills what is not there: a kilobyte took a gibibyte, and a minute."""
    _write_group(tmp_path / "a.zarr", {"samples": np.arange(1, 1001, dtype=np.uint16)}, {})
    document = tmp_path / "a.zarr" / "samples" / "zarr.json"
    about = json.loads(document.read_text())
    many = [300_000_000]
    if what == "shape":
        about["shape"] = many
    about["chunk_grid"]["configuration"]["chunk_shape"] = many if what != "shape" else [1000]
    if what == "chunks":
        about["codecs"][0]["configuration"]["chunk_shape"] = many
    document.write_text(json.dumps(about))
    with pytest.raises(StoreError, match="do not hold"):
        read_arrays(tmp_path / "a.zarr")


@pytest.mark.parametrize(("values", "fits"), [(3, True), (SMALL // 2, True), (SMALL // 2 + 1, False), (1 << 30, False)])
def test_zeros_without_a_file_are_no_more_than_a_small_part_has(values: int, fits: bool, tmp_path: Path) -> None:
    """Runs of before kept no file of zeros alone; a description of 2 GB of them was believed."""
    _write_group(tmp_path / "a.zarr", {"samples": np.zeros(3, np.uint16)}, {})
    assert (tmp_path / "a.zarr" / "samples" / "c" / "0").is_file()
    shutil.rmtree(tmp_path / "a.zarr" / "samples" / "c")
    document = tmp_path / "a.zarr" / "samples" / "zarr.json"
    document.write_text(json.dumps({**json.loads(document.read_text()), "shape": [values]}))
    if fits:
        assert read_arrays(tmp_path / "a.zarr")[0]["samples"].shape == (values,)
        return
    with pytest.raises(StoreError, match="do not hold"):
        read_arrays(tmp_path / "a.zarr")


@pytest.mark.parametrize("shape", [(10_000, 64), (9000, 300), (0, 64), (7, 0), (70, 1), (5, 4, 3)])
def test_arrays_of_any_shape_come_back_from_a_group(shape: tuple[int, ...], tmp_path: Path) -> None:
    values = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    _write_group(tmp_path / "a.zarr", {"X": values}, {})
    np.testing.assert_array_equal(read_arrays(tmp_path / "a.zarr")[0]["X"], values)


def test_features_of_rows_are_read_in_few_chunks(tmp_path: Path) -> None:
    _write_group(tmp_path / "a.zarr", {"X": np.ones((10_000, 64), np.float32)}, {})
    document = tmp_path / "a.zarr" / "X" / "zarr.json"
    about = json.loads(document.read_text())
    assert about["codecs"][0]["configuration"]["chunk_shape"] == [4096, 64]
    about["chunk_grid"]["configuration"]["chunk_shape"] = about["shape"] = [300_000_000, 64]
    about["codecs"][0]["configuration"]["chunk_shape"] = [300_000_000, 64]
    document.write_text(json.dumps(about))
    with pytest.raises(StoreError, match="do not hold"):
        read_arrays(tmp_path / "a.zarr")


def test_a_description_that_names_other_codecs_is_refused(tmp_path: Path) -> None:
    """Zarr takes any that is installed: the group's description could have arrays unpickled, and a description of zeros
    be swollen without bound."""
    told = {"name": "numcodecs.delta", "configuration": {"dtype": "<u2"}}
    swollen = {"name": "gzip", "configuration": {"level": 9}}

    def codecs(about: Any) -> list[Any]:
        return about["codecs"][0]["configuration"]["codecs"]

    changes: dict[str, Callable[[Any], object]] = {
        "a filter": lambda about: codecs(about).insert(0, told),
        "another codec": lambda about: codecs(about).append(swollen),
        "no shards": lambda about: about.update(codecs=codecs(about)),
        "text": lambda about: about.update(
            data_type={"name": "fixed_length_utf32", "configuration": {"length_bytes": 4}}
        ),
        "other names": lambda about: about["chunk_key_encoding"].update(name="v2"),
    }
    for what, change in changes.items():
        place = tmp_path / f"{what}.zarr"
        _write_group(place, {"samples": np.arange(1, 1001, dtype=np.uint16)}, {})
        about = json.loads((place / "samples" / "zarr.json").read_text())
        change(about)
        (place / "samples" / "zarr.json").write_text(json.dumps(about))
        with pytest.raises(StoreError, match="cannot be read"):
            read_arrays(place)


def test_a_group_is_not_asked_how_its_arrays_are_to_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its description may bring one for each of its arrays: zarr believed it, and had unpickled what lay there."""
    values = np.arange(1, 1001, dtype=np.uint16)
    _write_group(tmp_path / "a.zarr", {"samples": values}, {"edge": 1.0})
    document = tmp_path / "a.zarr" / "zarr.json"
    kept = {"shape": [3], "chunks": [3], "dtype": "|O", "compressor": None, "fill_value": None, "order": "C"}
    filters = [{"id": "vlen-utf8"}, {"id": "pickle"}]
    about = {"zarr_format": 2, "node_type": "array", "attributes": {}, "filters": filters, **kept}
    inline = {"kind": "inline", "must_understand": False, "metadata": {"samples": about}}
    document.write_text(json.dumps({**json.loads(document.read_text()), "consolidated_metadata": inline}))
    (tmp_path / "a.zarr" / "samples" / "0").write_bytes(pickle.dumps("x"))
    monkeypatch.setattr("numcodecs.pickles.Pickle.decode", lambda *_: pytest.fail("unpickled"))
    arrays, attributes = read_arrays(tmp_path / "a.zarr")
    np.testing.assert_array_equal(arrays["samples"], values)
    assert attributes == {"edge": 1.0}
