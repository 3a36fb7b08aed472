"""`fwclass classify`: one file by a trained model, without a run directory."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.classify.exempt import Exempt
from fwclass.classify.kept import Kept, with_kept
from fwclass.classify.lines import line_remarks
from fwclass.classify.params import ClassifyParams
from fwclass.classify.unsure import by_percent, unsure_facts
from fwclass.conf.checks import refuse_regularized
from fwclass.errors import ConfigError, InputError, first_few, visible
from fwclass.features.dense import Crowd
from fwclass.features.names import FeatureRequest, is_feature
from fwclass.graph.classify import CLASSIFY_ECHOES, OUTSIDE, codes_on_lines
from fwclass.graph.context import CLASSIFY_IN_CONTEXT, SHARE_FIRST
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.graph.kept import check_left, check_written, class_remarks, kept_codes, known_codes, other_names
from fwclass.graph.loaded_models import load_given
from fwclass.graph.model_fit import check_computed, check_names, ground_notes
from fwclass.graph.quantities import check_learned
from fwclass.graph.refine import ANSWER_COARSE, CLASSIFY_REFINED, WIDEN_BOUNDARY
from fwclass.graph.regularize import CLASSIFY_REGULARIZED, SHARE_ECHOES, SHARE_IN_CONTEXT
from fwclass.graph.stage import Stage
from fwclass.grid import millimetres
from fwclass.model import Contextual, Layered, Model, TwoLayer, sample_matrix
from fwclass.model.density import densities_of, squares_by_count
from fwclass.publish.strips import LEGACY_MAX, check_records, write_strip_laz
from fwclass.publish.tile_facts import counts_by_code
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.read.las import LasSource
from fwclass.read.points import classes_of
from fwclass.read.quantities import quantities_of
from fwclass.read.source import open_source
from fwclass.report.drift import drift, with_returns
from fwclass.report.labels import exchanged_words
from fwclass.schema import Table
from fwclass.single_file.features.echoes import (
    OF_ECHOES,
    EchoJob,
    FileEchoes,
    read_echoes,
    with_heights,
    with_lines,
    with_noise,
    with_radiometry,
)
from fwclass.single_file.ground.output import LAS, check_output
from fwclass.single_file.tiles import HELD, FileConfig, FileTiles, Tell, quiet
from fwclass.store.installed_models import model_location
from fwclass.store.unchanged import of_unchanged
from fwclass.survey.systems import given_crs

SECTIONS = (*OF_ECHOES, "classify", "publish", "tile")
"""Sections of the configuration that the command obeys."""

MODELS_OWN = "leave it out; what decides is the model's"
OF_TRAINING = ("classify.context", "classify.refine")
"""Settings of its sections that only training obeys."""

NAMED = 4
"""Features without a value that are named."""


@dataclass(frozen=True, kw_only=True)
class ClassifyJob(EchoJob):
    """What `fwclass classify` was asked for, besides what every `EchoJob` is; its files are LAS or LAZ.

    `model`: directory of the model, or a name that `installed_models` gives. `legacy`: class code to write in place of
    another; point formats 0 to 5 take what the model's classes say besides.
    """

    model: Path
    legacy: Mapping[int, int] | None = None


@of_unchanged
def classify_file(job: ClassifyJob, tell: Tell = quiet) -> dict[str, Any]:
    """Classify the points of a file; what was done, as plain data.

    Waveforms are decomposed where the file has them, as in a run; every point then takes the class of the echo of its
    pulse that is nearest to it. Features are computed as in a run, their neighbourhoods are those of this file alone.
    The points keep their order and all their other fields; `confidence` and `entropy` become extra bytes, with
    ``classify.probabilities`` the share of every class too.

    `ConfigError`: an output, a setting or a model that cannot be used. `InputError`: a file or model that cannot be
    used, or lacks what the model decides by.
    """
    began = time.perf_counter()
    job = replace(job, model=model_location(job.model))
    checked = _check(job)
    model, params, kept = checked.model, checked.params, Kept.of(checked.params)
    asked = FeatureRequest.of(n for n in model.features if is_feature(n))
    echoes = _echoes(job, model, asked, tell)
    if isinstance(model, TwoLayer):
        check_computed(model.fine, conf.section("features", job.settings), job.model)
    tiles, walk, without = _classify(echoes.table, model, (job.model, checked.digest), job.settings, tell)
    results = tiles.columns(walk[-1], walk[-1].columns(tiles.plan))  # tiles are walked here; their facts are there then
    first = model.coarse if isinstance(model, Layered) else model
    facts = {stage: tiles.facts(stage) for stage in walk}
    dense = densities_of([squares_by_count(millimetres(echoes.table["x"]), millimetres(echoes.table["y"]))])
    drifted = drift(first.card, [one[OUTSIDE] for one in facts[walk[0]] if OUTSIDE in one], dense)
    if drifted and "halls" in echoes.judged:
        ground = echoes.judged["halls"]["ground"]
        drifted = with_returns(drifted, first.card, echoes.judged["returns"], ground, echoes.table.rows)
    crowd = None
    if any(is_feature(n) for n in first.features):
        crowd = Crowd.of_parts(one.get("dense") for one in tiles.facts(COMPUTE_FEATURES))
    tell("writing")
    answered, own = _points_answered(job, checked, echoes, results)
    classes = answered["classification"]
    extra = {name: answered[name] for name in answered if name != "classification"}
    wrote = write_strip_laz(job.source, job.output, classes, extra, conf.section("publish", job.settings))
    used, counts = np.unique(classes, return_counts=True)
    by_code = dict(zip(*(n.tolist() for n in np.unique(own, return_counts=True)), strict=True))
    sure = answered["confidence"][np.isfinite(answered["confidence"])]
    unsure = unsure_facts(by_percent(answered["confidence"]), params, model.card)
    pierced = {"classes": counts_by_code(results["classification"])}
    pierced["several"] = counts_by_code(results["classification"][echoes.table["number_of_echoes"] > 1])
    exchanged = exchanged_words([pierced])
    return {
        "input": str(job.source),
        "output": str(job.output),
        "model": str(job.model),
        "kind": model.kind,
        "points": answered.rows,
        "echoes": echoes.table.rows,
        "features": list(model.features),
        "classes": {str(c): int(n) for c, n in zip(used, counts, strict=True)},
        "names": {
            **{str(code): name for code, name in other_names(by_code, params, ()).items()},
            **{str(int(checked.codes[c.code])): c.name for c in model.classes},
        },
        "kept": {str(code): n for code, n in kept_codes(by_code, kept).items()},
        "confidence": float(sure.mean()) if len(sure) else None,
        "without_value": {n: int(k) for n, k in zip(first.features, without, strict=True) if k},
        "judged": {**echoes.judged, "labels": {"elsewhere": "", "exchanged": exchanged, "uncounted": ""}},
        "drift": drifted,
        "unsure": unsure,
        "filled": sum(one.get("filled", 0) for some in facts.values() for one in some),
        "boundary": sum(one["boundary"] for one in facts[WIDEN_BOUNDARY]) if WIDEN_BOUNDARY in facts else None,
        "waveforms": wrote.get("wdp"),
        "notes": [
            *echoes.notes,
            *([crowd.text(conf.section("features", job.settings))] if crowd else []),
            *checked.notes,
            *line_remarks(facts[walk[-1]]),
            *_drift_notes(drifted),
            *(unsure or {}).get("remarks", ()),
            *([exchanged] if exchanged else []),
            *class_remarks(by_code, known_codes(model.classes), kept, "points"),
            *(str(n) for n in wrote.get("notes", ())),
        ],
        "seconds": round(time.perf_counter() - began, 3),
    }


@dataclass(frozen=True)
class _Checked:
    """A file and a model that fit each other and the settings.

    `codes`: uint8 (256,), what every class code is written as.
    """

    source: LasSource
    model: Model
    digest: str
    params: ClassifyParams
    codes: NDArray[np.uint8]
    notes: Sequence[str]


def _check(job: ClassifyJob) -> _Checked:
    """All that can be refused before a point is read."""
    conf.check_settings(job.settings, SECTIONS, MODELS_OWN)
    for text in job.settings:
        if text.startswith(OF_TRAINING):
            raise ConfigError("this setting has no effect here", where=f"--set {text}", do=MODELS_OWN)
    source = _checked_source(job)
    model, digest = load_given(job.model)
    params = conf.section("classify", job.settings)
    check_left(params.leave, model.classes, "classify.leave")
    if params.regularize.strength > 0 and isinstance(model, TwoLayer):
        refuse_regularized(job.model)
    check_output(job.source, job.output, job.overwrite)
    check_computed(model, conf.section("features", job.settings), job.model)
    notes = check_learned(model.card, {source.path.name: quantities_of(source)}, job.model)
    return _Checked(source, model, digest, params, legal_codes(job, model, source, params.leave), notes)


def _points_answered(
    job: ClassifyJob, checked: _Checked, echoes: FileEchoes, results: Mapping[str, NDArray]
) -> tuple[Table, NDArray[np.uint8]]:
    """Of every point what is written, from the `results` of the echoes, and the class that it has in the file."""
    rows = _row_of_point(echoes, job.source)
    own = classes_of(checked.source) if checked.source.has_waves else echoes.table["source_class"][rows]
    answered = Table({name: values[rows] for name, values in results.items()})
    answered = answered.with_columns({"classification": checked.codes[answered["classification"]]})
    return with_kept(answered, own, Kept.of(checked.params)), own


def _drift_notes(drifted: Mapping[str, Any] | None) -> list[str]:
    return (
        list(drifted["remarks"])
        if drifted
        else ["the model's card does not say what it has seen: train it again to be warned"]
    )


def _checked_source(job: ClassifyJob) -> LasSource:
    if not job.source.is_file():
        raise InputError("no such file", where=job.source, expected="a LAS or LAZ file", do="check the path")
    source = open_source(job.source)
    if not isinstance(source, LasSource):
        raise ConfigError(
            "only LAS and LAZ files are classified",
            where=job.source,
            expected="a LAS or LAZ file",
            do="convert the file first",
        )
    if job.output.suffix.lower() not in LAS:
        raise ConfigError(
            "classified points are written as LAS or LAZ",
            where=job.output,
            expected="a name that ends in .las or .laz",
            got=job.output.suffix or "no suffix",
            do="name the output with one of these endings",
        )
    check_records(job.source)
    return source


def legal_codes(job: ClassifyJob, model: Model, source: LasSource, leave: int | None = None) -> NDArray[np.uint8]:
    """What every class code is written as; `ConfigError` where the file's points cannot hold one, or two would be the
    same, or that of echoes that are left (`leave`)."""
    table = np.arange(256, dtype=np.uint8)
    if source.point_format <= 5:
        for one in model.classes:
            table[one.code] = one.code if one.legacy_code is None else one.legacy_code
    for code, other in (job.legacy or {}).items():
        if code not in model.codes:
            raise ConfigError(
                f"the model has no class of code {code}",
                where=f"--legacy-code {code}={other}",
                expected=", ".join(f"{c.code} ({c.name})" for c in model.classes),
                got=code,
                do="check the code",
            )
        table[code] = other
    written = {c.name: int(table[c.code]) for c in model.classes}
    way = f"--legacy-code CODE=OTHER, for example {model.classes[-1].code}=20"
    beyond = [c for c in model.classes if table[c.code] > LEGACY_MAX]
    if beyond:
        way = f"--legacy-code {beyond[0].code}=CODE, for example {beyond[0].code}=20"
    check_written(written, leave, source.point_format <= 5, job.source, way)
    return table


def _echoes(job: ClassifyJob, model: Model, asked: FeatureRequest, tell: Tell) -> FileEchoes:
    """The file's echoes with every column that the model decides by but the features of a neighbourhood."""
    tell("reading")
    fine = model.fine.features if isinstance(model, TwoLayer) else ()
    wide = FeatureRequest.of(n for n in fine if is_feature(n))
    exempt = Exempt.of(conf.section("classify", job.settings))
    needed = (*model.features, *fine, *asked.reads, *wide.reads, *(exempt.columns if exempt else ()))
    notes: tuple[str, ...] = ()
    echoes = read_echoes(job.source, needed, job.settings, given_crs(job.crs, "--crs"), tell)
    if "height_above_ground" in needed:
        method = job.method
        if method is None and job.preset is None and not job.own_ground:
            method = conf.section("ground", job.settings).method
        echoes = with_heights(echoes, replace(job, method=method), tell)
        if "height_above_ground" in model.features:
            notes = tuple(ground_notes(model.card, method, conf.section("terrain", job.settings).height))
    if asked.names or wide.names or "noise" in needed:
        echoes = with_lines(with_noise(echoes, job.settings, tell), job.source, job.settings)
    if any(n in RADIOMETRY.writes for n in needed):
        echoes = with_radiometry(echoes, job)
    check_names(model, echoes.table, job.source)
    return replace(echoes, notes=(*echoes.notes, *notes))


def _classify(
    echoes: Table, model: Model, place: tuple[Path, str], settings: tuple[str, ...], tell: Tell
) -> tuple[FileTiles, tuple[Stage, ...], NDArray[np.int64]]:
    """The echoes in tiles that are classified, by which stages, and how many lack a value of each of the features."""
    first: Model = model
    walk: tuple[Stage, ...] = (CLASSIFY_ECHOES,)
    if isinstance(model, TwoLayer):
        first, walk = model.coarse, (ANSWER_COARSE, WIDEN_BOUNDARY, CLASSIFY_REFINED)
    elif isinstance(model, Contextual):
        first, walk = model.coarse, (SHARE_FIRST, CLASSIFY_IN_CONTEXT)
    words = ["classes: tile", *["second layer: tile"] * (len(walk) - 1)]
    config = FileConfig(settings, classes=model.classes)
    on_lines = codes_on_lines(config.whole) and not isinstance(model, TwoLayer)
    if config.classify.regularize.strength > 0 or on_lines:
        own = SHARE_IN_CONTEXT if isinstance(model, Contextual) else SHARE_ECHOES
        walk, words = (*walk[:-1], own, CLASSIFY_REGULARIZED), [*words, "neighbours: tile"]
    tiles = FileTiles(
        echoes,
        config,
        (COMPUTE_FEATURES, *walk),
        tell,
        {stage.name: word for stage, word in zip(walk, words, strict=True)},
        held=HELD if len(walk) > 1 else 0,
        names=first.features,
        computed=first.features,
        model=place,
    )
    without = np.zeros(len(first.features), np.int64)
    for key in tiles.keys:
        tiles.make(walk[0], key)
        without += np.isnan(sample_matrix(tiles.rows(key, first.features), first.features, key)).sum(axis=0)
    return tiles, walk, without


def _row_of_point(echoes: FileEchoes, source: Path) -> NDArray[np.int64]:
    """For every point of the file the row of its echo."""
    if echoes.links is None:
        raise InputError("the file's points have no echoes", where=source, do="give a LAS or LAZ file")
    keys, wanted = _keys(echoes.table), _keys(echoes.links)
    order = np.argsort(keys, kind="stable")
    place = np.searchsorted(keys, wanted, sorter=order)
    place = order[np.minimum(place, len(keys) - 1)]
    if (keys[place] != wanted).any():
        raise InputError(
            "a point has no echo",
            where=source,
            got=f"{int((keys[place] != wanted).sum())} points",
            do="look at the file with `fwclass info`; points without a place cannot be classified",
        )
    return place


def _keys(table: Table) -> NDArray[np.uint64]:
    return (table["pulse"].astype(np.uint64) << np.uint64(8)) | table["echo_number"].astype(np.uint64)


def describe(summary: dict[str, Any]) -> str:
    """What was done, for a terminal."""
    total = summary["points"]
    lines = [
        f"{total:,} points by a {summary['kind']} of {len(summary['features'])} features",
        *summary["notes"],
        *(
            f"  {summary['names'].get(c, c):<14} {c:>3} {n:>12,}  {100 * n / total:5.1f} %"
            for c, n in summary["classes"].items()
        ),
    ]
    if summary["confidence"] is not None:
        lines.append(f"mean confidence {summary['confidence']:.2f}")
    if summary["boundary"] is not None:
        lines.append(f"{summary['boundary']:,} echoes where two classes meet were answered by the second layer")
    lines += _without(summary["without_value"])
    if summary["filled"]:
        lines.append(f"{summary['filled']:,} missing values were filled with the medians of the training rows")
    return "\n".join([*lines, f"written: {visible(summary['output'])}"])


def _without(lacking: Mapping[str, int]) -> list[str]:
    """Features without a value, those that lack as many in one line."""
    by_count: dict[int, list[str]] = {}
    for name, n in lacking.items():
        by_count.setdefault(n, []).append(name)
    lines = []
    for n, names in by_count.items():
        lines.append(f"no value: {first_few(names, NAMED)} of {n:,} echoes")
    return lines
