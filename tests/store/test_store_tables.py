"""Tables and arrays: what is read is what was written, part by part, and the same rows give the same bytes."""

import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fwclass.errors import InputError, StoreError
from fwclass.formats.arrow import arrow_array, numpy_values
from fwclass.grid import Box, quantise
from fwclass.model import FORMAT, LEAF, Forest
from fwclass.schema import Table
from fwclass.store import tables
from fwclass.store.arrays import SMALL, arrays_at, read_arrays, write_arrays
from fwclass.store.models import load_forest, save_model
from fwclass.store.tables import open_parquet, read_table, row_groups, write_groups, write_table


def table(n=5000, seed=0):
    r = np.random.default_rng(seed)
    x = np.sort(np.round(r.uniform(0, 1000, n), 3))
    return Table(
        {
            "x": x,
            "y": np.round(r.uniform(0, 10, n), 3),
            "pulse": np.arange(n),
            "echo_number": r.integers(1, 5, n),
            "amplitude": np.where(r.random(n) < 0.1, np.nan, r.random(n)),
            "ground": r.random(n) < 0.5,
        }
    )


def equal(a, b):
    assert list(a) == list(b)
    for n in a:
        assert a[n].dtype == b[n].dtype
        np.testing.assert_array_equal(a[n], b[n])


@pytest.mark.parametrize("n", [0, 1, 5000])
def test_tables_round_trip_with_their_dtypes_and_nan(tmp_path, n):
    write_table(tmp_path / "t", table(n))
    equal(read_table(tmp_path / "t"), table(n))
    equal(read_table(tmp_path / "t", ["pulse", "x"]), table(n).select(["pulse", "x"]))


def test_the_same_rows_give_the_same_bytes(tmp_path):
    for name in "ab":
        write_table(tmp_path / name, table())
        write_arrays(tmp_path / name, {"v": np.arange(10_000)})
        write_arrays(tmp_path / f"{name}-large", {"v": np.arange(3_000_000)})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    files = [[p.read_bytes() for p in sorted((tmp_path / f"{n}-large.zarr").rglob("*")) if p.is_file()] for n in "ab"]
    assert files[0] == files[1] and files[0]


def test_row_groups_never_miss_a_row_of_the_box(tmp_path):
    whole = table()
    write_table(tmp_path / "t", whole, row_group=256)
    for box in (Box(100, 0, 110, 10), Box(999, 0, 2000, 10), Box(-5, 0, 0.5, 10), Box(5000, 0, 6000, 1)):
        groups = row_groups(tmp_path / "t", box)
        part = read_table(tmp_path / "t", None, groups)
        equal(part.take(box.contains(part["x"], part["y"])), whole.take(box.contains(whole["x"], whole["y"])))
        assert len(groups) < 20


def test_groups_are_one_row_group_each(tmp_path):
    whole = table(100)
    write_groups(tmp_path / "t", whole, [0, 10, 10, 100])
    with open_parquet(tmp_path / "t") as file:
        assert [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)][-1] == 90
    equal(read_table(tmp_path / "t"), whole)


def test_a_damaged_table_is_named(tmp_path):
    (tmp_path / "t").write_bytes(b"PAR1 nonsense")
    with pytest.raises(StoreError, match="cannot be read"):
        read_table(tmp_path / "t")
    write_table(tmp_path / "u", table(10))
    with pytest.raises(StoreError, match="lacks z"):
        read_table(tmp_path / "u", ["z"])


@pytest.mark.parametrize("shape", [(0,), (1,), (0, 3), (300_000,), (30, 70), (300, 700), ()])
def test_arrays_round_trip(tmp_path, shape):
    r = np.random.default_rng(1)
    arrays = {
        "b": np.asarray(r.normal(size=shape), np.float32),
        "a": np.asarray(r.integers(0, 255, shape), np.uint8),
        "yes": np.asarray(r.random(shape) < 0.5),
        "wide": np.asarray(r.integers(-(1 << 62), 1 << 62, shape), np.int64),
    }
    write_arrays(tmp_path / "z", arrays, {"cell": 1.5, "crs": None})
    path = arrays_at(tmp_path / "z")
    assert path.suffix == (".zarr" if sum(a.nbytes for a in arrays.values()) > SMALL else ".parquet")
    found, about = read_arrays(path)
    assert about == {"cell": 1.5, "crs": None}
    assert list(read_arrays(path, ["wide"])[0]) == ["wide"]
    for n in arrays:
        np.testing.assert_array_equal(found[n], arrays[n])
        assert found[n].dtype == arrays[n].dtype


def forest():
    card = {
        "format": FORMAT,
        "features": ["zc", "width"],
        "classes": [{"name": "a", "code": 2}, {"name": "b", "code": 6}],
    }
    return Forest(
        np.array([0, LEAF, 1, LEAF, LEAF], np.uint16),
        np.array([1, 0, 2, 0, 0], np.float32),
        np.array([1, 0, 3, 1, 0], np.uint32),
        np.array([0, 5]),
        card,
    )


def test_a_forest_round_trips(tmp_path):
    save_model(tmp_path / "m", forest())
    found = load_forest(tmp_path / "m")
    for n in ("feature", "threshold", "child", "offsets"):
        np.testing.assert_array_equal(getattr(found, n), getattr(forest(), n))
    assert found.features == ("zc", "width")


def test_damaged_models_are_refused(tmp_path):
    """Any byte of any file set to any of a few values: loading refuses, or gives a forest that can be walked."""
    save_model(tmp_path / "m", forest())
    refused = 0
    for path in sorted((tmp_path / "m").iterdir()):
        good = path.read_bytes()
        for at in range(0, len(good), 3):
            for value in (0, 1, 127, 255):
                path.write_bytes(good[:at] + bytes([value]) + good[at + 1 :])
                try:
                    load_forest(tmp_path / "m").check()
                except InputError:
                    refused += 1
        path.write_bytes(good[: len(good) // 2])
        with pytest.raises(InputError):
            load_forest(tmp_path / "m")
        path.write_bytes(good)
    assert refused > 100


def test_a_pickled_array_is_not_loaded(tmp_path):
    save_model(tmp_path / "m", forest())
    np.save(tmp_path / "m" / "child.npy", np.array([{"a": 1}], object), allow_pickle=True)
    with pytest.raises(InputError, match="not a model"):
        load_forest(tmp_path / "m")


def test_no_table_loads_pandas(tmp_path):
    """Arrow's own conversions do where it is installed: half a second of every process."""
    code = (
        "import sys, numpy as np\n"
        "from pathlib import Path\n"
        "from fwclass.schema import Table\n"
        "from fwclass.store.tables import read_table, write_table\n"
        "table = Table({'x': np.arange(9.0), 'ground': np.arange(9) % 2 == 0, 'echo_number': np.arange(9)})\n"
        "path = Path(sys.argv[1])\n"
        "write_table(path, table, 4)\n"
        "back = read_table(path)\n"
        "assert all((back[n] == table[n]).all() and back[n].dtype == table[n].dtype for n in table)\n"
        "assert 'pandas' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "t.parquet")], check=True)


@pytest.mark.parametrize("dtype", ["bool", "u1", "u2", "u4", "u8", "f4", "f8"])
def test_arrow_and_back_by_buffers_is_what_arrow_itself_gives(dtype):
    values = (np.arange(37) * 3 % 7).astype(dtype)
    ours, theirs = arrow_array(values), pa.array(values)
    assert ours.equals(theirs)
    for parts in ([ours], [ours[:5], ours[5:20], ours[20:20], ours[20:]], [ours[3:11]], []):
        column = pa.chunked_array(parts, type=ours.type)
        got = numpy_values(column)
        assert got.dtype == values.dtype
        np.testing.assert_array_equal(got, column.to_numpy().astype(dtype))


def echoes_of_a_tile(n=20_000, seed=3):
    r = np.random.default_rng(seed)
    x, y = (quantise(low + 100.0 * r.random(n)) for low in (512_300.0, 5_403_700.0))
    order = np.lexsort((y // 2, x // 2))
    return Table({"x": x[order], "y": y[order], "z": quantise(300.0 + r.random(n))})


def test_whole_millimetres_take_half_the_bytes_and_lose_no_bit(tmp_path, monkeypatch):
    rows = echoes_of_a_tile()
    write_table(tmp_path / "whole", rows)
    equal(read_table(tmp_path / "whole"), rows)
    monkeypatch.setattr(tables, "_whole_millimetres", lambda metres: None)
    write_table(tmp_path / "plain", rows)
    equal(read_table(tmp_path / "plain"), rows)
    assert (tmp_path / "whole").stat().st_size < 0.55 * (tmp_path / "plain").stat().st_size
    box = Box(512_310.0, 5_403_710.0, 512_315.0, 5_403_715.0)
    for name in ("whole", "plain"):
        write_table(tmp_path / name, rows, row_group=1000)
    assert row_groups(tmp_path / "whole", box) == row_groups(tmp_path / "plain", box) != list(range(20))


@pytest.mark.parametrize("odd", [np.nan, np.inf, -0.0, 1e300, 512_300.0005, np.nextafter(512_300.0, np.inf)])
def test_coordinates_that_are_no_whole_millimetres_keep_every_bit(tmp_path, odd):
    rows = echoes_of_a_tile(100)
    x = rows["x"].copy()
    x[50] = odd
    write_table(tmp_path / "t", rows.with_columns({"x": x}))
    assert read_table(tmp_path / "t")["x"].tobytes() == x.tobytes()


def test_groups_are_encoded_as_tables_are(tmp_path):
    rows = echoes_of_a_tile()
    write_groups(tmp_path / "groups", rows, [0, 5000, 20_000])
    write_table(tmp_path / "table", rows)
    assert (tmp_path / "groups").stat().st_size < 1.1 * (tmp_path / "table").stat().st_size


def test_the_footer_of_many_groups_is_parsed_once_and_again_when_the_table_is_another(tmp_path, monkeypatch):
    whole, path = table(1000), tmp_path / "t"
    write_groups(path, whole, range(0, 1001, 5))
    parsed, real = [], tables.pq.ParquetFile
    monkeypatch.setattr(
        tables.pq, "ParquetFile", lambda path, **more: parsed.append(more.get("metadata")) or real(path, **more)
    )
    for group in range(200):
        equal(read_table(path, None, [group]), whole.take(np.arange(5 * group, 5 * group + 5)))
    assert parsed.count(None) == 1
    other = whole.take(np.arange(1000)[::-1])
    write_groups(path, other, range(0, 1001, 5))
    equal(read_table(path, None, [3]), other.take(np.arange(15, 20)))
    assert parsed.count(None) == 2


def test_footers_that_are_kept_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "KEPT_FOOTERS", 1)
    for name in "abc":
        write_groups(tmp_path / name, table(1000), range(0, 1001, 5))
        read_table(tmp_path / name, None, [0])
    assert list(tables._footers) == [str(tmp_path / "c")]


def test_fractions_that_repeat_are_kept_by_dictionary_bit_by_bit(tmp_path):
    n, r = 20_000, np.random.default_rng(5)
    few = r.integers(0, 300, n).astype(np.float32) / np.float32(7.0)
    few[r.integers(0, n, 90)] = -0.0
    few.view(np.uint32)[r.integers(0, n, 40)] = 0x7FC0_1234  # no number, as another program writes it
    few[r.integers(0, n, 40)] = np.nan
    rest = {"zc": r.random(n).astype(np.float32), "echo_ratio_r100": np.full(n, 0.5, np.float32)}
    columns = {"amplitude": few, **rest}
    write_table(tmp_path / "t", Table(columns), row_group=8192)
    write_table(tmp_path / "small", Table({"amplitude": few[:1000]}))
    back, about = read_table(tmp_path / "t"), pq.ParquetFile(tmp_path / "t").metadata
    for name, values in columns.items():
        np.testing.assert_array_equal(back[name].view(np.uint32), values.view(np.uint32))
    assert about.row_group(1).column(0).has_dictionary_page and about.row_group(1).column(2).has_dictionary_page
    assert not about.row_group(1).column(1).has_dictionary_page
    assert not pq.ParquetFile(tmp_path / "small").metadata.row_group(0).column(0).has_dictionary_page
    assert about.row_group(0).column(0).total_compressed_size < 0.6 * about.row_group(0).column(1).total_compressed_size
