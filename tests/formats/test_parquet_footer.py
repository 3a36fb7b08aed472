"""The number of values in a footer is Arrow's own; damage is a `ValueError`."""

import io
import struct
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fwclass.errors import InputError
from fwclass.formats.geoparquet import columns
from fwclass.formats.parquet_footer import check_unpacked, count_values, values_in


@pytest.mark.parametrize("groups", [1, 3, 40])
def test_the_values_are_those_that_arrow_tells(tmp_path, groups):
    path = tmp_path / "a.parquet"
    lists = [np.zeros(k % 7, np.float32) for k in range(120)]
    table = pa.table({"a": np.arange(120), "b": pa.array(lists, pa.list_(pa.float32())), "c": ["x", None] * 60})
    table = table.replace_schema_metadata({"some": "thing" * 100})
    pq.write_table(table, path, row_group_size=120 // groups)
    meta = pq.read_metadata(path)
    told = [meta.row_group(g).column(c).num_values for g in range(meta.num_row_groups) for c in range(3)]
    assert count_values(path) == sum(told)


def test_damage_is_told(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"a": np.arange(120)}), path)
    data = path.read_bytes()
    rng, refused = np.random.default_rng(1), 0
    for _ in range(500):
        broken = bytearray(data)
        broken[int(rng.integers(len(data) - 500, len(data)))] = int(rng.integers(256))
        path.write_bytes(broken)
        try:
            count_values(path)
        except ValueError:
            refused += 1
    assert refused
    path.write_bytes(data[:-1])
    with pytest.raises(ValueError, match="no footer"):
        count_values(path)


def number(value):
    """As Thrift's compact protocol writes it."""
    rest = []
    while value > 127:
        rest.append(value & 127 | 128)
        value >>= 7
    return bytes([*rest, value])


def file_of(pages, footer):
    return b"PAR1" + pages + footer + struct.pack("<I", len(footer)) + b"PAR1"


@pytest.mark.parametrize("kinds", [0x11, 0x12, 0x21, 0x22])
def test_a_map_of_truth_values_ends_with_its_bytes(kinds):
    """Each takes a byte: a billion of them in a file of a few were counted one by one."""
    data = file_of(b"", bytes([0x1B]) + number(1 << 40) + bytes([kinds, 1, 2, 0]))
    with pytest.raises(ValueError, match="cut short"):
        values_in(io.BytesIO(data), len(data))


def test_headers_that_many_columns_share_are_walked_over_once():
    """100 kB of a page's header, which each of 400 columns names as its own, took 25 s."""
    elements, columns = 100_000, 400
    page = bytes([0x25, 2, 0x15, 2, 0x69, 0xF5]) + number(elements) + bytes(elements) + b"\0"
    column = bytes([0x3C, 0x56, 2, 0x26]) + number(2 * len(page)) + bytes([0x26, 8, 0, 0])
    group = bytes([0x19, 0xFC]) + number(columns) + column * columns + b"\0"
    data = file_of(page, bytes([0x49, 0x1C]) + group + b"\0")
    assert values_in(io.BytesIO(data), len(data)) == columns
    began = time.process_time()
    with pytest.raises(ValueError, match="share"):
        check_unpacked(io.BytesIO(data), len(data), 200)
    assert time.process_time() - began < 5


def test_rows_of_nothing_are_refused_before_arrow_makes_them(tmp_path, monkeypatch):
    """Of 200 kB that hold 100 million decimals without a value it made 3 GB."""
    path, count = tmp_path / "a.parquet", 2_000_000
    pq.write_table(pa.table({"code": pa.nulls(count, pa.decimal128(38))}), path, row_group_size=count)
    assert path.stat().st_size < 20_000
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *_: pytest.fail("read"))
    with pytest.raises(InputError, match="2,000,000 rows"):
        columns(path, ["code"])
