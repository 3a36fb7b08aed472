"""What a run tells at its end: `report.json`, `report.html`, and the figures for both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fwclass import __version__
from fwclass.assess.stage import caution
from fwclass.classify.kept import Kept
from fwclass.conf import Config
from fwclass.decompose.plausible import add_counts
from fwclass.errors import visible
from fwclass.features.dense import Crowd
from fwclass.graph.accuracy_remarks import accuracy_remarks
from fwclass.graph.classify import OUTSIDE
from fwclass.graph.contours import DELIVER_CONTOURS
from fwclass.graph.corrections import CORRECTIONS
from fwclass.graph.drift import drift
from fwclass.graph.kept import class_remarks, kept_codes, kept_names, known_codes
from fwclass.graph.layout import Layout, Survey
from fwclass.graph.plausibility import UNREADABLE, of_strip, receiver_facts, remarks
from fwclass.graph.report_facts import place_of, receipts_of_run, some_waves, sureness
from fwclass.graph.report_figures import report_figures
from fwclass.graph.sampling import LABELS, SAMPLES
from fwclass.graph.sampling_summary import sampling
from fwclass.graph.tiling import source_codes
from fwclass.graph.vectors import DELIVER_VECTORS, vector_remarks
from fwclass.graph.water import LEVELS
from fwclass.model.ranges import RANGES
from fwclass.run.inputs import PartInputs
from fwclass.run.libraries import report_libraries
from fwclass.run.runner import Runner, Tally
from fwclass.store.atomic import read_json, write_json
from fwclass.store.directory import link
from fwclass.store.url import Url
from fwclass.tile.stage import SPLIT

REPORT, PAGE = "report.json", "report.html"

SOURCES = ("index", "read", "pulse", "places", "decompose", "split")
"""Stages whose failed parts leave tiles without some of their echoes."""

JUDGING = ("label", "confusion", "assess")
"""Stages without which there is no accuracy."""

SHOWN = 4
"""Chunks that are named of those that failed."""


def write_report(
    config: Config,
    runner: Runner,
    survey: Survey,
    layout: Layout,
    names: tuple[str, ...],
    graph: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Gather the figures from receipts, write `report.json` and `report.html`, return the dict.

    `graph`: name, kind of part and sources of every stage, as `stages.described` gives them.

    Both are written beside, to be published with the rest. Where this run made nothing new, the report of the run that
    did is left as it is.
    """
    standing = _standing(config, runner)
    if standing is not None:
        return standing
    from fwclass.publish.report import render_report  # its templates are not needed where nothing was made

    source = source_codes({(SPLIT.name, r.part): r for r in receipts_of_run(runner, SPLIT.name)})
    keeps = Kept.of(config.classify)
    report = {
        "survey": config.survey.name,
        "fwclass": __version__,
        "input": (files := _input(runner, survey)),
        "counts": _counts(runner),
        "stages": [_stage(runner, name, tally) for name, tally in runner.tallies.items()],
        "graph": list(graph),
        "classes": (classes := _classes(config, source, keeps) if (classified := "classify" in runner.tallies) else []),
        "accuracy": (accuracy := _accuracy(runner, config)),
        "model": {"path": config.survey.model, "features": list(names)},
        "training": _training(runner, names),
        "selection": selected.model_dump() if (selected := config.selection) else None,
        "place": place_of(
            (tiles := receipts_of_run(runner, "publish-tile")),
            survey.crs,
            survey.standard_time,
            sum(r.meta["class_cells"] for r in receipts_of_run(runner, "publish-rasters")),
            config.publish.class_cell,
        ),
        "sureness": sureness(tiles, classes),
        "automation": next((r.meta["automation"] for r in receipts_of_run(runner, "assess")), []),
        "waves": some_waves(
            receipts_of_run(runner, "read"),
            {r.part for r in receipts_of_run(runner, "decompose")},
            PartInputs(runner.store),
        ),
        "sampling": (
            counted := sampling(
                config,
                *(receipts_of_run(runner, s) for s in (LABELS, SAMPLES, "label", "polygons", CORRECTIONS)),
                whole_run=runner.whole,
            )
        ),
        "distribution": _distribution(runner),
        "waveforms": _waveforms(runner, survey),
        "drift": (drifted := _drift(runner)),
        "plausibility": (plausible := _plausibility(runner, survey, config)),
        "remarks": [
            *_of_accuracy(accuracy, counted, config, names),
            *(plausible or {}).get("remarks", ()),
            *(drifted or {}).get("remarks", ()),
            *_crowd_remarks(runner, config),
            *_empty(files),
            *_of_parts(runner),
            *(class_remarks(source, known_codes(config.classes), keeps) if classified else ()),
        ],
        "kept": {str(c): n for c, n in kept_codes(source, keeps).items()},
        "ground": _ground(runner, config),
        "water": [body for r in receipts_of_run(runner, LEVELS) for body in r.meta["bodies"]],
        "quality": next((r.meta["quality"] for r in receipts_of_run(runner, "publish-quality")), None),
        "areas": {k: [list(b.bounds) for b in config.areas.boxes(k)] for k in ("train", "test")},
        "outputs": _outputs(runner),
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


def _classes(config: Config, source: Mapping[int, int], kept: Kept | None) -> list[dict[str, Any]]:
    """The survey's classes, and those that stay as the sources have them."""
    own = [{"name": c.name, "code": c.code} for c in config.survey.classes]
    others = kept_names(source, kept, (c.code for c in config.survey.classes))
    return [*own, *({"name": name, "code": code} for code, name in others.items())]


def _standing(config: Config, runner: Runner) -> dict[str, Any] | None:
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
        or standing.get("outputs") != _outputs(runner)
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


def _input(runner: Runner, survey: Survey) -> dict[str, Any]:
    faults: Counter[str] = Counter()
    for meta in _chunk_facts(runner):
        faults.update(meta["faults"])
    indexed = {r.part: r.meta for r in receipts_of_run(runner, "index")}
    files = []
    for strip in survey.strips:
        meta = indexed.get(f"{strip.number:05d}", {})
        facts = {n: meta.get(n) for n in ("points", "pulses", "point_format")}
        files.append({"path": strip.path.name, "strip": strip.number, **facts})
    return {"files": files, "faults": dict(sorted(faults.items()))}


def _of_parts(runner: Runner) -> list[str]:
    """What the parts of water, contour lines and vectors say."""
    stages = (LEVELS, DELIVER_CONTOURS.name)
    remarks = [
        line for stage in stages for receipt in receipts_of_run(runner, stage) for line in receipt.meta["remarks"]
    ]
    return [*remarks, *(line for r in receipts_of_run(runner, DELIVER_VECTORS.name) for line in vector_remarks(r.meta))]


def _empty(files: Mapping[str, Any]) -> list[str]:
    """That source files have nothing in them."""
    names = [visible(f["path"]) for f in files["files"] if f["points"] == 0 and not f["pulses"]]
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return [f"files without any point: {', '.join(names[:SHOWN])}{more}"] if names else []


def _chunk_facts(runner: Runner) -> list[Mapping[str, Any]]:
    """What every chunk held: told by those that were read, and by those that were decomposed as they were read."""
    return [r.meta for stage in ("read", "decompose") for r in receipts_of_run(runner, stage) if "returns" in r.meta]


def _counts(runner: Runner) -> dict[str, int]:
    reads = _chunk_facts(runner)
    tiles = receipts_of_run(runner, "tile")
    return {
        "pulses": sum(r.meta["pulses"] for r in receipts_of_run(runner, "index")),
        "returns": sum(m["returns"] for m in reads),
        "returns_without_packet": sum(r.meta["kept_returns"] for r in receipts_of_run(runner, "decompose")),
        "returns_without_echo": sum(r.meta["returns_without_echo"] for r in receipts_of_run(runner, "decompose")),
        "echoes_decomposed": sum(r.meta["echoes"] for r in receipts_of_run(runner, "decompose")),
        "echoes_in_tiles": sum(r.meta["rows"] for r in tiles),
        "tiles": len(tiles),
    }


def _drift(runner: Runner) -> dict[str, Any] | None:
    """How much lies outside of what the model has seen; None where nothing was classified, or it does not say."""
    counts = [
        r.meta[OUTSIDE] for stage in ("coarse", "classify") for r in receipts_of_run(runner, stage) if OUTSIDE in r.meta
    ]
    if not counts:
        return None
    cards = [r.meta["card"] for stage in ("train-coarse", "train") for r in receipts_of_run(runner, stage)]
    return drift(cards[0] if cards else {RANGES: {}}, counts)


def _crowd_remarks(runner: Runner, config: Config) -> list[str]:
    """That some places are too dense for all echoes of a neighbourhood to count."""
    crowd = Crowd.of_parts(r.meta.get("dense") for r in receipts_of_run(runner, "features"))
    return [crowd.text(config.features)] if crowd else []


def _stage(runner: Runner, name: str, tally: Tally) -> dict[str, Any]:
    receipts = receipts_of_run(runner, name)
    return {
        "name": name,
        "parts": tally.parts,
        "computed": tally.computed,
        "skipped": tally.skipped,
        "failed": tally.failed,
        "seconds": round(sum(r.seconds for r in receipts), 3),
        "peak_mib": max((r.peak_mib for r in receipts), default=0.0),
        "rows": sum(int(r.meta.get("rows", 0)) for r in receipts),
    }


def _accuracy(runner: Runner, config: Config) -> dict[str, Any] | None:
    receipt = next(iter(receipts_of_run(runner, "assess")), None)
    if receipt is None or receipt.meta["accuracy"] is None:
        return None
    gap = config.areas.gap
    area = "the listed test areas" if config.areas.test else "all echoes"
    accuracy = dict(receipt.meta["accuracy"])
    if accuracy.get("intervals"):
        accuracy["intervals"] = {**accuracy["intervals"], "caution": caution(accuracy["intervals"]["blocks"])}
    return {**accuracy, "area": f"{area} further than {gap:g} m from every training area"}


def _of_accuracy(
    accuracy: dict[str, Any] | None, counted: Mapping[str, Any] | None, config: Config, names: tuple[str, ...]
) -> list[str]:
    """Remarks on the accuracy, which are kept with it too."""
    if accuracy is None or counted is None:
        return []
    nearest = counted["gap"]["found"]
    sentences = accuracy_remarks(accuracy, config, names, counted["echoes"], counted["other_codes"], nearest)
    accuracy["remarks"] = sentences
    return sentences


def _training(runner: Runner, names: tuple[str, ...]) -> dict[str, Any] | None:
    receipt = next(iter(receipts_of_run(runner, "train")), None)
    if receipt is None:
        return None
    card = receipt.meta["card"]
    samples = {c["name"]: n for c, n in zip(card["classes"], card["samples"], strict=True)}
    return {
        "method": card.get("method", "forest"),
        "samples": samples,
        "trees": receipt.meta["trees"],
        "features": list(names),
        "out_of_bag": card.get("out_of_bag", {}).get("accuracy"),
        "notes": card.get("notes", []),
        "importance": card.get("importance"),
    }


def _distribution(runner: Runner) -> dict[str, Any] | None:
    receipt = next(iter(receipts_of_run(runner, "assess")), None)
    if receipt is None:
        return None
    distribution = receipt.meta["distribution"]
    labels = [f"p{round(100 * s)}" for s in distribution["shares"]]
    return {
        feature: {
            name: {**dict(zip(labels, row["quantiles"], strict=True)), "n": row["rows"] - row["without_value"]}
            for name, row in by_class.items()
        }
        for feature, by_class in distribution["features"].items()
    }


def _waveforms(runner: Runner, survey: Survey) -> dict[str, Any] | None:
    """The system's pulse of every strip with waveforms, and how radiometry was calibrated."""
    pulses = {r.part: r.meta for r in receipts_of_run(runner, "pulse") if r.meta["sampled"]}
    calibration: dict[str, Any] | None = next(
        (r.meta["calibration"] for r in receipts_of_run(runner, "calibrate")), None
    )
    balanced = {s["strip"]: s["gain"] for s in (calibration or {}).get("strips", ()) if s["error"] is not None}
    strips = [
        {"name": s.path.stem, **pulses[f"{s.number:05d}"], "gain": balanced.get(s.number)}
        for s in survey.strips
        if f"{s.number:05d}" in pulses
    ]
    if not strips:
        return None
    metas = [r.meta for r in receipts_of_run(runner, "radiometry")]
    angles = [m["pointing_error"] for m in metas if m["pointing_error"] is not None]
    return {
        "strips": strips,
        "calibration": calibration,
        "without_range": sum(m["without_range"] for m in metas),
        "pointing_error": max(angles, default=None),
    }


def _plausibility(runner: Runner, survey: Survey, config: Config) -> dict[str, Any] | None:
    """What the echoes of every strip with waveforms look like beside its returns; None without waveforms."""
    noise = {r.part: r.meta for r in receipts_of_run(runner, "pulse") if r.meta["sampled"]}
    places = {r.part: r.meta["places"] for r in receipts_of_run(runner, "places")}
    counts: dict[str, list[dict[str, int]]] = {}
    for receipt in receipts_of_run(runner, "decompose"):
        counts.setdefault(receipt.part.split("-")[0], []).append(receipt.meta["plausibility"])
    returns, pulses, faults = Counter[str](), Counter[str](), dict[str, Counter[str]]()
    for receipt in receipts_of_run(runner, "read"):
        part = receipt.part.split("-")[0]
        returns[part] += receipt.meta["returns"]
        pulses[part] += receipt.meta["waveforms"] + sum(receipt.meta["faults"].get(name, 0) for name in UNREADABLE)
        faults.setdefault(part, Counter()).update(receipt.meta["faults"])
    parts = [(s.path.stem, f"{s.number:05d}") for s in survey.strips]
    strips = [
        of_strip(
            name,
            returns[part],
            add_counts(counts[part]),
            receiver_facts(noise[part]),
            places.get(part),
            faults.get(part),
            pulses[part],
        )
        for name, part in parts
        if part in noise and part in counts
    ]
    if not strips:
        return None
    return {"strips": strips, "remarks": remarks(strips, config.decompose), "accepted": config.plausibility.accept}


def _ground(runner: Runner, config: Config) -> dict[str, Any]:
    """The filter, what it found, and what cutting the survey into blocks changed."""
    blocks = [r.meta for r in receipts_of_run(runner, "ground-filter")]
    seams = next((r.meta for r in receipts_of_run(runner, "seams")), None)
    judged = next((r.meta["ground"] for r in receipts_of_run(runner, "assess")), None)
    return {
        "method": config.ground.method,
        "echoes": sum(m["rows"] for m in blocks),
        "ground": sum(m["ground"] for m in blocks),
        "noise": sum(m["noise"] for m in blocks),
        "without_terrain": sum(r.meta["without_terrain"] for r in receipts_of_run(runner, "terrain")),
        "block": config.ground.block,
        "accuracy": judged,
        "seams": dict(seams) if seams else None,
    }


def _outputs(runner: Runner) -> dict[str, list[str]]:
    stages = (
        "publish-tile",
        "publish-strip",
        "publish-rasters",
        "publish-quality",
        "publish-overview",
        "publish-catalogue",
        "publish-polygons",
        "publish-contours",
        DELIVER_VECTORS.name,
        "train",
    )
    names = [n for stage in stages for r in receipts_of_run(runner, stage) for n in r.outputs]
    kinds: dict[str, str | tuple[str, ...]] = {
        "laz": "laz/",
        "parquet": "parquet/",
        "rasters": "rasters/",
        "model": "model/",
        "quality": "quality.",
        "gis": ("survey.qgz", "tiles.gpkg"),
        "contours": "contours.gpkg",
        "vectors": ("vectors.gpkg", "vectors/"),
    }
    return {kind: sorted(n for n in names if n.startswith(prefix)) for kind, prefix in kinds.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value if isinstance(value, (str, int, float, bool)) or value is None else str(value)


def summary(report: Mapping[str, Any], root: Path | Url) -> str:
    """The last words of a run, for the terminal; what it delivered lies below `root`."""
    if "words" in report:  # of a workflow that has no echoes
        return "\n".join([*report["words"], *(f"{'page':<11} {root / name}" for name in report["outputs"])])
    counts = report["counts"]
    decomposed, in_tiles = counts["echoes_decomposed"], counts["echoes_in_tiles"]
    balance = "all of them in tiles" if decomposed == in_tiles else f"{in_tiles:,} of them in the tiles of this run"
    lost = sorted({f["part"] for f in report["failed"] if f["stage"] in SOURCES})
    if lost:
        more = f" and {len(lost) - SHOWN} more" if len(lost) > SHOWN else ""
        balance += f", without those of chunks that failed: {', '.join(lost[:SHOWN])}{more}"
    source = f"{counts['pulses']:,} pulses" if counts["pulses"] else f"{counts['returns']:,} returns"
    rows = [f"echoes      {decomposed:,} from {source}, {balance} ({counts['tiles']} tiles)"]
    if counts["returns_without_packet"]:
        rows.append(
            f"kept        {counts['returns_without_packet']:,} returns without a usable waveform packet, as echoes"
        )
    rows += [f"fault       {name}: {n:,}" for name, n in report["input"]["faults"].items()]
    accuracy, model = report["accuracy"], report.get("model") or {}
    if model.get("path"):
        count = len(model["features"])
        rows.append(f"classifier  {model['path']}, by its own {count} features; survey.features is not looked at")
    if accuracy:
        kappa = accuracy["kappa"]
        rows.append(
            f"accuracy    {100 * accuracy['overall_accuracy']:.1f} % overall"
            + (f", kappa {kappa:.3f}" if kappa is not None else "")
            + f" on {accuracy['area']}"
        )
    elif report["training"]:
        none = "unknown: no labelled echo lies in a test area (areas.test, areas.gap)"
        failed = any(f["stage"] in JUDGING for f in report["failed"])
        lacking = "not assessed: parts of the assessment failed" if failed else none
        rows.append(f"accuracy    {lacking if report['whole'] else 'not assessed: not all of the survey is made'}")
    rows += [f"remark      {text}" for text in report.get("remarks", ())]
    rows += [f"{'label':<11} {text}" for text in (report.get("sampling") or {}).get("remarks", ())]
    if report["water"]:
        flat = sum(body["level_enough"] for body in report["water"])
        rows.append(
            f"water       {flat} of {len(report['water'])} polygons flattened, each with its level in report.json"
        )
    for kind, names in report["outputs"].items():
        if kind == "contours":
            rows += [f"{kind:<11} {root / name}" for name in names]
        elif kind == "gis":
            rows += [f"{'qgis':<11} {root / name}" for name in names if name.endswith(".qgz")]
        elif kind == "quality":
            rows += [f"{kind:<11} {root / name}" for name in names]
        elif names:
            rows.append(f"{kind:<11} {root / kind}  ({len(names)} files)")
    rows.append(f"report      {root / 'report.html'}")
    return "\n".join(rows)
