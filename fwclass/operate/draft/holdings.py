"""What the files hold that a survey file is drafted for: headers, classes and where these lie, coordinate systems."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from fwclass.errors import InputError
from fwclass.formats.projected import metric_twin
from fwclass.operate.draft.areas import ClassPlaces
from fwclass.read.info import info
from fwclass.read.las import LasSource
from fwclass.read.points import PointReader, coordinates
from fwclass.read.polygons import is_polygon_file
from fwclass.read.projection import box_brought, is_brought, project_places
from fwclass.read.source import Source, is_beam_file, open_source
from fwclass.survey.gather import refuse_unusable
from fwclass.survey.systems import with_heights

WORDS_OF_NO_CLASS = {0: "never classified", 1: "unclassified", 7: "noise", 12: "overlap", 18: "high noise"}
"""Codes of LAS 1.4 that stand for no class of things, and what they mean."""


@dataclass
class Holdings:
    """What the files hold together: `facts` of each file of points or pulses, files of `polygons`, where classes lie
    (`places`) and points by class (`codes`), coordinate systems as the files name them (`named`), and the system that
    files in feet are brought into (`target`, which `places` are in; None where no file is in feet)."""

    facts: list[dict[str, Any]] = field(default_factory=list)
    polygons: list[Path] = field(default_factory=list)
    places: ClassPlaces = field(default_factory=ClassPlaces)
    codes: Counter[int] = field(default_factory=Counter)
    named: dict[str, CRS | None] = field(default_factory=dict)
    target: str | None = None

    @cached_property
    def waveforms(self) -> bool:
        """Any of the files has waveforms."""
        return any(f.get("waveforms") for f in self.facts)

    @cached_property
    def records(self) -> int:
        """Points and pulses."""
        return sum(int(f.get("points") or f.get("pulses") or 0) for f in self.facts)

    @cached_property
    def blank(self) -> dict[str, Counter[int]]:
        """Codes of the files that hold none of any class, by name, where others do."""
        codes = {
            Path(f["path"]).name: Counter({int(c): n for c, n in (f.get("classes") or {}).items()}) for f in self.facts
        }
        return {name: own for name, own in codes.items() if own and set(own) <= set(WORDS_OF_NO_CLASS)}

    def systems(self) -> dict[str, int]:
        """How many files name each coordinate system."""
        names = Counter(_system(f.get("crs")) for f in self.facts)
        return dict(names.most_common())

    @property
    def one_system(self) -> bool:
        """A run takes the systems that are named for one (`survey.systems.common_crs`)."""
        own = [crs for crs in self.named.values() if crs is not None]
        return len(own) == len(self.named) and (len(own) == 1 or with_heights(own) is not None)


def _system(crs: Mapping[str, Any] | None) -> str:
    if not crs:
        return "none"
    return f"EPSG:{crs['epsg']}" if crs.get("epsg") else str(crs["name"])


def look_into(files: Sequence[Path]) -> Holdings:
    """Read all `files` once more than their headers: classes and where they lie; `InputError` naming all that cannot
    be read."""
    holdings, faults, opened = Holdings(), list[InputError](), list[tuple[Path, Source]]()
    for path in files:
        if is_polygon_file(path) and not is_beam_file(path):
            holdings.polygons.append(path)
            continue
        try:
            opened.append((path, open_source(path)))
        except InputError as fault:
            faults.append(fault)
    holdings.target = _target(source.crs for _, source in opened)
    for path, source in opened:
        try:
            facts = info(path)
            if is_brought(source.crs):
                source = replace(source, target=holdings.target)
            if set(facts.get("classes") or ()) - {"0"}:
                _count_places(source, holdings)
            if facts.get("bounds") and source.target is not None:
                facts["bounds"] = list(box_brought(source, tuple(facts["bounds"])))
            holdings.facts.append(facts)
            holdings.named.setdefault(_system(facts.get("crs")), source.crs)
        except InputError as fault:
            faults.append(fault)
    where = os.path.commonpath([p.resolve().parent for p in files]) if faults else ""
    refuse_unusable(faults, len(files), where, "draft with the others alone, by their names")
    if not holdings.facts or not holdings.records:
        raise InputError(
            "no file of points or pulses that holds any",
            where=", ".join(str(f["path"]) for f in holdings.facts[:3]) or None,
            do="name the survey's LAS, LAZ or waveform files",
        )
    return holdings


def _target(systems: Iterable[CRS | None]) -> str | None:
    """What files of these systems are brought into, where they are in feet: the same projection in metres; None where
    they are of several."""
    twins = {metric_twin(crs) for crs in systems if is_brought(crs)}
    return (twins.pop() or None) if len(twins) == 1 else None


def _count_places(source: Source, holdings: Holdings) -> None:
    if not isinstance(source, LasSource):
        return
    with PointReader(source) as reader:
        for _, points in reader.blocks():
            x, y, _ = project_places(source, coordinates(source, points))
            codes = np.asarray(points["classification"], np.uint8)
            holdings.places.add(x, y, codes)
            holdings.codes.update(dict(enumerate(np.bincount(codes).tolist())))
