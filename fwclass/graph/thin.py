"""Parts of a thinned run (Xiong 2018): which echoes are sampled, and classes from the nearest sampled echo."""

from __future__ import annotations

from functools import partial

from fwclass.classify.stage import CLASSIFY
from fwclass.conf import Config
from fwclass.graph.layout import Layout, needs_of, plain
from fwclass.graph.work import thin
from fwclass.grid import Tile
from fwclass.run.part import Name, Task
from fwclass.run.tasks import Tasks
from fwclass.store.external_file import ExternalFile
from fwclass.store.remote_file import Location
from fwclass.thin.sample import THIN


def thins(config: Config) -> bool:
    """Only a share of the echoes is classified."""
    return config.thin.rate < 1.0


def thin_columns(config: Config) -> dict[str, str]:
    """The column that says which echoes count, and its stage; nothing where all do."""
    return {"sampled": THIN.name} if thins(config) else {}


def thin_tasks(layout: Layout) -> Tasks:
    """Which echoes of every tile are sampled; none where all are."""
    config, here = layout.config, layout.keys
    if not thins(config):
        return Tasks()
    halo, params = THIN.halo(config.thin), plain(config.thin)
    columns = dict.fromkeys(THIN.reads, "tile")

    def made(tile: Tile) -> Task:
        within = tile.box.grown(halo)
        present = layout.around(within, here)
        work = partial(thin.thinned, tile, halo, present, config.thin)
        needs = needs_of(columns, present)
        return Task(THIN.name, tile.key, THIN.version, params, work, needs=needs, within=within)

    return Tasks.of(THIN.name, layout.tiles, made)


def follow_tasks(layout: Layout, names: tuple[str, ...], model: tuple[Location, str] | None) -> Tasks:
    """classify, of a thinned run."""
    config, here = layout.config, layout.keys
    columns, shares = layout.columns(names), config.classify.probabilities
    trained: tuple[Name, ...] = () if model else (("train", "model"),)
    params = {"features": list(names), "probabilities": shares, "reach": config.thin.reach, "thin": THIN.version}

    def made(tile: Tile) -> Task:
        present = layout.around(tile.box.grown(config.thin.reach), here)
        return Task(
            "classify",
            tile.key,
            CLASSIFY.version,
            params,
            partial(thin.classified, tile, columns, present, model, shares, config.thin.reach),
            needs=(*needs_of({**columns, **thin_columns(config)}, present), *trained),
            external=(ExternalFile("model", model[1]),) if model else (),
        )

    return Tasks.of("classify", layout.tiles, made)
