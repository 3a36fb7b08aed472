"""A delivery as an object: echoes, rasters, tiles, the report, waveforms, and why an echo has its class."""

from __future__ import annotations

import numbers
import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from fwclass.delivery.echoes import Bounds, Echoes, require_box
from fwclass.delivery.explain import Explanation, explain
from fwclass.delivery.rasters import Raster, read_raster
from fwclass.delivery.waves import Waveform, waveform_of
from fwclass.errors import InputError
from fwclass.formats.geoparquet import header as geoparquet_header
from fwclass.schema import IDENTITY
from fwclass.store.atomic import read_json
from fwclass.store.bucket import Remote
from fwclass.store.delivered import REPORT, TILES, check_shape
from fwclass.store.digests import digest_now
from fwclass.store.directory import CURRENT, MANIFEST
from fwclass.store.generations import Generation, Generations, Manifest, manifest_files
from fwclass.store.history import is_run
from fwclass.store.run_location import RunLocation
from fwclass.store.run_store import Store

CATALOGUE = "laz/survey.vpc"
EDGE = 1.0
"""Coordinates of a tile's files are rounded, each in its way: its echoes lie within its bounds to so many metres."""

REPAIR = "run the survey again with --verify: what is damaged is made anew"


class Delivery:
    """What a run delivered, as it stood when it was opened: a run that goes on meanwhile changes nothing of it.

    Nothing is read before it is asked for, and nothing is written. Coordinates are those of the survey's CRS [m];
    a missing value is NaN. `root` is the run, `path` the delivery on this host: of one on object storage what was asked
    for. What is removed after it was opened, by hand or because newer deliveries took its place, raises an
    `InputError` when it is asked for.
    """

    def __init__(self, root: RunLocation, generation: Path, listed: Manifest, far: Far | None = None) -> None:
        self.root, self.path, self._listed, self._far = root, generation, listed, far

    def __repr__(self) -> str:
        return f"Delivery({str(self.root)!r}, {self.path.name})"

    def echoes(self, box: Bounds | None = None, columns: Sequence[str] | None = None, where: Any = None) -> Echoes:
        """Classified echoes, to be had as pyarrow, pandas, geopandas or Dask.

        Tiles that the box touches are held to the digests of the manifest, once a process.

        `box`: xmin, ymin, xmax, ymax [m], half-open; None for everywhere. `columns`: names; None for all. `where`: a
        pyarrow expression, or a list of (column, operator, value), all of which hold.

        `InputError`: there is no such column, the box is none, or a tile is damaged.
        """
        self._part("parquet")
        box = None if box is None else require_box(box)
        return Echoes([self.file(name) for name in self._tables(box)], box, columns, where)

    def _tables(self, box: Bounds | None) -> list[str]:
        """Names of the Parquet files of all tiles, or of those that a box touches: one at least, for its columns."""
        tables = sorted(n for n in self._listed if n.startswith("parquet/") and n.endswith(".parquet"))
        for name in tables:
            self._there(name)
        if box is None or CATALOGUE not in self._listed:
            return tables
        xmin, ymin, xmax, ymax = box
        beside = {
            f"parquet/{t['tile']}.parquet"
            for t in self.tiles
            for west, south, _, east, north, _ in [t["bounds"]]
            if west - EDGE > xmax or east + EDGE < xmin or south - EDGE > ymax or north + EDGE < ymin
        }
        return [n for n in tables if n not in beside] or tables[:1]

    def table(self, tile: str) -> Path:
        """The Parquet file of a tile, on this host."""
        return self.file(f"parquet/{tile}.parquet")

    def file(self, name: str) -> Path:
        """A file on this host, whether or not the delivery has it; `InputError` where it has, and the file is gone or
        has other bytes."""
        if self._far is not None:
            self._far([name])
        path = self._there(name)
        if name in self._listed:
            self._check(path, str(self._listed[name]["digest"]))
        return path

    def lists(self, name: str) -> bool:
        """Whether the delivery's manifest names a file, which is not looked at."""
        return name in self._listed

    def _check(self, path: Path, digest: str) -> None:
        try:
            got = digest_now(path)
        except FileNotFoundError:
            raise self._gone(path.relative_to(self.path).as_posix()) from None
        if got != digest:
            raise InputError(
                "a file of this delivery is damaged",
                where=path,
                expected=f"bytes of digest {digest}",
                got=f"bytes of digest {got}",
                do=REPAIR,
            )

    def _there(self, name: str) -> Path:
        """A file, which is there if the delivery has it."""
        path = self.path / name
        if name in self._listed and not path.is_file():
            raise self._gone(name)
        return path

    def _gone(self, name: str) -> InputError:
        removed = not self.path.is_dir()
        return InputError(
            "this delivery is there no more" if removed else "a file of this delivery is gone",
            where=self.path if removed else self.path / name,
            do="open the run again: of its deliveries the last `run.keep_generations` stay" if removed else REPAIR,
        )

    def raster(self, name: str) -> Raster:
        """``classes, confidence, density, dtm, dsm, ndsm, hillshade, slope, roughness, dtm_mask`` or
        ``dtm_distance``; of a survey of several places ``PLACE/dtm`` and so on.

        `InputError`: there is no such raster.
        """
        directory = self._part("rasters")
        self.file(f"rasters/{name}.tif")
        return read_raster(directory, name)

    def waveform(self, strip: int, pulse: int) -> Waveform:
        """The recorded waveform of a pulse, and the echoes that were found in it.

        `strip`, `pulse`: as the echoes have them.

        `InputError`: the run has no such waveform, or keeps none.
        """
        return waveform_of(
            self._store, self.echoes(where=[("strip", "==", strip), ("pulse", "==", pulse)]), strip, pulse
        )

    def explain(self, echo: tuple[int, int, int] | Mapping[str, Any]) -> Explanation:
        """Why an echo has its class: the share of every class, and what each feature did to it.

        `echo`: (strip, pulse, echo_number), or a row that has these.

        `InputError`: there is no such echo, or one of the three is missing or no whole number.
        """
        row = echo if isinstance(echo, Mapping) else dict(zip(IDENTITY, echo, strict=False))
        if not row.keys() >= set(IDENTITY) or not all(_is_whole(row[name]) for name in IDENTITY):
            raise InputError(
                "this names no echo",
                where="explain",
                expected=f"{', '.join(IDENTITY)}, whole numbers",
                got=", ".join(f"{name}: {value}" for name, value in row.items()) or "none",
            )
        tiles = lambda: (t["tile"] for t in self.tiles)  # noqa: E731 (the list of tiles is read where it is needed)
        return explain(self._store, self._part("model"), row, tiles, self.table)

    @cached_property
    def report(self) -> dict[str, Any]:
        """``report.json``: accuracy, counts, inputs, settings."""
        path = self.file("report.json")
        return dict(check_shape(read_json(path), REPORT, path))

    @cached_property
    def classes(self) -> list[dict[str, Any]]:
        """The classes that the model gives: ``name, code``, and ``codes``, those of the reference that count as it."""
        model = self.report["model"]
        return list(model.get("classes", self.report["config"]["survey"]["classes"]))

    @property
    def correctable(self) -> dict[int, str]:
        """Names of the classes that a correction can give an echo, by code: those that a run learns from labels.

        The codes of unsure echoes (`classify.leave`), of those that keep their source's class, and of a ground filter
        are none.
        """
        classes = self.classes if self.has_model else self.report["config"]["survey"]["classes"]
        return {int(c["code"]): str(c["name"]) for c in classes if c["codes"]}

    @property
    def has_model(self) -> bool:
        """Whether a model gave the classes; else (``--workflow ground``) a ground filter did."""
        return self.report["model"].get("features") != []

    @cached_property
    def tiles(self) -> list[dict[str, Any]]:
        """Every tile: ``tile, file, echoes, bounds`` (xmin, ymin, zmin, xmax, ymax, zmax), ``height`` (mean z [m])."""
        listed = self.file(CATALOGUE)
        listed = listed if listed.is_file() else self._part("laz") / listed.name
        catalogue = check_shape(read_json(listed), TILES, listed)
        return [
            {
                "tile": item["id"],
                "file": str(self.path / "laz" / item["assets"]["data"]["href"].removeprefix("./")),
                "echoes": item["properties"]["pc:count"],
                "bounds": tuple(item["properties"]["proj:bbox"]),
                "height": next(f["average"] for f in item["properties"]["pc:statistics"] if f["name"] == "Z"),
            }
            for item in catalogue["features"]
        ]

    @cached_property
    def crs(self) -> Any:
        """The survey's coordinate system (`pyproj.CRS`), None where it names none."""
        tile = next((self.table(t["tile"]) for t in self.tiles), None)
        return geoparquet_header(tile)["crs"] if tile is not None else None

    @cached_property
    def _store(self) -> Store:
        return Store(self.root, read_only=True)

    def _part(self, name: str) -> Path:
        if self._far is not None:
            self._far([f"{name}/"])
        path = self.path / name
        if not self.path.is_dir():
            raise self._gone(name)
        if not path.exists():
            there = sorted(p.name for p in self.path.iterdir())
            raise InputError(
                f"this delivery has no {name}",
                where=self.path,
                expected=name,
                got=", ".join(there) or "nothing",
                do="a run of another workflow or of chosen tiles, or one with a given model, delivers a part alone; "
                "run the whole survey",
            )
        return path


def open_run(run: str | os.PathLike[str] | Remote) -> Delivery:
    """The current delivery of a run directory.

    `run`: the directory that ``fwclass run`` wrote to.

    `InputError`: it is no run, has delivered nothing yet, is on object storage, or files of the delivery are gone.
    """
    if isinstance(run, Remote):
        return open_at(run)
    text = _path_of(run)
    if "://" in text:
        raise InputError(
            "a run on object storage cannot be opened in place",
            where=text,
            expected="a directory",
            got="an address",
            do="look at it with `fwclass view`, copy the delivery first, for example `rclone copy "
            "REMOTE:bucket/run/generations/0001 copy`, and open the copy, or read its Parquet with DuckDB",
        )
    root = Path(text).resolve()
    if not root.is_dir():
        got = "a file" if root.exists() else "none"
        raise InputError("there is no such run", where=root, expected="a directory", got=got, do="check the path")
    return open_at(root)


def _is_whole(value: object) -> bool:
    return isinstance(value, numbers.Real) and float(value).is_integer()


def _path_of(run: object) -> str:
    """`run` as text; `InputError` for what is no path."""
    text = os.fspath(run) if isinstance(run, (str, os.PathLike)) else None
    if not isinstance(text, str) or "\0" in text:
        raise InputError("this is no path", where="open", expected="the directory of a run", got=repr(run)[:80])
    return text


def open_delivery(run: str | os.PathLike[str]) -> Delivery:
    """The current delivery of a run directory, or a delivery that was copied out of one (``cp -rL RUN/current COPY``).

    A copy has echoes, tiles, rasters and the report; waveforms and votes stay with the run.

    `run`: the directory that ``fwclass run`` wrote to, or a copy of its delivery.

    `InputError`: it is neither, has delivered nothing yet, is on object storage, or files of the delivery are gone.
    """
    text = _path_of(run)
    copy = Path(text)
    if "://" in text or is_run(copy) or not (copy / MANIFEST).is_file():
        return open_run(run)
    copy = copy.resolve()
    try:
        listed = manifest_files((copy / MANIFEST).read_bytes())
    except (OSError, ValueError) as fault:
        raise InputError(
            "the manifest of a copied delivery cannot be read",
            where=copy / MANIFEST,
            got=f"{type(fault).__name__}: {fault}"[:200],
            do="copy the delivery again",
        ) from fault
    gone = [n for n, f in listed.items() if not (copy / n).is_file() or (copy / n).stat().st_size != f["bytes"]]
    if gone:
        raise _damaged(copy, gone, "copy it again")
    return Delivery(copy, copy, listed)


def _damaged(where: object, gone: Sequence[str], do: str) -> InputError:
    return InputError(
        "the delivery is damaged",
        where=where,
        expected="every file of its manifest, with its size",
        got=", ".join(gone[:3]) or "no manifest",
        do=do,
    )


def open_at(root: RunLocation) -> Delivery:
    """The current delivery of a run, in a directory or on object storage: there files are fetched when they are asked
    for, and kept for the next time.

    `InputError`: there is no delivery, or files of it are gone. `StoreError`: object storage does not answer.
    """
    store = Store(root, read_only=True)
    generations = store.generations
    current = generations.current()
    if current is None and isinstance(root, Path) and (root / CURRENT).is_symlink():
        raise _damaged(root / CURRENT, ["nothing where the link leads to"], REPAIR)
    if current is None:
        under_way = (root / "store").is_dir() if isinstance(root, Path) else bool(store.parts())
        raise InputError(
            "this run has delivered nothing yet" if under_way else "this is not a run directory",
            where=root,
            expected=f"a link `{CURRENT}` to a delivery",
            got="a run under way, or one that was interrupted" if under_way else "no store",
            do="wait for `fwclass run` to end, or run it again: it goes on where it was"
            if under_way
            else "name the directory that was given as --out",
        )
    listed = generations.manifest(current)
    gone = generations.lacking(current, listed or {})
    if listed is None or gone:
        raise _damaged(current.where, gone, REPAIR)
    far = Far(generations, current, listed) if isinstance(root, Remote) else None
    return Delivery(root, current.path, listed, far)


class Far:
    """Fetches files of a delivery on object storage."""

    def __init__(self, generations: Generations, generation: Generation, listed: Manifest) -> None:
        self._generations, self._generation, self._listed = generations, generation, listed

    def __call__(self, names: Sequence[str]) -> None:
        """The files of these names, and for one that ends with ``/`` all below it; what is not there is passed over."""
        below = tuple(name for name in names if name.endswith("/"))
        files = {n: f for n, f in self._listed.items() if n in names or n.startswith(below)}
        if files:
            self._generations.files.fetch(self._generation.key, files)
