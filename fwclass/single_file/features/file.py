"""`fwclass features`: the features of every echo of one file as GeoParquet, without a run directory."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import compiling, conf
from fwclass.errors import ConfigError, first_few
from fwclass.features.dense import Crowd
from fwclass.features.names import MAX_REACH, FeatureRequest, is_feature
from fwclass.features.params import FeaturesParams
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.ground.stage import TERRAIN
from fwclass.publish.geoparquet import bounds_of, short_coordinates, write_geoparquet_parts
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.schema import Table, column
from fwclass.single_file.features.echoes import (
    OF_ECHOES,
    PLACE,
    EchoJob,
    FileEchoes,
    ranges,
    read_echoes,
    with_heights,
    with_lines,
    with_noise,
    with_radiometry,
)
from fwclass.single_file.features.names import FeatureList, requested_features
from fwclass.single_file.ground.output import check_places
from fwclass.single_file.tiles import FileConfig, FileTiles, Tell, quiet
from fwclass.store.unchanged import of_unchanged
from fwclass.survey.systems import given_crs
from fwclass.temporary import array_in_file, temporary_directory
from fwclass.tile.stage import morton

SECTIONS = (*OF_ECHOES, "tile", "publish")
"""Sections of the configuration that the command obeys."""

SUFFIX = (".parquet", ".geoparquet")

HELD = 256 << 20
"""Bytes of features that are held in memory; more lie on disk."""


@dataclass(frozen=True)
class FeaturesJob(EchoJob):
    """What `fwclass features` was asked for, besides what every `EchoJob` is.

    `named`, `listed`: a feature set by name or file, or names with commas between; both None: the set `default`.
    """

    named: str | None = None
    listed: str | None = None


@of_unchanged
def features_file(job: FeaturesJob, tell: Tell = quiet) -> dict[str, Any]:
    """Write the features of every echo of a file; what was done, as plain data.

    Echoes are fitted where there are waveforms, else returns are echoes. Rows stand as in the tiles of a run: by
    global cells of 2 m, then pulse and echo number. The file is worked on in tiles (`tile.size`), which change no byte;
    the echoes' columns are held in memory, and so are the features up to `HELD`; more lie on disk beside the output
    until they are written.

    `ConfigError`: an output, a name or a setting that cannot be used, or a feature that the file cannot give.
    `InputError`: an input that cannot be used.
    """
    started = time.perf_counter()
    _check_output(job)
    conf.check_settings(job.settings, SECTIONS)
    features = requested_features(job.named, job.listed)
    params: FeaturesParams = conf.section("features", job.settings)
    publish = conf.section("publish", job.settings)
    _check_reach(features, params)
    tell("reading")
    before = compiling.compile_seconds()
    echoes = _echoes(job, features, tell)
    features, left_out = available(features, echoes.table, job.source, job.skip_missing)
    table = _sort(echoes.table)
    with temporary_directory("features", job.output.parent) as room:
        columns, tiles, crowd = _features(table, features, params, job.settings, room, tell)
        tell("writing")
        empty = dict.fromkeys(features.names, 0)
        parts = _row_groups(table, features, columns, publish.row_group, empty)
        written = write_geoparquet_parts(parts, bounds_of(short_coordinates(table)), job.output, echoes.crs, publish)
        del columns, parts
    return {
        "input": str(job.source),
        "output": str(job.output),
        "set": features.label,
        "features": list(features.names),
        "left_out": left_out,
        "echoes": table.rows,
        "tiles": tiles,
        "reach": features.around.reach(params),
        "without_value": {name: n for name, n in empty.items() if n},
        "crs": echoes.crs.name if echoes.crs is not None else None,
        "judged": echoes.judged,
        "notes": [*echoes.notes, *([crowd.text(params)] if crowd else [])],
        "bytes": written["bytes"],
        "seconds": {
            "compiling": round(compiling.compile_seconds() - before, 3),
            "all": round(time.perf_counter() - started, 3),
        },
    }


def _check_output(job: FeaturesJob) -> None:
    if job.output.suffix.lower() not in SUFFIX:
        raise ConfigError(
            "the output is GeoParquet",
            where=job.output,
            expected="a name that ends in .parquet",
            got=job.output.suffix or "no suffix",
            do="name the output with this ending",
        )
    check_places(job.source, [job.output], job.overwrite)


def _check_reach(wanted: FeatureList, params: FeaturesParams) -> None:
    reach = wanted.around.reach(params)
    if reach > MAX_REACH:
        raise ConfigError(
            "a feature reaches too far",
            where=wanted.label,
            expected=f"at most {MAX_REACH:g} m",
            got=f"{reach:g} m",
            do="names end in centimetres: height_range_c500 is a cylinder of 5 m",
        )


def _echoes(job: FeaturesJob, wanted: FeatureList, tell: Tell) -> FileEchoes:
    """The echoes with everything that the features and the output read."""
    columns = dict.fromkeys((*wanted.around.reads, *wanted.names))
    echoes = read_echoes(job.source, columns, job.settings, given_crs(job.crs, "--crs"), tell)
    later = (*TERRAIN.writes, *(RADIOMETRY.writes if ranges(echoes, job) else ()))
    available(wanted, echoes.table, job.source, job.skip_missing, frozenset(later))
    if "height_above_ground" in wanted.names:
        echoes = with_heights(echoes, job, tell)
    if wanted.around.names:
        echoes = with_lines(with_noise(echoes, job.settings, tell), job.source, job.settings)
        columns["noise"] = None
    if set(wanted.names) & set(RADIOMETRY.writes):
        echoes = with_radiometry(echoes, job)
    keep = [n for n in echoes.table if n in columns or n in PLACE]
    return replace(echoes, table=echoes.table.select(keep))


def _sort(table: Table) -> Table:
    """Rows by the cells of the tiles' spatial sort, then as they were (canonical)."""
    return table.take(np.argsort(morton(table["x"], table["y"]), kind="stable"))


def _features(
    table: Table, wanted: FeatureList, params: FeaturesParams, settings: tuple[str, ...], room: Path, tell: Tell
) -> tuple[dict[str, NDArray[np.float32]], int, Crowd | None]:
    """Features of a neighbourhood of all rows, by name, those of many in files below `room`; how many tiles it took;
    dense places."""
    around = wanted.around
    if not around.names:
        return {}, 0, None
    in_memory = 4 * table.rows * len(around.names) <= HELD
    columns: dict[str, NDArray[np.float32]] = {
        n: np.empty(table.rows, column(n).dtype)
        if in_memory
        else _in_file(room / f"{k}.bin", column(n).dtype, table.rows)
        for k, n in enumerate(around.names)
    }
    tiles = FileTiles(
        table,
        FileConfig(settings, features=params),
        (COMPUTE_FEATURES,),
        tell,
        {COMPUTE_FEATURES.name: "features: tile"},
        held=0,
        computed=around.names,
    )
    tiles.columns(COMPUTE_FEATURES, around.names, columns)
    crowds = [facts.get("dense") for facts in tiles.facts(COMPUTE_FEATURES)]
    return columns, len(tiles.keys), Crowd.of_parts(crowds)


def _in_file(path: Path, dtype: str, rows: int) -> NDArray[np.float32]:
    with path.open("w+b") as file:
        return array_in_file(file, dtype, (rows,))


def _row_groups(
    table: Table, wanted: FeatureList, columns: dict[str, NDArray[np.float32]], size: int, empty: dict[str, int]
) -> Iterator[Table]:
    """The output's columns, row group by row group; echoes without a value are counted to `empty`, by feature."""
    plain = [n for n in dict.fromkeys((*PLACE, *wanted.names)) if n in table]
    order = dict.fromkeys((*(n for n in PLACE if n in table), *wanted.names))
    for first in range(0, table.rows, size):
        part = slice(first, first + size)
        own = {n: table[n][part] for n in plain} | {n: values[part] for n, values in columns.items()}
        for n in empty:
            if own[n].dtype == np.float32:
                empty[n] += int(np.count_nonzero(np.isnan(own[n])))
        yield Table({n: own[n] for n in order})


SHORT = 12
"""So many names are written out."""

_WHY = {
    "width": "no echo widths (no waveforms, nor the extra byte `Pulse width`)",
    "gps_time": "no times that tell which returns are of one pulse",
    "height_above_ground": "no ground (class 2)",
    **dict.fromkeys(("echo_number", "number_of_echoes"), "no echo numbers (a text has none)"),
    **dict.fromkeys(
        RADIOMETRY.writes,
        "no ranges (they need beams, as waveforms have, and --trajectory or --set radiometry.platform_altitude=METRES)",
    ),
}
"""What a file lacks that does not have a column."""


def available(
    wanted: FeatureList, table: Table, source: Path, skip: bool, later: frozenset[str] = frozenset()
) -> tuple[FeatureList, dict[str, str]]:
    """The features that `table` can give; those that it cannot, with what it lacks. Columns `later` may still come.

    `ConfigError`: it cannot give one, and `skip` is not asked for; or none is left.
    """
    there = (set(table) | later) - ({"echo_number"} if "number_of_echoes" not in table else set())
    lost = {name: why for name in wanted.names if (why := _lacks(name, there))}
    left = tuple(n for n in wanted.names if n not in lost)
    if lost and (not skip or not left):
        reasons = dict.fromkeys(lost.values())
        missing = "; ".join(f"{why}: {first_few([n for n in lost if lost[n] == why], SHORT)}" for why in reasons)
        some = "add --skip-missing" + (f", or ask for --features {','.join(left)}" if len(left) <= SHORT else "")
        raise ConfigError(
            f"the file cannot give {len(lost)} of the {len(wanted.names)} features",
            where=f"{source}, features of {wanted.label}",
            got=missing,
            do=some if left else "ask for other features: `fwclass features --list` shows all",
        )
    return FeatureList(wanted.label, left), lost


def _lacks(name: str, there: set[str]) -> str:
    """What feature `name` cannot be computed without, "" where nothing is missing."""
    reads = FeatureRequest.of([name]).reads if is_feature(name) else (name,)
    missing = [n for n in reads if n not in there]
    return _WHY.get(missing[0], f"no {missing[0]}") if missing else ""
