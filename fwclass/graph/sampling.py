"""Parts that count the labels: where they are, and which of them train."""

from __future__ import annotations

from functools import partial

from fwclass.graph.layout import Layout, plain_classes
from fwclass.graph.work import sampling
from fwclass.grid import Tile
from fwclass.run.part import Task
from fwclass.run.tasks import Tasks


def sampling_tasks(layout: Layout) -> Tasks:
    """census of every tile, and taken of the tiles in training areas."""
    config = layout.config
    train, test = config.areas.boxes("train"), config.areas.boxes("test")
    params = {"areas": config.areas.model_dump(mode="json"), "classes": plain_classes(config)}

    def census(tile: Tile) -> Task:
        work = partial(sampling.counted, tile, train, test, config.areas.gap, config.classes)
        return Task("census", tile.key, 1, params, work, needs=(("tile", tile.key), ("label", tile.key)))

    def taken(tile: Tile) -> Task:
        needs = (("tile", tile.key), ("label", tile.key), ("training", "all"))
        return Task("taken", tile.key, 1, params, partial(sampling.drawn, tile, train, config.classes), needs=needs)

    training = [t for t in layout.tiles if any(t.box.touches(b) for b in train)]
    return Tasks.of("census", layout.tiles, census) + Tasks.of("taken", training, taken)
