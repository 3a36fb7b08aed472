"""Whether every file of a survey lies where its coordinate system is used, where its header says, near the others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.decompose.params import PlausibilityParams
from fwclass.errors import first_few, refuse_named, refuse_unsound, several, visible
from fwclass.formats.area_of_use import away_from_area, elsewhere, outside_of_area, overruled_words, place_faults
from fwclass.formats.crs import crs_of_wkt
from fwclass.graph.sources import strip_of
from fwclass.read.return_counts import join_counts
from fwclass.store.receipts import Receipt
from fwclass.survey.layout import Survey
from fwclass.survey.systems import heights_taken

Bounds = tuple[Sequence[float], Sequence[float]]
"""Least and greatest x, y and z [m]."""

NAMED = 3
"""Files that are named."""

SLACK = 1.0
"""m, that points may lie outside of a header's bounds: some writers round these."""

FEW, MANY = 0.1, 5
"""Share of the files up to which those outside of the largest place are few, and the number from which they are many:
one file of two or three may be a site of its own."""


def bounds_of_files(read: Iterable[Receipt], tiled: Iterable[Receipt]) -> dict[int, Bounds]:
    """Where the returns of every strip lie, by its number, as the parts that counted them say; the echoes of a strip
    without returns, by its tiles (`tiled`)."""
    counted: dict[int, list[Mapping[str, Any]]] = {}
    for receipt in read:
        if "values" in receipt.meta:
            counted.setdefault(strip_of(receipt.part), []).append(receipt.meta["values"])
    lattices = {strip: join_counts(parts)["lattice"] for strip, parts in counted.items()}
    bounds = {
        strip: ([0.001 * axis[0] for axis in lattice], [0.001 * axis[1] for axis in lattice])
        for strip, lattice in lattices.items()
        if lattice is not None and any(lattice[0])
    }
    others: dict[int, list[Sequence[float]]] = {}
    for receipt in tiled:
        for strip in receipt.meta["strips"]:
            if strip not in bounds:
                others.setdefault(strip, []).append(receipt.meta["bounds"])
    for strip, boxes in others.items():
        bounds[strip] = np.min(boxes, axis=0)[:3].tolist(), np.max(boxes, axis=0)[3:].tolist()
    return dict(sorted(bounds.items()))


def echoes_in_tiles(split: Iterable[Receipt]) -> dict[int, dict[str, int]]:
    """How many echoes of every strip, by its number, lie in which tile."""
    counts: dict[int, dict[str, int]] = {}
    for receipt in split:
        own = counts.setdefault(strip_of(receipt.part), {})
        for key, (_, rows) in receipt.meta["tiles"].items():
            own[key] = own.get(key, 0) + rows
    return counts


def file_places(
    survey: Survey,
    bounds: Mapping[int, Bounds],
    params: PlausibilityParams,
    tiles: Mapping[str, Bounds] | None = None,
    echoes: Mapping[int, Mapping[str, int]] | None = None,
) -> dict[str, Any]:
    """``remarks`` on where files lie, and what of it is not sound: files that lie ``elsewhere`` than their system is
    used, or have more than `params.max_implausible` of their echoes there, that survey.crs puts further away than the
    system that they name (``overruled_words``), that are ``alone`` far from many others; each what `judge_file_places`
    refuses, or "". What is said of a survey whose whole extent lies elsewhere (`place_facts`) is not said of its files
    again.

    `bounds`: of the files, by number; `tiles`: where the echoes of tiles lie, by key; `echoes`: of the files, by
    number, in which tile (`echoes_in_tiles`).
    """
    system = crs_of_wkt(survey.crs)
    files = {s.number: visible(s.path.name) for s in survey.strips if s.number in bounds}
    away = {k: place_faults(system, *bounds[k])[0] for k in files if elsewhere(system, *bounds[k])}
    for k in files:
        if k not in away and (text := _partly_away(system, bounds[k], (echoes or {}).get(k, {}), tiles or {}, params)):
            away[k] = text
    near = [k for k in files if k not in away]
    named = {s.number: survey.overruled.get(s.path.name) for s in survey.strips}
    own = {k: crs_of_wkt(named[k]) for k in near}
    odd = {k: overruled_words(system, own[k], *bounds[k]) for k in near}
    every = (f([b[k] for b in bounds.values()], axis=0).tolist() for k, f in enumerate((np.min, np.max)))
    all_away = bool(away) and elsewhere(system, *every)
    apart, alone = _apart({files[k]: bounds[k] for k in near}, params)
    facts = {
        "elsewhere": "" if all_away else _of_files({files[k]: text for k, text in away.items()}, len(files)),
        "overruled": _of_files({files[k]: text for k, text in odd.items() if text}, len(files)),
    }
    beyond = [files[s.number] for s in survey.strips if _beyond(bounds.get(s.number), survey.stated.get(s.path.name))]
    headers = (
        f"points of {first_few(beyond, NAMED)} lie outside of the bounds that the header states: programs that go by "
        "headers do not show them, also of the copy in laz/strips, which has the same header"
        if beyond
        else ""
    )
    said = (*facts.values(), apart, headers, heights_taken(survey.heightless, survey.crs))
    return {"remarks": [text for text in said if text], **facts, "alone": apart if alone else ""}


def _beyond(bounds: Bounds | None, stated: Sequence[float] | None) -> bool:
    """Points with `bounds` lie outside of the box that is `stated`."""
    if bounds is None or stated is None:
        return False
    low, high = (np.array(side) for side in bounds)
    return bool((low < np.array(stated[:3]) - SLACK).any() or (high > np.array(stated[3:]) + SLACK).any())


def judge_file_places(facts: Mapping[str, Any] | None, params: PlausibilityParams, where: object) -> None:
    """`QualityError` for files that do not lie where they can (`file_places`); nothing where the user accepts it."""
    ways = (
        (
            "elsewhere",
            "echoes of a file do not lie where their coordinate system is",
            "places in the area that the system is used in, at heights where land is",
            "mend the file's coordinates or their unit, or take it out (survey.sources)",
        ),
        (
            "overruled",
            "survey.crs puts files where they do not lie by the system that they name",
            "a system whose area holds the echoes no less than that of the file's own does",
            "leave survey.crs out, or name the right one",
        ),
        (
            "alone",
            "files lie far from all others",
            f"places within {params.max_apart / 1000:g} km of each other (plausibility.max_apart)",
            "take the files of another survey out (survey.sources); of one survey with far sites set "
            "plausibility.max_apart [m]",
        ),
    )
    refuse_named(facts, ways, params.accept, where)


def _partly_away(
    system: CRS | None, box: Bounds, echoes: Mapping[str, int], tiles: Mapping[str, Bounds], params: PlausibilityParams
) -> str:
    """That many of a file's `echoes` lie outside of the area of its `system`, where corners of its `box` do."""
    (west, south), (east, north) = box[0][:2], box[1][:2]
    keys = [key for key in echoes if key in tiles]
    if not keys or not any(away_from_area(system, [west, west, east, east], [south, north, south, north])):
        return ""
    middle = [[(low + high) / 2.0 for low, high in zip(*tiles[key], strict=True)] for key in keys]
    far = [
        key
        for key, away in zip(keys, away_from_area(system, *zip(*(m[:2] for m in middle), strict=True)), strict=True)
        if away
    ]
    number, every = sum(echoes[key] for key in far), sum(echoes.values())
    if number < params.least or number <= params.max_implausible * every:
        return ""
    fullest = max(far, key=lambda key: (echoes[key], key))
    return f"{number:,} of {every:,} echoes: {outside_of_area(system, *tiles[fullest])}"


def _of_files(said: Mapping[str, str], every: int) -> str:
    """What is said of the first file, and the names of all."""
    if not said:
        return ""
    return f"{len(said):,} of {several(every, 'file')} ({first_few(list(said), NAMED)}): {next(iter(said.values()))}"


def _apart(bounds: Mapping[str, Bounds], params: PlausibilityParams) -> tuple[str, bool]:
    """That files lie in several places further than `params.max_apart` from each other, and whether all
    but few of many lie in one of these."""
    names = list(bounds)
    boxes = np.array([[*low[:2], *high[:2]] for low, high in bounds.values()]).reshape(-1, 4)
    places = _joined(boxes, params.max_apart)
    if len(places) < 2:
        return "", False
    largest, smallest = (np.array(f(places, key=len)) for f in (max, min))
    rest = np.setdiff1d(np.arange(len(names)), smallest)
    gap = min(float(_gaps(boxes[k], boxes[rest]).min()) for k in smallest)
    few = len(names) >= MANY and len(names) - len(largest) <= max(1, FEW * len(names))
    listed = first_few([names[k] for k in smallest], NAMED)
    return (
        f"the files lie in {len(places)} places further than {params.max_apart / 1000:g} km from each other: "
        f"{listed} {'lies' if len(smallest) == 1 else 'lie'} {gap / 1000:,.0f} km from the nearest of the other "
        f"{several(len(rest), 'file')}. Is it one survey?",
        few,
    )


def _joined(boxes: NDArray[np.float64], most: float) -> list[list[int]]:
    """Rows of `boxes` [xmin, ymin, xmax, ymax] (n, 4) that hang together by gaps of at most `most` [m]."""
    left, places = set(range(len(boxes))), []
    while left:
        waiting = [min(left)]
        left -= set(waiting)
        place = []
        while waiting:
            one = waiting.pop()
            place.append(one)
            others = np.array(sorted(left), np.int64)
            near = others[_gaps(boxes[one], boxes[others]) <= most].tolist()
            waiting += near
            left -= set(near)
        places.append(sorted(place))
    return places


def _gaps(box: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of a box (4,) from each of `others` (n, 4) [m], 0 where they touch."""
    beside = np.maximum(others[:, :2] - box[2:], box[:2] - others[:, 2:])
    return np.hypot(*np.maximum(beside, 0.0).T)


def judge_place(place: Mapping[str, Any] | None, accepted: bool, where: object) -> None:
    """`QualityError` where no echo can lie where the survey says; nothing where the user accepts it."""
    refuse_unsound(
        place["remarks"] if place and place.get("elsewhere") else [],
        accepted,
        "the echoes do not lie where their coordinate system is",
        where,
        expected="places in the area that the system is used in, at heights where land is",
        do="name the right system (--crs, survey.crs), or mend the files' coordinates",
    )
