"""Two deliveries, of one run or of two: settings, inputs, libraries, accuracy, echoes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.conf import by_dotted_key
from fwclass.errors import ConfigError, InputError, visible
from fwclass.formats.gdal import write_shapes
from fwclass.formats.geoparquet import header
from fwclass.formats.wkb import box_wkb
from fwclass.graph.assess import BLOCKS
from fwclass.operate.assess_runs import compare, counts_in
from fwclass.operate.difference.echoes import ClassChanges, class_changes
from fwclass.operate.difference.rasters import DIFFERS, raster_changes
from fwclass.publish.files import written_whole
from fwclass.schema import MOVED
from fwclass.store.atomic import read_json
from fwclass.store.delivered import REPORT, check_shape
from fwclass.store.digests import digest_now
from fwclass.store.generations import Generation
from fwclass.store.run_store import Store

SHOWN = 10
"""Rows of a list that are shown; JSON has all settings and files, and so many places."""

FIGURES = ("overall_accuracy", "kappa", "mean_iou")

QUALITY = {
    "density.area": "m² with echoes",
    "density.pulses": "pulses per m²",
    "voids.count": "voids",
    "voids.area": "m² of voids",
    "strips.rms": "m that strips lie apart in height",
    "noise_share": "share of noise",
    "coverage.share": "share of the area covered",
    "check_points.all.rmse": "m RMSEz at check points",
}
"""Figures of a survey's quality that are compared, by their place in ``quality.json``."""


@dataclass(frozen=True)
class ComparedDelivery:
    """A generation of the run `run` and what its report says."""

    run: Path
    generation: Generation
    report: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Run and generation, as text."""
        return f"{self.run} {self.generation.name}"

    @property
    def classes(self) -> dict[int, str]:
        """Names of the classes by code."""
        return {int(c["code"]): str(c["name"]) for c in self.report["classes"]}


def deliveries(run: Path, others: Sequence[str]) -> tuple[ComparedDelivery, ComparedDelivery]:
    """The two deliveries that are meant: `others` are up to two numbers of generations of `run`, or another run.

    Without any: the one before the current one, and the current one. With one number: that one and the current one.

    `ConfigError`: a run has no such generation, or not two.
    """
    if len(others) == 1 and not others[0].isdigit():
        return _delivery(run, None), _delivery(Path(others[0]), None)
    if any(not other.isdigit() for other in others) or len(others) > 2:
        raise ConfigError(
            "two deliveries are compared",
            where="fwclass diff",
            expected="RUN, RUN A, RUN A B with numbers of generations, or RUN RUN",
            got=" ".join((str(run), *others)),
        )
    if others:
        return _delivery(run, int(others[0])), _delivery(run, int(others[1]) if len(others) == 2 else None)
    last = _delivery(run, None)
    earlier = [g.number for g in Store(run, read_only=True).generations.all() if g.number < last.generation.number]
    if not earlier:
        raise ConfigError(
            "the run has delivered once only, or earlier deliveries were removed",
            where=run,
            expected="two generations",
            got=last.generation.name,
            do="compare with another run: fwclass diff RUN OTHER",
        )
    return _delivery(run, earlier[-1]), last


def _delivery(run: Path, number: int | None) -> ComparedDelivery:
    """Generation `number` of a run, the current one for None."""
    generations = Store(run, read_only=True).generations
    if number is None:
        chosen = generations.current()
    else:
        chosen = next((g for g in generations.all() if g.number == number), None)
    if chosen is None:
        if (run / "manifest.json").is_file():
            raise ConfigError(
                "this is a delivery that was copied out of its run, and runs are compared",
                where=run,
                expected="a run directory, with its generations",
                got="one delivery",
                do="copy the whole run directory (cp -a); fwclass.open reads this one",
            )
        raise ConfigError(
            "the run has no such delivery" if number is not None else "nothing was delivered there",
            where=run,
            expected="one of " + (", ".join(g.name for g in generations.all()) or "none"),
            got="none of them" if number is None else number,
            do="fwclass history lists what was delivered; run.keep_generations says how many stay",
        )
    report, listed = chosen.path / "report.json", generations.manifest(chosen) or {}
    there = [*(chosen.path / "parquet").glob("*"), *(chosen.path / "rasters").rglob("*.tif")]
    read = {n for n in listed if n.startswith("parquet/") or (n.startswith("rasters/") and n.endswith(".tif"))}
    kept = [BLOCKS] if (chosen.path / BLOCKS).exists() else []
    for name in ("report.json", *kept, *sorted(read | {str(path.relative_to(chosen.path)) for path in there})):
        path, facts = chosen.path / name, listed.get(name)
        if facts is None or path.stat().st_size != facts["bytes"] or digest_now(path) != facts["digest"]:
            raise InputError(
                "the delivery is damaged",
                where=path,
                expected="the bytes of its manifest",
                got="others",
                do="run the survey again with --verify: what is damaged is made anew",
            )
    return ComparedDelivery(run, chosen, check_shape(read_json(report), REPORT, report))


def difference(first: ComparedDelivery, second: ComparedDelivery) -> tuple[dict[str, Any], ClassChanges]:
    """What changed from `first` to `second` as plain data, and the echoes' classes.

    ``settings``, ``labels``, ``libraries``: by key, before and after, null where it was not there. ``files``:
    ``added``, ``removed``, ``changed``. ``accuracy``: figures before and after, of how many ``tested`` echoes;
    ``paired`` with intervals where both are runs with the same test echoes, else null and ``why`` not. ``echoes``:
    counts (``apart``: pairs of one name that lie apart and are not compared), ``classes`` and ``matrix`` (rows before,
    columns after). ``quality``: those of `QUALITY` that changed, before and after.
    ``heights``: `raster_changes` of terrain and surface. ``places``: boxes with most changed echoes.
    """
    changes = class_changes(_tiles(first), _tiles(second), _sizes(first, second))
    codes = [k for k in range(256) if changes.matrix[k].any() or changes.matrix[:, k].any()]
    names = {**first.classes, **second.classes}
    paired, why = _paired(first, second)
    return {
        "first": _facts(first),
        "second": _facts(second),
        "settings": _changed(by_dotted_key(first.report["config"]), by_dotted_key(second.report["config"])),
        "files": _files(first, second),
        "labels": _changed(_labels(first), _labels(second)),
        "libraries": _changed(first.report["libraries"]["here"], second.report["libraries"]["here"]),
        "accuracy": {
            **{key: [_figure(first, key), _figure(second, key)] for key in FIGURES},
            "tested": [_tested(first), _tested(second)],
            "paired": paired,
            "why": why,
        },
        "echoes": {
            "common": changes.common,
            "only_first": changes.only[0],
            "only_second": changes.only[1],
            "apart": changes.apart,
            "changed": changes.changed,
            "classes": [visible(names.get(code, str(code))) for code in codes],
            "codes": codes,
            "matrix": changes.matrix[np.ix_(codes, codes)].tolist(),
        },
        "quality": _changed(_quality(first), _quality(second)),
        "heights": raster_changes(*(d.generation.path / "rasters" for d in (first, second))),
        "places": [{"box": list(box.bounds), "changed": n} for box, n in changes.places()[:SHOWN]],
    }, changes


def _facts(delivery: ComparedDelivery) -> dict[str, Any]:
    when = read_json(delivery.generation.path / "generation.json").get("made")
    return {"run": str(delivery.run), "generation": delivery.generation.number, "made": when}


def _tiles(delivery: ComparedDelivery) -> Path:
    return delivery.generation.path / "parquet"


def _sizes(first: ComparedDelivery, second: ComparedDelivery) -> tuple[float, float]:
    return float(first.report["config"]["tile"]["size"]), float(second.report["config"]["tile"]["size"])


def _changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, list[Any]]:
    keys = sorted({*before, *after})
    return {k: [before.get(k), after.get(k)] for k in keys if before.get(k) != after.get(k)}


def _files(first: ComparedDelivery, second: ComparedDelivery) -> dict[str, list[str]]:
    a, b = ({f["path"]: f for f in d.report["input"]["files"]} for d in (first, second))
    return {
        "added": sorted(b.keys() - a.keys()),
        "removed": sorted(a.keys() - b.keys()),
        "changed": sorted(k for k in a.keys() & b.keys() if a[k] != b[k]),
    }


def _labels(delivery: ComparedDelivery) -> dict[str, int]:
    """Echoes with a label, and corrections that label one; of a run that did not train none."""
    sampled = delivery.report.get("sampling") or {}
    corrections = sampled.get("corrections") or {}
    return {"labelled": sampled["labelled"], "corrections": corrections.get("applied", 0)} if sampled else {}


def _quality(delivery: ComparedDelivery) -> dict[str, float | None]:
    """Figures of `QUALITY`, None for what is not known."""
    figures = {}
    for place in QUALITY:
        value: Any = delivery.report.get("quality")
        for key in place.split("."):
            value = value.get(key) if isinstance(value, Mapping) else None
        figures[place] = float(value) if isinstance(value, int | float) else None
    return figures


def _figure(delivery: ComparedDelivery, key: str) -> float | None:
    accuracy = delivery.report.get("accuracy") or {}
    return accuracy.get(key)


def _tested(delivery: ComparedDelivery) -> int:
    confusion = (delivery.report.get("accuracy") or {}).get("confusion") or []
    return sum(sum(row) for row in confusion)


def _paired(first: ComparedDelivery, second: ComparedDelivery) -> tuple[dict[str, Any] | None, str | None]:
    """Differences with intervals, and why there are none, as of deliveries of earlier versions."""
    both = [(delivery, delivery.generation.path / BLOCKS) for delivery in (first, second)]
    for delivery, path in both:
        if delivery.report.get("accuracy") is None:
            return None, f"{delivery.name} was tested on nothing"
        if not path.is_file():
            return None, f"{delivery.name} keeps no counts by block, as none did before; the same run again leaves them"
    a, b = ((tuple((d.report.get("accuracy") or {}).get("classes", ())), counts_in(path)) for d, path in both)
    try:
        return compare(a, b, f"{first.name}, {second.name}"), None
    except InputError as fault:
        return None, fault.what


def crs_of(delivery: ComparedDelivery) -> str | None:
    """The system of a delivery as WKT, None for none."""
    tile = next(_tiles(delivery).glob("*.parquet"), None)
    crs = header(tile)["crs"] if tile is not None else None
    return None if crs is None else str(crs.to_wkt())


def write_places(path: Path, changes: ClassChanges, crs: str | None) -> None:
    """Every place with changed echoes as a GeoPackage, layer ``places``: how many ``changed`` in each; `crs` as WKT."""
    places = changes.places()
    fields = {"changed": np.array([n for _, n in places], np.int64)}
    with written_whole(path) as beside:
        write_shapes(beside, "places", box_wkb([box for box, _ in places]), fields, crs)


def describe(difference: Mapping[str, Any]) -> str:
    """The difference for a person."""
    return "\n".join(_lines(difference))


def _lines(difference: Mapping[str, Any]) -> Iterator[str]:
    for name in ("first", "second"):
        one = difference[name]
        yield f"{name:<12}{visible(one['run'])}, generation {one['generation']:04d}, of {one['made']}"
    yield from _pairs_lines("setting", difference["settings"])
    for what, paths in difference["files"].items():
        yield from (f"{'file ' + what:<14}{visible(path)}" for path in paths[:SHOWN])
        if len(paths) > SHOWN:
            yield f"{'':<14}and {len(paths) - SHOWN} more"
    for key, counts in difference["labels"].items():
        before, after = ("none" if n is None else f"{n:,}" for n in counts)
        yield f"{'labels':<12}{key}: {before} -> {after} echoes"
    yield from _pairs_lines("library", difference["libraries"])
    yield from _accuracy_lines(difference["accuracy"])
    yield from _echo_lines(difference["echoes"])
    for place, values in difference["quality"].items():
        before, after = ("unknown" if v is None else f"{v:,.0f}" if v >= 1000 else f"{v:.4g}" for v in values)
        yield f"{'quality':<12}{QUALITY[place]}: {before} -> {after}"
    yield from _height_lines(difference["heights"])
    for place in difference["places"]:
        x, y, x1, y1 = place["box"]
        yield f"{'place':<12}{place['changed']:>10,} changed in {x:.0f} {y:.0f} to {x1:.0f} {y1:.0f}"


def _pairs_lines(word: str, pairs: Mapping[str, Sequence[Any]]) -> Iterator[str]:
    for key, (before, after) in pairs.items():
        yield f"{word:<12}{visible(key)}: {visible(str(before))} -> {visible(str(after))}"


def _called(figure: str) -> str:
    return figure.replace("_", " ").replace("iou", "IoU")


def _accuracy_lines(accuracy: Mapping[str, Any]) -> Iterator[str]:
    for key in FIGURES:
        before, after = accuracy[key]
        if before is not None and after is not None:
            yield f"{_called(key):<18}{before:.4f} -> {after:.4f} ({after - before:+.4f})"
        elif before is not None or after is not None:
            words = ("unknown" if value is None else f"{value:.4f}" for value in (before, after))
            yield f"{_called(key):<18}{' -> '.join(words)}"
    before, after = accuracy["tested"]
    if before != after:
        yield (
            f"{'':<12}of {before:,} and {after:,} tested echoes, not the same ones (areas, labels and corrections "
            "decide): part of the difference may be theirs"
        )
    worse = [k for k in FIGURES if None not in accuracy[k] and accuracy[k][1] < accuracy[k][0]]
    paired = accuracy["paired"] or {}
    chance = [k for k in worse if ((paired.get(k) or {}).get("interval") or (0.0, -1.0))[1] >= 0.0]
    lost = [k for k in worse if k not in chance]
    for head, some, more in (
        ("LOST", [] if before != after else lost, ""),
        ("lower", lost if before != after else [], ": other echoes were tested, so that this need be no loss"),
        ("by chance", chance, ": lower, and their intervals hold 0"),
    ):
        if some:
            yield f"{head:<12}{', '.join(_called(w) for w in some)}{more}"
    if accuracy["paired"] is not None:
        level = 100 * accuracy["paired"]["level"]
        for key in FIGURES:
            ends = accuracy["paired"][key]["interval"]
            if ends is not None:
                yield f"{'':<12}{_called(key)}: {ends[0]:+.4f} to {ends[1]:+.4f}, {level:.0f} % interval"
    elif accuracy["why"] and any(None not in accuracy[key] for key in FIGURES):
        yield f"{'':<12}no intervals: {accuracy['why']}"


def _height_lines(rasters: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    for one in rasters:
        word = visible(str(one["name"]).removesuffix(".tif"))
        if "why" in one:
            yield f"{word:<12}{one['why']}"
            continue
        cells, changed = one["cells"], one["changed"]
        share = f" ({100 * changed / cells:.2f} %)" if cells else ""
        off = ""
        if changed:
            off = f"; mean {one['mean']:+.3f}, rmse {one['rmse']:.3f}, {one['lowest']:+.2f} to {one['highest']:+.2f} m"
        yield f"{word:<12}{cells:,} cells in both, {changed:,} off by over {100 * DIFFERS:g} cm{share}{off}"
        for key, which in (("only_first", "first"), ("only_second", "second")):
            if one[key]:
                yield f"{'':<12}{one[key]:,} cells in the {which} alone"


def _echo_lines(echoes: Mapping[str, Any]) -> Iterator[str]:
    common, changed = echoes["common"], echoes["changed"]
    if not common + echoes["only_first"] + echoes["only_second"]:
        return  # neither delivers any, as of the workflow quality
    share = f" ({100 * changed / common:.2f} %)" if common else ""
    yield f"{'echoes':<12}{common:,} in both, {changed:,} of another class{share}"
    for key, word in (("only_first", "first"), ("only_second", "second")):
        if echoes[key]:
            yield f"{'':<12}{echoes[key]:,} in the {word} alone"
    if apart := echoes["apart"]:
        yield (
            f"{'NOTE':<12}{apart:,} echoes of one strip, pulse and number lie more than {MOVED:g} m apart, and are not "
            "compared: a file's points were put in another order, or are others; what is told of echoes is told of the "
            "rest alone"
        )
    names = echoes["classes"]
    matrix = np.array(echoes["matrix"], np.int64).reshape(len(names), len(names))
    moves = [(int(matrix[i, j]), i, j) for i, j in np.argwhere(matrix) if i != j]
    for n, i, j in sorted(moves, reverse=True)[:SHOWN]:
        yield f"{'':<12}{n:>10,} from {names[i]} to {names[j]}"
