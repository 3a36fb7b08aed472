"""The report of a run: one HTML file without any link to the network."""

from __future__ import annotations

import base64
import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from fwclass.errors import first_few, several, visible
from fwclass.publish.files import write_page
from fwclass.publish.ground_section import ground
from fwclass.publish.overview_section import (
    FRAMED,
    LAYERS,
    class_key,
    curve,
    importance,
    layers,
    next_steps,
    reliability_rows,
    selection_curve,
    subject,
    sure_rows,
    survey_rows,
    verdict,
    waves,
)
from fwclass.publish.quality_section import quality
from fwclass.publish.sampling_section import sampling
from fwclass.publish.sections import (
    accuracy,
    classifier,
    distribution,
    measure,
    number,
    percent,
    quantity,
    seconds,
    stages,
    training,
    waveforms,
)
from fwclass.publish.stage_graph import stage_graph

TEMPLATE = "report.html.j2"
SECTIONS = (
    *("layers", "maps", "accuracy", "sure", "curve", "importance", "selection", "waves", "next_steps", "sampling"),
    *("distribution", "waveforms", "plausibility", "ground", "quality", "stages", "outputs", "config"),
)
"""Of the page, in its order; those without content are left out."""
LISTED = 8
"""Outputs of a kind that are listed openly; the others unfold."""

COUNTED = ("unexplained", "outside", "below", "weak", "implausible", "returns_without_echo")
"""Counts of echoes and returns of a strip that its table shows."""

OF_WAVEFORMS = ("pulses", "returns_without_packet", "returns_without_echo", "echoes_decomposed")
"""Counts of a survey with waveforms, which one of returns alone has as zeros, or as its returns."""

PULSE, SAMPLING = "pulse", "sampling"
"""Figures that stand in sections of their own, not among the maps."""

_FILES = "csv|gpkg|h5|html|jpg|json|las|laz|parquet|pls|plz|png|qgz|tif|txt|wdp|wdz|yaml|zarr"
_SETTING = rf"\b[a-z_]+(?:\.(?!(?:{_FILES})\b)[a-z_]+)+\b"
_VALUE = r"(?:=[^\s()]*)?"
_COMMAND = re.compile(rf"--[a-z]|`|{_SETTING}")
_ALONE = re.compile(rf" \({_SETTING}{_VALUE}(?:(?:, | and ){_SETTING}{_VALUE})*\)")
_ASIDE = re.compile(r" \(([^()]*)\)")
_CLAUSE = re.compile(r"[:;.] ")


def render_report(
    report: Mapping[str, Any], figures: Mapping[str, bytes], path: Path, heights: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Write the report as one HTML file: styles inside, images as data, nothing from the network.

    Every text of `report` is escaped. A section whose data are missing, None or empty is left out.

    Parameters
    ----------
    report : ``survey, fwclass, input {files, faults}, counts, stages, graph, classes, accuracy, training, sampling,
        distribution, waveforms, plausibility, remarks, areas, outputs, config, seconds``; plain data, any key may be
        missing.
    figures : PNG by name; ``map, confidence, errors, relief`` are layers of one map, others follow under their names;
        ``pulse`` stands with the waveforms, ``sampling`` with the labels.
    heights : of the lowest and the highest tint of ``relief`` [m].

    Returns a dict with ``path, bytes, sections``.
    """
    view = _view(report, figures, heights)
    page = environment().get_template(TEMPLATE).render(view)
    shown = [name for name in SECTIONS if view[name]]
    return {"path": str(path), "bytes": write_page(path, page), "sections": shown}


@functools.cache
def environment() -> Environment:
    """Jinja's environment of the pages: it escapes every text, writes out what would turn one around, and a name that
    is not given is an error."""
    env = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        finalize=lambda value: visible(value, "\n\t") if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.filters.update(
        number=number, parted=split_remark, percent=percent, quantity=quantity, seconds=seconds, width=width
    )
    env.filters.update(sentence=sentence)
    return env


def report_style() -> str:
    """The style sheet of a run's report, for the other pages."""
    text = (Path(__file__).parent / TEMPLATE).read_text(encoding="utf-8")
    match = re.search(r"<style>(.*?)</style>", text, re.S)
    return match[1] if match else ""


def _as_yaml(config: Any) -> str:
    """The configuration as text, by libyaml, a sixth of the time, unless it escapes a letter (those beyond 16 bits)."""
    how: dict[str, Any] = {"sort_keys": False, "allow_unicode": True, "width": 100}
    text = str(yaml.dump(config, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), **how))
    return str(yaml.safe_dump(config, **how)) if "\\U" in text else text


def _view(
    report: Mapping[str, Any], figures: Mapping[str, bytes], heights: tuple[float, float] | None
) -> dict[str, Any]:
    """What the template shows, complete: every key is there, empty where there is nothing to show."""
    classes = list(report.get("classes") or ())
    counts = dict(report.get("counts") or {})
    source = report.get("input") or {}
    config, about = report.get("config"), subject(report)
    pictures = layers({n: data_uri(f) for n, f in figures.items() if n in LAYERS}, classes, heights)
    remarks = list(dict.fromkeys([*_lacking(report), *(str(text) for text in report.get("remarks") or ())]))
    return {
        "survey": report.get("survey") or "survey",
        "subject": about,
        "version": report.get("fwclass") or "",
        "accepted": dict((report.get("libraries") or {}).get("accepted") or {}),
        "total": report.get("seconds"),
        "summary": _summary(report, classes, counts),
        "facts": _facts(report, counts),
        "verdict": verdict(report),
        "surveyed": survey_rows(report),
        "layers": sorted(pictures, key=lambda one: about == "terrain" and one["key"] != "relief"),
        "framed": {
            f"{how} frames: {kind}ing areas" if kind == "train" else f"{how} frames: {kind} areas": FRAMED
            for kind, how in (("train", "dashed"), ("test", "solid"))
            if (report.get("areas") or {}).get(kind)
        },
        "key": class_key(classes),
        "next_steps": [{**step, "href": _link(step["path"]) if step["path"] else ""} for step in next_steps(report)],
        "sure": sure_rows(report),
        "curve": curve(report.get("automation")),
        "reliability": reliability_rows(report.get("reliability")),
        "importance": importance(report.get("training")),
        "selection": selection_curve(report.get("selection"), len((report.get("model") or {}).get("features") or ())),
        "waves": waves(report.get("waves")),
        "maps": [
            {"title": n.replace("_", " ").capitalize(), "uri": data_uri(f)}
            for n, f in figures.items()
            if n not in (PULSE, SAMPLING, *LAYERS)
        ],
        "remarks": remarks,
        "names": names_of(f["path"] for f in source.get("files") or ()),
        "waveforms": waveforms(report.get("waveforms")),
        "plausibility": _plausibility(report.get("plausibility")),
        "ground": ground(report.get("ground")),
        "quality": quality(report.get("quality"), report.get("thresholds") or ()),
        "pulse": data_uri(figures[PULSE]) if PULSE in figures else "",
        "sampling": sampling(report.get("sampling")),
        "sampling_map": data_uri(figures[SAMPLING]) if SAMPLING in figures else "",
        "accuracy": accuracy(report.get("accuracy"), classes, remarks),
        "distribution": distribution(report.get("distribution"), classes),
        "training": training(report.get("training")),
        "counts": {n: v for n, v in counts.items() if counts.get("pulses") or n not in OF_WAVEFORMS},
        "balance": _balance(counts),
        "files": list(source.get("files") or ()),
        "faults": dict(source.get("faults") or {}),
        "stages": stages(report.get("stages") or ()),
        "graph": stage_graph(report.get("graph") or ()),
        "outputs": _outputs(report.get("outputs") or {}),
        "config": _as_yaml(config) if config else "",
    }


def _summary(report: Mapping[str, Any], classes: Sequence[Mapping[str, Any]], counts: Mapping[str, Any]) -> str:
    """One or two sentences on what the run was."""
    files = len((report.get("input") or {}).get("files") or ())
    text = [f"{several(files, 'source file')}"] if files else ["The survey"]
    if counts.get("pulses"):
        text.append(f"with {number(counts['pulses'])} pulses")
    if counts.get("echoes_decomposed"):
        text.append(f"gave {number(counts['echoes_decomposed'])} echoes")
        if water := report.get("bathymetry"):
            text[-1] += f", {number(water['bottoms'])} of them bottoms of water"
    elif counts.get("echoes_in_tiles"):
        text.append(f"hold {number(counts['echoes_in_tiles'])} echoes")
    first = " ".join(text)
    if classes and subject(report) == "terrain":
        ground_echoes = (report.get("ground") or {}).get("ground", 0)
        first += f", {number(ground_echoes)} of them ground"
    elif classes:
        names = [str(c["name"]) for c in classes]
        listed = " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]
        first += f", classified as {listed}"
    if counts.get("tiles"):
        first += f", in {number(counts['tiles'])} tile{'s' * (counts['tiles'] != 1)}"
    training = report.get("training")
    second = ""
    if training and (named := classifier(training)):
        samples = sum(int(n) for n in (training.get("samples") or {}).values())
        second = f" The {named} learned from {number(samples)} samples"
        if layer := training.get("second_layer"):
            second += (
                f", a second layer, which tells {' from '.join(layer['between'])} where they meet, from "
                f"{number(layer['samples'])},"
            )
        second += " and was assessed outside of its training areas." if report.get("accuracy") else "."
    return f"{first}.{second}"


def _lacking(report: Mapping[str, Any]) -> list[str]:
    """What is not there since parts failed: the first thing that a reader must know of a delivery."""
    failed = report.get("failed") or ()
    if not failed:
        return []
    named = first_few([f"{one['stage']} {one['part']}" for one in failed], 3)
    first = str(failed[0]["message"]).splitlines()[:1]
    why = f" The first: {first[0]}." if first else ""
    some = f"{several(len(failed), 'part')}"
    return [
        f"This delivery is not whole: {some} failed ({named}), and what they make is missing, or as an earlier run "
        f"made it.{why} Mend the cause and run again: only what is missing is made."
    ]


def _facts(report: Mapping[str, Any], counts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The figures at the top: (label, value), those that are known."""
    accuracy = report.get("accuracy") or {}
    wanted = (
        ("overall accuracy", percent(accuracy.get("overall_accuracy")), " %"),
        ("kappa", f"{accuracy['kappa']:.3f}" if accuracy.get("kappa") is not None else "", ""),
        ("mean IoU", percent(accuracy.get("mean_iou")), " %"),
        ("pulses", quantity(counts.get("pulses") or None), ""),
        ("echoes", quantity(counts.get("echoes_in_tiles")), ""),
        ("tile" if counts.get("tiles") == 1 else "tiles", quantity(counts.get("tiles")), ""),
        *_times(report),
    )
    return [(label, value + unit) for label, value, unit in wanted if value]


def _times(report: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """How long the run took; where it skipped parts that earlier ones made, also what all of them took."""
    stages, run = report.get("stages") or (), seconds(report.get("seconds"))
    if not any(stage.get("skipped") for stage in stages):
        return [("time", run, "")]
    return [("time of the last run", run, ""), ("time of all parts", seconds(sum(s["seconds"] for s in stages)), "")]


def _plausibility(facts: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Echoes beside the returns of their strip: one row for every strip with waveforms; None without any."""
    if not facts or not facts.get("strips"):
        return None
    rows = [
        {
            "name": strip["name"],
            "fitted": number(strip["fitted"]),
            "cells": [number(strip[name]) for name in COUNTED],
            "share": percent(strip["implausible_share"]) or "–",
            "lag1": measure(strip["lag1"]),
            "inflation": measure(strip["inflation"]),
        }
        for strip in facts["strips"]
    ]
    return {"rows": rows, "accepted": bool(facts.get("accepted")) and bool(facts.get("remarks"))}


def _balance(counts: Mapping[str, Any]) -> dict[str, Any] | None:
    """Whether every decomposed echo lies in a tile."""
    decomposed, in_tiles = counts.get("echoes_decomposed"), counts.get("echoes_in_tiles")
    if decomposed is None or in_tiles is None:
        return None
    return {
        "made": number(decomposed),
        "kept": number(in_tiles),
        "equal": decomposed == in_tiles,
        "lost": number(abs(decomposed - in_tiles)),
    }


def data_uri(picture: bytes) -> str:
    """A PNG as an address that stands in the page itself."""
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"


def _outputs(outputs: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Paths by kind, relative ones as links."""
    labels = {
        "laz": "Classified points (LAZ)",
        "parquet": "GeoParquet",
        "rasters": "Rasters (GeoTIFF)",
        "model": "Trained model",
        "quality": "Survey quality",
        "gis": "QGIS project and tile map",
        "contours": "Contour lines (GeoPackage)",
        "vectors": "Vectors (GeoPackage, GeoParquet)",
    }
    out = []
    for kind, items in outputs.items():
        paths = [str(i["path"] if isinstance(i, Mapping) else i) for i in items or ()]
        links = [{"text": p, "href": _link(p)} for p in paths]
        if links:
            out.append(
                {"label": labels.get(kind, kind), "count": len(links), "open": links[:LISTED], "more": links[LISTED:]}
            )
    return out


def _link(path: str) -> str:
    """A link that can only lead to a file beside the report; "" for any other path."""
    inside = not path.startswith(("/", "\\")) and ".." not in path.split("/") and ":" not in path.split("/")[0]
    return "./" + quote(path.replace("\\", "/")) if inside else ""


def split_remark(text: str) -> tuple[str, str]:
    """What a remark means, and what whoever makes the next run can do, "" for nothing.

    A clause that names an option, a command or a setting is of the second kind, with all that follows, and so is such a
    clause in brackets; names of settings alone in brackets go. A remark that begins with such a clause stays whole.
    """
    said, advice = _ALONE.sub("", text), []
    for aside in _ASIDE.finditer(said):
        if _COMMAND.search(aside[1]):
            advice.append(aside[1])
            said = said.replace(aside[0], "", 1)
    if (command := _COMMAND.search(said)) is not None:
        ends = [m.end() for m in _CLAUSE.finditer(said, 0, command.start())]
        if not ends:
            return text, ""
        advice.insert(0, said[ends[-1] :])
        said = said[: ends[-1] - 2]
    return said if said.endswith(".") or not advice else f"{said}.", "; ".join(advice)


_NAME = re.compile(r"\S*[\d_/\\]|\S*\.\S|[b-z]\b|\S+ = ")
"""What no word begins with: the name of a file, a column or a setting, an axis."""


def sentence(text: str, names: Iterable[str] = ()) -> str:
    """A remark as it stands on a page: with a capital letter, unless it begins with a name, and a stop. `names`: of the
    sources and strips (`names_of`), which may look like words."""
    named = _NAME.match(text) or any(text.startswith(n) and not text[len(n) :][:1].isalnum() for n in names)
    begun = text if named else text[:1].upper() + text[1:]
    return begun if begun.endswith((".", "?", "!", ":")) else f"{begun}."


def names_of(files: Iterable[str]) -> set[str]:
    """How remarks call the `files`, paths: by name, and without its ending."""
    paths = [PurePosixPath(str(file)) for file in files]
    return {*(path.name for path in paths), *(path.stem for path in paths)} - {""}


LONG = 750
"""Pixels of a picture that is wider than a telephone shows at once: that it goes on is said there."""


def width(uri: str) -> dict[str, str | None]:
    """Attributes of the image at `data_uri`, by its width [pixels]: a telephone shows nearly half as many, the letters
    of axes at nine."""
    pixels = int.from_bytes(base64.b64decode(uri.partition(",")[2][:32])[16:20])
    return {"style": f"--wide: {pixels}px", "class": "long" if pixels > LONG else None}
