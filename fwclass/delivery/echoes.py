"""Echoes of a delivery: chosen by place, column and condition, read when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from fwclass.errors import InputError, first_line, nearest, several
from fwclass.lazy_module import LazyModule

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.dataset as ds
    import pyarrow.parquet as pq
else:
    pa, pc = LazyModule("pyarrow"), LazyModule("pyarrow.compute")
    ds, pq = LazyModule("pyarrow.dataset"), LazyModule("pyarrow.parquet")

_DAMAGE = OSError, ValueError, LookupError, TypeError, NotImplementedError
"""What Arrow raises: its own are some of these."""

Bounds = tuple[float, float, float, float]
GEOMETRY = ("geometry", "bbox")


def require_box(box: object) -> Bounds:
    """`box`, xmin, ymin, xmax, ymax [m]; `InputError` for what is none, or holds nothing."""
    try:
        xmin, ymin, xmax, ymax = (float(bound) for bound in box)  # type: ignore[attr-defined]
    except (TypeError, ValueError) as fault:
        expected = "xmin, ymin, xmax, ymax [m]"
        raise InputError("this is no box", where="box", expected=expected, got=repr(box)[:80]) from fault
    if not (xmin < xmax and ymin < ymax):
        raise InputError("this box holds nothing", where="box", expected="xmin < xmax, ymin < ymax", got=box)
    return xmin, ymin, xmax, ymax


class Echoes:
    """A choice of echoes; `len` counts them, the other methods read them."""

    def __init__(self, files: Sequence[Path], box: Bounds | None, columns: Sequence[str] | None, where: Any) -> None:
        self._files = [str(f) for f in files]
        self._data = self._read(lambda: ds.dataset(self._files, format="parquet"))
        names = self._data.schema.names
        for name in columns or ():
            if name not in names:
                raise InputError("there is no such column", where="columns", got=name, do=nearest(name, names))
        self.columns = list(columns) if columns is not None else [n for n in names if n not in GEOMETRY]
        self._filter = self._condition(box, where)

    def __repr__(self) -> str:
        tiles, columns = several(len(self._files), "tile"), several(len(self.columns), "column")
        return f"Echoes({len(self):,} echoes of {tiles}, {columns})"

    def _condition(self, box: Bounds | None, where: Any) -> Any:
        try:
            condition = pq.filters_to_expression(where) if isinstance(where, (list, tuple)) else where
        except (ValueError, TypeError) as fault:
            raise InputError(
                "this is no condition",
                where="where",
                expected="triples of column, operator (==, !=, <, >, <=, >=, in, not in) and value, or a pyarrow "
                "expression",
                got=first_line(fault),
            ) from fault
        if isinstance(where, (list, tuple)):
            self._check_names(where)
        if box is None:
            return condition
        xmin, ymin, xmax, ymax = box
        x, y = pc.field("x"), pc.field("y")
        inside = (x >= xmin) & (x < xmax) & (y >= ymin) & (y < ymax)
        return inside if condition is None else inside & condition

    def _check_names(self, where: Any) -> None:
        """`InputError` for a column of triples, or of lists of triples, that there is not."""
        names = self._data.schema.names
        for one in where:
            if len(one) == 3 and isinstance(one[0], str):
                if one[0] not in names:
                    raise InputError("there is no such column", where="where", got=one[0], do=nearest(one[0], names))
            else:
                self._check_names(one)

    def __len__(self) -> int:
        return int(self._read(lambda: self._data.count_rows(filter=self._filter)))

    def _read(self, work: Callable[[], Any]) -> Any:
        return _reading(self._files, work)

    def to_arrow(self) -> pa.Table:
        """A pyarrow table; metadata of its fields tell unit and meaning."""
        return self._read(lambda: self._data.to_table(columns=self.columns, filter=self._filter))

    def to_pandas(self) -> Any:
        """A pandas data frame."""
        return self.to_arrow().to_pandas()

    def to_geopandas(self) -> Any:
        """A geopandas frame with points and the survey's CRS; needs geopandas."""
        import json

        geopandas = _needed("geopandas")
        import pyproj

        columns = list(dict.fromkeys([*self.columns, "geometry"]))
        table = self._read(lambda: self._data.to_table(columns=columns, filter=self._filter))
        about = json.loads(self._data.schema.metadata[b"geo"])["columns"]["geometry"]
        crs = pyproj.CRS.from_json_dict(about["crs"]) if about["crs"] else None
        points = geopandas.GeoSeries.from_wkb(table["geometry"].to_pandas(), crs=crs)
        return geopandas.GeoDataFrame(table.select(self.columns).to_pandas(), geometry=points)

    def dask(self) -> Any:
        """A Dask data frame with a partition a tile; needs pandas."""
        _needed("pandas")
        from fwclass.run.cluster import data_frame

        return data_frame(_Part(self.columns, self._filter), self._files)


class _Part:
    """Reads one tile; it travels to Dask's workers."""

    def __init__(self, columns: list[str], condition: Any) -> None:
        self.columns, self.condition = columns, condition

    def __call__(self, file: str) -> Any:
        def table() -> Any:
            return ds.dataset(file, format="parquet").to_table(columns=self.columns, filter=self.condition)

        return _reading([file], table).to_pandas()


def _reading(files: Sequence[str], work: Callable[[], Any]) -> Any:
    """What `work` reads of the `files`; `InputError` with the one that cannot be read any more."""
    try:
        return work()
    except _DAMAGE as fault:
        for file in files:
            _check_readable(Path(file))
        if isinstance(fault, (pa.ArrowNotImplementedError, pa.ArrowTypeError)):
            raise InputError(
                "a condition compares a column with what it cannot be compared with",
                where="where",
                expected="numbers for columns of numbers; true or false for `ground` and `noise`",
                got=first_line(fault),
            ) from fault
        raise InputError("the echoes cannot be read", where="fwclass.open", got=fault) from fault


def _needed(name: str) -> Any:
    """A library that only some of the methods need."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as fault:
        raise InputError(f"this needs {name}", where="fwclass.open", got=fault, do=f"pip install {name}") from fault


def table_columns(path: Path, names: Sequence[str]) -> dict[str, NDArray]:
    """Columns of a delivered tile as arrays, those of `names` that it has; its rows are those of the store's tile.

    `InputError` where the file is damaged: it was sound when the delivery was opened. One that is gone (the run
    delivered anew) is the system's error.
    """
    with _sound(path), pq.ParquetFile(path) as file:
        there = _there(file, names)
        arrow = file.read(columns=there, use_threads=False)
        return {n: arrow.column(n).to_numpy() for n in there}


def table_row(path: Path, names: Sequence[str], row: int) -> dict[str, Any]:
    """One row of a delivered tile, as `table_columns` has it; only its row group is read."""
    with _sound(path), pq.ParquetFile(path) as file:
        there = _there(file, names)
        group = 0
        while row >= (rows := file.metadata.row_group(group).num_rows):
            group, row = group + 1, row - rows
        arrow = file.read_row_group(group, columns=there, use_threads=False).slice(row, 1)
        return {n: arrow.column(n).to_numpy()[0] for n in there}


def _there(file: pq.ParquetFile, names: Sequence[str]) -> list[str]:
    """Those of the columns that a file has."""
    in_file = set(file.schema_arrow.names)  # which is read from the file's head every time
    return [n for n in names if n in in_file]


@contextmanager
def _sound(path: Path) -> Iterator[None]:
    """`InputError` where a delivered tile is damaged; one that is gone is the system's error."""
    try:
        yield
    except FileNotFoundError:
        raise
    except _DAMAGE as fault:
        raise _damaged(path, fault) from fault


def _check_readable(path: Path) -> None:
    """`InputError` where a tile's file cannot be read."""
    with _sound(path), pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            file.read_row_group(group, use_threads=False)


def _damaged(path: Path, fault: Exception) -> InputError:
    return InputError(
        "a delivered tile cannot be read any more",
        where=path,
        expected="the file that was there when the delivery was opened",
        got=first_line(fault),
        do="run the survey again with --verify: what is damaged is made anew",
    )


def table_fields(path: Path) -> list[dict[str, str]]:
    """Name, unit and meaning of the columns of numbers of a delivered tile."""
    out = []
    with _sound(path), pq.ParquetFile(path) as file:
        for field in file.schema_arrow:
            if field.name not in GEOMETRY:
                about = {k.decode(): v.decode() for k, v in (field.metadata or {}).items()}
                out.append({"name": field.name, "unit": about.get("unit", ""), "meaning": about.get("meaning", "")})
    return out
