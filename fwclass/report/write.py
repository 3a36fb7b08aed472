"""What a run tells at its end: `report.json` and `report.html`, gathered from receipts."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fwclass import __version__
from fwclass.classify.kept import Kept
from fwclass.classify.params import RegularizeParams
from fwclass.conf import Config
from fwclass.graph.assess import ASSESS, BLOCKS, COUNTS
from fwclass.graph.classify import codes_on_lines
from fwclass.graph.corrections import CORRECTIONS, ECHO_LABELS
from fwclass.graph.kept import class_remarks, kept_codes, known_codes, other_names
from fwclass.graph.model_fit import ground_notes
from fwclass.graph.sampling import LABELS, SAMPLES
from fwclass.graph.tiling import codes_of_strips, source_codes
from fwclass.graph.water import LEVELS
from fwclass.quality.check_points import check_remarks
from fwclass.quality.covered import CoveredArea
from fwclass.quality.judge import thresholds
from fwclass.quality.roughness import roughness_remarks
from fwclass.quality.steps import step_remarks
from fwclass.quality.strips import offset_remarks, unsound_strips
from fwclass.report.accuracy import class_accuracy, drift_of_run, feature_distribution, ground_facts, training_facts
from fwclass.report.counts import (
    bathymetry_facts,
    delivered_files,
    echo_counts,
    source_files,
    stage_figures,
    vector_counts,
    withheld_returns,
)
from fwclass.report.drift import with_returns
from fwclass.report.earlier import since_earlier
from fwclass.report.facts import (
    legacy_codes,
    metas_of_run,
    place_of,
    place_without_tiles,
    receipts_of_run,
    sureness,
    unsure_of_run,
)
from fwclass.report.figures import report_figures
from fwclass.report.labels import label_facts
from fwclass.report.places import bounds_of_files, echoes_in_tiles, file_places
from fwclass.report.remarks import (
    lines_changed,
    remarks_of_parts,
    remarks_on_accuracy,
    remarks_on_crowds,
    remarks_on_files,
)
from fwclass.report.repeated import repeated_facts
from fwclass.report.returns import heights_of_returns, returns_facts
from fwclass.report.sampling import sampling
from fwclass.report.waveforms import plausibility_of_run, radiometry_of_run, some_waves, waveform_facts
from fwclass.run.inputs import PartInputs
from fwclass.run.libraries import report_libraries
from fwclass.run.runner import Runner
from fwclass.store.arrays import read_arrays, write_one_file
from fwclass.store.atomic import read_json, write_json
from fwclass.store.libraries import fingerprint
from fwclass.store.links import link
from fwclass.store.receipts import Receipt
from fwclass.survey.layout import Layout, Survey
from fwclass.tile.stage import SPLIT, TILE

REPORT, PAGE = "report.json", "report.html"


def write_report(
    config: Config,
    runner: Runner,
    survey: Survey,
    layout: Layout,
    names: tuple[str, ...],
    graph: Sequence[Mapping[str, Any]],
    card: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Gather the figures from receipts, write `report.json` and `report.html`, return the dict.

    `graph`: name, kind of part and sources of every stage, as `stages.graph_of` gives them; `card` that of the model
    that was given, None where one was trained.

    Both are written beside, to be published with the rest. Where this run made nothing new, the report of the run that
    did is left as it is.
    """
    standing = _standing(config, runner, survey)
    if standing is not None:
        _keep_counts(standing, runner)
        return standing
    from fwclass.publish.report import render_report  # its templates are not needed where nothing was made

    source = source_codes({(SPLIT.name, r.part): r for r in receipts_of_run(runner, SPLIT.name)})
    tiles = receipts_of_run(runner, "publish-tile")
    described = _of_the_survey(config, runner, survey, layout, names, tiles)
    report = {
        **_of_the_run(config, runner, graph, names),
        **described,
        **_of_the_classes(config, runner, survey, names, tiles, source, card),
    }
    if report["drift"] and card:
        ground = report["ground"]
        report["drift"] = with_returns(report["drift"], card, report["returns"], ground["ground"], ground["echoes"])
    if (accuracy := report["accuracy"]) is not None:
        echoes, cells = report["counts"]["echoes_in_tiles"], (report["training"] or {}).get("in_context") or ()
        accuracy["remarks"] = remarks_on_accuracy(
            accuracy, report["sampling"], echoes, config, names, survey, cells, lines_changed(runner)
        )
    report["remarks"] = _remarks(report, config, runner, source, card)
    write_json(runner.pending / REPORT, report)
    figures, heights = report_figures(config, runner, layout, report)
    render_report(report, figures, runner.pending / PAGE, heights)
    _keep_counts(report, runner)
    return report


def _keep_counts(report: Mapping[str, Any], runner: Runner) -> None:
    """The counts by block that the accuracy of a delivery stands on, as a copy: a link would lead into the store."""
    if report.get("accuracy") is None:
        return
    counts = runner.store.arrays_path(ASSESS.name, "all", COUNTS)
    if counts.is_file():
        shutil.copyfile(counts, runner.pending / BLOCKS)
    else:  # those of hundreds of thousands of blocks, the report's map holds them too
        arrays, about = read_arrays(counts)
        smallest = np.min_scalar_type(arrays["blocks"].max(initial=0))
        write_one_file(runner.pending / BLOCKS, arrays | {"blocks": arrays["blocks"].astype(smallest)}, about)


def _of_the_run(
    config: Config, runner: Runner, graph: Sequence[Mapping[str, Any]], names: tuple[str, ...]
) -> dict[str, Any]:
    """What ran, by which settings, and how it ended."""
    return {
        "survey": config.survey.name,
        "fwclass": __version__,
        "stages": [stage_figures(runner, name, tally) for name, tally in runner.tallies.items()],
        "graph": list(graph),
        "model": {
            "path": config.survey.model,
            "base": config.survey.base_model,
            "features": list(names),
            "classes": [{"name": c.name, "code": c.code, "codes": list(c.codes)} for c in config.classes],
        },
        "selection": selected.model_dump() if (selected := config.selection) else None,
        "outputs": delivered_files(runner),
        "lost_workers": [
            {"stage": o.stage, "part": o.part, "status": o.status, "causes": list(o.lost)}
            for o in runner.outcomes.values()
            if o.lost
        ],
        "failed": [{"stage": o.stage, "part": o.part, "message": o.message} for o in runner.failures],
        "config": _plain(config.raw),
        "libraries": report_libraries(runner),
        "whole": runner.whole,
        "seconds": round(max((t.ended for t in runner.tallies.values()), default=0.0) - runner.began, 3),
    }


def _of_the_survey(
    config: Config, runner: Runner, survey: Survey, layout: Layout, names: tuple[str, ...], tiles: Sequence[Receipt]
) -> dict[str, Any]:
    """The files, their waveforms, echoes and ground."""
    files, spacings = source_files(runner, survey), config.quality.void_spacings
    covered = CoveredArea.joined(config.publish.class_cell, metas_of_run(runner, "publish-rasters", "covered"))
    read = [r for stage in ("read", "decompose") for r in receipts_of_run(runner, stage)]
    tiled = receipts_of_run(runner, TILE.name)
    decomposed = {r.part for r in read if r.stage == "decompose"}
    quality = next(iter(metas_of_run(runner, "publish-quality", "quality")), None)
    unplaced = None if tiles else place_without_tiles(survey.crs, layout.box, heights_of_returns(read))
    return {
        "input": {
            **files,
            "place": unplaced,
            "places": file_places(
                survey,
                bounds_of_files(read, tiled),
                config.plausibility,
                {r.part: (r.meta["bounds"][:3], r.meta["bounds"][3:]) for r in tiled},
                echoes_in_tiles(receipts_of_run(runner, SPLIT.name)),
            ),
        },
        "counts": echo_counts(runner),
        "bathymetry": bathymetry_facts(runner),
        "earlier": since_earlier(runner, REPORT, config.survey.name, files),
        "place": place_of(tiles, survey.crs, survey.standard_time, covered, spacings),
        "areas": config.areas.shown(layout.box),
        "waves": some_waves(receipts_of_run(runner, "read"), decomposed, PartInputs(runner.store)),
        "waveforms": waveform_facts(runner, survey),
        "plausibility": plausibility_of_run(runner, survey, config),
        "radiometry": radiometry_of_run(runner, survey, config),
        "repeated": repeated_facts((r.meta for r in tiled), survey.strips, receipts_of_run(runner, "decompose")),
        "returns": returns_facts(
            read, survey.strips, names if "classify" in runner.tallies else (), config.plausibility, survey.weekly
        ),
        "ground": ground_facts(runner, config, withheld_returns(runner)),
        "water": [body for bodies in metas_of_run(runner, LEVELS, "bodies") for body in bodies],
        "vectors": vector_counts(runner),
        "quality": quality,
        "thresholds": thresholds(quality, config.quality) if quality else [],
    }


def _of_the_classes(
    config: Config,
    runner: Runner,
    survey: Survey,
    names: tuple[str, ...],
    tiles: Sequence[Receipt],
    source: Mapping[int, int],
    card: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """The labels, what was learned of them, and how good and how sure the classes are."""
    classified = "classify" in runner.tallies
    classes = _classes(config, source) if classified else []
    counted = sampling(
        config,
        *(receipts_of_run(runner, s) for s in (LABELS, SAMPLES, "label", "polygons", CORRECTIONS, ECHO_LABELS)),
        files=_codes_of_files(runner, survey),
        whole_run=runner.whole,
    )
    return {
        "classes": classes,
        "kept": {str(c): n for c, n in kept_codes(source, Kept.of(config.classify)).items()},
        "legacy_codes": legacy_codes(runner, survey, config),
        "sampling": counted,
        "training": training_facts(runner, names),
        "labels": label_facts(
            [r for stage in ("training", "assess") for r in receipts_of_run(runner, stage)],
            tiles if classified else (),
            config.plausibility,
            receipts_of_run(runner, "label"),
            _uncounted(config, counted) if classified else 0.0,
        ),
        "accuracy": class_accuracy(runner, config),
        "automation": next(iter(metas_of_run(runner, "assess", "automation")), []),
        "reliability": next(iter(metas_of_run(runner, "assess", "reliability")), None),
        "distribution": feature_distribution(runner),
        "sureness": sureness(tiles, classes),
        "drift": drift_of_run(runner, card),
        "unsure": unsure_of_run(tiles, config, survey, card) if classified else None,
    }


SORTED = 4, 0.9, 0.05
"""Tiles, and the share of them in which so many of the echoes are labelled, of a survey that was sorted as a whole: one
that has labels here and there, and is unclassified elsewhere, is what `run` is for."""


def _uncounted(config: Config, counted: Mapping[str, Any] | None) -> float:
    """Share of the echoes of a survey that was sorted as a whole to which its reference gives a code that no class
    counts, though they are classified."""
    if counted is None or config.survey.reference.kind not in ("source", "cloud") or config.classify.only:
        return 0.0
    tiles = [one for one in counted["tiles"] if one["echoes"]]
    labelled = sum(sum(one["labelled"]) >= SORTED[2] * one["echoes"] for one in tiles)
    if len(tiles) < SORTED[0] or labelled < SORTED[1] * len(tiles):
        return 0.0
    stays = {int(code) for code in config.classify.keep}
    sorted_echoes = counted["echoes"] - sum(counted["without_classes"].values())
    return sum(n for code, n in counted["left_codes"].items() if int(code) not in stays) / max(sorted_echoes, 1)


def _codes_of_files(runner: Runner, survey: Survey) -> dict[str, Mapping[int, int]]:
    """Echoes of every source file by their code in it."""
    codes = codes_of_strips(receipts_of_run(runner, SPLIT.name))
    return {strip.path.name: codes[strip.number] for strip in survey.strips if strip.number in codes}


def _remarks(
    report: Mapping[str, Any], config: Config, runner: Runner, source: Mapping[int, int], card: Mapping[str, Any] | None
) -> list[str]:
    """All that is remarked on, in the order in which the report has it."""

    def of(*subjects: str) -> list[str]:
        return [line for subject in subjects for line in (report[subject] or {}).get("remarks", ())]

    classified, known, keeps = "classify" in runner.tallies, known_codes(config.classes), Kept.of(config.classify)
    return [
        *of("accuracy", "earlier", "place"),
        *(report["input"]["place"] or {}).get("remarks", ()),
        *report["input"]["places"]["remarks"],
        *(report["radiometry"] or {}).get("implausible", ()),
        *(_of_quality(report["quality"], config) if report["quality"] else ()),
        *of("labels", "repeated", "returns", "ground", "plausibility", "bathymetry", "drift", "unsure"),
        *ground_notes(card or {}, config.ground.method, config.terrain.height, in_run=True),
        *remarks_on_crowds(runner, config),
        *remarks_on_files(report["input"]),
        *remarks_of_parts(runner),
        *(class_remarks(source, known, keeps) if classified else ()),
        *(_on_neighbours(config.classify.regularize) if classified else ()),
        *(_without_lines(config) if classified else ()),
    ]


def _of_quality(quality: Mapping[str, Any], config: Config) -> list[str]:
    strips, checked = quality["strips"], quality["check_points"]
    return [
        *(unsound_strips(strips) or offset_remarks(strips)),
        *step_remarks(strips),
        *roughness_remarks(strips["roughness"]),
        *(check_remarks(checked, config.quality.check_points.reach) if checked else ()),
    ]


def _on_neighbours(params: RegularizeParams) -> list[str]:
    if params.strength == 0:
        return []
    return [
        f"neighbours agree by a mean field of strength {params.strength:g} (classify.regularize): classes and "
        "confidences are those after it"
    ]


def _without_lines(config: Config) -> list[str]:
    if codes_on_lines(config) or not config.classify.lines.among(c.code for c in config.classes):
        return []
    return [
        "wires are not looked for along lines (classify.lines): the run is thinned, has a second layer of two "
        "classes, or keeps the source's wires"
    ]


def _classes(config: Config, source: Mapping[int, int]) -> list[dict[str, Any]]:
    """The survey's classes, and codes that echoes have besides."""
    own = [{"name": c.name, "code": c.code} for c in config.survey.classes]
    others = other_names(source, config.classify, [c.code for c in config.survey.classes])
    return [*own, *({"name": name, "code": code} for code, name in others.items())]


def _standing(config: Config, runner: Runner, survey: Survey) -> dict[str, Any] | None:
    """The report that is there, if it still tells everything; it goes into the next generation too."""
    if any(o.status != "skipped" for o in runner.outcomes.values()):
        return None
    report, page = (runner.store.generations.shown(name) for name in (REPORT, PAGE))
    if report is None or page is None:
        return None
    standing = read_json(report)
    if (
        standing.get("config") != _plain(config.raw)
        or standing.get("failed")
        or (standing.get("libraries") or {}).get("here") != dict(fingerprint())  # told, and shown, by other code
        or standing.get("outputs") != delivered_files(runner)
        or standing["input"].get("excluded", []) != list(survey.excluded)
        or ((standing.get("sampling") or {}).get("corrections") is None) != (survey.corrections is None)
    ):
        return None
    if (
        runner.accept_libraries
        and (standing.get("libraries") or {}).get("accepted") != report_libraries(runner)["accepted"]
    ):
        return None
    for path in (report, page):
        link(path, runner.pending / path.name)
    return dict(standing)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value if isinstance(value, (str, int, float, bool)) or value is None else str(value)
