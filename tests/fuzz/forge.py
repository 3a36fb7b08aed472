"""Damage to what files say rather than to their bytes: values of JSON, columns of Parquet.

An operation is ``FILE:PLACE@NUMBER``: the value at `PLACE` (numbers of members, from the outermost one) becomes the
`NUMBER`-th of `VALUES`; of Parquet, the column `PLACE` is changed by the `NUMBER`-th of `CHANGES`.
"""

from __future__ import annotations

import contextlib
import json
import random
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

REMOVED = object()
VALUES: tuple[Any, ...] = (
    None,
    "x",
    -1,
    0,
    7,
    0.5,
    1e308,
    float("nan"),
    10**18,
    True,
    [],
    {},
    [None],
    {"a": 1},
    [[0, 1], [2, 3]],
    "../x",
    REMOVED,
)


def _values(change: Callable[[Any], Any]) -> Callable[[Any, str], Any]:
    """What changes the numbers of a column, where they can be changed so."""

    def changed(table: Any, name: str) -> Any:
        import pyarrow as pa

        at, field = table.schema.get_field_index(name), table.schema.field(name)
        values = change(table[name].to_numpy().copy())
        with contextlib.suppress(pa.ArrowInvalid, pa.ArrowTypeError, OverflowError):
            return table.set_column(at, field, pa.array(values, field.type, from_pandas=False))
        return table.set_column(at, field.with_type(pa.array(values).type), pa.array(values))

    return changed


def _some(value: Any) -> Callable[[Any], Any]:
    """Every third value is another."""

    def change(values: Any) -> Any:
        made = values.astype("f8" if isinstance(value, float) else "O" if values.dtype == object else "i8")
        made[::3] = value
        return made

    return change


CHANGES: tuple[Callable[[Any, str], Any], ...] = (
    lambda table, name: table.drop_columns([name]),
    lambda table, name: table.rename_columns([n + "x" if n == name else n for n in table.column_names]),
    lambda table, name: table.slice(0, table.num_rows // 2),
    lambda table, name: table.slice(0, 0),
    lambda table, name: table.take(list(range(table.num_rows)) * 2),
    lambda table, name: table.take(list(range(table.num_rows))[::-1]),
    _values(_some(float("nan"))),
    _values(_some(float("inf"))),
    _values(_some(1e300)),
    _values(_some(-1)),
    _values(_some(0)),
    _values(_some(200)),
    _values(_some(2**31)),
    _values(lambda values: values.astype("f4")),
    _values(lambda values: values.astype(str)),
    _values(lambda values: [None] * len(values)),
)


def forged(data: bytes, place: str, number: int) -> bytes:
    """The file with one operation done; as it was where that cannot be."""
    return (
        _json(data, [int(k) for k in place.split(".")], number)
        if data[:1] == b"{"
        else _table(data, int(place), number)
    )


def _json(data: bytes, way: list[int], number: int) -> bytes:
    try:
        whole = json.loads(data)
        inside = whole
        for k in way[:-1]:
            inside = inside[_key(inside, k)]
        last = _key(inside, way[-1])
        if VALUES[number] is REMOVED:
            del inside[last]
        else:
            inside[last] = VALUES[number]
    except (ValueError, TypeError, LookupError):
        return data
    return json.dumps(whole).encode()


def _key(inside: Any, k: int) -> Any:
    return list(inside)[k] if isinstance(inside, dict) else k


def _table(data: bytes, at: int, number: int) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(BytesIO(data))
        made = CHANGES[number](table, table.column_names[at])
        out = BytesIO()
        pq.write_table(made.replace_schema_metadata(table.schema.metadata), out)
    except (ValueError, TypeError, LookupError, pa.ArrowException, OverflowError):
        return data
    return out.getvalue()


def forgery(files: Mapping[str, bytes], rng: random.Random) -> str:
    """One or two operations, drawn by `rng`."""
    made = []
    for _ in range(rng.choice((1, 1, 2))):
        stages = sorted({n.split("/")[2] for n in files})
        stage = rng.choice(stages)
        name = rng.choice(sorted(n for n in files if n.split("/")[2] == stage))
        if name.endswith(".parquet"):
            import pyarrow.parquet as pq

            columns = len(pq.read_schema(BytesIO(files[name])).names)
            made.append(f"{name}:{rng.randrange(columns)}@{rng.randrange(len(CHANGES))}")
        else:
            made.append(f"{name}:{_way(json.loads(files[name]), rng)}@{rng.randrange(len(VALUES))}")
    return ";".join(made)


def _way(whole: Any, rng: random.Random) -> str:
    """A way to some value, mostly into what a receipt says of its part."""
    keys = list(whole)
    way = [keys.index("meta") if whole.get("meta") and rng.random() < 0.8 else rng.randrange(len(keys))]
    inside = whole[keys[way[0]]]
    while isinstance(inside, dict | list) and inside and (len(way) == 1 or rng.random() < 0.6):
        way.append(rng.randrange(len(inside)))
        inside = inside[_key(inside, way[-1])]
    return ".".join(map(str, way))
