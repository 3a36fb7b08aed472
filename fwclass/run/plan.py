"""Which parts a run has, and what each needs: the edges of the graph, and no more than the edges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fwclass.classify.stage import CLASSIFY
from fwclass.conf import Config
from fwclass.decompose.stage import DECOMPOSE
from fwclass.features.stage import FEATURES
from fwclass.features.stage import names as feature_names
from fwclass.grid import Box, Tile, TileGrid, Window
from fwclass.ground.stage import GROUND, GROUND_SURFACE
from fwclass.label.stage import LABEL
from fwclass.read.spans import Span
from fwclass.read.stage import READ
from fwclass.run import forest, outputs, sources, tiles
from fwclass.run.part import Name, Task
from fwclass.run.tiles import MARGIN
from fwclass.stage import Stage
from fwclass.store.atomic import digest_of, file_digest, files_below
from fwclass.store.receipts import Receipt
from fwclass.tile.stage import REFERENCE, SPLIT, TILE
from fwclass.train.stage import TRAIN, TRAIN_SAMPLE, TRAIN_TREES

TREES_PER_PART = 5
"""Trees that one task grows; a forest does not depend on it."""

DELIVERED = (
    "x", "y", "z", "strip", "pulse", "echo_number", "number_of_echoes", "gps_time", "intensity", "amplitude", "width",
    "height_above_ground", "ground", "classification", "confidence",
)  # fmt: skip
"""Columns of the delivered tiles, besides the forest's features."""

FileDigests = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Strip:
    """A source file with its place in the survey's sorted list."""

    number: int
    path: Path
    digests: FileDigests
    point_format: int


def _params(value: Any) -> Any:
    return value.model_dump(mode="json")


def _spans(receipt: Receipt) -> list[Span]:
    return [Span(*row) for row in receipt.meta["spans"]]


def index_tasks(config: Config, strips: Iterable[Strip]) -> list[Task]:
    return [
        Task(
            "index", f"{s.number:03d}", 1, _params(config.read),
            partial(sources.index, s.path, config.read), external=s.digests,
        )
        for s in strips
    ]  # fmt: skip


def chunk_name(strip: int, span: int) -> str:
    return f"{strip:03d}-{span:05d}"


def chunk_tasks(config: Config, strips: Iterable[Strip], indexed: Mapping[Name, Receipt]) -> list[Task]:
    """read, decompose and split of every span of every strip."""
    grid = TileGrid(config.tile.size)
    made = []
    for strip in strips:
        for k, span in enumerate(_spans(indexed["index", f"{strip.number:03d}"])):
            part = chunk_name(strip.number, k)
            made += [
                Task(
                    "read", part, READ.version, {**_params(config.read), "span": [*vars(span).values()]},
                    partial(sources.read, strip.path, span, config.read), external=strip.digests,
                ),
                Task(
                    "decompose", part, DECOMPOSE.version, {**_params(config.decompose), "strip": strip.number},
                    partial(sources.decomposed, part, strip.number, config.decompose), needs=(("read", part),),
                ),
                Task(
                    "split", part, SPLIT.version, _params(config.tile),
                    partial(sources.scattered, part, grid), needs=(("decompose", part),),
                ),
            ]  # fmt: skip
    return made


def cloud_tasks(config: Config, files: Iterable[tuple[Path, FileDigests, int]]) -> list[Task]:
    """Splits of the reference files, `CLOUD_ROWS` points at a time."""
    grid = TileGrid(config.tile.size)
    made = []
    for number, (path, digests, points) in enumerate(files):
        for k, first in enumerate(range(0, points, sources.CLOUD_ROWS)):
            last = min(points, first + sources.CLOUD_ROWS)
            params = {**_params(config.tile), "rows": [first, last]}
            work = partial(sources.scattered_cloud, path, first, last, grid)
            part = chunk_name(number, k)
            made.append(Task("reference-split", part, SPLIT.version, params, work, external=digests))
    return made


def _fragments(splits: Mapping[Name, Receipt], stage: str) -> dict[str, list[tuple[str, int]]]:
    """For every tile the (chunk, row group) pairs that hold its rows, in chunk order."""
    found: dict[str, list[tuple[str, int]]] = {}
    for (name, part), receipt in sorted(splits.items()):
        if name == stage:
            for key, (group, _) in receipt.meta["tiles"].items():
                found.setdefault(key, []).append((part, group))
    return found


def tile_tasks(config: Config, splits: Mapping[Name, Receipt], wanted: frozenset[str] | None) -> list[Task]:
    """Tiles of echoes and of reference points. `wanted`: tiles to restrict to (with all others left as they are)."""
    made = []
    block = config.ground.block
    for key, pairs in sorted(_fragments(splits, "split").items()):
        if wanted is None or key in wanted:
            made.append(
                Task(
                    "tile", key, TILE.version, {**_params(config.tile), "block": block},
                    partial(sources.tiled, key, tuple(pairs), block), needs=tuple(("split", p) for p, _ in pairs),
                )
            )  # fmt: skip
    for key, pairs in sorted(_fragments(splits, "reference-split").items()):
        made.append(
            Task(
                "reference", key, REFERENCE.version, _params(config.tile),
                partial(sources.tiled_cloud, tuple(pairs)), needs=tuple(("reference-split", p) for p, _ in pairs),
            )
        )  # fmt: skip
    return made


@dataclass(frozen=True)
class Ground:
    """What phase three stands on: the tiles there are, where their echoes lie, and the reference tiles."""

    config: Config
    tiles: tuple[Tile, ...]
    blocks: tuple[Tile, ...]
    clouds: frozenset[str]
    box: Box

    @classmethod
    def of(cls, config: Config, done: Mapping[Name, Receipt]) -> Ground:
        grid = TileGrid(config.tile.size)
        mine = {part: r for (stage, part), r in done.items() if stage == "tile"}
        occupied = {b for r in mine.values() for b in r.meta["blocks"]}
        low = [min(r.meta["bounds"][k] for r in mine.values()) for k in range(2)]
        high = [max(r.meta["bounds"][k] for r in mine.values()) for k in range(3, 5)]
        return cls(
            config,
            tuple(sorted(grid.tile(k) for k in mine)),
            tuple(outputs.blocks_around(occupied, config.ground.block)),
            frozenset(part for stage, part in done if stage == "reference"),
            Box(low[0], low[1], high[0] + 0.001, high[1] + 0.001),
        )

    @property
    def keys(self) -> frozenset[str]:
        return frozenset(t.key for t in self.tiles)

    def around(self, box: Box, among: Iterable[str]) -> tuple[str, ...]:
        """Tiles of `among` that touch `box`."""
        here = set(among)
        return tuple(t.key for t in TileGrid(self.config.tile.size).touching(box) if t.key in here)

    def providers(self) -> dict[str, str]:
        """Which stage's tables hold each column that the forest or the outputs may ask for."""
        config = self.config
        found = dict.fromkeys(DECOMPOSE.writes, "tile")
        found |= dict.fromkeys(GROUND.writes, "ground")
        found |= dict.fromkeys(feature_names(config.features), "features")
        found |= {"reference": "label", "classification": "classify", "confidence": "classify"}
        return found


def _needs(columns: Mapping[str, str], parts: Iterable[str]) -> tuple[Name, ...]:
    return tuple((stage, part) for part in parts for stage in sorted({*columns.values(), "tile"}))


def surface_tasks(base: Ground) -> list[Task]:
    config, made = base.config, []
    halo = GROUND_SURFACE.halo(config.ground)
    for block in base.blocks:
        present = base.around(block.box.grown(halo), base.keys)
        made.append(
            Task(
                "surface", block.key, GROUND_SURFACE.version, _params(config.ground),
                partial(tiles.terrain, block, config.tile.size, present, config.ground),
                needs=tuple(("tile", k) for k in present),
            )
        )  # fmt: skip
    return made


def ground_tasks(base: Ground) -> list[Task]:
    config, made = base.config, []
    there = {b.key for b in base.blocks}
    for tile in base.tiles:
        window = Window.covering(tile.box, config.ground.cell, margin=MARGIN)
        blocks = tuple(b.key for b in TileGrid(config.ground.block).touching(window.box) if b.key in there)
        made.append(
            Task(
                "ground", tile.key, GROUND.version, _params(config.ground),
                partial(tiles.grounded, tile, blocks, config.ground),
                needs=(("tile", tile.key), *(("surface", b) for b in blocks)),
            )
        )  # fmt: skip
    return made


def label_tasks(base: Ground) -> list[Task]:
    config, made = base.config, []
    for tile in base.tiles:
        needs: tuple[Name, ...] = (("tile", tile.key),)
        if config.survey.reference.kind == "source":
            work = partial(tiles.labelled_by_source, tile, config.label)
        else:
            clouds = base.around(tile.box.grown(LABEL.halo(config.label)), base.clouds)
            work = partial(tiles.labelled_by_cloud, tile, clouds, config.label)
            needs += tuple(("reference", c) for c in clouds)
        params = {**_params(config.label), "kind": config.survey.reference.kind}
        made.append(Task("label", tile.key, LABEL.version, params, work, needs=needs))
    return made


def _tile_task(base: Ground, stage: Stage, tile: Tile, columns: Mapping[str, str], work: Any, params: Any) -> Task:
    return Task(stage.name, tile.key, stage.version, params, work, needs=_needs(columns, (tile.key,)))


def feature_tasks(base: Ground) -> list[Task]:
    config, made = base.config, []
    halo = FEATURES.halo(config.features)
    providers = base.providers()
    columns = {n: providers[n] for n in FEATURES.reads}
    for tile in base.tiles:
        present = base.around(tile.box.grown(halo), base.keys)
        made.append(
            Task(
                "features", tile.key, FEATURES.version, _params(config.features),
                partial(tiles.featured, tile, halo, columns, present, config.features), needs=_needs(columns, present),
            )
        )  # fmt: skip
    return made


def forest_columns(base: Ground, names: Iterable[str]) -> dict[str, str]:
    providers = base.providers()
    return {n: providers[n] for n in names}


def _class_params(config: Config) -> list[dict[str, Any]]:
    return [c.model_dump(mode="json") for c in config.survey.classes]


def training_tasks(base: Ground) -> list[Task]:
    """sample, training, trees, train."""
    config, names = base.config, base.config.survey.features
    columns = forest_columns(base, names)
    boxes = config.areas.boxes("train")
    params = {**_params(config.train), "classes": _class_params(config), "features": list(names)}
    drawn = {n: params[n] for n in ("seed", "samples_per_class", "classes", "features")}
    per_tree = {n: v for n, v in params.items() if n != "trees"}
    made = []
    chosen = tuple(t.key for t in base.tiles if any(t.box.touches(b) for b in boxes))
    for tile in base.tiles:
        if tile.key in chosen:
            work = partial(forest.sampled, tile, columns, names, boxes, config.train, config.classes)
            area = {**drawn, "areas": [list(b.bounds) for b in boxes]}
            made.append(_tile_task(base, TRAIN_SAMPLE, tile, {**columns, "reference": "label"}, work, area))
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


def classify_tasks(base: Ground, names: tuple[str, ...], model: tuple[Path, str] | None) -> list[Task]:
    columns = forest_columns(base, names)
    made = []
    for tile in base.tiles:
        trained: tuple[Name, ...] = () if model else (("train", "model"),)
        made.append(
            Task(
                "classify", tile.key, CLASSIFY.version, {"features": list(names)},
                partial(forest.classified, tile, columns, names, model),
                needs=(*_needs(columns, (tile.key,)), *trained),
                external=(("model", model[1]),) if model else (),
            )
        )  # fmt: skip
    return made


def assess_tasks(base: Ground, names: tuple[str, ...]) -> list[Task]:
    config = base.config
    columns = forest_columns(base, names)
    train, test = config.areas.boxes("train"), config.areas.boxes("test")
    params = {
        "areas": config.areas.model_dump(mode="json"),
        "classes": _class_params(config),
        "features": list(names),
    }
    made = []
    for tile in base.tiles:
        work = partial(forest.judged, tile, columns, names, train, test, config.areas.gap, config.classes)
        needs = _needs({**columns, "a": "label", "b": "classify"}, (tile.key,))
        made.append(Task("confusion", tile.key, 1, params, work, needs=needs))
    keys = tuple(t.key for t in base.tiles)
    made.append(
        Task(
            "assess", "all", 1, {**params, "quantiles": list(config.assess.quantiles)},
            partial(forest.assessed, keys, config.classes, config.assess.quantiles),
            needs=tuple(("confusion", k) for k in keys),
        )
    )  # fmt: skip
    return made


def output_tasks(
    base: Ground, names: tuple[str, ...], strips: Iterable[Strip], crs: str | None,
    chunks: Mapping[int, tuple[str, ...]], in_strip: Mapping[int, tuple[str, ...]],
) -> list[Task]:  # fmt: skip
    """Tiles (LAZ, GeoParquet), strips (LAZ), class blocks and rasters."""
    config = base.config
    params = {**_params(config.publish), "crs": crs, "classes": _class_params(config)}
    wanted = tuple(dict.fromkeys((*DELIVERED, *names)))
    columns = forest_columns(base, wanted)
    made = [
        Task(
            "publish-tile", t.key, 1, {**params, "columns": list(wanted)},
            partial(outputs.delivered_tile, t, columns, crs, config.publish),
            needs=_needs(columns, (t.key,)), place="run",
        )
        for t in base.tiles
    ]  # fmt: skip
    made += _strip_tasks(config, params, strips, chunks, in_strip)
    owned = [b for b in base.blocks if b.box.touches(base.box)]
    for block in owned:
        cells = Window.covering(block.box, config.publish.class_cell).box
        present = base.around(cells, base.keys)
        made.append(
            Task(
                "class-block", block.key, 1, params,
                partial(outputs.class_block, block, config.tile.size, present, config.publish),
                needs=_needs({"a": "classify"}, present),
            )
        )  # fmt: skip
    keys = tuple(b.key for b in owned)
    codes = {c.code: c.name for c in config.survey.classes}
    made.append(
        Task(
            "publish-rasters", "all", 1, {**params, "box": list(base.box.bounds), "cell": config.ground.cell},
            partial(
                outputs.delivered_rasters, base.box, config.ground.cell, keys, keys, codes, crs, config.publish
            ),
            needs=(*(("surface", k) for k in keys), *(("class-block", k) for k in keys)), place="run",
        )
    )  # fmt: skip
    return made


def _strip_tasks(
    config: Config, params: Any, strips: Iterable[Strip], chunks: Mapping[int, tuple[str, ...]],
    in_strip: Mapping[int, tuple[str, ...]],
) -> list[Task]:  # fmt: skip
    made = []
    for strip in strips:
        legacy = strip.point_format <= 5
        codes = {c.code: c.legacy_code for c in config.survey.classes if legacy and c.legacy_code is not None}
        mine, here = chunks[strip.number], in_strip[strip.number]
        made.append(
            Task(
                "publish-strip", strip.path.stem, 1, params,
                partial(outputs.delivered_strip, strip.path, strip.number, mine, here, codes, config.publish),
                needs=(*(("decompose", c) for c in mine), *_needs({"a": "classify"}, here)),
                external=strip.digests, place="run",
            )
        )  # fmt: skip
    return made


def where(
    chunks: Iterable[Task], splits: Mapping[Name, Receipt]
) -> tuple[dict[int, tuple[str, ...]], dict[int, tuple[str, ...]]]:
    """For every strip its chunks, and the tiles that hold its echoes."""
    parts: dict[int, list[str]] = {}
    held: dict[int, set[str]] = {}
    for task in chunks:
        if task.stage == "split":
            strip = int(task.part.split("-")[0])
            parts.setdefault(strip, []).append(task.part)
            receipt = splits.get(task.name)
            held.setdefault(strip, set()).update(receipt.meta["tiles"] if receipt else ())
    return {s: tuple(p) for s, p in parts.items()}, {s: tuple(sorted(t)) for s, t in held.items()}


def digest_of_model(path: Path) -> str:
    """Digest of a model directory's files."""
    return digest_of([[p.relative_to(path).as_posix(), file_digest(p)] for p in files_below(path)])
