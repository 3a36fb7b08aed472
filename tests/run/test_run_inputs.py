"""A part's work gets what its task declares, and nothing else: an undeclared read would be in no key."""

import numpy as np
import pytest

from fwclass.grid import Tile
from fwclass.run.inputs import TABLE, Declared, PartInputs, UndeclaredRead
from fwclass.run.part import Task, execute
from fwclass.schema import Table
from fwclass.store.arrays import write_arrays
from fwclass.store.row_digests import ROW_DIGESTS, digests_by_name, digests_by_square
from fwclass.store.run_location import open_store
from fwclass.store.tables import read_table, write_groups, write_table

SIZE = 10.0
OWN = Tile(0, 0, SIZE)
NEXT = Tile(1, 0, SIZE)


def echoes(tile, inputs, directory):
    r = np.random.default_rng(tile.ix)
    n = 50
    x, y = tile.box.xmin + r.uniform(0, SIZE, n).round(3), tile.box.ymin + r.uniform(0, SIZE, n).round(3)
    table = Table(
        {
            "strip": np.zeros(n, np.uint16),
            "pulse": np.arange(n, dtype=np.uint64) + np.uint64(1000 * tile.ix),
            "echo_number": np.ones(n, np.uint8),
            "x": x,
            "y": y,
            "z": r.uniform(0, 5, n),
        }
    )
    write_table(directory / TABLE, table)
    write_arrays(directory / "a", {"z": table["z"]})
    ends = [float(f(table[c])) for f in (np.min, np.max) for c in "xyz"]
    return {
        "rows": n,
        "bounds": ends,
        "blocks": {},
        "strips": [],
        "times": [],
        ROW_DIGESTS: digests_by_square(table, x, y),
    }


def named(inputs, directory):
    table = Table({"z": np.arange(4.0)})
    write_groups(directory / TABLE, table, [0, 2, 4])
    return {
        "rows": 4,
        "tiles": {"0_0": [0, 2], "1_0": [1, 2]},
        ROW_DIGESTS: digests_by_name(table, ["0_0", "1_0"], [0, 2, 4]),
    }


@pytest.fixture
def location(tmp_path):
    for task in (
        Task("tile", OWN.key, 1, {}, lambda i, d: echoes(OWN, i, d)),
        Task("tile", NEXT.key, 1, {}, lambda i, d: echoes(NEXT, i, d)),
        Task("other", OWN.key, 1, {}, lambda i, d: echoes(OWN, i, d)),
        Task("split", "a", 1, {}, named),
    ):
        assert execute(tmp_path, task).ok
    return tmp_path


def inputs_of(location, needs, within=None):
    return PartInputs(open_store(location), declared=Declared(("mine", "0_0"), frozenset(needs), within))


BOTH = (("tile", OWN.key), ("tile", NEXT.key))


@pytest.mark.parametrize(
    "read",
    [
        lambda i: i.table("other", OWN.key),
        lambda i: i.arrays("other", OWN.key, "a"),
        lambda i: i.meta("other", OWN.key),
        lambda i: i.digest("other", OWN.key),
        lambda i: i.path("other", OWN.key, TABLE),
        lambda i: i.fragment("split", "a", OWN.key),
        lambda i: i.groups("other", OWN.key, [0]),
        lambda i: i.rows(OWN.key, {"z": "other"}),
        lambda i: i.rows("0_1", {"z": "tile"}),
        lambda i: i.rows_at(OWN.key, {"z": "other"}, np.arange(3)),
        lambda i: i.chunk(OWN, 0.0, {"z": "other"}, (OWN.key,)),
        lambda i: next(i.cuts(OWN.key, {"z": "other"})),
        lambda i: next(i.chunks(OWN, 2.0, {"z": "other"}, (OWN.key, NEXT.key))),
    ],
)
@pytest.mark.parametrize("split", [1, 2])
def test_a_part_that_is_not_declared_is_refused(location, read, split):
    inputs = inputs_of(location, BOTH)
    object.__setattr__(inputs, "split", split)
    with pytest.raises(UndeclaredRead, match="does not declare"):
        read(inputs)


def test_the_refusal_names_column_and_stage(location):
    with pytest.raises(UndeclaredRead, match=r"mine/0_0(.|\n)*z of other/0_0(.|\n)*declare the columns z.*stage other"):
        inputs_of(location, BOTH).rows(OWN.key, {"z": "other"})


@pytest.mark.parametrize(
    "read",
    [
        lambda i: i.chunk(OWN, 3.0, {"z": "tile"}, (OWN.key, NEXT.key)),
        lambda i: i.rows(NEXT.key, {"z": "tile"}),
        lambda i: i.inside(OWN.box.grown(3.0), SIZE, {"z": "tile"}, (OWN.key, NEXT.key)),
        lambda i: i.table("tile", NEXT.key),
        lambda i: i.arrays("tile", NEXT.key, "a"),
    ],
)
def test_rows_beyond_the_declared_halo_are_refused(location, read):
    with pytest.raises(UndeclaredRead):
        read(inputs_of(location, BOTH, OWN.box.grown(2.0)))


def test_what_is_declared_is_read(location):
    inputs = inputs_of(location, BOTH, OWN.box.grown(2.0))
    chunk = inputs.chunk(OWN, 2.0, {"z": "tile"}, (OWN.key, NEXT.key))
    assert len(chunk.core) == 50 < chunk.table.rows
    object.__setattr__(inputs, "split", 2)
    pieces = list(inputs.chunks(OWN, 2.0, {"z": "tile"}, (OWN.key, NEXT.key)))
    assert sum(len(rows) for rows, _ in pieces) == 50


@pytest.mark.parametrize("rows", [[], [0], [19, 20, 21, 49], list(range(50))])
def test_chosen_rows_of_a_tile_are_those_of_all(tmp_path, rows):
    def in_groups(inputs, directory):
        meta = echoes(OWN, inputs, directory)
        write_table(directory / TABLE, read_table(directory / TABLE), row_group=20)
        return meta

    for stage in ("tile", "other"):
        assert execute(tmp_path, Task(stage, OWN.key, 1, {}, in_groups)).ok
    inputs, columns = inputs_of(tmp_path, [("tile", OWN.key), ("other", OWN.key)]), {"x": "tile", "z": "other"}
    chosen, whole = inputs.rows_at(OWN.key, columns, np.array(rows, np.int64)), inputs.rows(OWN.key, columns)
    assert list(chosen) == ["x", "z"]
    for name in columns:
        np.testing.assert_array_equal(chosen[name], whole[name][rows])


def test_a_fragment_of_another_tile_is_refused(location):
    inputs = inputs_of(location, [("split", "a")], OWN.key)
    assert inputs.fragment("split", "a", OWN.key)["z"].tolist() == [0.0, 1.0]
    with pytest.raises(UndeclaredRead, match="rows of tile 1_0"):
        inputs.fragment("split", "a", NEXT.key)


def test_a_part_that_reads_more_than_its_task_says_fails_in_words(location):
    task = Task("mine", OWN.key, 1, {}, lambda i, d: {"z": i.meta("other", OWN.key)}, needs=(("tile", OWN.key),))
    outcome = execute(location, task)
    assert outcome.status == "failed"
    assert "does not declare" in outcome.message and "other/0_0" in outcome.message
