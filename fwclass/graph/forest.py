"""Parts that learn and judge: sample, trees, model, classification, assessment."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from fwclass.classify.stage import CLASSIFY
from fwclass.graph.layout import Layout, needs_of, plain, plain_classes, providers
from fwclass.graph.model_fit import computed
from fwclass.graph.thin import follow_tasks, thin_columns, thins
from fwclass.graph.work import forest, others
from fwclass.grid import Tile
from fwclass.run.part import Name, Task
from fwclass.run.tasks import Tasks
from fwclass.store.external_file import ExternalFile
from fwclass.store.models import model_digest
from fwclass.store.remote_file import Location
from fwclass.train.baselines.stage import VERSION
from fwclass.train.stage import TRAIN, TRAIN_IMPORTANCE, TRAIN_SAMPLE, TRAIN_TREES

TREES_PER_PART = 5
"""Trees that one task grows; a forest does not depend on it."""


def training_tasks(layout: Layout) -> list[Task]:
    """sample, training, trees, train."""
    config, names = layout.config, layout.config.features_asked
    columns = layout.columns(names) | thin_columns(config)
    boxes = config.areas.boxes("train")
    params = {**plain(config.train), "classes": plain_classes(config), "features": list(names)}
    drawn = {n: params[n] for n in ("seed", "samples_per_class", "classes", "features")}
    per_tree = {n: v for n, v in params.items() if n not in ("trees", "importance_repeats")}
    made = []
    chosen = tuple(t.key for t in layout.tiles if any(t.box.touches(b) for b in boxes))
    for tile in layout.tiles:
        if tile.key in chosen:
            work = partial(forest.sampled, tile, columns, names, boxes, config.train, config.classes)
            area = {**drawn, "areas": [list(b.bounds) for b in boxes]}
            needs = needs_of({**columns, "reference": "label"}, (tile.key,))
            made.append(Task("sample", tile.key, TRAIN_SAMPLE.version, area, work, needs=needs))
    made.append(
        Task(
            "training",
            "all",
            TRAIN_SAMPLE.version,
            drawn,
            partial(forest.merged, chosen, names, config.train, config.classes),
            needs=tuple(("sample", k) for k in chosen),
        )
    )
    if config.train.method != "forest":
        return [*made, _other_task(layout, names, params)]
    params["computed"] = computed(names, config.features, config.ground.method, layout.quantities)
    batches = []
    for first in range(0, config.train.trees, TREES_PER_PART):
        count = min(TREES_PER_PART, config.train.trees - first)
        batches.append(f"{first:05d}")
        made.append(
            Task(
                "trees",
                batches[-1],
                TRAIN_TREES.version,
                {**per_tree, "count": count},
                partial(forest.grown, first, count, names, config.train, config.classes),
                needs=(("training", "all"),),
            )
        )
        if config.train.importance_repeats:
            repeats = {**per_tree, "count": count, "importance_repeats": config.train.importance_repeats}
            made.append(
                Task(
                    "importance",
                    batches[-1],
                    TRAIN_IMPORTANCE.version,
                    repeats,
                    partial(forest.weighed, first, names, config.train),
                    needs=(("training", "all"), ("trees", batches[-1])),
                )
            )
    weighed = [("importance", b) for b in batches if config.train.importance_repeats]
    made.append(
        Task(
            "train",
            "model",
            TRAIN.version,
            params,
            partial(forest.trained, tuple(batches), names, config.train, config.classes, params["computed"]),
            needs=(("training", "all"), *(("trees", b) for b in batches), *weighed),
            place="deliver",
        )
    )
    return made


def _other_task(layout: Layout, names: tuple[str, ...], params: dict[str, Any]) -> Task:
    """train, of a classifier that is no forest."""
    config = layout.config
    params = {
        **params,
        "compare": plain(config.compare),
        "computed": computed(names, config.features, config.ground.method, layout.quantities),
    }
    work = partial(others.fitted, names, config.train, config.compare, config.classes, params["computed"])
    return Task("train", "model", VERSION, params, work, needs=(("training", "all"),), place="deliver")


def classify_tasks(layout: Layout, names: tuple[str, ...], model: tuple[Location, str] | None) -> Tasks:
    if thins(layout.config):
        return follow_tasks(layout, names, model)
    columns, shares = layout.columns(names), layout.config.classify.probabilities
    params = {"features": list(names), "probabilities": shares}
    trained: tuple[Name, ...] = () if model else (("train", "model"),)

    def made(tile: Tile) -> Task:
        return Task(
            "classify",
            tile.key,
            CLASSIFY.version,
            params,
            partial(forest.classified, tile, columns, names, model, shares),
            needs=(*needs_of(columns, (tile.key,)), *trained),
            external=(ExternalFile("model", model[1]),) if model else (),
        )

    return Tasks.of("classify", layout.tiles, made)


FAN_2013 = ("echo_number", "amplitude", "backscatter", "width")
"""Of the seven features of Fan 2013 those that no neighbourhood is needed for; the report sets their distribution
beside the paper's, used by the forest or not."""


def described(layout: Layout, names: tuple[str, ...]) -> tuple[str, ...]:
    """The classifier's features, those that are computed besides, and what else Fan 2013 has."""
    known = providers(layout.config)
    return tuple(dict.fromkeys((*names, *layout.config.features.also, *(n for n in FAN_2013 if n in known))))


def assess_tasks(layout: Layout, names: tuple[str, ...]) -> Tasks:
    config = layout.config
    names = described(layout, names)
    columns = layout.columns(names)
    train, test = config.areas.boxes("train"), config.areas.boxes("test")
    params = {
        "areas": config.areas.model_dump(mode="json"),
        "classes": plain_classes(config),
        "features": list(names),
        "block": config.assess.block,
    }

    def judged(tile: Tile) -> Task:
        work = partial(
            forest.judged, tile, columns, names, train, test, config.areas.gap, config.assess.block, config.classes
        )
        needs = needs_of({**columns, "a": "label", "b": "classify", "c": "ground"}, (tile.key,))
        return Task("confusion", tile.key, 4, params, work, needs=needs, check=True)

    keys = tuple(t.key for t in layout.tiles)
    whole = Task(
        "assess",
        "all",
        5,
        {**params, "quantiles": list(config.assess.quantiles)},
        partial(forest.assessed, keys, names, config.classes, config.assess.quantiles),
        needs=tuple(("confusion", k) for k in keys),
        check=True,
    )
    return Tasks.of("confusion", layout.tiles, judged) + Tasks.held([whole])


def digest_of_model(path: Path) -> str:
    """Digest of a model directory's files."""
    return model_digest(path)
