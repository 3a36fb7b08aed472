"""A few tiles of a survey, the fullest ones, all the way to their files: what `fwclass plan --dry-run` measures."""

from __future__ import annotations

from fwclass.conf import Config
from fwclass.errors import InputError
from fwclass.graph.layout import check_features
from fwclass.graph.walk import until_labels, until_tiles
from fwclass.operate.estimate.trial import Trial, whole_tiles
from fwclass.run.runner import Runner
from fwclass.store.models import load_model
from fwclass.store.remote_file import local
from workflows.classification import from_tiles, given_model


def trial(asked: Trial, runner: Runner, count: int, halo: float) -> tuple[str, ...]:
    """Run the `count` tiles with most echoes of those that are whole; return their keys, the fullest first."""
    config: Config = asked.config
    model = given_model(config)
    names = load_model(local(model[0])).features if model else config.features_asked
    check_features(config, names, model[0] if model else f"{config.path}: survey.features")
    check_features(config, config.features.also, f"{config.path}: features.also")
    tiled = until_tiles(config, runner, names)
    tiles = tiled.layout.tiles
    whole = whole_tiles([t.key for t in tiles], [t.box for t in tiles], asked.left, halo)
    if not whole:
        raise InputError(
            "no tile of the dry run is whole",
            where="--dry-run",
            got=f"{len(tiles)} tiles at the edges of its files",
            do="--dry-run with more tiles, or smaller tile.size",
        )
    chosen = tuple(sorted(whole, key=lambda key: (-_rows(runner, key), key))[:count])
    labelling = until_labels(tiled, (*names, *config.features.also))
    from_tiles(config, runner, tiled, names, labelling, model, frozenset(chosen))
    return chosen


def _rows(runner: Runner, key: str) -> int:
    receipt = runner.store.receipt("tile", key)
    return int(receipt.meta["rows"]) if receipt else 0
