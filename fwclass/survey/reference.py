"""The reference's files, found and checked before anything is computed: another cloud, polygons, labels by echo."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError, several
from fwclass.formats.crs import crs_of_wkt
from fwclass.formats.echo_labels import FIELD, MOST_BYTES, check_echo_labels, read_echo_labels
from fwclass.formats.wkb import Shapes
from fwclass.grid import Box, TileGrid, joint_box
from fwclass.ground.stage import TERRAIN
from fwclass.label.corrections import reference_codes
from fwclass.label.values import codes_of
from fwclass.params import ShapeFileParams
from fwclass.paths import below, open_sized
from fwclass.read.polygons import (
    check_field,
    open_polygons,
    read_lines,
    read_polygons,
    reproject,
    source_crs,
    values_of,
)
from fwclass.read.projection import box_brought
from fwclass.read.source import open_source
from fwclass.read.stage import with_settings
from fwclass.store.atomic import write_bytes
from fwclass.store.corrections import CORRECTIONS
from fwclass.store.receipts import Receipt
from fwclass.store.remote_file import Location, find_remote, local
from fwclass.store.run_store import Store
from fwclass.store.url import Url
from fwclass.survey.area_of_interest import edges, shares_area
from fwclass.survey.file_digests import Digests
from fwclass.survey.files import box_text, joint_bounds
from fwclass.survey.layout import FileDigests, PolygonFile
from fwclass.survey.systems import given_crs
from fwclass.water.along import Bounds, check_lines
from fwclass.water.shore import check_bodies


def reference_clouds(
    config: Config, directory: Path | Url, digests: Digests, box: Box
) -> tuple[tuple[Location, FileDigests, int], ...]:
    """The reference's clouds, with their digests and points; `InputError` where they lie elsewhere than `box`."""
    if config.survey.reference.kind != "cloud":
        return ()
    files = digests.find(config.survey.reference.files, directory, "survey.reference.files", config)
    opened = [with_settings(open_source(local(p)), config.read) for p in files]
    place = joint_bounds([box_brought(s, s.bounds) for s in opened])
    if not place.grown(config.label.max_distance).touches(box):
        raise InputError(
            "the reference lies in another place than the survey",
            where=", ".join(str(f) for f in files),
            expected=f"points around {box_text(box)}",
            got=box_text(place),
            do="check survey.reference.files and the files' coordinate systems",
        )
    return tuple((p, digests.of([local(p)], p), s.n_points) for p, s in zip(files, opened, strict=True))


def reference_polygons(
    config: Config, directory: Path | Url, digests: Digests, crs: str | None, say: Callable[[str], None]
) -> tuple[PolygonFile, ...]:
    """The reference's files of polygons, each with its class field, in a system that is known; one that names two is
    told by `say`."""
    reference = config.survey.reference
    user_crs = given_crs(reference.crs, "survey.reference.crs")
    if reference.kind != "polygons":
        return ()
    survey = crs_of_wkt(crs)
    files = []
    for place in digests.find(reference.files, directory, "survey.reference.files", config):
        path = local(place)
        opened = open_polygons(path, reference.layer)
        field = reference.field or ""
        check_field(opened, field)
        codes_of(values_of(opened, [field])[field], reference.values, config.classes, f"{path}: field {field}")
        system = source_crs(opened, user_crs, survey, say=say)
        files.append(
            PolygonFile(
                place, digests.of(opened.files, place), opened.layer, system.to_wkt() if system is not None else None
            )
        )
    return tuple(files)


_WHAT = {"water": "water", "breaklines": "breakline", "quality.area": "area that was to be flown"}


def shape_file(
    section: Literal["water", "breaklines", "quality.area"],
    section_params: ShapeFileParams,
    config: Config,
    directory: Path | Url,
    digests: Digests,
    crs: str | None,
    box: Box,
    say: Callable[[str], None],
) -> PolygonFile | None:
    """The file that a section of the configuration names, one with two systems told by `say`; `InputError` for
    breaklines without heights, and where none of its shapes lies in the survey's `box` [m]."""
    user_crs = given_crs(section_params.crs, f"{section}.crs")
    if section_params.file is None:
        return None
    survey = crs_of_wkt(crs)
    places = digests.find([section_params.file], directory, f"{section}.file", config)
    if len(places) > 1:
        raise InputError(
            f"{section}.file is one file", where=config.path, got=f"{len(places)} files match", do="name one"
        )
    path = local(places[0])
    opened = open_polygons(path, section_params.layer, f"{section}.layer")
    name_crs = f"--set {section}.crs=EPSG:<code>"
    system = source_crs(opened, user_crs, survey, name_crs, say)
    shapes = read_lines(opened)[0] if section == "breaklines" else read_polygons(opened, None)[1]
    if system is not None and survey is not None:
        shapes, _ = reproject(shapes, system, survey, path, name_crs)
    a, b = edges(shapes.x, shapes.y, shapes.ring_start)
    low, high = np.array(box.bounds[:2]), np.array(box.bounds[2:])
    near = ((np.maximum(a, b) >= low) & (np.minimum(a, b) <= high)).all(axis=1).any()
    if not (shares_area(box, a, b) if section != "breaklines" and len(a) else near):
        raise InputError(
            f"no {_WHAT[section]} lies in the survey",
            where=path,
            expected=f"shapes that meet {box_text(box)}",
            got=f"{several(shapes.parts, 'shape')}{_reach(shapes)}",
            do=f"check the file, and its coordinate system ({section}.crs)",
        )
    if section == "water":
        check_bodies(shapes.parts, path)
    if section != "quality.area":
        check_lines(shapes.x, shapes.y, shapes.ring_start, config.terrain.thin, _around(box, config), path)
    wkt = system.to_wkt() if system is not None else None
    return PolygonFile(places[0], digests.of(opened.files, places[0]), opened.layer, wkt)


def _reach(shapes: Shapes) -> str:
    """Where shapes lie, "" for none."""
    ends = [float(f(v)) for f in (np.min, np.max) for v in (shapes.x, shapes.y)] if len(shapes.x) else []
    return f" in {box_text(Box(*ends))}" if ends else ""


def _around(box: Box, config: Config) -> Bounds:
    """What blocks of the terrain read, and shores, of a survey in `box` (`graph.water.near_echoes`)."""
    terrain, grid = config.terrain, TileGrid(config.terrain.block)
    xmin, ymin, xmax, ymax = box.bounds
    blocks = joint_box(grid.tile(key).box for key in grid.keys(np.array([xmin, xmax]), np.array([ymin, ymax])))
    return blocks.grown(terrain.block + TERRAIN.halo(terrain) + config.water.shore).bounds


def reference_echo_labels(
    config: Config, directory: Path | Url, digests: Digests
) -> tuple[tuple[Location, FileDigests], ...]:
    """The reference's files of labels by echo."""
    reference = config.survey.reference
    if reference.kind != "echoes":
        return ()
    places = digests.find(reference.files, directory, "survey.reference.files", config)
    for place in places:
        check_echo_labels(local(place), reference.field or FIELD)
    return tuple((place, digests.of([local(place)], place)) for place in places)


def reference_corrections(
    config: Config, directory: Path | Url, digests: Digests, store: Store
) -> tuple[Location, FileDigests] | None:
    """What corrects the labels: the file that the configuration names, or that of the run; None for nothing.

    A run goes by them as they are now, though somebody may add to them meanwhile: it reads a copy of its own.
    """
    reference, run = config.survey.reference, store.where
    if reference.kind == "none" or reference.corrections is False:
        return None
    if reference.corrections:
        places = digests.find([reference.corrections], directory, "survey.reference.corrections", config)
    elif isinstance(run, Url):
        places = list(find_remote(CORRECTIONS, run, config.store))
    else:
        places = [run / CORRECTIONS] if (run / CORRECTIONS).is_file() else []
    if len(places) > 1:
        raise InputError(
            "there are several files of corrections, and their order counts",
            where=f"{config.path}: survey.reference.corrections",
            expected="one file",
            got=", ".join(p.name for p in places[:3]),
            do="name one",
        )
    if not places and reference.kind == "corrections":
        raise ConfigError(
            "there are no corrections to learn from",
            where=f"{config.path}: survey.reference.kind",
            expected=f"{CORRECTIONS} in the run directory, or a file that survey.reference.corrections names",
            got=f"none in {run}",
            do="correct or confirm echoes (docs/corrections.md), and run in the same directory",
        )
    if not places:
        return None
    place = places[0]
    if isinstance(place, Path) and isinstance(run, Path):
        data = _bytes_of(place)
        _check_corrections(data, place, config)
        copy = _copied(place, data, store)
        return copy, digests.of_copy(copy, place)
    _check_corrections(local(place), place, config)
    return place, digests.of([local(place)], place)


def _bytes_of(path: Path) -> bytes:
    stream, size = open_sized(path)
    with stream:
        if size > MOST_BYTES:
            raise InputError("too large a file of corrections", where=path, expected=f"{MOST_BYTES} bytes", got=size)
        return stream.read(size)


def _check_corrections(source: Path | bytes, place: Location, config: Config) -> None:
    labels = read_echo_labels(source, place).standing()
    reference_codes(labels.code[labels.code >= 0], config.classes, place)


def _copied(path: Path, data: bytes, store: Store) -> Path:
    """The bytes of the file where they go with what else a run leaves behind; itself where nothing is written."""
    if store.read_only:
        return path
    copy = below(store.root, "store/staging/read/corrections.parquet")
    write_bytes(copy, data, flush=False)
    return copy


def check_polygons(config: Config, polygons: Iterable[Receipt], box: Box) -> None:
    """`InputError` where no polygon with a code touches the survey's `box` [m]."""
    places = [Box(*r.meta["bounds"]) for r in polygons if r.meta["bounds"]]
    if places and not any(p.grown(0.001).touches(box) for p in places):
        raise InputError(
            "the reference polygons lie in another place than the survey",
            where=f"{config.path}: survey.reference.files",
            expected=f"polygons that touch {box_text(box)}",
            got=", ".join(box_text(p) for p in places),
            do="check the files, and their coordinate system (survey.reference.crs)",
        )
