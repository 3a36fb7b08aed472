"""What a report tells of a delivery: where and when the survey is, and how sure the classes are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.unsure import PERCENT, unlike_files, unsure_facts
from fwclass.conf import Config
from fwclass.formats.area_of_use import dates, kind_faults, place_facts, time_faults
from fwclass.formats.crs import crs_of_wkt
from fwclass.graph.outputs import DELIVER_TILE, TILE_ENDING, TILES
from fwclass.grid import Box
from fwclass.publish.tile_facts import WORTH, least_sure_first
from fwclass.quality.covered import CoveredArea
from fwclass.run.runner import Runner
from fwclass.store.receipts import Receipt
from fwclass.survey.layout import Survey
from fwclass.units import utc_of

LEAST_SURE = 5
"""Tiles of the least sure ones that are named."""


def receipts_of_run(runner: Runner, stage: str) -> list[Receipt]:
    """Receipts of a stage's parts that are done in this run; what an earlier run left is not this run's result."""
    parts = sorted(part for name, part in runner.outcomes if name == stage and runner.is_done(stage, part))
    return [r for r in (runner.store.receipt(stage, part) for part in parts) if r is not None]


def metas_of_run(runner: Runner, stage: str, name: str) -> list[Any]:
    """What the receipts of a stage's parts that are done in this run say of `name`."""
    return [r.meta[name] for r in receipts_of_run(runner, stage)]


def place_without_tiles(crs: str | None, box: Box, heights: tuple[float, float] | None) -> dict[str, Any] | None:
    """What is odd about where the sources lie (``remarks``), and whether none can lie there (``elsewhere``), by the
    `box` and the `heights` [m] that all returns lie in: of a run that delivers no tiles."""
    if heights is None:
        return None
    system = crs_of_wkt(crs)
    return place_facts(system, [box.xmin, box.ymin, heights[0]], [box.xmax, box.ymax, heights[1]])


def place_of(
    tiles: Sequence[Receipt], crs: str | None, standard_time: bool, covered: CoveredArea, spacings: float
) -> dict[str, Any] | None:
    """CRS, flight dates, area with echoes [m²] and echoes per m², what is odd about them (``remarks``), and whether no
    echo can lie there (``elsewhere``); None where no tile was delivered.

    `covered`: cells with an echo; gaps of more than so many mean `spacings` of echoes are none of it.
    """
    if not tiles:
        return None
    system = crs_of_wkt(crs)
    points = sum(r.meta["facts"]["points"] for r in tiles)
    times = [t for r in tiles for t in r.meta["facts"]["times"] or ()]
    bounds = np.array([r.meta["facts"]["bounds"] for r in tiles])
    low, high = bounds[:, :3].min(axis=0).tolist(), bounds[:, 3:].max(axis=0).tolist()
    area = covered.of(points, spacings)
    first, last = (min(times), max(times)) if times else (np.nan, np.nan)
    untimely = time_faults(first, last)
    if standard_time and not untimely:
        untimely = kind_faults(first, last, standard_time)
    place = place_facts(system, low, high)
    authority = system.to_authority() if system is not None else None
    return {
        "crs": system.name if system is not None else None,
        "code": ":".join(authority) if authority else None,
        "bounds": [*low[:2], *high[:2]],
        "flown": [_date(first), _date(last)] if standard_time and dates(first, last) else None,
        "area": area,
        "density": points / area if area else None,
        "remarks": [*place["remarks"], *untimely],
        "elsewhere": place["elsewhere"],
    }


def legacy_codes(runner: Runner, survey: Survey, config: Config) -> dict[str, Any] | None:
    """Codes that delivered strips of point formats 0 to 5 have in place of others, by these; None where none has."""
    written = {str(c.code): c.legacy_code for c in config.survey.classes if c.legacy_code not in (None, c.code)}
    delivered = {r.part for r in receipts_of_run(runner, "publish-strip")}
    strips = [s.path.stem for s in survey.strips if 0 <= s.point_format <= 5 and s.path.stem in delivered]
    return {"strips": strips, "written": written} if written and strips else None


def _date(seconds: float) -> str:
    return utc_of(seconds).strftime("%Y-%m-%d")


def unsure_of_run(
    tiles: Sequence[Receipt], config: Config, survey: Survey, given: Mapping[str, Any] | None
) -> dict[str, Any] | None:
    """How much the model is unsure of (`unsure_facts`), and of a given one in which files (`unlike_files`); None where
    nothing was classified."""
    counts = [np.array(r.meta["percent"], np.int64) for r in tiles if r.meta["percent"]]
    facts = unsure_facts(np.sum(counts, axis=0), config.classify, given) if counts else None
    if facts is None or not facts["judged"]:
        return facts
    names = {str(s.number): s.path.name for s in survey.strips}
    of_files: dict[str, NDArray[np.int64]] = {}
    for one in tiles:
        for number, percent in one.meta["of_files"].items():
            name = names[number]
            of_files[name] = of_files.get(name, np.zeros(PERCENT, np.int64)) + np.array(percent, np.int64)
    unlike = unlike_files(of_files, config.classify)
    return facts | {"files": unlike["files"], "remarks": [*facts["remarks"], *unlike["remarks"]]}


def sureness(tiles: Sequence[Receipt], classes: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Echoes of every class, the mean confidence of those that were classified, and the tiles whose classes are least
    sure."""
    facts = {r.part: r.meta["facts"] for r in tiles if r.meta["facts"]["confidence"] is not None}
    if not facts:
        return None
    rows = []
    for one in classes:
        code = str(one["code"])
        count = sum(f["classes"].get(code, 0) for f in facts.values())
        counted, total = np.sum([f["sure"].get(code, (0, 0.0)) for f in facts.values()], axis=0).tolist()
        rows.append(
            {
                "name": one["name"],
                "code": one["code"],
                "echoes": count,
                "confidence": total / counted if counted else None,
            }
        )
    order = least_sure_first(facts)
    least = ([key for key in order if facts[key]["points"] >= WORTH] or order)[:LEAST_SURE]
    listed = [
        {
            "tile": key,
            "file": f"{TILES}/{key}{TILE_ENDING}",
            "confidence": facts[key]["confidence"],
            "echoes": facts[key]["points"],
        }
        for key in least
    ]
    return {"classes": rows, "tiles": listed, "stage": DELIVER_TILE.name}
