"""`fwclass normalize`: heights above ground of the points of one file, without a run directory."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.classes import GROUND
from fwclass.errors import ConfigError, InputError
from fwclass.graph.ground import GATHER_HEIGHT
from fwclass.ground.filters import Flags
from fwclass.ground.params import GroundParams
from fwclass.ground.stage import TERRAIN
from fwclass.publish.heights import NO_HEIGHT
from fwclass.read.cloud import PointCloud, read_point_cloud
from fwclass.read.text import SUFFIXES as TEXT
from fwclass.report.ground import filter_remarks, sunken_remarks
from fwclass.single_file.ground.file import (
    came_as_noise,
    classes_of,
    flags_and_facts,
    judged_of_cloud,
    last_returns_lack,
    require_shown,
    shown_points,
)
from fwclass.single_file.ground.output import check_copy, check_output, write_points
from fwclass.single_file.ground.params import FileJob, ground_params
from fwclass.single_file.ground.rasters import check_extent, ground_table
from fwclass.single_file.tiles import MAKE_HEIGHTS, FileConfig, FileTiles, Tell, quiet
from fwclass.store.unchanged import of_unchanged
from fwclass.survey.systems import given_crs


@dataclass(frozen=True)
class NormalizeJob(FileJob):
    """What `fwclass normalize` was asked for, besides what every `FileJob` is; without a ground filter it takes the
    ground of the file's classes.

    `height`: above what: ``tin``, ``nearest`` or ``raster``; None takes ``terrain.height``. `keep_z`: z stays, the
    height goes into the extra byte `HeightAboveGround`. `use_flagged`: see `GroundJob`.
    """

    height: str | None = None
    keep_z: bool = False
    use_flagged: bool = False

    @property
    def filters(self) -> bool:
        """The ground is looked for, not taken from the classes."""
        return self.method is not None or self.preset is not None or bool(self.assignments)


@of_unchanged
def normalize_file(job: NormalizeJob, tell: Tell = quiet) -> dict[str, Any]:
    """Write the points of a file with their height above ground as z; what was done, as plain data.

    Everything but z stays as it is. Heights are in the file's own unit, the extra byte is in metres. A point without
    terrain gets -9999 in LAS and ``nan`` in text and extra byte.

    `ConfigError`: an output, filter or parameter that cannot be used. `InputError`: an input that cannot be used, or
    that has no ground.
    """
    started = time.perf_counter()
    check_output(job.source, job.output, job.overwrite)
    if job.keep_z and job.output.suffix.lower() in TEXT:
        raise ConfigError("a text has no extra bytes", where=job.output, do="leave out --keep-z, or write a LAZ file")
    conf.check_settings(job.settings, ("ground", "terrain", "publish"))
    own = {} if job.height is None else {"height": job.height}
    params = conf.section("terrain", job.settings, {"terrain": own})
    tell("reading")
    cloud = read_point_cloud(job.source, given_crs(job.crs, "--crs"))
    check_copy(cloud, job.output, job.overwrite)
    shown = shown_points(cloud, True, job.use_flagged)
    check_extent(cloud, cloud.usable, params.cell)
    flags, facts, by = _ground(cloud, shown, job, tell)
    tell("terrain and heights")
    rows = np.flatnonzero(cloud.usable)
    tiles = FileTiles(
        ground_table(cloud, rows, flags.ground, flags.noise | ~shown),
        FileConfig((), terrain=params),
        (MAKE_HEIGHTS, GATHER_HEIGHT),
    )
    height = np.full(cloud.points, np.nan)
    height[rows] = tiles.columns(GATHER_HEIGHT, TERRAIN.writes)["height_above_ground"]
    tell("writing")
    written = _write(cloud, flags, height, job)
    judged, odd = judged_of_cloud(cloud, flags.noise | ~shown, job.settings)
    ground = int(flags.ground.sum())
    if by is not None:
        judged |= facts
        odd += [*last_returns_lack(cloud), *filter_remarks(facts, by)]
    elif cloud.classes is not None:
        judged["ground"] = sunken_remarks(height, cloud.classes, conf.section("plausibility"))
        odd += judged["ground"]
    return {
        "input": str(job.source),
        "output": str(job.output),
        "height": params.height,
        "method": None if by is None else by.method,
        "points": cloud.points,
        "ground": ground,
        "without": int(np.isnan(height).sum()),
        "keep_z": job.keep_z,
        "crs": cloud.units.source,
        "metres_per_unit": {"xy": cloud.units.xy, "z": cloud.units.z},
        "judged": judged,
        "max_gap": params.max_gap,
        "heights_m": _spread(height[np.isfinite(height)]),
        "waveforms": written.get("wdp"),
        "notes": [*written.get("notes", []), *odd],
        "seconds": {"all": round(time.perf_counter() - started, 3)},
    }


def _spread(height: NDArray[np.float64]) -> dict[str, float] | None:
    """Lowest, middle and highest height [m], None where there is none."""
    if not len(height):
        return None
    low, middle, high = (round(float(v), 3) for v in (height.min(), np.median(height), height.max()))
    return {"least": low, "median": middle, "greatest": high}


def _ground(
    cloud: PointCloud, shown: NDArray[np.bool_], job: NormalizeJob, tell: Tell
) -> tuple[Flags, dict[str, Any], GroundParams | None]:
    """Ground and noise by a filter, what of it lies on wide roofs or in pits, and the filter; or by the file's
    classes."""
    if job.filters:
        params = ground_params(job.method, job.preset, job.assignments, job.settings)
        require_shown(cloud, shown, "give points another class than 7 and 18, which are noise")
        return *flags_and_facts(cloud, shown, params, tell), params
    if cloud.classes is not None and (cloud.classes == GROUND).any():
        return Flags((cloud.classes == GROUND) & shown, came_as_noise(cloud)), {}, None
    raise InputError(
        "the input has no ground",
        where=cloud.path,
        expected="points of class 2",
        got="no classes" if cloud.classes is None else f"classes {_listed(cloud.classes)}",
        do="run `fwclass ground` first, or let it be looked for: add --method, for example --method smrf",
    )


def _listed(classes: NDArray[np.uint8]) -> str:
    return ", ".join(str(c) for c in np.unique(classes))


def _write(cloud: PointCloud, flags: Flags, height: NDArray[np.float64], job: NormalizeJob) -> dict[str, Any]:
    classes = cloud.classes if cloud.classes is not None else classes_of(cloud, flags, False)
    publish = conf.section("publish", job.settings)
    if job.keep_z:
        return write_points(
            cloud, job.output, classes, publish, extra={"height_above_ground": height.astype(np.float32)}
        )
    z = height / cloud.units.z
    if job.output.suffix.lower() not in TEXT:
        z = np.where(np.isnan(z), NO_HEIGHT, z)
    else:
        z = np.round(z, 6)
    return write_points(cloud, job.output, classes, publish, z)
