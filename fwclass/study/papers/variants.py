"""Variants of a classifier as parts: one sample trains them all, one set of test echoes judges them all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from fwclass.classify.stage import CLASSIFY
from fwclass.conf import Config
from fwclass.graph.areas import IDENTITY_AND_PLACE
from fwclass.graph.learn import TREES_PER_PART
from fwclass.graph.stage import Plan, always
from fwclass.graph.training_rows import DRAW_SAMPLE
from fwclass.model import ClassDef
from fwclass.run.part import Task
from fwclass.study.keys import needs_of, plain
from fwclass.study.papers import work
from fwclass.study.papers.work import Variant
from fwclass.survey.layout import Layout
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.stage import VERSION as OTHERS_VERSION
from fwclass.train.params import TrainParams
from fwclass.train.stage import TRAIN_IMPORTANCE, TRAIN_TREES

VERSION = 2


def all_classes(config: Config) -> tuple[ClassDef, ...]:
    """The survey's classes, then those that the paper does not have."""
    more = (ClassDef(**c.model_dump()) for c in config.papers.more_classes)
    return (*config.classes, *more)


def data_tasks(layout: Layout, names: tuple[str, ...], filtered: bool = False) -> list[Task]:
    """The sample of the training areas and the echoes of the test areas, with all columns that any variant reads;
    `filtered`: and what the ground filter says of the latter."""
    config, classes = layout.config, all_classes(layout.config)
    train, test = config.areas.boxes("train"), config.areas.boxes("test")
    columns = layout.columns(names)
    class_facts = [[c.name, c.code, list(c.codes)] for c in classes]
    drawn = {
        "features": list(names),
        "classes": class_facts,
        "train": [list(b.bounds) for b in train],
        "seed": config.train.seed,
        "samples_per_class": config.train.samples_per_class,
    }
    share = min(1.0, config.papers.test_echoes / max(1, layout.echoes))
    judged = {
        "features": list(names),
        "classes": class_facts,
        "areas": config.areas.model_dump(mode="json"),
        "share": share,
        "seed": config.papers.seed,
    }
    chosen = tuple(t for t in layout.tiles if any(t.box.touches(b) for b in train))
    also = {"ground": "ground"} if filtered else {}
    if filtered:
        judged["filtered"] = True
    sampling = replace(
        DRAW_SAMPLE,
        name="paper-sample",
        when=always,
        arguments=lambda plan: {"names": names, "params": config.train, "classes": classes, "areas": train},
        own=(*IDENTITY_AND_PLACE, *names, "reference"),
    )
    tasks = [sampling.task(Plan(config, tiled=layout), t) for t in chosen]
    draw = partial(
        work.draw_test_echoes, columns, also, names, train, test, config.areas.gap, classes, share, config.papers.seed
    )
    reads = {**columns, **also, "reference": "label"}
    for tile in layout.tiles:
        needs = needs_of(reads, (tile.key,))
        tasks.append(Task("paper-test", tile.key, VERSION, judged, partial(draw, tile), needs=needs))
    keys = tuple(t.key for t in chosen)
    merge = partial(work.merge_sample, keys, columns, config.train)
    needs = (*(("paper-sample", k) for k in keys), *needs_of(columns, keys))
    tasks.append(Task("paper-training", "all", VERSION, drawn, merge, needs=needs))
    keys = tuple(t.key for t in layout.tiles)
    gather = partial(work.gather_test_echoes, keys)
    tasks.append(Task("paper-tested", "all", VERSION, judged, gather, needs=tuple(("paper-test", k) for k in keys)))
    return tasks


def learn_tasks(config: Config, names: tuple[str, ...], variants: Iterable[Variant]) -> list[Task]:
    """A model of every variant, and its answers on the test echoes."""
    tasks = []
    for one in variants:
        params, classes = facts_of(config, one), all_classes(config)
        learn = partial(work.learn, one, names, config.compare, classes)
        tasks.append(Task("paper-model", one.name, _version(), params, learn, needs=(("paper-training", "all"),)))
        params = {**params, "block": config.papers.block}
        judge = partial(work.judge, one, names, classes, config.papers.block)
        needs = (("paper-model", one.name), ("paper-tested", "all"))
        tasks.append(Task("paper-judged", one.name, 1000 * CLASSIFY.version + VERSION, params, judge, needs=needs))
    return tasks


def time_tasks(config: Config, names: tuple[str, ...], variants: Iterable[Variant]) -> list[Task]:
    """How long every variant trains and answers: parts that nothing reads, to be run when all else is done."""
    tasks = []
    for one in variants:
        needs = (("paper-model", one.name), ("paper-tested", "all"), ("paper-training", "all"))
        work_ = partial(work.time_variant, one, names, config.compare, all_classes(config))
        tasks.append(Task("paper-time", one.name, _version(), facts_of(config, one), work_, needs=needs))
    return tasks


def importance_tasks(config: Config, names: tuple[str, ...], one: Variant) -> list[Task]:
    """Permutation importance of a forest's features on what its trees did not see."""
    tasks, batches = [], []
    params = {**facts_of(config, one), "repeats": config.papers.repeats}
    for first in range(0, one.train.trees, TREES_PER_PART):
        count = min(TREES_PER_PART, one.train.trees - first)
        part = f"{first:05d}"
        batches.append(part)
        measure = partial(work.measure_drops, one, names, first, count, config.papers.repeats)
        reads = (("paper-training", "all"), ("paper-model", one.name))
        counted = {**params, "count": count}
        tasks.append(Task("paper-drops", part, TRAIN_IMPORTANCE.version, counted, measure, needs=reads))
    merge = partial(work.importance, tuple(batches), one.features)
    needs = tuple(("paper-drops", b) for b in batches)
    return [*tasks, Task("paper-importance", "all", VERSION, params, merge, needs=needs)]


def facts_of(config: Config, one: Variant) -> dict[str, Any]:
    """What a variant's parts depend on."""
    params = {"train": plain(one.train), "features": list(one.features), "classes": one.classes, "rows": one.rows}
    if one.squares:
        params["squares"] = list(one.squares)
    if one.filtered is not None:
        params["filtered"] = one.filtered
    if one.train.method != "forest":
        compare: CompareParams = config.compare
        params["compare"] = plain(compare)
    return params


def _version() -> int:
    return 1000 * OTHERS_VERSION + TRAIN_TREES.version


def make_variant(
    config: Config, name: str, features: Sequence[str], classes: int | None = None, rows: int = 0, **train: Any
) -> Variant:
    """The run's own classifier with other features, classes or training parameters."""
    params = TrainParams.model_validate({**plain(config.train), "importance_repeats": 0, **train})
    return Variant(name, tuple(features), params, len(config.classes) if classes is None else classes, rows)


def comparison_tasks(config: Config, pairs: Iterable[tuple[Variant, Variant]]) -> list[Task]:
    """How much better the first of each pair is than the second on the same test echoes, with an interval."""
    tasks = []
    for one, other in pairs:
        known = min(one.classes, other.classes)
        params = {"classes": known, "block": config.papers.block}
        compare = partial(work.compare, one.name, other.name, known, config.papers.block)
        needs = (("paper-judged", one.name), ("paper-judged", other.name), ("paper-tested", "all"))
        tasks.append(Task("paper-difference", f"{one.name}-{other.name}", VERSION, params, compare, needs=needs))
    return tasks
