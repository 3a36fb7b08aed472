"""Why an echo has its class: what the model answers, and what it would answer with one feature at a usual value."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.context import coarse_share_columns, context_of, halo_of, with_context
from fwclass.classify.stage import classify
from fwclass.delivery.echoes import table_columns
from fwclass.errors import InputError
from fwclass.graph.context import FIRST
from fwclass.grid import Box
from fwclass.model import Contextual, Model, sample_matrix
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.schema import IDENTITY, Table
from fwclass.store.models import load_model
from fwclass.store.run_store import Store
from fwclass.store.tables import open_parquet
from fwclass.units import QUANTUM


@dataclass(frozen=True)
class Explanation:
    """What decided.

    `shares`: share of every class by name, the largest first. `features`: (name, value, effect), the largest effect
    first. Effect: share of the given class less what it would be were this feature at the median of the tile's echoes.
    """

    strip: int
    pulse: int
    echo_number: int
    tile: str
    shares: dict[str, float]
    features: tuple[tuple[str, float, float], ...]

    def __str__(self) -> str:
        (name, share), *rest = self.shares.items()
        others = ", ".join(f"{n} {s:.0%}" for n, s in rest if s)
        lines = [f"{name} {share:.0%}" + (f" ({others})" if others else "")]
        lines += [f"  {f} = {v:.4g}: {e:+.0%}" for f, v, e in self.features[:5] if e]
        return "\n".join(lines)


def explain(
    store: Store,
    model: Path,
    row: Mapping[str, Any],
    tiles: Callable[[], Iterable[str]],
    delivered: Callable[[str], Path],
) -> Explanation:
    """See `Delivery.explain`; `delivered` is the file of each of its `tiles`, which
    are asked for where the store has none."""
    strip, pulse, number = (int(row[name]) for name in IDENTITY)
    forest: Model = load_model(model)
    inputs = PartInputs(store)
    tile, place = _place(store.where, _identities(store, inputs, tiles, delivered), strip, pulse, number)
    X = deciding_values(store, inputs, tile, forest, delivered)
    usual = np.nanmedian(np.where(np.isfinite(X), X, np.nan), axis=0)
    variants = np.repeat(X[[place]], 1 + X.shape[1], axis=0)
    for k in range(X.shape[1]):
        variants[1 + k, k] = usual[k]
    answers = classify(np.ascontiguousarray(variants, np.float32), forest, True)
    shares = {c.name: answers[f"probability_{c.code}"] for c in forest.classes}
    winner = max(shares, key=lambda name: float(shares[name][0]))
    effects = shares[winner][0] - shares[winner][1:]
    order = np.argsort(-np.abs(effects), kind="stable")
    return Explanation(
        strip,
        pulse,
        number,
        tile,
        {n: float(s[0]) for n, s in sorted(shares.items(), key=lambda item: -float(item[1][0]))},
        tuple((forest.deciding[k], float(X[place, k]), float(effects[k])) for k in order),
    )


def _identities(
    store: Store, inputs: PartInputs, tiles: Callable[[], Iterable[str]], delivered: Callable[[str], Path]
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Strip, pulse and number of the echoes of every tile: of the store, or where it has none any more delivered."""
    kept = [receipt.part for receipt in store.receipts("tile")]
    for tile in kept or tiles():
        yield tile, inputs.table("tile", tile, IDENTITY) if kept else table_columns(delivered(tile), IDENTITY)


def _place(
    where: object, tiles: Iterable[tuple[str, Mapping[str, Any]]], strip: int, pulse: int, number: int
) -> tuple[str, int]:
    """Tile and row of an echo."""
    for tile, who in tiles:
        here = (who["strip"] == strip) & (who["pulse"] == pulse) & (who["echo_number"] == number)
        if here.any():
            return tile, int(np.flatnonzero(here)[0])
    raise InputError(
        "there is no such echo",
        where=where,
        expected="strip, pulse and echo_number of an echo of .echoes()",
        got=f"strip {strip}, pulse {pulse}, echo {number}",
        do="look it up in .echoes()",
    )


def deciding_values(
    store: Store, inputs: PartInputs, tile: str, model: Model, delivered: Callable[[str], Path]
) -> NDArray[np.float32]:
    """float32 (rows, features): what `model` is asked with of a tile's echoes, in the order of ``model.deciding``.

    `InputError` where it decides in context, and the run keeps none any more.
    """
    X = sample_matrix(tile_features(store, inputs, tile, model.features, delivered), model.features, tile)
    if not isinstance(model, Contextual):
        return X
    columns = coarse_share_columns(model.codes)
    present = [part for stage, part in store.parts() if stage == FIRST]
    if tile not in present:
        raise InputError(
            "what an echo's neighbours are is not kept any more, and this model decides by it",
            where=store.where,
            expected=f"stage {FIRST}",
            do="run the same again: `fwclass clean` removed it",
        )
    read = {**dict.fromkeys(("x", "y", "z"), "tile"), **dict.fromkeys(columns, FIRST)}
    own = inputs.rows(tile, read).select(read)
    box = _box(inputs, tile).grown(halo_of(model.cells))
    others = [p for p in present if p != tile and _box(inputs, p).touches(box)]
    table = Table.concat([own, *(inputs.rows(p, read, box).select(read) for p in others)])
    return with_context(X, context_of(table, np.arange(own.rows), columns, model.cells))


def _box(inputs: PartInputs, tile: str) -> Box:
    """Where the echoes of a tile lie."""
    low_x, low_y, _, high_x, high_y, _ = inputs.meta("tile", tile)["bounds"]
    return Box(low_x, low_y, high_x + QUANTUM, high_y + QUANTUM)


def tile_features(
    store: Store, inputs: PartInputs, tile: str, names: tuple[str, ...], delivered: Callable[[str], Path]
) -> Table:
    """The model's features of a tile, from whichever stages wrote them; what `fwclass clean` removed of these from the
    `delivered` tile, where they are rounded (`publish.parquet_bits`)."""
    known: dict[str, Any] = {}
    for stage, part in store.parts():
        receipt = store.receipt(stage, part) if part == tile else None
        if receipt is None or receipt.emptied or not (path := store.path(stage, part, TABLE)).is_file():
            continue
        mine = [n for n in open_parquet(path).schema_arrow.names if n in names and n not in known]
        if mine:
            known |= dict(inputs.table(stage, part, mine))
    if lacking := [n for n in names if n not in known]:
        known |= table_columns(delivered(tile), lacking)
    return Table({n: known[n] for n in names if n in known})
