"""Stages that deliver echoes: classified tiles as COPC and GeoParquet, and strips."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.kept import Kept
from fwclass.classify.unsure import by_file, by_percent
from fwclass.conf import Config
from fwclass.errors import StoreError, first_few
from fwclass.formats.crs import crs_of_wkt
from fwclass.graph.classify import classes_written
from fwclass.graph.kept import check_written, deciding_column, kept_argument, other_names
from fwclass.graph.radiometry import MEASURE_RADIOMETRY
from fwclass.graph.sources import RETURNS, link_table, spans_of, strip_of, water_columns
from fwclass.graph.stage import Names, Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.tiling import source_codes, tiles_of_strips
from fwclass.publish.copc import write_tile_copc
from fwclass.publish.geoparquet import about_delivery, round_floats, write_geoparquet
from fwclass.publish.laz import without
from fwclass.publish.params import PublishParams
from fwclass.publish.strips import LEGACY_MAX, write_strip_laz
from fwclass.publish.tile_facts import tile_facts
from fwclass.read.quantities import COUNTS, DECIBELS, INTENSITY
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Name
from fwclass.schema import Table
from fwclass.survey.layout import Strip

TILE_COLUMNS = (
    *("x", "y", "z"),
    *("strip", "pulse", "echo_number", "number_of_echoes"),
    *("gps_time", "intensity"),
    *(
        "amplitude",
        "amplitude_sigma",
        "amplitude_db",
        "width",
        "width_sigma",
        "energy",
        "range_sigma",
        "deviation",
        "fit_flags",
    ),
    *("height_above_ground", "ground", "noise"),
    *("classification", "confidence", "entropy"),
)
"""Columns of the delivered tiles, besides the forest's features and radiometry."""

EXACT = ("range", "confidence")
"""Columns that Parquet has as they are: a range's standard error is a hundred-thousandth of it, votes are few."""

TILES, TILE_ENDING = "laz/tiles", ".copc.laz"

NO_BYTE = frozenset({"raster_cache", "figure_pixels", "overview_echoes", "overview_square"})
"""Settings that change no byte of what these parts write."""

_ECHO_BITS = 8
"""Of an echo's key: `echo_number` is a u1."""


def deliver_tile(
    here: StageInputs,
    params: PublishParams,
    crs: str | None,
    standard_time: bool,
    calibrated: bool,
    names: Mapping[str, str],
    repeated: Names = (),
) -> Result:
    """A tile as COPC and as GeoParquet. Without a calibration the COPC has no `reflectance`: other programs show its
    no-data number as a value; nor has it the columns `repeated`, which say what others do. `names` of classes by
    code."""
    table, directory = here.rows(), here.directory
    for name in (TILES, "parquet"):
        (directory / name).mkdir(parents=True)
    path = directory / TILES / f"{here.part}{TILE_ENDING}"
    shown = without(table, repeated if calibrated else (*repeated, "reflectance"))
    called = {int(code): name for code, name in names.items()}
    copc = write_tile_copc(shown, path, crs_of_wkt(crs), params, called, standard_time=standard_time)
    about = about_delivery(called, params.parquet_bits)
    plain = round_floats(table, params.parquet_bits, EXACT)
    write_geoparquet(plain, directory / "parquet" / f"{here.part}.parquet", crs_of_wkt(crs), params, about)
    classified = "confidence" in table
    return {
        "rows": table.rows,
        "beyond": copc["beyond"],
        "facts": tile_facts(table),
        "percent": by_percent(table["confidence"]).tolist() if classified else [],
        "of_files": by_file(table) if classified else {},
        "clipped": copc["clipped"],
        "without_time": copc["without_time"],
    }


def deliver_strip(
    here: StageInputs, params: PublishParams, codes: Mapping[str, int], kept: Kept | None = None
) -> Result:
    """A source strip in its own order with every point's class: that of its nearest echo of the same pulse, or its own
    where that is `kept`.

    `codes` maps class codes to those that the strip's point format can hold.
    """
    spans = here.parts("decompose")
    answers = _answers_of_strip(strip_of(spans[0]), here.parts("tile"), here.inputs)
    classes = np.concatenate([_classes_of_links(answers, here, span) for span in spans])
    legal = np.arange(256, dtype=np.uint8)
    for code, other in codes.items():
        legal[int(code)] = other
    output = here.directory / "laz" / "strips" / f"{here.part}.laz"
    output.parent.mkdir(parents=True)
    answered = legal[classes]
    read = here.parts("read")  # of returns with waveforms several may be one echo's
    if kept and read:
        own = np.concatenate([here.inputs.table("read", c, ("source_class",), RETURNS)["source_class"] for c in read])
        answered = np.where(kept.rows(own), own, answered)
    facts = write_strip_laz(here.file(), output, answered, None, params)
    return {"points": len(classes), "lacking": facts["lacking"]}


def _keys(table: Table) -> NDArray[np.uint64]:
    return (table["pulse"].astype(np.uint64) << np.uint64(_ECHO_BITS)) | table["echo_number"].astype(np.uint64)


def _answers_of_strip(strip: int, tiles: tuple[str, ...], inputs: PartInputs) -> NDArray[np.uint64]:
    """Key and class code (the lowest 8 bits) of every echo of a strip, by key: a strip may have 100 million."""
    columns = {**dict.fromkeys(("strip", "pulse", "echo_number"), "tile"), "classification": "classify"}
    answers = [np.empty(0, np.uint64)]
    for tile in tiles:
        table = inputs.rows(tile, columns)
        table = table.take(table["strip"] == strip)
        answers.append((_keys(table) << np.uint64(8)) | table["classification"].astype(np.uint64))
    every = np.concatenate(answers)
    every.sort()
    return every


def _classes_of_links(answers: NDArray[np.uint64], here: StageInputs, span: str) -> NDArray[np.uint8]:
    """uint8 (points,): class codes of the points of a span, by what `_answers_of_strip` gives."""
    wanted = _keys(link_table(here.inputs, span))
    place = np.searchsorted(answers, wanted << np.uint64(8))
    answered = answers[np.minimum(place, len(answers) - 1)] if len(answers) else np.zeros(len(wanted), np.uint64)
    if len(wanted) and (len(answers) == 0 or (answered >> np.uint64(8) != wanted).any()):
        raise StoreError(
            "a return's echo is in no tile",
            where=here.source,
            do="run again without --tiles: a strip is delivered when all its tiles are classified",
        )
    return (answered & np.uint64(255)).astype(np.uint8)


@dataclass(frozen=True)
class _Strip:
    """A strip with points, the tiles that hold its echoes, and its spans."""

    key: str
    strip: Strip
    spans: Names
    tiles: Names


def _strips(plan: Plan) -> list[_Strip]:
    tiles_by_strip = tiles_of_strips(plan)
    return [
        _Strip(s.path.stem, s, tuple(span.key for span in spans_of(plan, s)), tiles_by_strip.get(s.number, ()))
        for s in plan.survey.strips
        if s.point_format >= 0 and spans_of(plan, s)  # a file of pulses only, or without any points, is no strip
    ]


def _legacy_codes(plan: Plan, part: _Strip) -> Mapping[str, Any]:
    legacy = part.strip.point_format <= 5
    classes = plan.config.survey.classes
    codes = {str(c.code): c.legacy_code for c in classes if legacy and c.legacy_code is not None}
    return {"codes": codes}


def check_class_codes(formats: Mapping[str, int], config: Config) -> None:
    """`ConfigError` where the points of a strip cannot hold the code of a class, or two would have one: told before
    anything is computed.

    `formats`: the point format of every strip by its file's name.
    """
    legacy = [name for name, number in formats.items() if 0 <= number <= 5]
    if legacy:
        written = {c.name: c.code if c.legacy_code is None else c.legacy_code for c in config.survey.classes}
        where = f"{config.path}: survey.classes; {first_few(legacy, 3)} of point format {formats[legacy[0]]}"
        way = f"give a class a legacy_code up to {LEGACY_MAX}, which is written there instead"
        check_written(written, config.classify.leave, True, where, way)


def _spans_of_returns(plan: Plan, part: _Strip) -> list[Name]:
    """The spans whose returns are asked for their own class."""
    waves = {s.key for s in spans_of(plan, part.strip) if s.waves} if deciding_column(plan) else ()
    return [("read", c) for c in part.spans if c in waves]


def columns_of_tiles(plan: Plan) -> Names:
    """The columns that a delivered tile has."""
    measured = [name for name in MEASURE_RADIOMETRY.columns(plan) if name in plan.providers]
    besides = (*water_columns(plan), *classes_written(plan), *measured)
    return tuple(dict.fromkeys((*TILE_COLUMNS, *besides, *delivered_features(plan))))


def delivered_features(plan: Plan) -> Names:
    """The features that `publish.parquet_features` asks for."""
    wanted = plan.config.publish.parquet_features
    return {"all": (*plan.names, *plan.config.features.also), "used": plan.names, "none": ()}[wanted]


def repeated_columns(plan: Plan) -> Names:
    """What a COPC needs not: without waveforms the amplitude is the intensity, or the extra byte `Amplitude`."""
    kinds = {q.amplitude for q in plan.files.quantities.values()} if plan.files else {COUNTS}
    return ("amplitude",) if kinds <= {INTENSITY, DECIBELS} else ()


def repeated_argument(plan: Plan) -> dict[str, Any]:
    """For the stages that write COPC; nothing where every column says something."""
    repeated = repeated_columns(plan)
    return {"repeated": repeated} if repeated else {}


def class_names(plan: Plan) -> dict[str, str]:
    """Names of the survey's classes by code, and of codes that echoes have besides."""
    own = {str(c.code): c.name for c in plan.config.survey.classes}
    others = other_names(source_codes(plan.splits), plan.config.classify, [int(code) for code in own])
    return {**{str(code): name for code, name in others.items()}, **own}


DELIVER_TILE = Stage(
    "publish-tile",
    11,
    "tile",
    "echo",
    deliver_tile,
    arguments=lambda plan: {
        "params": plan.config.publish,
        "crs": plan.survey.crs,
        "standard_time": plan.survey.standard_time,
        "calibrated": plan.config.radiometry.calibrates,
        "names": class_names(plan),
        **repeated_argument(plan),
    },
    keyed=lambda plan: {"columns": columns_of_tiles(plan)},
    silent=NO_BYTE,
    own=columns_of_tiles,
    place="deliver",
)
DELIVER_STRIP = Stage(
    "publish-strip",
    1,
    "strip",
    "point",
    deliver_strip,
    parts=_strips,
    arguments=lambda plan: {"params": plan.config.publish, **kept_argument(plan)},
    each=_legacy_codes,
    silent=NO_BYTE,
    after=("read", "decompose", "classify", "tile"),
    needs=lambda plan, part: [
        *(("decompose", c) for c in part.spans),
        *_spans_of_returns(plan, part),
        *((stage, t) for t in part.tiles for stage in ("classify", "tile")),
    ],
    source=lambda plan, part: (part.strip.path, part.strip.digests),
    place="deliver",
)
