"""Parts of tiles between ground and training: labels, features."""

from __future__ import annotations

from functools import partial

from fwclass.features.stage import FEATURES
from fwclass.label.stage import LABEL
from fwclass.run.part import Name, Task
from fwclass.run.plan.layout import Layout, needs_of, plain
from fwclass.run.work import tiles


def label_tasks(layout: Layout) -> list[Task]:
    config, made = layout.config, []
    for tile in layout.tiles:
        needs: tuple[Name, ...] = (("tile", tile.key),)
        if config.survey.reference.kind == "source":
            work = partial(tiles.labelled_by_source, tile, config.label)
        else:
            clouds = layout.around(tile.box.grown(LABEL.halo(config.label)), layout.clouds)
            work = partial(tiles.labelled_by_cloud, tile, clouds, config.label)
            needs += tuple(("reference", c) for c in clouds)
        params = {**plain(config.label), "kind": config.survey.reference.kind}
        made.append(Task("label", tile.key, LABEL.version, params, work, needs=needs))
    return made


def feature_tasks(layout: Layout) -> list[Task]:
    config, made = layout.config, []
    halo = FEATURES.halo(config.features)
    columns = layout.columns(FEATURES.reads)
    for tile in layout.tiles:
        present = layout.around(tile.box.grown(halo), layout.keys)
        made.append(
            Task(
                "features", tile.key, FEATURES.version, plain(config.features),
                partial(tiles.featured, tile, halo, columns, present, config.features),
                needs=needs_of(columns, present),
            )
        )  # fmt: skip
    return made
