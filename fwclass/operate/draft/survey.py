"""The text of a survey file, drafted from the headers and points of files."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fwclass import conf
from fwclass.classes import UNCLASSIFIED
from fwclass.errors import FwclassError, first_few, several, visible
from fwclass.operate.draft.areas import AreaSplit
from fwclass.operate.draft.classes import LEAST, MEANINGS, Meaning, codes_of, propose_classes
from fwclass.operate.draft.holdings import Holdings, look_into
from fwclass.operate.draft.sources import name_of, sources_of
from fwclass.operate.estimate.forecast import make_forecast
from fwclass.operate.estimate.headers import survey_facts
from fwclass.operate.estimate.limits import room_at
from fwclass.read.info_together import alike_faults
from fwclass.survey.gather import require_distinct
from fwclass.workflows import workflow_of

SHOWN = 5
"""Faults of a file that stand in the draft."""

WITH_WAVEFORMS = (
    "",
    "# radiometry:",
    "#   platform_altitude: 900.0    # m; or survey.trajectory: {files: [flight.csv]}: for ranges and cross-sections",
)

MOSTLY_SORTED = 0.2
"""Share of the points from which class 1, unclassified, is no leftover."""


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
        f"  name: {_quoted(name or name_of(paths, directory))}",
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
        lines += [f"    - {{name: {one.name}, code: {one.code}, codes: [{codes_of(one)}]}}    # {count:,} points"]
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
