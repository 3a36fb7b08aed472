"""Parts that count the labels: where they are, and which of them train."""

from __future__ import annotations

from functools import partial

from fwclass.run.part import Task
from fwclass.run.plan.layout import Layout, plain_classes
from fwclass.run.work import sampling


def sampling_tasks(layout: Layout) -> list[Task]:
    """census of every tile, and taken of the tiles in training areas."""
    config, made = layout.config, []
    train, test = config.areas.boxes("train"), config.areas.boxes("test")
    params = {"areas": config.areas.model_dump(mode="json"), "classes": plain_classes(config)}
    for tile in layout.tiles:
        needs = (("tile", tile.key), ("label", tile.key))
        work = partial(sampling.counted, tile, train, test, config.areas.gap, config.classes)
        made.append(Task("census", tile.key, 1, params, work, needs=needs))
        if any(tile.box.touches(b) for b in train):
            drawn = partial(sampling.drawn, tile, train, config.classes)
            made.append(Task("taken", tile.key, 1, params, drawn, needs=(*needs, ("training", "all"))))
    return made
