"""Parts that learn and judge: sample, trees, model, classification, assessment."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

from fwclass.classify.stage import CLASSIFY
from fwclass.run.part import Name, Task
from fwclass.run.plan.layout import Layout, needs_of, plain, plain_classes, providers
from fwclass.run.work import forest
from fwclass.store.atomic import digest_of, file_digest, files_below
from fwclass.train.stage import TRAIN, TRAIN_SAMPLE, TRAIN_TREES

TREES_PER_PART = 5
"""Trees that one task grows; a forest does not depend on it."""


def training_tasks(layout: Layout) -> list[Task]:
    """sample, training, trees, train."""
    config, names = layout.config, layout.config.survey.features
    columns = layout.columns(names)
    boxes = config.areas.boxes("train")
    params = {**plain(config.train), "classes": plain_classes(config), "features": list(names)}
    drawn = {n: params[n] for n in ("seed", "samples_per_class", "classes", "features")}
    per_tree = {n: v for n, v in params.items() if n != "trees"}
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
            "training", "all", TRAIN_SAMPLE.version, drawn,
            partial(forest.merged, chosen, names, config.train, config.classes),
            needs=tuple(("sample", k) for k in chosen),
        )
    )  # fmt: skip
    batches = []
    for first in range(0, config.train.trees, TREES_PER_PART):
        count = min(TREES_PER_PART, config.train.trees - first)
        batches.append(f"{first:05d}")
        made.append(
            Task(
                "trees", batches[-1], TRAIN_TREES.version, {**per_tree, "count": count},
                partial(forest.grown, first, count, names, config.train, config.classes), needs=(("training", "all"),),
            )
        )  # fmt: skip
    made.append(
        Task(
            "train", "model", TRAIN.version, params,
            partial(forest.trained, tuple(batches), names, config.train, config.classes),
            needs=(("training", "all"), *(("trees", b) for b in batches)), place="run",
        )
    )  # fmt: skip
    return made


def classify_tasks(layout: Layout, names: tuple[str, ...], model: tuple[Path, str] | None) -> list[Task]:
    columns = layout.columns(names)
    made = []
    for tile in layout.tiles:
        trained: tuple[Name, ...] = () if model else (("train", "model"),)
        made.append(
            Task(
                "classify", tile.key, CLASSIFY.version, {"features": list(names)},
                partial(forest.classified, tile, columns, names, model),
                needs=(*needs_of(columns, (tile.key,)), *trained),
                external=(("model", model[1]),) if model else (),
            )
        )  # fmt: skip
    return made


FAN_2013 = ("zc", "echo_number", "amplitude", "echo_ratio", "backscatter", "inclination", "width")
"""The seven features of Fan 2013; the report sets their distribution beside the paper's, used by the forest or not."""


def described(layout: Layout, names: tuple[str, ...]) -> tuple[str, ...]:
    """The forest's features, then those of the paper's seven that the forest leaves out, at every radius."""
    others = [n for n in providers(layout.config) if re.sub(r"_r\d+$", "", n) in FAN_2013]
    return tuple(dict.fromkeys((*names, *others)))


def assess_tasks(layout: Layout, names: tuple[str, ...]) -> list[Task]:
    config = layout.config
    names = described(layout, names)
    columns = layout.columns(names)
    train, test = config.areas.boxes("train"), config.areas.boxes("test")
    params = {
        "areas": config.areas.model_dump(mode="json"),
        "classes": plain_classes(config),
        "features": list(names),
    }
    made = []
    for tile in layout.tiles:
        work = partial(forest.judged, tile, columns, names, train, test, config.areas.gap, config.classes)
        needs = needs_of({**columns, "a": "label", "b": "classify", "c": "ground"}, (tile.key,))
        made.append(Task("confusion", tile.key, 2, params, work, needs=needs))
    keys = tuple(t.key for t in layout.tiles)
    made.append(
        Task(
            "assess", "all", 2, {**params, "quantiles": list(config.assess.quantiles)},
            partial(forest.assessed, keys, names, config.classes, config.assess.quantiles),
            needs=tuple(("confusion", k) for k in keys),
        )
    )  # fmt: skip
    return made


def digest_of_model(path: Path) -> str:
    """Digest of a model directory's files."""
    return digest_of([[p.relative_to(path).as_posix(), file_digest(p)] for p in files_below(path)])
