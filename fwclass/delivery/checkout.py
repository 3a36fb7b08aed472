"""Delivered tiles given out for editing: copies, a QGIS project, the classes that they had, and a note of their run."""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery, open_run
from fwclass.errors import ConfigError, InputError, StoreError, first_line, nearest, several, system_error
from fwclass.formats.echo_labels import EchoLabels, echo_labels_bytes
from fwclass.grid import TileGrid
from fwclass.publish.files import whole_directory
from fwclass.publish.qgis import MapLayer, write_project
from fwclass.publish.qgis_layers import cloud_styles
from fwclass.schema import IDENTITY, PLACE
from fwclass.store.atomic import file_digest, read_json, sync, write_bytes, write_json
from fwclass.store.directory import MANIFEST

NOTE, PROJECT, ENDING = "checkout.json", "checkout.qgz", ".copc.laz"
MOST_NOTE = 10_000_000
"""Bytes of a note that is read; one of ten thousand tiles has a tenth."""

LATEST = 2**53
"""Microseconds since 1970: in 2255."""


@dataclass(frozen=True)
class Note:
    """What a directory of tiles was made from.

    Attributes
    ----------
    run : absolute path of the run directory.
    survey, generation : names of the survey and of the delivery.
    tiles : keys, and the digest of the file of each with the classes that it had.
    collected : when changes were collected, microseconds since 1970 (UTC); rows of corrections with such a time are
        this directory's.
    """

    run: str
    survey: str
    generation: str
    tiles: Mapping[str, str]
    collected: tuple[int, ...] = ()


def tile_file(directory: Path, tile: str) -> Path:
    """The tile that is edited."""
    return directory / f"{tile}{ENDING}"


def labels_file(directory: Path, tile: str) -> Path:
    """The classes that the tile's echoes had."""
    return directory / "labels" / f"{tile}.parquet"


def least_sure_tiles(run: Path, count: int) -> frozenset[str]:
    """The keys of the `count` tiles that the report lists as least sure, or of all that it lists if these are fewer.

    `InputError`: `run` is no run that has delivered, or its delivery has no confidences (``--workflow ground``).
    """
    delivery = open_run(run)
    listed = (delivery.report.get("sureness") or {"tiles": []})["tiles"]
    if not listed:
        raise InputError(
            "no tile of this delivery has a confidence",
            where=delivery.path,
            expected="a delivery of classified echoes",
            do="name tiles with --tiles",
        )
    return frozenset(str(one["tile"]) for one in listed[:count])


def check_out(run: Path, directory: Path, tiles: Iterable[str]) -> str:
    """Copy tiles of the current delivery to a new directory; a sentence of what is there now.

    `InputError`: `run` is no run that has delivered, or a tile of it is damaged. `ConfigError`: the directory is not
    empty, or there is no such tile.
    """
    delivery, keys = open_run(run), sorted(set(tiles))
    by_key = {str(t["tile"]): t for t in delivery.tiles}
    for key in keys:
        if key not in by_key:
            raise ConfigError(
                "no such tile in this delivery",
                where=delivery.path,
                expected="names of files in laz/tiles",
                got=key,
                do=nearest(key, list(by_key)[:50]),
            )
    with whole_directory(directory) as beside:
        labels = {key: _copy_tile(delivery, Path(by_key[key]["file"]), key, beside) for key in keys}
        _write_project(delivery, [by_key[key] for key in keys], beside)
        note = Note(str(delivery.root), delivery.report["survey"], delivery.path.name, labels)
        write_json(beside / NOTE, asdict(note))
    echoes = sum(int(by_key[key]["echoes"]) for key in keys)
    size = sum(tile_file(directory, key).stat().st_size for key in keys)
    collect = shlex.join(("fwclass", "label", "collect", str(directory)))
    return (
        f"{several(len(keys), 'tile')} of delivery {delivery.path.name}, {echoes:,} echoes, {size / 1e6:,.1f} MB: open "
        f"{directory / PROJECT} in QGIS, change classes, save, then `{collect}`"
    )


def _copy_tile(delivery: Delivery, source: Path, tile: str, directory: Path) -> str:
    """Copy a tile, and keep the classes that it has; the digest of their file."""
    copy, name = tile_file(directory, tile), source.relative_to(delivery.path).as_posix()
    shutil.copyfile(source, copy)  # never a link: QGIS writes into the file itself
    sync(copy)
    if file_digest(copy) != read_json(delivery.path / MANIFEST)["files"][name]["digest"]:
        raise InputError(
            "a delivered tile is damaged",
            where=source,
            expected="the bytes of its manifest",
            got="others",
            do="run the survey again with --verify: what is damaged is made anew",
        )
    columns = table_columns(delivery.table(tile), (*IDENTITY, *PLACE, "classification"))
    labels = EchoLabels.of(columns, columns["classification"], 0, "")
    write_bytes(labels_file(directory, tile), echo_labels_bytes(labels))
    return file_digest(labels_file(directory, tile))


def _write_project(delivery: Delivery, tiles: list[dict[str, Any]], directory: Path) -> None:
    names = {int(c["code"]): str(c["name"]) for c in delivery.report["classes"]}
    layers = [
        MapLayer(str(t["tile"]), "copc", tile_file(Path(), t["tile"]).name, cloud_styles(names)["classes"], shown=True)
        for t in tiles
    ]
    bounds = np.array([t["bounds"] for t in tiles])
    edges = (*bounds[:, :2].min(axis=0).tolist(), *bounds[:, 3:5].max(axis=0).tolist())
    title = f"{delivery.report['survey']}, to be corrected"
    write_project(title, {"Echoes": layers}, edges, directory / PROJECT, delivery.crs)


def read_note(directory: Path) -> Note:
    """The note of a directory; `InputError` where it has none, or a damaged one."""
    path = directory / NOTE
    if not path.is_file():
        raise InputError(
            "no tiles were checked out to this directory",
            where=directory,
            expected=f"a note, {NOTE}, beside the tiles",
            got="none" if directory.is_dir() else "no directory",
            do="name the directory that `fwclass label checkout` made",
        )
    try:
        if path.stat().st_size > MOST_NOTE:
            raise ValueError(f"{path.stat().st_size} bytes")
        plain = json.loads(path.read_bytes())
        texts = {n: plain[n] for n in ("run", "survey", "generation")}
        tiles, times = plain["tiles"], plain["collected"]
        if not all(isinstance(v, str) for v in (*texts.values(), *tiles, *tiles.values())):
            raise ValueError("text is wanted")
        if not Path(texts["run"]).is_absolute():
            raise ValueError(f"the run {texts['run']!r} has no absolute path")
        for key in tiles:
            TileGrid(1.0).tile(key)  # they become names of files
        if not all(type(t) is int and 0 <= t < LATEST for t in times):
            raise ValueError("times are wanted")
        return Note(**texts, tiles=dict(tiles), collected=tuple(times))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, ConfigError) as fault:
        raise InputError(
            "the note of a checkout cannot be read",
            where=path,
            got=first_line(fault),
            do="it was changed or damaged: check the tiles out again, to another directory",
        ) from fault


def add_time(directory: Path, note: Note, time: int) -> None:
    """Note that changes were collected at `time`; `StoreError` where the directory cannot be written to."""
    try:
        write_json(directory / NOTE, asdict(replace(note, collected=(*note.collected, time))))
    except OSError as fault:
        raise StoreError(
            "the directory must know when it was collected from, and cannot be written to",
            where=directory,
            got=system_error(fault),
            do="ask for the right to write there; nothing was collected",
        ) from fault
