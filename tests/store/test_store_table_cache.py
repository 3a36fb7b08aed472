"""What is kept of tables is what would be read, of the file that lies there now, and no more than may be kept."""

from collections import OrderedDict

import numpy as np
import pytest

from fwclass.grid import Box, quantise
from fwclass.schema import Table
from fwclass.store import table_cache
from fwclass.store.tables import read_table, row_groups, write_table


@pytest.fixture(autouse=True)
def _nothing_kept(monkeypatch):
    monkeypatch.setattr(table_cache, "_columns", OrderedDict())
    monkeypatch.setattr(table_cache, "_groups", OrderedDict())
    monkeypatch.setattr(table_cache, "_bytes", 0)


def rows_of(n=3000, seed=0):
    r = np.random.default_rng(seed)
    x = np.sort(quantise(100.0 * r.random(n)))
    return Table({"x": x, "y": quantise(r.random(n)), "pulse": np.arange(n), "ground": r.random(n) < 0.5})


def equal(a, b):
    assert list(a) == list(b)
    assert all(a[n].dtype == b[n].dtype and a[n].tobytes() == b[n].tobytes() for n in a)


@pytest.mark.parametrize("seed", range(5))
def test_whatever_was_asked_before_the_answer_is_that_of_the_file(tmp_path, seed, monkeypatch):
    r = np.random.default_rng(seed)
    monkeypatch.setattr(table_cache, "MOST", 20_000)  # some stay, some go
    paths = [tmp_path / name for name in "abc"]
    for k, path in enumerate(paths):
        write_table(path, rows_of(seed=k), row_group=500)
    for _ in range(100):
        path, names = paths[r.integers(3)], r.permutation(["x", "y", "pulse", "ground"])[: r.integers(1, 5)].tolist()
        groups = np.flatnonzero(r.random(6) < 0.4).tolist()
        equal(table_cache.read_kept(path, names, groups), read_table(path, names, groups))
        held = sum(v.nbytes for v in table_cache._columns.values())
        assert table_cache._bytes == held <= table_cache.MOST
    box = Box(20.0, 0.0, 40.0, 1.0)
    assert table_cache.groups_touching(paths[0], box) == row_groups(paths[0], box) != list(range(6))


def test_what_is_kept_is_not_read_again(tmp_path, monkeypatch):
    path = tmp_path / "t"
    write_table(path, rows_of(), row_group=500)
    first = table_cache.read_kept(path, ["x", "pulse"], [0, 1, 2])
    monkeypatch.setattr(table_cache, "read_table", None)
    equal(table_cache.read_kept(path, ["pulse", "x"], [1, 2]), first.select(["pulse", "x"]).take(np.arange(500, 1500)))


def test_a_file_that_was_replaced_is_read_anew(tmp_path):
    path = tmp_path / "t"
    write_table(path, rows_of(seed=1))
    table_cache.read_kept(path, ["x"], [0])
    write_table(tmp_path / "u", rows_of(seed=2))
    (tmp_path / "u").replace(path)
    equal(table_cache.read_kept(path, ["x"], [0]), rows_of(seed=2).select(["x"]))


def test_nobody_writes_to_what_others_read(tmp_path):
    path = tmp_path / "t"
    write_table(path, rows_of())
    table_cache.read_kept(path, ["x"], [0])["x"][0] = -1.0  # what it read itself
    again = table_cache.read_kept(path, ["x"], [0])
    equal(again, rows_of().select(["x"]))
    with pytest.raises(ValueError, match="read-only"):
        again["x"][0] = 1.0


def test_a_table_too_large_to_keep_takes_no_place(tmp_path, monkeypatch):
    path, large = tmp_path / "t", tmp_path / "large"
    write_table(path, rows_of(10))
    write_table(large, rows_of(3000))
    table_cache.read_kept(path, ["x"], [0])
    monkeypatch.setattr(table_cache, "MOST", 24_000)
    equal(table_cache.read_kept(large, ["x"], [0]), rows_of(3000).select(["x"]))
    assert len(table_cache._columns) == 1


@pytest.mark.parametrize("rows", [1, 3000])
def test_what_was_written_is_read_from_memory_as_from_its_file(tmp_path, rows, monkeypatch):
    table, path, names = rows_of(rows), tmp_path / "part" / "t", ["pulse", "x", "y", "ground"]
    table_cache.write_and_hold(tmp_path / "t", table)
    path.parent.mkdir()
    (tmp_path / "t").replace(path)
    table_cache.moved(tmp_path / "other", path)  # is not what was written
    assert not table_cache._columns
    table_cache.moved(tmp_path / "t", path)
    table["x"][0] = -1.0  # it is the writer's
    monkeypatch.setattr(table_cache, "read_table", None)
    monkeypatch.setattr(table_cache, "row_groups_of", None)
    equal(table_cache.read_kept(path, names, [0]), read_table(path, names))
    for box in (Box(0.0, 0.0, 100.0, 1.0), Box(20.0, 3.0, 30.0, 4.0)):
        assert table_cache.groups_touching(path, box) == row_groups(path, box)


def test_coordinates_that_are_no_millimetres_are_known_by_their_file(tmp_path):
    table_cache.write_and_hold(tmp_path / "t", rows_of(5).with_columns({"x": np.array([0.1234, 1, 2, 3, np.nan])}))
    table_cache.moved(tmp_path / "t", tmp_path / "t")
    assert table_cache.groups_touching(tmp_path / "t", Box(9.0, 0.0, 10.0, 1.0)) == row_groups(
        tmp_path / "t", Box(9.0, 0.0, 10.0, 1.0)
    )


def test_groups_of_all_files_that_a_worker_goes_through_are_remembered(tmp_path, monkeypatch):
    """5,184 tiles, half of them a worker's, of each of which stages read six tables: 4,096 were remembered, and every
    stage read each anew."""
    read = []
    monkeypatch.setattr(table_cache, "row_groups_of", lambda path: read.append(path) or (table_cache.Group(1, None),))
    for _ in range(2):
        for k in range(6 * 5184 // 2):
            table_cache._groups_in((f"{k}", (k, 0, 0)))
    assert len(read) == 6 * 5184 // 2
