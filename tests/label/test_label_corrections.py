"""Labels by echo: whose a label is, whose it is no more, and the file that they are kept in."""

from __future__ import annotations

import contextlib
import threading

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fwclass.errors import ConfigError, InputError, StoreError
from fwclass.formats.echo_labels import EchoLabels, echo_labels_bytes, read_echo_labels
from fwclass.grid import Box
from fwclass.label.corrections import far_from_labels, last_of_each, match_labels, outside, reference_codes
from fwclass.model import ClassDef
from fwclass.schema import Table
from fwclass.store.bucket import Remote
from fwclass.store.corrections import add_corrections, check_writable, read_corrections
from fwclass.store.params import StoreParams
from fwclass.store.url import Url

CLASSES = (ClassDef("ground", 2, (9, 2)), ClassDef("tree", 5, (3, 4)), ClassDef("roof", 6, (6,)))


def echoes(n: int, **changes) -> dict:
    at = np.arange(n)
    made = {"strip": np.full(n, 7), "pulse": at, "echo_number": np.ones(n, int), "x": at + 0.5, "y": at * 0.0, "z": at}
    return {**made, **changes}


def rows(n: int, code, time: int = 1, who: str = "me", **changes) -> EchoLabels:
    return EchoLabels.of(echoes(n, **changes), np.full(n, code), time, who)


def test_a_label_is_of_the_echo_of_its_number_that_lies_where_it_lay():
    labels = Table({**echoes(6), "label_code": np.arange(6)})
    moved = echoes(6)
    moved["z"] = moved["z"] + [0, 0.074, 0.076, 0, 0, 0]
    moved["echo_number"] = np.array([1, 1, 1, 2, 1, 1])
    order = np.array([5, 3, 1, 4, 2, 0])
    here = Table(moved).take(order)
    found, own = match_labels(here, labels, 0.075)
    assert sorted(order[found].tolist()) == [0, 1, 4, 5] and own.tolist() == order[found].tolist()
    assert match_labels(here, labels.take(np.empty(0, int)), 0.075)[0].tolist() == []


def test_the_last_row_of_an_echo_counts_and_may_take_back():
    some = EchoLabels.joined([rows(3, 2), rows(2, 6, time=2), rows(1, -1, time=3)])
    stands = some.standing()
    assert dict(zip(stands.pulse.tolist(), stands.code.tolist(), strict=True)) == {0: -1, 1: 6, 2: 2}
    table = Table({**echoes(2, pulse=[4, 4]), "label_code": [1, 2]})
    assert last_of_each(table)["label_code"].tolist() == [2]


def test_what_lies_near_a_label_is_not_tested():
    """Against the definition, pair by pair, in whole millimetres, at the very edge too."""
    rng = np.random.default_rng(3)
    x, y = rng.integers(0, 40_000, (2, 500)) / 1000
    labels = Table({**echoes(4), "x": [5.0, 20.0, 20.0, 39.0], "y": [5.0, 5.0, 30.0, 39.0], "label_code": [2] * 4})
    x[:2], y[:2] = [8.0, 8.001], [5.0, 5.0]
    among = rng.random(500) < 0.9
    among[:2] = True
    far = np.maximum(np.abs(x[:, None] - labels["x"]), np.abs(y[:, None] - labels["y"]))
    expected = among & (np.rint(1000 * far) > 3000).all(axis=1)
    np.testing.assert_array_equal(far_from_labels(x, y, labels, 3.0, among), expected)
    assert not expected[0] and expected[1]
    np.testing.assert_array_equal(far_from_labels(x, y, labels, 0.0, among), among)
    assert outside(labels, [Box(0, 0, 20, 20)]).tolist() == [False, True, True, True]


def test_delivered_codes_become_reference_codes():
    given = np.array([0, 2, 5, 4, 6], np.int16)
    assert reference_codes(given, CLASSES, "f").tolist() == [0, 2, 3, 4, 6]
    with pytest.raises(ConfigError, match=r"17 \(2 rows\)"):
        reference_codes(np.array([17, 2, 17], np.int16), CLASSES, "f")


def test_a_file_gives_back_what_was_written(tmp_path):
    some = EchoLabels.joined([rows(3, 2, time=1_700_000_000_000_000, who="Zoë\x1b[2J"), rows(1, -1, who="x" * 500)])
    back = read_echo_labels(echo_labels_bytes(some), "bytes", signed=True)
    for name in ("strip", "pulse", "echo_number", "code", "x", "y", "z", "time"):
        np.testing.assert_array_equal(getattr(back, name), getattr(some, name))
    assert back.who[0] == "Zoë\\x1b[2J" and back.who[3] == "x" * 100
    assert echo_labels_bytes(back) == echo_labels_bytes(some)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"pulse": None}, "lack the column 'pulse'"),
        ({"class": pa.array([2, 300])}, "300"),
        ({"class": pa.array(["a", "b"])}, "type that it cannot have"),
        ({"echo_number": pa.array([0, 1])}, "0 in row 1"),
        ({"strip": pa.array([1, None])}, "1 rows without a value"),
        ({"x": pa.array([1.0, float("nan")])}, "nan"),
        ({"z": pa.array([1.0, 1e300])}, "1e\\+300"),
    ],
)
def test_a_file_with_values_of_no_echo_is_refused(change, words, tmp_path):
    columns = {n: pa.array(v) for n, v in echoes(2).items()} | {"class": pa.array([2, 6])} | change
    pq.write_table(pa.table({n: v for n, v in columns.items() if v is not None}), tmp_path / "f.parquet")
    with pytest.raises(InputError, match=words):
        read_echo_labels(tmp_path / "f.parquet", tmp_path / "f.parquet")


@pytest.mark.parametrize("name", ["x", "strip", "who", "time"])
def test_a_column_that_is_there_twice_is_refused(name, tmp_path):
    table = pq.read_table(pa.BufferReader(echo_labels_bytes(EchoLabels.none())))
    pq.write_table(table.append_column(name, table.column(name)), tmp_path / "f.parquet")
    with pytest.raises(InputError, match="there twice"):
        read_echo_labels(tmp_path / "f.parquet", "f", signed=True)


@pytest.mark.parametrize("names", [pa.array([], pa.list_(pa.string())), pa.array([], pa.struct([("a", pa.string())]))])
def test_names_that_are_no_texts_are_refused(names, tmp_path):
    table = pq.read_table(pa.BufferReader(echo_labels_bytes(EchoLabels.none())))
    pq.write_table(table.set_column(table.schema.get_field_index("who"), "who", names), tmp_path / "f.parquet")
    with pytest.raises(InputError, match="cannot be read"):
        read_echo_labels(tmp_path / "f.parquet", "f", signed=True)


@pytest.mark.statistics
def test_a_damaged_file_is_refused_wherever_it_is_cut():
    data = echo_labels_bytes(rows(50, 2))
    for size in (0, 3, 9, len(data) // 2, len(data) - 9, len(data) - 1):
        with pytest.raises(InputError, match="cannot be read"):
            read_echo_labels(data[:size], "f")
    rng = np.random.default_rng(0)
    for _ in range(300):
        bytes_ = bytearray(data)
        at = int(rng.integers(len(data)))
        bytes_[at] ^= int(rng.integers(1, 256))
        with contextlib.suppress(InputError):
            assert read_echo_labels(bytes(bytes_), "f").rows <= 50


@pytest.fixture(params=["directory", "bucket"])
def where(request, tmp_path, base):
    """A run in a directory, and one on object storage."""
    if request.param == "directory":
        return tmp_path
    return Remote(Url(f"memory://{tmp_path.name}"), StoreParams(**base["store"]))


def test_writers_at_the_same_time_lose_nothing(where):
    assert read_corrections(where).rows == 0
    check_writable(where)

    def add(k: int) -> None:
        for m in range(5):
            add_corrections(where, lambda _, m=m: rows(3, 2, who=f"{k}/{m}"))

    threads = [threading.Thread(target=add, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    made = read_corrections(where)
    assert made.rows == 60 and len(set(made.who.tolist())) == 20
    before = made.who.tolist()
    add_corrections(where, lambda seen: rows(1, -1, who=str(seen.rows)))
    after = read_corrections(where).who.tolist()
    assert after == [*before, "60"]  # nothing that was there is changed
    assert add_corrections(where, lambda _: EchoLabels.none()).rows == 0


def test_a_place_that_cannot_be_written_is_told_at_once(tmp_path):
    (tmp_path / "labels").write_text("a file in the way")
    for ask in (lambda: check_writable(tmp_path), lambda: add_corrections(tmp_path, lambda _: rows(1, 2))):
        with pytest.raises(StoreError, match="corrections cannot be written here") as told:
            ask()
        assert [str(told.value).count(word) for word in ("where:", "what to do:")] == [1, 1]


def test_a_change_that_fails_leaves_the_file_as_it_was(tmp_path):
    add_corrections(tmp_path, lambda _: rows(2, 2))
    before = (tmp_path / "labels" / "corrections.parquet").read_bytes()

    def fail(_):
        raise InputError("no")

    with pytest.raises(InputError):
        add_corrections(tmp_path, fail)
    assert (tmp_path / "labels" / "corrections.parquet").read_bytes() == before
    assert [p.name for p in (tmp_path / "labels").iterdir()] == ["corrections.parquet"]


@pytest.mark.statistics
def test_labels_unpack_to_no_more_than_their_bytes_allow(tmp_path):
    """A million rows that are all the same, and a name of 100 MB."""
    for name, n, who in (("rows", 1_000_000, "me"), ("name", 1, "x" * (100 << 20))):
        made = {k: np.zeros(n) if k in "xyz" else np.ones(n, np.uint8) for k in (*echoes(0), "class")}
        table = pa.table({**made, "who": pa.DictionaryArray.from_arrays(np.zeros(n, np.int32), pa.array([who]))})
        pq.write_table(table, tmp_path / name, compression="zstd", write_statistics=False)
        assert (tmp_path / name).stat().st_size < 100_000
        with pytest.raises(InputError, match=r"too many labels|unpack to more"):
            read_echo_labels(tmp_path / name, name, signed=True)
