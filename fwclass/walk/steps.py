"""The walk of a run: files, tiles, then all that is made of them; each step is planned by what the last one found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from fwclass.conf import Config
from fwclass.conf.sets import feature_set
from fwclass.errors import ConfigError
from fwclass.graph.backscatter import SAMPLE_WAVES, check_waves
from fwclass.graph.base_model import base_remarks
from fwclass.graph.corrections import READ_CORRECTIONS, READ_ECHO_LABELS, label_parts
from fwclass.graph.fine_layer import fine_layer
from fwclass.graph.kept import check_left
from fwclass.graph.label import READ_POLYGONS
from fwclass.graph.left_aside import LEFT_ASIDE, takes_returns
from fwclass.graph.outputs import DELIVER_STRIP, DELIVER_TILE, check_class_codes
from fwclass.graph.quantities import check_learned, joint_quantities, mixed_note
from fwclass.graph.radiometry import READ_TRAJECTORY, check_altitude, flown_by, has_pointing
from fwclass.graph.sampling import COUNT_LABELS, check_labels
from fwclass.graph.simulation import SIMULATE, simulate_survey
from fwclass.graph.sites import describe_sites, sites
from fwclass.graph.sources import INDEX, index_name
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stages import OF_STRIPS, STAGES, TO_LABELS, TO_TILES, check_features, graph_of, providers
from fwclass.graph.tiling import SPLIT_REFERENCE, TILE_ECHOES, TILE_REFERENCE, tiles_of_strips
from fwclass.graph.vectors import lacking
from fwclass.label.stage import LABEL
from fwclass.report.write import write_report
from fwclass.run.part import Name
from fwclass.run.runner import Runner, ancestors, require_all, stop_if_nothing
from fwclass.run.tasks import Tasks
from fwclass.store.models import load_same
from fwclass.store.receipts import Receipt
from fwclass.store.remote_file import local
from fwclass.store.run_store import Store
from fwclass.survey.area_of_interest import Area
from fwclass.survey.gather import gather
from fwclass.survey.layout import Layout, Strip
from fwclass.survey.reference import check_polygons
from fwclass.walk.models import base_model, given_model, with_model

LABELLING = (COUNT_LABELS.name, LABEL.name)
"""Stages of the labels, which need nothing but echoes in tiles."""

MANY, FEW = 1000, 1000
"""A run of so many tiles with fewer echoes than this in each, on average, spends its time on opening files."""


def plan_with_features(config: Config, stages: Iterable[Stage] = STAGES) -> Plan:
    """A plan that knows the features that decide, and the model that is given; `ConfigError` for what is no feature."""
    config = with_model(config)
    check_left(config.classify.leave, config.classes, f"{config.path}: classify.leave")
    model, base = given_model(config), base_model(config)
    names = load_same(local(model[0]), model[1]).features if model else config.features_asked
    check_features(config, names, model[0] if model else f"{config.path}: survey.features", stages)
    check_features(config, config.features.also, f"{config.path}: features.also", stages)
    if model is None and config.classify.refine.between:
        check_features(config, config.classify.refine.shares, f"{config.path}: classify.refine.scales", stages)
    plan = Plan(config, names, tuple(dict.fromkeys((*names, *config.features.also))), model, base)
    if model and (layer := fine_layer(plan)):
        check_features(config, layer.names, model[0], stages)
    return replace(plan, providers=providers(plan, stages))


def until_tiles(plan: Plan, runner: Runner, stages: Iterable[Stage] = STAGES, delivers: bool = False) -> Plan:
    """Make all parts up to the tiles; the plan with what is known then. What `delivers` must be able to write its
    classes into strips."""
    stages = tuple(stages)
    config, plan = plan.config, replace(plan, providers=providers(plan, stages))
    copied = delivers and DELIVER_STRIP in stages
    simulate_survey(config, runner)
    survey = gather(config, runner, copied, (plan.model, plan.base))
    if copied:
        check_class_codes({s.path.name: s.point_format for s in survey.strips}, config)
    learned: Mapping[str, Any] | None = load_same(local(plan.model[0]), plan.model[1]).card if plan.model else None
    quantities = joint_quantities(survey.quantities, plan.names, f"{config.path}: survey.sources")
    notes = check_learned(learned, survey.quantities, config.survey.model) if learned else ()
    for note in (*notes, *mixed_note(survey.quantities), *base_remarks(plan)):
        runner.display.say(f"note: {note}")
    plan = replace(plan, files=survey)
    polygons = require_all(runner, READ_POLYGONS.tasks(plan))
    by_echo = require_all(runner, tasks_of(plan, [s for s in (READ_ECHO_LABELS, READ_CORRECTIONS) if s in stages]))
    indexed = require_all(runner, INDEX.tasks(plan))
    survey = replace(survey, strips=tuple(s for s in survey.strips if index_name(s) in indexed))
    plan = replace(plan, files=survey, indexed=indexed)
    plan = replace(plan, returns=plan.returns and takes_returns(plan, runner.store))
    plan = replace(plan, providers=providers(plan, stages))
    if plan.returns:
        runner.display.say(f"note: {LEFT_ASIDE} (survey.echoes: waveforms has them)")
    if SAMPLE_WAVES in stages and (left_out := check_waves(plan)):
        runner.display.say(f"note: {left_out}")
    splits = runner.do(_of_strips(plan) + SPLIT_REFERENCE.tasks(plan))
    _check_widths(config, plan.names, splits, runner.store)
    plan = replace(plan, splits=splits)
    tiled = runner.do(TILE_ECHOES.tasks(plan) + TILE_REFERENCE.tasks(plan))
    stop_if_nothing(runner, {name: receipt for name, receipt in tiled.items() if name[0] == "tile"})
    layout = replace(Layout.of(config, {**tiled, **polygons}), quantities=quantities, providers=providers(plan, stages))
    layout = replace(layout, **label_parts(layout, by_echo))
    check_polygons(config, polygons.values(), layout.box)
    plan = replace(plan, tiled=layout)
    plan = replace(plan, flown=flown_by(plan, runner.do(READ_TRAJECTORY.tasks(plan))))
    return replace(plan, pointing=has_pointing(plan))


def _check_widths(config: Config, names: tuple[str, ...], splits: Mapping[Name, Receipt], store: Store) -> None:
    """`ConfigError` early if the forest is to decide by echo widths and no source has any."""
    spans = [store.receipt("decompose", part) for stage, part in splits if stage == "split"]
    echoes = sum(int(r.meta["echoes"]) for r in spans if r)
    without = sum(int(r.meta["without_width"]) for r in spans if r)
    wide = [n for n in names if n.split("_")[0] == "width"]
    if wide and echoes and echoes == without:
        others = [n for n in names if n not in wide]
        plain = set(others) == set(feature_set("default").features)
        raise ConfigError(
            f"classes are to be told by {wide[0]!r}, and no echo of this survey has one",
            where=f"{config.path}: survey.features",
            expected="waveforms, or an extra byte `Pulse width`",
            got=f"{echoes} echoes without a width",
            do="--set survey.features=default" if plain else f'--set "survey.features=[{", ".join(others)}]"',
        )


def _of_strips(plan: Plan) -> Tasks:
    """Strip by strip, so that what was read last is decomposed next."""
    return Tasks.joined(tasks_of(_strip_alone(plan, strip), OF_STRIPS) for strip in plan.survey.strips)


def _strip_alone(plan: Plan, strip: Strip) -> Plan:
    return replace(plan, files=replace(plan.survey, strips=(strip,)))


def tasks_of(plan: Plan, stages: Iterable[Stage]) -> Tasks:
    """The tasks of `stages`, one stage after the other."""
    return Tasks.joined(stage.tasks(plan) for stage in stages)


def tasks_until_labels(plan: Plan) -> Tasks:
    """Tasks of ground, heights, the features that `plan` computes, radiometry; labels where there are."""
    check_altitude(plan.layout)
    return tasks_of(plan, TO_LABELS)


def until_report(
    plan: Plan, runner: Runner, stages: Iterable[Stage], tiles: frozenset[str] | Area | None = None
) -> dict[str, Any]:
    """Make the parts of `stages` and all that is delivered, and write the report.

    `tiles`: deliver only these, or those in an area; what they need (their neighbours' echoes, the training areas) is
    made too, so that they come out as in a whole run.
    """
    layout, config = plan.layout, plan.config
    check_altitude(layout)
    keys = tiles.tiles(layout, plan.survey.crs, runner.display.say) if isinstance(tiles, Area) else tiles
    stages = tuple(stages)
    graph = graph_of(plan, (SIMULATE, *TO_TILES, *stages))
    for words in (
        describe_sites(sites(layout), plan.survey.strips, tiles_of_strips(plan)),
        small_tiles(layout),
        lacking(plan),
    ):
        if words:
            runner.display.say(words)
    if keys is not None:
        tasks = Tasks.held(ancestors(tasks_of(plan, stages), _wanted(layout, keys, stages)))
    else:
        if COUNT_LABELS in stages:
            stages = _judge_labels(plan, runner, stages)
        tasks = tasks_of(plan, stages)
    runner.do(tasks)
    runner.finish(whole=keys is None)
    card = load_same(local(plan.model[0]), plan.model[1]).card if plan.model else None
    return runner.carry_out(lambda: write_report(config, runner, plan.survey, layout, plan.names, graph, card))


def _judge_labels(plan: Plan, runner: Runner, stages: tuple[Stage, ...]) -> tuple[Stage, ...]:
    """The other stages, once those of the labels are made: nothing is computed that the labels may not be worth."""
    first = [stage for stage in stages if stage.name in LABELLING]
    receipts = runner.do(tasks_of(plan, first))
    counted = {name: receipt for name, receipt in receipts.items() if name[0] == COUNT_LABELS.name}
    if not runner.failures:  # what failed may hold the labels that are lacking
        runner.carry_out(lambda: check_labels(plan, counted))
    return tuple(stage for stage in stages if stage not in first)


def _wanted(layout: Layout, tiles: frozenset[str], stages: Iterable[Stage]) -> list[tuple[str, str]]:
    """The delivered parts of `tiles`."""
    if not any(stage.name == DELIVER_TILE.name for stage in stages):
        raise ConfigError(
            "this workflow delivers no tiles",
            where="--tiles, --aoi",
            expected="a workflow that does, as classification or ground",
            got=f"{len(tiles)} tiles asked for",
            do="leave it out: all of the survey is measured",
        )
    unknown = sorted(tiles - layout.keys)
    if unknown:
        raise ConfigError(
            "no such tile in this survey",
            where="--tiles",
            expected="keys of tiles with echoes, for example " + ", ".join(t.key for t in layout.tiles[:3]),
            got=", ".join(unknown),
            do="the keys are the names of the files in laz/tiles, without .copc.laz",
        )
    return [(DELIVER_TILE.name, key) for key in sorted(tiles)]


def small_tiles(layout: Layout) -> str:
    """What a user should know of tiles that hold hardly anything; nothing of others."""
    number, size = len(layout.tiles), layout.config.tile.size
    each = layout.echoes / number
    if number < MANY or each >= FEW:
        return ""
    return (
        f"note: {number:,} tiles of {size:g} m hold {each:,.0f} echoes each on average: larger ones (tile.size) take "
        "less time and change no result; `fwclass plan` compares sizes"
    )
