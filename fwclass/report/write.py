"""What a run tells at its end: `report.json` and `report.html`, gathered from receipts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass import __version__
from fwclass.classify.kept import Kept
from fwclass.conf import Config
from fwclass.graph.corrections import CORRECTIONS
from fwclass.graph.kept import class_remarks, kept_codes, known_codes, other_names
from fwclass.graph.sampling import LABELS, SAMPLES
from fwclass.graph.tiling import source_codes
from fwclass.graph.water import LEVELS
from fwclass.quality.covered import CoveredArea
from fwclass.report.accuracy import class_accuracy, drift_of_run, feature_distribution, ground_facts, training_facts
from fwclass.report.counts import delivered_files, echo_counts, source_files, stage_figures, withheld_returns
from fwclass.report.earlier import since_earlier
from fwclass.report.facts import legacy_codes, place_of, receipts_of_run, sureness, unsure_of_run
from fwclass.report.figures import report_figures
from fwclass.report.radiometry import radiometry_facts
from fwclass.report.remarks import remarks_of_parts, remarks_on_accuracy, remarks_on_crowds, remarks_on_empty_files
from fwclass.report.repeated import repeated_facts
from fwclass.report.sampling import sampling
from fwclass.report.waveforms import plausibility_of_run, some_waves, waveform_facts
from fwclass.run.inputs import PartInputs
from fwclass.run.libraries import report_libraries
from fwclass.run.runner import Runner
from fwclass.store.atomic import read_json, write_json
from fwclass.store.directory import link
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
        return standing
    from fwclass.publish.report import render_report  # its templates are not needed where nothing was made

    source = source_codes({(SPLIT.name, r.part): r for r in receipts_of_run(runner, SPLIT.name)})
    keeps, classified = Kept.of(config.classify), "classify" in runner.tallies
    classes = _classes(config, source) if classified else []
    files, tiles = source_files(runner, survey), receipts_of_run(runner, "publish-tile")
    counted = sampling(
        config,
        *(receipts_of_run(runner, s) for s in (LABELS, SAMPLES, "label", "polygons", CORRECTIONS)),
        whole_run=runner.whole,
    )
    accuracy, counts = class_accuracy(runner, config), echo_counts(runner)
    on_accuracy = remarks_on_accuracy(accuracy, counted, counts["echoes_in_tiles"], config, names, survey)
    if accuracy is not None:
        accuracy["remarks"] = on_accuracy
    ground = ground_facts(runner, config, withheld_returns(runner))
    drifted, plausible = drift_of_run(runner), plausibility_of_run(runner, survey, config)
    repeated = repeated_facts((r.meta for r in receipts_of_run(runner, TILE.name)), survey.strips)
    unsure = unsure_of_run(tiles, config, card) if classified else None
    place = place_of(
        tiles,
        survey.crs,
        survey.standard_time,
        CoveredArea.joined(
            config.publish.class_cell, [r.meta["covered"] for r in receipts_of_run(runner, "publish-rasters")]
        ),
        config.quality.void_spacings,
    )
    radiometric = radiometry_facts(
        (r.meta for r in receipts_of_run(runner, "radiometry")),
        next((r.meta["calibration"] for r in receipts_of_run(runner, "calibrate")), None),
        survey.strips,
        config.radiometry,
        bool(config.survey.trajectory.files) or config.radiometry.platform_altitude is not None,
        {} if config.survey.trajectory.files else _sensors(runner, survey),
    )
    earlier = since_earlier(runner, REPORT, config.survey.name, files["files"])
    report = {
        "survey": config.survey.name,
        "fwclass": __version__,
        "input": files,
        "counts": counts,
        "stages": [stage_figures(runner, name, tally) for name, tally in runner.tallies.items()],
        "graph": list(graph),
        "classes": classes,
        "accuracy": accuracy,
        "model": {
            "path": config.survey.model,
            "base": config.survey.base_model,
            "features": list(names),
            "classes": [{"name": c.name, "code": c.code, "codes": list(c.codes)} for c in config.classes],
        },
        "training": training_facts(runner, names),
        "selection": selected.model_dump() if (selected := config.selection) else None,
        "place": place,
        "radiometry": radiometric,
        "earlier": earlier,
        "sureness": sureness(tiles, classes),
        "automation": next((r.meta["automation"] for r in receipts_of_run(runner, "assess")), []),
        "reliability": next((r.meta["reliability"] for r in receipts_of_run(runner, "assess")), None),
        "waves": some_waves(
            receipts_of_run(runner, "read"),
            {r.part for r in receipts_of_run(runner, "decompose")},
            PartInputs(runner.store),
        ),
        "sampling": counted,
        "distribution": feature_distribution(runner),
        "waveforms": waveform_facts(runner, survey),
        "drift": drifted,
        "unsure": unsure,
        "plausibility": plausible,
        "repeated": repeated,
        "remarks": [
            *on_accuracy,
            *(earlier or {}).get("remarks", ()),
            *(place or {}).get("remarks", ()),
            *(radiometric or {}).get("implausible", ()),
            *(repeated or {}).get("remarks", ()),
            *ground["remarks"],
            *(plausible or {}).get("remarks", ()),
            *(drifted or {}).get("remarks", ()),
            *(unsure or {}).get("remarks", ()),
            *remarks_on_crowds(runner, config),
            *remarks_on_empty_files(files),
            *remarks_of_parts(runner),
            *(class_remarks(source, known_codes(config.classes), keeps) if classified else ()),
        ],
        "kept": {str(c): n for c, n in kept_codes(source, keeps).items()},
        "legacy_codes": legacy_codes(runner, survey, config),
        "ground": ground,
        "water": [body for r in receipts_of_run(runner, LEVELS) for body in r.meta["bodies"]],
        "quality": next((r.meta["quality"] for r in receipts_of_run(runner, "publish-quality")), None),
        "areas": config.areas.shown(layout.box),
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
    write_json(runner.pending / REPORT, report)
    render_report(report, report_figures(config, runner, layout, report), runner.pending / PAGE)
    return report


def _classes(config: Config, source: Mapping[int, int]) -> list[dict[str, Any]]:
    """The survey's classes, and codes that echoes have besides."""
    own = [{"name": c.name, "code": c.code} for c in config.survey.classes]
    others = other_names(source, config.classify, [c.code for c in config.survey.classes])
    return [*own, *({"name": name, "code": code} for code, name in others.items())]


def _sensors(runner: Runner, survey: Survey) -> dict[str, tuple[float, float]]:
    """Heights of the sensor and of what it saw [m], by strip that tells them."""
    indexed = {r.part: sensor for r in receipts_of_run(runner, "index") if (sensor := r.meta.get("sensor"))}
    return {s.path.name: (indexed[s.key][0], indexed[s.key][1]) for s in survey.strips if s.key in indexed}


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
        or standing.get("outputs") != delivered_files(runner)
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
