"""Parts of tiles between ground and training: labels, features."""

from __future__ import annotations

from functools import partial

from fwclass.features.params import Asked, is_feature
from fwclass.features.stage import FEATURES
from fwclass.graph.layout import Layout, needs_of, plain
from fwclass.graph.thin import thin_columns, thins
from fwclass.graph.work import reference, tiles
from fwclass.grid import Tile
from fwclass.label.stage import LABEL
from fwclass.run.part import Name, Task
from fwclass.run.tasks import Tasks

MANY, FEW = 1000, 1000
"""A run of so many tiles with fewer echoes than this in each, on average, spends its time on opening files."""


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


def label_tasks(layout: Layout) -> Tasks:
    config = layout.config
    params = {**plain(config.label), "kind": config.survey.reference.kind}
    judges = config.survey.model is not None  # nothing is trained by the labels

    def made(tile: Tile) -> Task:
        needs: tuple[Name, ...] = (("tile", tile.key),)
        within = tile.box
        if config.survey.reference.kind == "source":
            work = partial(tiles.labelled_by_source, tile, config.label)
        elif config.survey.reference.kind == "polygons":
            work = partial(reference.labelled_by_polygons, tile, layout.polygons)
            needs += tuple(("polygons", p) for p in layout.polygons)
        else:
            within = tile.box.grown(LABEL.halo(config.label))
            clouds = layout.around(within, layout.clouds)
            work = partial(tiles.labelled_by_cloud, tile, clouds, config.label)
            needs += tuple(("reference", c) for c in clouds)
        return Task("label", tile.key, LABEL.version, params, work, needs=needs, within=within, check=judges)

    return Tasks.of("label", layout.tiles, made)


def feature_tasks(layout: Layout, names: tuple[str, ...]) -> Tasks:
    """Those of `names` that are features of a neighbourhood."""
    config = layout.config
    asked = Asked.of(sorted(n for n in names if is_feature(n)))  # who asks in another order gets the same part
    halo = asked.halo(config.features)
    columns = layout.columns(asked.reads)
    params = {**config.features.model_dump(mode="json", exclude={"also"}), "names": list(asked.names)}
    here = layout.keys

    def made(tile: Tile) -> Task:
        within = tile.box.grown(halo)
        present = layout.around(within, here)
        return Task(
            "features",
            tile.key,
            FEATURES.version,
            params,
            partial(tiles.featured, tile, halo, columns, present, asked.names, config.features, thins(config)),
            needs=(*needs_of(columns, present), *((s, tile.key) for s in thin_columns(config).values())),
            within=within,
        )

    return Tasks.of("features", layout.tiles, made)
