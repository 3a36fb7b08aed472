"""The number of values in a footer is Arrow's own; damage is a `ValueError`."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fwclass.formats.parquet_footer import count_values


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
