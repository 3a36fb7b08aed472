"""Parts that read: index, chunks, reference clouds, tiles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

from fwclass.conf import Config
from fwclass.decompose.stage import DECOMPOSE, PULSE
from fwclass.grid import TileGrid
from fwclass.read.spans import Span
from fwclass.read.stage import READ
from fwclass.run.part import Name, Task
from fwclass.run.plan.layout import FileDigests, Strip, Survey, plain
from fwclass.run.plan.numbering import numbers
from fwclass.run.work import reference, sources
from fwclass.store.receipts import Receipt
from fwclass.tile.stage import REFERENCE, SPLIT, TILE

INDEX_VERSION = 2
"""Raised when the same file would be cut into other spans or other pulses."""


def _spans(receipt: Receipt) -> list[Span]:
    return [Span(a, b, first, pulses, tuple(shared)) for a, b, first, pulses, shared in receipt.meta["spans"]]


def index_tasks(config: Config, strips: Iterable[Strip]) -> list[Task]:
    return [
        Task(
            "index", f"{s.number:05d}", INDEX_VERSION, plain(config.read),
            partial(sources.index, s.path, config.read), external=s.digests,
        )
        for s in strips
    ]  # fmt: skip


def chunk_name(strip: int, span: int) -> str:
    return f"{strip:05d}-{span:05d}"


def chunk_tasks(config: Config, strips: Iterable[Strip], indexed: Mapping[Name, Receipt]) -> list[Task]:
    """read, decompose and split of every span of every strip, and every strip's system pulse."""
    grid = TileGrid(config.tile.size)
    made = []
    for strip in strips:
        index = indexed["index", f"{strip.number:05d}"]
        spans = _spans(index)
        for k, span in enumerate(spans):
            rows = [span.first_point, span.last_point, span.first_pulse, span.n_pulses, list(span.shared)]
            made.append(
                Task(
                    "read", chunk_name(strip.number, k), READ.version, {**plain(config.read), "span": rows},
                    partial(sources.read, strip.path, span, config.read), external=strip.digests,
                )
            )  # fmt: skip
        made.append(_pulse_task(config, strip, int(index.meta["pulses"]), len(spans)))
        for k in range(len(spans)):
            part = chunk_name(strip.number, k)
            made += [
                Task(
                    "decompose", part, DECOMPOSE.version, {**plain(config.decompose), "strip": strip.number},
                    partial(sources.decomposed, part, strip.number, config.decompose),
                    needs=(("read", part), ("pulse", f"{strip.number:05d}")),
                ),
                Task(
                    "split", part, SPLIT.version, plain(config.tile),
                    partial(sources.scattered, part, grid), needs=(("decompose", part),),
                ),
            ]  # fmt: skip
    return made


def _pulse_task(config: Config, strip: Strip, pulses: int, spans: int) -> Task:
    parts = tuple(chunk_name(strip.number, k) for k in range(spans))
    return Task(
        "pulse", f"{strip.number:05d}", PULSE.version,
        {**plain(config.pulse), "strip": strip.number},
        partial(sources.measured_pulse, strip.number, pulses, parts, config.pulse),
        needs=tuple(("read", p) for p in parts),
    )  # fmt: skip


def cloud_tasks(config: Config, files: Iterable[tuple[Path, FileDigests, int]]) -> list[Task]:
    """Splits of the reference files, `CLOUD_ROWS` points at a time."""
    grid = TileGrid(config.tile.size)
    made, listed = [], list(files)
    numbered = numbers(path.name for path, _, _ in listed)
    for path, digests, points in listed:
        for k, first in enumerate(range(0, points, sources.CLOUD_ROWS)):
            last = min(points, first + sources.CLOUD_ROWS)
            params = {**plain(config.tile), "rows": [first, last]}
            work = partial(sources.scattered_cloud, path, first, last, grid)
            part = chunk_name(numbered[path.name], k)
            made.append(Task("reference-split", part, SPLIT.version, params, work, external=digests))
    return made


def polygon_tasks(config: Config, survey: Survey) -> list[Task]:
    """One part for every file of reference polygons: corners in the survey's system, with codes."""
    asked, made = config.survey.reference, []
    params = {
        "field": asked.field, "values": {str(k): v for k, v in asked.values.items()}, "crs": survey.crs,
        "classes": [[c.name, c.code, list(c.codes)] for c in config.classes],
    }  # fmt: skip
    for number, file in enumerate(survey.polygons):
        work = partial(reference.polygons_read, file, asked.field or "", asked.values, config.classes, survey.crs)
        own = {**params, "layer": file.layer, "from": file.crs}
        made.append(Task("polygons", f"{number:03d}", 1, own, work, external=file.digests))
    return made


def _fragments(splits: Mapping[Name, Receipt], stage: str) -> dict[str, list[tuple[str, int]]]:
    """For every tile the (chunk, row group) pairs that hold its rows, in chunk order."""
    found: dict[str, list[tuple[str, int]]] = {}
    for (name, part), receipt in sorted(splits.items()):
        if name == stage:
            for key, (group, _) in receipt.meta["tiles"].items():
                found.setdefault(key, []).append((part, group))
    return found


def tile_tasks(config: Config, splits: Mapping[Name, Receipt]) -> list[Task]:
    """Tiles of echoes and of reference points."""
    made = []
    blocks = tuple(sorted({float(config.ground.block), float(config.terrain.block)}))
    for key, pairs in sorted(_fragments(splits, "split").items()):
        made.append(
            Task(
                "tile", key, TILE.version, {**plain(config.tile), "blocks": list(blocks)},
                partial(sources.tiled, key, tuple(pairs), blocks), needs=tuple(("split", p) for p, _ in pairs),
                within=key,
            )
        )  # fmt: skip
    for key, pairs in sorted(_fragments(splits, "reference-split").items()):
        made.append(
            Task(
                "reference", key, REFERENCE.version, plain(config.tile),
                partial(sources.tiled_cloud, tuple(pairs)), needs=tuple(("reference-split", p) for p, _ in pairs),
                within=key,
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
