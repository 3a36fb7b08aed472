"""The last words of a run, for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fwclass.assess.remarks import percent_words
from fwclass.decompose.water_column import water_words
from fwclass.errors import first_few, several
from fwclass.publish.quality_section import threshold_words
from fwclass.quality.check_points import check_words
from fwclass.quality.strips import farthest_pair
from fwclass.store.url import Url

SOURCES = ("index", "read", "pulse", "places", "decompose", "split")
"""Stages whose failed parts leave tiles without some of their echoes."""

OF_ACCURACY = ("label", "confusion", "assess")
"""Stages without which there is no accuracy."""

KINDS: Mapping[str, tuple[str, ...]] = {
    "laz": ("laz/",),
    "parquet": ("parquet/",),
    "rasters": ("rasters/",),
    "model": ("model/",),
    "quality": ("quality.",),
    "gis": ("survey.qgz", "tiles.gpkg"),
    "contours": ("contours.gpkg", "contours.qml"),
    "vectors": ("vectors.gpkg", "vectors/"),
    "backscatter": ("samples/", "stacked/", "voxels.zarr", "profiles.zarr"),
}
"""What a run delivers, in the order in which it is told, and how the paths of each begin; then follow ``other``, of
stages that the program does not know, and ``page``, of a paper."""

SHOWN = 4
"""Names that are told of a longer list."""


def describe_reliability(reliability: Mapping[str, Any]) -> str:
    """What `assess.reliability` says, in a sentence."""
    mean, right, error = (100 * reliability[n] for n in ("confidence", "right", "error"))
    aside = (
        f"; without the {reliability['without_class']:,} test echoes that got no class"
        if reliability["without_class"]
        else ""
    )
    return f"{mean:.1f} % on average where {right:.1f} % are right; expected calibration error {error:.1f} %{aside}"


def object_lines(objects: Mapping[str, Any] | None) -> list[str]:
    """What was made of the objects of every class, in a line each; none without objects."""
    lines = []
    for one in (objects or {}).get("classes", ()):
        large = one["sizes"][-1]
        share = f"{one['found']:,} of {one['reference']:,} found"
        if 0 < large["reference"] < one["reference"]:
            share += f" ({large['found']:,} of {large['reference']:,} from {large['from']:g} m² on)"
        false = one["predicted"] - one["correct"]
        lines.append(f"{one['name']}: {share}, {one['split']:,} split; {false:,} false, {one['merged']:,} of several")
    return lines


def summary(report: Mapping[str, Any], root: Path | Url) -> str:
    """The last words of a run, for the terminal; what it delivered lies below `root`."""
    if "words" in report:  # of a workflow that has no echoes
        return "\n".join([*report["words"], *(f"{'page':<11} {root / name}" for name in report["outputs"])])
    counts = report["counts"]
    decomposed, in_tiles = counts["echoes_decomposed"], counts["echoes_in_tiles"]
    balance = "all of them in tiles" if decomposed == in_tiles else f"{in_tiles:,} of them in the tiles of this run"
    lost = sorted({f["part"] for f in report["failed"] if f["stage"] in SOURCES})
    if lost:
        balance += f", without those of chunks that failed: {first_few(lost, SHOWN)}"
    source = f"{counts['pulses']:,} pulses" if counts["pulses"] else f"{counts['returns']:,} returns"
    rows = [f"echoes      {decomposed:,} from {source}, {balance} ({several(counts['tiles'], 'tile')})"]
    if counts["returns_without_packet"]:
        rows.append(
            f"kept        {counts['returns_without_packet']:,} returns without a usable waveform packet, as echoes"
        )
    if report.get("bathymetry"):
        rows.append(f"water       {water_words(report['bathymetry'])} in waveforms")
    rows += [f"fault       {name}: {n:,}" for name, n in report["input"]["faults"].items()]
    model, trained = report.get("model") or {}, report["training"] or {}
    if model.get("path"):
        count = len(model["features"])
        rows.append(f"classifier  {model['path']}, by its own {count} features; survey.features is not looked at")
    if trained.get("context_trial"):
        rows.append(f"layers      {trained['context_trial']}")
    rows += _accuracy_lines(report)
    quality, remarks = report.get("quality") or {}, list(report.get("remarks", ()))
    if quality and not trained and not model.get("path"):  # a run that judges, or filters the ground
        rows += quality_lines(quality)
        remarks = list(dict.fromkeys([*remarks, *quality["remarks"]]))
    rows += threshold_lines(report.get("thresholds", ()))
    if checked := quality.get("check_points"):
        rows.append(f"checked     {check_words(checked)}")
    rows += [f"remark      {text}" for text in remarks]
    if reliability := report.get("reliability"):
        rows.append(f"confidence  {describe_reliability(reliability)}")
    rows += [f"{'label':<11} {text}" for text in (report.get("sampling") or {}).get("remarks", ())]
    if report["water"]:
        flat = sum(body["level_enough"] for body in report["water"])
        rows.append(
            f"water       {flat} of {len(report['water'])} polygons flattened, each with its level in report.json"
        )
    rows += _output_lines(report, root)
    rows.append(f"report      {root / 'report.html'}")
    return "\n".join(rows)


def _accuracy_lines(report: Mapping[str, Any]) -> list[str]:
    """How well the test areas are classified, or why that is not known."""
    if accuracy := report["accuracy"]:
        kappa = "" if accuracy["kappa"] is None else f", kappa {accuracy['kappa']:.3f}"
        return [
            f"accuracy    {100 * accuracy['overall_accuracy']:.1f} % overall{kappa} on {accuracy['area']}",
            *(f"objects     {text}" for text in object_lines(accuracy.get("objects"))),
        ]
    if not report["training"]:
        return []
    if not report["whole"]:
        return ["accuracy    not assessed: not all of the survey is made"]
    if any(f["stage"] in OF_ACCURACY for f in report["failed"]):
        return ["accuracy    not assessed: parts of the assessment failed"]
    return [
        "accuracy    unknown: no labelled echo lies in a test area and areas.gap from all that trains (areas.train, "
        "corrections; with areas.train: all none is left)"
    ]


def _output_lines(report: Mapping[str, Any], root: Path | Url) -> list[str]:
    """Where the files of every kind lie that were delivered."""
    rows, order = [], (*KINDS, "other", "page")
    for kind, names in sorted(report["outputs"].items(), key=lambda one: order.index(one[0])):
        if kind == "contours":
            rows += [f"{kind:<11} {root / name}" for name in names if name.endswith(".gpkg")]
        elif kind in ("backscatter", "other"):
            rows += [f"{kind:<11} {root / top}" for top in sorted({name.partition("/")[0] for name in names})]
        elif kind == "gis":
            rows += [f"{'qgis':<11} {root / name}" for name in names if name.endswith(".qgz")]
        elif kind == "vectors" and report.get("vectors"):
            counted = ", ".join(several(n, name.removesuffix("s")) for name, n in report["vectors"].items())
            rows.append(f"{kind:<11} {counted}: {root / 'vectors.gpkg'}, {root / kind}")
        elif kind in ("quality", "page"):
            rows += [f"{kind:<11} {root / name}" for name in names]
        elif names:
            rows.append(f"{kind:<11} {root / kind}  ({several(len(names), 'file')})")
    return rows


def quality_lines(quality: Mapping[str, Any]) -> Iterator[str]:
    """Density, voids, strips, noise and coverage of a survey, a line each; `quality`: as ``quality.json`` has it."""
    density, voids, strips = quality["density"], quality["voids"], quality["strips"]
    if density["pulses"] is not None:
        p = density["percentiles"]
        yield (
            f"density     {density['pulses']:.2f} pulses per m², {density['echoes']:.2f} echoes; in 90 % of the cells "
            f"{p['p5']:.2f} to {p['p95']:.2f} pulses"
        )
    if voids["count"]:
        largest = f"the largest {voids['largest'][0]['area']:,.3g} m²"
        share = percent_words(voids["share"])
        yield f"voids       {voids['count']:,} from {voids['least']:.3g} m² on, {share} of the area; {largest}"
    else:
        yield f"voids       none from {voids['least']:.3g} m² on"
    yield f"strips      {_strips(strips)}"
    aside = farthest_pair(strips)
    if aside is not None:
        first, second = (strips["strips"][aside[k]]["name"] for k in ("first", "second"))
        offset = aside["offset"]
        apart = f"{100 * offset['distance']:.1f} ± {100 * offset['error']:.1f} cm apart at most"
        yield f"in plan     {apart}: {first} and {second}"
    if quality["noise_share"] is not None:
        yield f"noise       {percent_words(quality['noise_share'])} of the echoes ({quality['noise']:,})"
    if covered := quality["coverage"]:
        share = "no cell lies in it" if covered["share"] is None else percent_words(covered["share"])
        yield f"coverage    {share} of the area that was to be flown, {several(covered['gaps'], 'gap')}"


def threshold_lines(thresholds: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Whether each threshold that was asked for is met, a line each; `thresholds`: as ``report.json`` has them."""
    for one in thresholds:
        yield f"threshold   {one['what']}: {threshold_words(one)}"


def _strips(strips: Mapping[str, Any]) -> str:
    text = f"{len(strips['strips']):,} by {strips['by']}"
    if not strips["pairs"]:
        return f"{text}, nowhere compared"
    left = f", {100 * strips['left']:.1f} cm without their heights and tilts" if strips["left"] is not None else ""
    return (
        f"{text}, {100 * strips['rms']:.1f} cm apart in height (root mean square of {strips['pairs']:,} places){left}"
    )
