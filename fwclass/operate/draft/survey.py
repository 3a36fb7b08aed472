"""The text of a survey file, drafted from the headers and points of files."""

from __future__ import annotations

import glob
import json
import math
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pyproj import CRS

from fwclass import conf
from fwclass.classify.context import halo_of
from fwclass.conf.sets import feature_set
from fwclass.errors import FwclassError, InputError, first_few, several, visible
from fwclass.features.names import FeatureRequest, is_feature
from fwclass.formats.projected import metric_twin
from fwclass.operate.draft.areas import AreaSplit, ClassPlaces, best_split, outer_box
from fwclass.operate.estimate.forecast import make_forecast
from fwclass.operate.estimate.headers import survey_facts
from fwclass.operate.estimate.limits import room_at
from fwclass.read.info import info
from fwclass.read.info_together import alike_faults
from fwclass.read.las import LasSource
from fwclass.read.points import PointReader, coordinates
from fwclass.read.polygons import is_polygon_file
from fwclass.read.projection import box_brought, brought, is_brought
from fwclass.read.source import Source, is_beam_file, open_source
from fwclass.survey.gather import refuse_unusable, require_distinct
from fwclass.survey.systems import with_heights
from fwclass.workflows import workflow_of

LEAST = 500
"""Points of a class below which it is not proposed: too few to learn from and to judge by."""

SHOWN = 5
"""Faults of a file that stand in the draft."""


WITH_WAVEFORMS = (
    "",
    "# radiometry:",
    "#   platform_altitude: 900.0    # m; or survey.trajectory: {files: [flight.csv]}: for ranges and cross-sections",
)


UNCLASSIFIED, MOSTLY_SORTED = 1, 0.2
"""A code of the LAS specification, and the share of the points from which it is no leftover."""


class Meaning(NamedTuple):
    """A class as it is proposed: its name, the code it is delivered as, the codes of files that count as it."""

    name: str
    code: int
    codes: tuple[int, ...]


MEANINGS = (
    Meaning("ground", 2, (2,)),
    Meaning("vegetation", 5, (3, 4, 5)),
    Meaning("building", 6, (6,)),
    Meaning("water", 9, (9,)),
    Meaning("rail", 10, (10,)),
    Meaning("road", 11, (11,)),
    Meaning("wire", 14, (13, 14, 16)),
    Meaning("tower", 15, (15,)),
    Meaning("bridge", 17, (17,)),
)
"""Of the LAS specification's codes for point formats 6 to 10."""

NO_CLASS = {0: "never classified", 1: "unclassified", 7: "noise", 12: "overlap", 18: "high noise"}


@dataclass
class Holdings:
    """What the files hold together: `facts` of each file of points or pulses, `polygons` beside them, systems as they
    are `named`, and the `target` that files in feet are brought into: what lies where is told in it."""

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
        return {name: own for name, own in codes.items() if own and set(own) <= set(NO_CLASS)}

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
            x, y, _ = brought(source, coordinates(source, points))
            codes = np.asarray(points["classification"], np.uint8)
            holdings.places.add(x, y, codes)
            holdings.codes.update(dict(enumerate(np.bincount(codes).tolist())))


@dataclass(frozen=True)
class Draft:
    """A survey file's `text`, and `notes` on what it still lacks."""

    text: str
    notes: tuple[str, ...]


def draft(files: Sequence[Path], beside: Path, name: str | None = None, directory: Path | None = None) -> Draft:
    """A survey file for `files`, to lie in the directory `beside`. `directory`: they are what it holds.

    `InputError`: a file cannot be read, none holds points or pulses, or two have one name but for their ending.
    """
    holdings = look_into(files)
    paths = [Path(f["path"]) for f in holdings.facts]
    require_distinct(paths)
    features = "default-waveform" if holdings.waveforms else "default"
    classes, left, split = propose_classes(holdings, features)
    home, patterns = sources_of(paths, beside, directory is not None)
    lines = [
        *_head(holdings),
        "survey:",
        f"  name: {_quoted(name or _name_of(paths, directory))}",
        f"  directory: {_quoted(home)}    # of the sources, relative to this file",
        f"  sources: {_quoted(patterns)}",
        *_system_lines(holdings),
        *_label_lines(holdings, classes, left),
        f"  features: {features}    # a set of `fwclass features --list`, or a list of columns",
        *_reading_lines(holdings),
        *_area_lines(classes, split),
        *(WITH_WAVEFORMS if holdings.waveforms else ()),
    ]
    text = "\n".join(lines) + "\n"
    return Draft(text + _tile_lines(text, beside, split is not None), tuple(_lacks(holdings, split)))


def propose_classes(holdings: Holdings, features: str) -> tuple[list[Meaning], dict[str, str], AreaSplit | None]:
    """Classes to learn; why others were left out; where to train."""
    classes = [m for m in MEANINGS if sum(holdings.codes[c] for c in m.codes) >= LEAST]
    left = _left_out(holdings.codes, classes)
    bounds = [f["bounds"] for f in holdings.facts if f.get("bounds")]
    split = None
    while len(classes) > 1:
        split = best_split(holdings.places, [c.codes for c in classes], outer_box(bounds), gap_of(features, classes))
        if split is None:
            break
        both = (split.train >= LEAST / 10) & (split.test >= LEAST / 10)
        if both.all():
            return classes, left, split
        for one in (c for c, there in zip(classes, both, strict=True) if not there):
            left[_codes(one)] = f"{one.name}: it does not lie on both sides of any line through the survey"
        classes = [c for c, there in zip(classes, both, strict=True) if there]
    return classes, left, None


def _left_out(codes: Counter[int], classes: Sequence[Meaning]) -> dict[str, str]:
    """Why codes that the files hold are in no class."""
    known = {code: m for m in MEANINGS for code in m.codes}
    covered = {code for m in classes for code in m.codes}
    left = {}
    for code, n in sorted(codes.items()):
        if n and code not in covered:
            words = NO_CLASS.get(code) or (known[code].name if code in known else "no code of the LAS specification")
            left[str(code)] = f"{words}, {n:,} points"
    return left


def gap_of(features: str, classes: Iterable[Meaning]) -> float:
    """m, in whole metres: how far apart tested echoes share no neighbour with a training area's, and neither a second
    layer nor a line looks at any of its echoes."""
    reach = FeatureRequest.of(n for n in feature_set(features).features if is_feature(n)).reach(
        conf.section("features")
    )
    ways = conf.section("classify")
    lines = ways.lines.halo if ways.lines.among(one.code for one in classes) else 0.0
    return float(math.ceil(max(2 * reach, reach + halo_of(ways.context.auto_cells), lines)))


def sources_of(paths: Sequence[Path], beside: Path, whole: bool) -> tuple[str, list[str]]:
    """`survey.directory` and `survey.sources` for files, seen from the directory `beside`.

    One pattern for each ending where the files are all of their directory with these endings, else their names.
    `whole`: it was the directory that was named, so that one file is all of it too.
    """
    own = [p.resolve() for p in paths]
    home = Path(os.path.commonpath([p.parent for p in own]))
    below = home.is_relative_to(beside.resolve())
    base = beside.resolve() if below else home
    directory = "." if below else str(home)
    endings = {p.suffix for p in own}
    alike = all(p.parent == home for p in own) and (whole or len(own) > 1)
    if alike and set(own) == {p.resolve() for p in home.iterdir() if p.suffix in endings}:
        return directory, [f"{_literal(home, base)}*{ending}" for ending in sorted(endings)]
    return directory, sorted(_literal(p, base).rstrip("/") for p in own)


def _literal(path: Path, base: Path) -> str:
    """`path` from `base` on as a pattern that matches it alone; with a slash behind unless it is `base`."""
    return "".join(f"{glob.escape(part)}/" for part in path.relative_to(base).parts)


def _name_of(paths: Sequence[Path], directory: Path | None) -> str:
    """The name of the directory that was named, else the one file's, or that of the directory that holds all."""
    own = [p.resolve() for p in paths]
    if directory is not None:
        home = directory.resolve().name
    else:
        home = own[0].stem if len(own) == 1 else Path(os.path.commonpath([p.parent for p in own])).name
    return re.sub(r"[^\w .-]", "-", unicodedata.normalize("NFC", home)).lstrip("- .")[:100] or "survey"


def _head(holdings: Holdings) -> list[str]:
    """What the files are, and what is wrong with them, as comments."""
    files, area = len(holdings.facts), holdings.places.area
    density = f", {sum(holdings.codes.values()) / area:.1f}/m2 on {area / 1e6:.3g} km2" if area else ""
    waves = ", with waveforms" if holdings.waveforms else ""
    held = f"{holdings.records:,} points or pulses{density}{waves}"
    lines = [f"# Drafted by `fwclass init` from {several(files, 'file')}: {held}."]
    return [*lines, *(f"# ! {line}" for line in alike_faults(holdings.facts, SHOWN))]


def _system_lines(holdings: Holdings) -> list[str]:
    systems = {visible(name): count for name, count in holdings.systems().items()}
    if len(systems) == 1 and holdings.one_system:
        return [f"  crs: null    # all files: {next(iter(systems))}"]
    words = ", ".join(f"{name} ({several(count, 'file')})" for name, count in systems.items())
    if holdings.one_system:
        return [f"  crs: null    # heights of all are those of the files that name theirs; the files name: {words}"]
    example = next((name for name in systems if name.startswith("EPSG:")), "EPSG:25832")
    return [f"  crs: null    # TO DO: give one for all, e.g. {example}; the files name: {words}"]


def _reading_lines(holdings: Holdings) -> list[str]:
    if holdings.target is None:
        return []
    words = "m: what files in another unit are brought into as they are read; strips are delivered as they came"
    return ["", "read:", f"  project_to: {_quoted(holdings.target)}    # {words}"]


def _label_lines(holdings: Holdings, classes: Sequence[Meaning], left: Mapping[str, str]) -> list[str]:
    lines = []
    if holdings.polygons:
        names = _quoted([str(p) for p in holdings.polygons])
        lines += [f"  # reference: {{kind: polygons, files: {names}, field: class}}    # docs/labels.md"]
    if len(classes) < 2:
        lines += [
            "  # TO DO: labels (docs/labels.md), or `model: PATH`, or `model: NAME` (`fwclass models` lists them)"
        ]
    lines += [
        f"  reference: {{kind: {'source' if len(classes) > 1 else 'none'}}}    # the files' own classes, if `source`"
    ]
    lines += ["  classes:" if classes else "  classes: []"]
    for one in classes:
        count = sum(holdings.codes[c] for c in one.codes)
        lines += [f"    - {{name: {one.name}, code: {one.code}, codes: [{_codes(one)}]}}    # {count:,} points"]
    lines += [f"    # not a class: {code} ({words})" for code, words in left.items()]
    blank = sum(holdings.blank.values(), Counter[int]())
    if len(classes) > 1 and holdings.blank:
        names = first_few([visible(name) for name in holdings.blank], SHOWN)
        lines += [
            f"    # {several(len(holdings.blank), 'file')} without classes, {blank.total():,} points: {names}",
            "    # classified by what is learned from the others; no class may count their codes",
        ]
    share = (holdings.codes[UNCLASSIFIED] - blank[UNCLASSIFIED]) / max(holdings.codes.total() - blank.total(), 1)
    if len(classes) > 1 and str(UNCLASSIFIED) in left and share > MOSTLY_SORTED:
        lines += [
            f"    # TO DO: {100 * share:.0f} % of the points have class {UNCLASSIFIED}, each is given one of these:",
            "    # where they are all that is left, plants and cars for example, learn them as another:",
            f"    # - {{name: other, code: {UNCLASSIFIED}, codes: [{UNCLASSIFIED}]}}",
        ]
    return lines


def _area_lines(classes: Sequence[Meaning], split: AreaSplit | None) -> list[str]:
    if split is None:
        return [
            "",
            "areas:",
            "  train: []    # TO DO: boxes [xmin, ymin, xmax, ymax) that hold all classes; the rest is tested",
        ]
    box = ", ".join(f"{v:g}" if abs(v) < 1e5 else f"{v:.1f}" for v in split.box.bounds)
    lines = ["", "areas:", f"  train: [[{box}]]"]
    for one, inside, tested in zip(classes, split.train, split.test, strict=True):
        lines += [f"    # {one.name}: {inside:,} points to train on, {tested:,} to test on"]
    return [
        *lines,
        f"  gap: {split.gap:g}    # m: no feature, second layer or wire knows tested echoes by trained ones",
        "",
        "classify:",
        "  context: {cells: auto}    # a second layer by the answers around, where it pays (docs/context.md); []: none",
    ]


def _tile_lines(text: str, beside: Path, classifies: bool) -> str:
    """`tile.size` where another than the default suits the survey, by `fwclass plan`: of its terrain where there is
    nothing yet to classify by."""
    try:
        workflow = workflow_of("classification" if classifies else "ground")
        config = conf.load_text(text, beside / "survey.yaml", classifies)
        begun = workflow.begin(config)
        forecast = make_forecast(begun, survey_facts(config, beside), config.run.workers, room_at(beside))
    except FwclassError:
        return ""  # what is missing stands in the notes; `fwclass plan` says the rest
    if forecast.best is None or forecast.best.size == config.tile.size:
        return ""
    return f"\ntile:\n  size: {forecast.best.size:g}    # m, by `fwclass plan`\n"


def _lacks(holdings: Holdings, split: AreaSplit | None) -> Iterator[str]:
    """What the draft needs before it runs."""
    if not holdings.one_system:
        yield "no coordinate system that all files name: set survey.crs"
    if sum(sum(holdings.codes[c] for c in m.codes) >= LEAST for m in MEANINGS) < 2:
        yield (
            "fewer than two classes with points enough: add labels (docs/labels.md), or set survey.model; "
            "--workflow ground needs neither"
        )
    elif split is None:
        yield (
            "no line leaves two classes on both of its sides, a gap apart: name more files, set areas.train, or set "
            "survey.model"
        )


def _quoted(value: str | list[str]) -> str:
    """`value` as YAML reads it: as it is where all of it can be seen, else by its escapes."""
    plain = json.dumps(value, ensure_ascii=False)
    return plain if visible(plain) == plain else json.dumps(value)


def _codes(one: Meaning) -> str:
    return ", ".join(map(str, one.codes))
