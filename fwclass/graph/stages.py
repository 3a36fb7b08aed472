"""All stages of a run, in the order in which a survey goes through them, and which of them writes a column."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fwclass.columns import FEATURES
from fwclass.conf import Config
from fwclass.errors import ConfigError, nearest
from fwclass.features.names import MAX_REACH, NO_FEATURE, FeatureRequest, check_scale, is_feature, meant
from fwclass.graph.assess import ASSESS, COUNT_CONFUSION
from fwclass.graph.backscatter import (
    DELIVER_PROFILES,
    DELIVER_SAMPLES,
    DELIVER_VOXELS,
    FILL_PROFILES,
    FILL_VOXELS,
    SAMPLE_WAVES,
)
from fwclass.graph.base_rows import CHOOSE_BASE_ROWS
from fwclass.graph.breaklines import READ_BREAKLINES
from fwclass.graph.catalogue import DELIVER_CATALOGUE, DELIVER_POLYGONS
from fwclass.graph.check_points import MEASURE_CHECK_POINTS
from fwclass.graph.classify import CLASSIFY_ECHOES, CLASSIFY_THINNED
from fwclass.graph.context import CLASSIFY_IN_CONTEXT, SHARE_FIRST
from fwclass.graph.context_folds import SHARE_FOLDS, TRAIN_FOLDS
from fwclass.graph.context_training import DRAW_CONTEXT, MERGE_CONTEXT, TRAIN_CONTEXT, TRY_CONTEXT
from fwclass.graph.contours import CONTOUR_BLOCKS, DELIVER_CONTOURS
from fwclass.graph.corrections import READ_CORRECTIONS, READ_ECHO_LABELS
from fwclass.graph.density import COUNT_ECHOES, COUNT_TRAINING_ECHOES
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.graph.ground import FILTER_GROUND, GATHER_GROUND, GATHER_HEIGHT, MAKE_TERRAIN
from fwclass.graph.ground_auto import CHOOSE_PARAMETERS
from fwclass.graph.ground_classes import CLASSIFY_GROUND
from fwclass.graph.ground_seams import CHECK_SEAMS
from fwclass.graph.label import LABEL_BY_CLOUD, LABEL_BY_ECHOES, LABEL_BY_POLYGONS, LABEL_BY_SOURCE, READ_POLYGONS
from fwclass.graph.learn import (
    GROW_TREES,
    MEASURE_IMPORTANCE,
    TRAIN_BASELINE,
    TRAIN_COARSE_BASELINE,
    TRAIN_COARSE_FOREST,
    TRAIN_FOREST,
    TRY_MACHINES,
)
from fwclass.graph.noise import FILTER_NOISE, GATHER_NOISE
from fwclass.graph.outputs import DELIVER_STRIP, DELIVER_TILE
from fwclass.graph.overview import DELIVER_OVERVIEW, DRAW_OVERVIEW
from fwclass.graph.quality import DELIVER_QUALITY, MEASURE_QUALITY
from fwclass.graph.radiometry import (
    CALIBRATE_STRIPS,
    CHECK_POINTING,
    COMPARE_STRIPS,
    MEASURE_RADIOMETRY,
    READ_TRAJECTORY,
)
from fwclass.graph.raster_outputs import DELIVER_RASTERS, MAP_CLASSES
from fwclass.graph.refine import (
    ANSWER_COARSE,
    CLASSIFY_REFINED,
    DRAW_BOUNDARY,
    MERGE_BOUNDARY,
    TRAIN_FINE,
    WIDEN_BOUNDARY,
)
from fwclass.graph.regularize import CLASSIFY_REGULARIZED, SHARE_ECHOES, SHARE_IN_CONTEXT
from fwclass.graph.sampling import COUNT_LABELS, COUNT_SAMPLES
from fwclass.graph.simulation import SIMULATE
from fwclass.graph.sources import DECOMPOSE_RETURNS, DECOMPOSE_WAVES, INDEX, MEASURE_PLACES, MEASURE_PULSE, READ_SPAN
from fwclass.graph.stacking import DELIVER_STACK, MAKE_FIRST_TERRAIN, STACK_PULSES
from fwclass.graph.stage import Plan, Stage, names_under
from fwclass.graph.thin import THIN_ECHOES
from fwclass.graph.tiling import SPLIT_ECHOES, SPLIT_REFERENCE, TILE_ECHOES, TILE_REFERENCE
from fwclass.graph.training_rows import DRAW_SAMPLE, MERGE_SAMPLE
from fwclass.graph.vectors import CHOOSE_CELL, COUNT_PULSES, DELIVER_VECTORS, FIND_BUILDINGS, FIND_TREES
from fwclass.graph.water import LEVEL_WATER, MEASURE_SHORE, READ_WATER
from fwclass.radiometry.stage import RADIOMETRY

OF_STRIPS = (READ_SPAN, MEASURE_PULSE, MEASURE_PLACES, DECOMPOSE_WAVES, DECOMPOSE_RETURNS, SPLIT_ECHOES)
"""What every strip goes through by itself."""
TO_TILES = (
    READ_POLYGONS,
    READ_ECHO_LABELS,
    READ_CORRECTIONS,
    INDEX,
    *OF_STRIPS,
    SPLIT_REFERENCE,
    TILE_ECHOES,
    TILE_REFERENCE,
    READ_TRAJECTORY,
)
"""From files to tiles: each of these is planned by what the ones before it found, so `walk.steps.until_tiles` names
them one by one, those of `OF_STRIPS` together."""
OF_GROUND = (
    CHOOSE_PARAMETERS,
    FILTER_GROUND,
    GATHER_GROUND,
    READ_BREAKLINES,
    READ_WATER,
    MEASURE_SHORE,
    LEVEL_WATER,
    MAKE_FIRST_TERRAIN,
    STACK_PULSES,
    MAKE_TERRAIN,
    GATHER_HEIGHT,
)
"""Ground, terrain and heights."""
TO_LABELS = (
    *(*OF_GROUND, THIN_ECHOES, COMPUTE_FEATURES),
    *(CHECK_POINTING, COMPARE_STRIPS, CALIBRATE_STRIPS, MEASURE_RADIOMETRY),
    *(LABEL_BY_SOURCE, LABEL_BY_CLOUD, LABEL_BY_POLYGONS, LABEL_BY_ECHOES),
)
"""What is known of every echo before it is classified."""
OF_NOISE = (FILTER_NOISE, GATHER_NOISE)
OF_QUALITY = (MEASURE_QUALITY, MEASURE_CHECK_POINTS)
OF_SAMPLES = (COUNT_ECHOES, COUNT_TRAINING_ECHOES, DRAW_SAMPLE, MERGE_SAMPLE, CHOOSE_BASE_ROWS)
OF_FIRST_LAYER = (
    *(GROW_TREES, MEASURE_IMPORTANCE, TRAIN_FOREST, TRY_MACHINES, TRAIN_BASELINE),
    *(TRAIN_COARSE_FOREST, TRAIN_COARSE_BASELINE),
)
OF_FINE_LAYER = (ANSWER_COARSE, DRAW_BOUNDARY, MERGE_BOUNDARY, TRAIN_FINE, WIDEN_BOUNDARY)
OF_CONTEXT = (
    *(TRAIN_FOLDS, SHARE_FOLDS, DRAW_CONTEXT, MERGE_CONTEXT, TRY_CONTEXT, TRAIN_CONTEXT),
    *(SHARE_FIRST, SHARE_ECHOES, SHARE_IN_CONTEXT),
)
LEARNING = (*OF_SAMPLES, *OF_FIRST_LAYER, *OF_FINE_LAYER, *OF_CONTEXT, COUNT_LABELS, COUNT_SAMPLES)
CLASSIFYING = (CLASSIFY_ECHOES, CLASSIFY_THINNED, CLASSIFY_REFINED, CLASSIFY_IN_CONTEXT, CLASSIFY_REGULARIZED)
JUDGING = (COUNT_CONFUSION, ASSESS)
DELIVERY = (
    *(DELIVER_TILE, DELIVER_STRIP, DELIVER_STACK, MAP_CLASSES, DELIVER_RASTERS, CONTOUR_BLOCKS, DELIVER_CONTOURS),
    *(DELIVER_QUALITY, DRAW_OVERVIEW, DELIVER_OVERVIEW, DELIVER_CATALOGUE, DELIVER_POLYGONS),
)
OF_WAVEFORMS = (SAMPLE_WAVES, FILL_VOXELS, FILL_PROFILES, DELIVER_SAMPLES, DELIVER_VOXELS, DELIVER_PROFILES)
"""For those who want the waveform, not echoes."""
OF_VECTORS = (COUNT_PULSES, CHOOSE_CELL, FIND_BUILDINGS, FIND_TREES, DELIVER_VECTORS)
STAGES = (
    *(SIMULATE, *TO_TILES, *TO_LABELS, CHECK_SEAMS, *OF_NOISE, *OF_QUALITY, *LEARNING, *CLASSIFYING, CLASSIFY_GROUND),
    *(*JUDGING, *DELIVERY, *OF_VECTORS, *OF_WAVEFORMS),
)
"""Every stage that any run has; what a run takes is reckoned by this list."""


def providers(plan: Plan, stages: Iterable[Stage] = STAGES) -> dict[str, str]:
    """Which stage's tables of tiles hold each column. Where two have one (places: echoes' and reference points'), the
    first counts."""
    stage_of: dict[str, str] = {}
    for stage in stages:
        if stage.over == "tile":
            for column in stage.columns(plan):
                stage_of.setdefault(column, stage.name)
    return stage_of


def graph_of(plan: Plan, stages: Iterable[Stage] = STAGES) -> list[dict[str, Any]]:
    """Every stage that a run has: ``name``, ``over`` (what a part of it is), ``unit`` of its cost, and ``reads``, the
    stages whose parts it reads or is planned by; in the order of the run."""
    stages = [s for s in stages if s.when(plan)]
    stage_of = providers(plan, stages)
    nodes: dict[str, dict[str, Any]] = {}
    names = {s.name for s in stages}
    for stage in stages:
        columns = (*names_under(stage.reads, plan), *names_under(stage.own, plan))
        sources = {stage_of.get(c, COMPUTE_FEATURES.name) for c in columns} | set(stage.after)
        if columns:
            sources.add(TILE_ECHOES.name)
        one = nodes.setdefault(stage.name, {"name": stage.name, "over": stage.over, "unit": stage.unit, "reads": []})
        one["reads"] += sources & names - {stage.name}
    order = {name: k for k, name in enumerate(nodes)}
    for one in nodes.values():
        one["reads"] = sorted(set(one["reads"]), key=order.__getitem__)
    return list(nodes.values())


def check_reads(plan: Plan, stages: Iterable[Stage]) -> list[str]:
    """The features of a neighbourhood that a user's own `stages` read, which are to be computed; `ConfigError` for a
    column that nobody writes."""
    more = []
    for stage in stages:
        for column in (*names_under(stage.reads, plan), *names_under(stage.own, plan)):
            if column in plan.providers:
                continue
            if not is_feature(column):
                raise ConfigError(
                    "a stage reads a column that no stage writes",
                    where=f"stage {stage.name}, reads",
                    got=column,
                    do=nearest(column, {**plan.providers, **{c.name: "" for c in FEATURES}}),
                )
            more.append(column)
    return more


def check_order(plan: Plan, stages: Iterable[Stage]) -> None:
    """`ConfigError` for a stage that comes before the one that writes what it reads."""
    earlier = {stage.name for stage in TO_TILES}
    for stage in stages:
        for column, source in stage.columns_read(plan).items():
            if source not in earlier and source != stage.name:
                raise ConfigError(
                    "a stage comes before the one that writes what it reads",
                    where=f"workflow, stage {stage.name}",
                    expected=f"behind {source}",
                    got=f"it reads {column}, which {source} writes",
                    do="put it further back",
                )
        earlier.add(stage.name)


def check_features(config: Config, names: Iterable[str], where: object, stages: Iterable[Stage] = STAGES) -> None:
    """`ConfigError` for a feature that no stage writes, or that would tell the forest the answer or the place."""
    labels, classes = {LABEL_BY_CLOUD.name}, {CLASSIFY_ECHOES.name, ANSWER_COARSE.name, WIDEN_BOUNDARY.name}
    of_stages = providers(Plan(config), stages)
    known = {n: s for n, s in of_stages.items() if n not in NO_FEATURE and s not in labels | classes}
    for name in names:
        check_scale(name, where)
        if name in RADIOMETRY.writes and name not in known and name not in NO_FEATURE:
            raise ConfigError(
                f"{name!r} needs the range to the sensor, which nothing tells",
                where=where,
                expected="survey.trajectory.files or radiometry.platform_altitude",
                got="neither",
                do="set one of them, or leave the feature out",
            )
        if name not in known and not is_feature(name):
            bases = {c.name: "" for c in FEATURES}
            raise ConfigError(
                f"{name!r} is not a feature",
                where=where,
                expected="a measured column, or a feature with its scale, as echo_ratio_r100 "
                "(`fwclass features --list` shows all)",
                got=name,
                do=meant(name, known) or nearest(name, {**known, **bases}),
            )
    reach = FeatureRequest.of(n for n in names if is_feature(n)).reach(config.features)
    if reach > MAX_REACH:
        raise ConfigError(
            "a feature reaches too far",
            where=where,
            expected=f"at most {MAX_REACH:g} m: every tile would read its surroundings that far",
            got=f"{reach:g} m",
            do="names end in centimetres: height_range_c500 is a cylinder of 5 m",
        )
