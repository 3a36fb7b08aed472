"""Parts that read: index, chunks, reference clouds, tiles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from fwclass.conf import Config
from fwclass.decompose.stage import DECOMPOSE, PULSE
from fwclass.graph.layout import FileDigests, Strip, Survey, plain
from fwclass.graph.numbering import numbers
from fwclass.graph.work import reference as of_reference
from fwclass.graph.work import sources
from fwclass.grid import TileGrid
from fwclass.read.spans import Span
from fwclass.read.stage import READ
from fwclass.run.part import Name, Task
from fwclass.run.tasks import Tasks
from fwclass.store.receipts import Receipt
from fwclass.store.remote_file import Location
from fwclass.tile.stage import REFERENCE, SPLIT, TILE

INDEX_VERSION = 2
"""Raised when the same file would be cut into other spans or other pulses."""


def _spans(receipt: Receipt) -> list[Span]:
    return [Span(a, b, first, pulses, tuple(shared)) for a, b, first, pulses, shared in receipt.meta["spans"]]


def index_name(strip: Strip) -> Name:
    return "index", f"{strip.number:05d}"


def index_tasks(config: Config, strips: Iterable[Strip]) -> list[Task]:
    return [
        Task(
            *index_name(s),
            INDEX_VERSION,
            plain(config.read),
            partial(sources.index, s.path, config.read),
            external=s.digests,
        )
        for s in strips
    ]


def chunk_name(strip: int, span: int) -> str:
    return f"{strip:05d}-{span:05d}"


def chunk_tasks(config: Config, strips: Iterable[Strip], indexed: Mapping[Name, Receipt]) -> Tasks:
    """read, decompose and split of every span of every strip, and every strip's system pulse."""
    made = Tasks()
    for strip in strips:
        index = indexed[index_name(strip)]
        made += _strip_tasks(config, strip, _spans(index), int(index.meta["pulses"]))
    return made


def _strip_tasks(config: Config, strip: Strip, spans: list[Span], pulses: int) -> Tasks:
    grid, reading, sizes = TileGrid(config.tile.size), plain(config.read), plain(config.tile)
    decomposing = plain(config.decompose)  # of the strip that the part is named after

    def rows_of(span: Span) -> list[Any]:
        return [span.first_point, span.last_point, span.first_pulse, span.n_pulses, list(span.shared)]

    def read(k: int) -> Task:
        span = spans[k]
        return Task(
            "read",
            chunk_name(strip.number, k),
            READ.version,
            {**reading, "span": rows_of(span)},
            partial(sources.read, strip.path, span, config.read),
            external=strip.digests,
        )

    def decompose(k: int) -> Task:
        part = chunk_name(strip.number, k)
        return Task(
            "decompose",
            part,
            DECOMPOSE.version,
            decomposing,
            partial(sources.decomposed, part, strip.number, config.decompose),
            needs=(("read", part), ("pulse", f"{strip.number:05d}")),
        )

    def echoes(k: int) -> Task:
        """decompose of a file without waveforms, whose returns are echoes: nothing is kept in between."""
        span, width = spans[k], config.pulse.width or config.pulse.fallback_width
        return Task(
            "decompose",
            chunk_name(strip.number, k),
            DECOMPOSE.version,
            {**decomposing, "read": reading, "span": rows_of(span)},
            partial(sources.returned, strip.path, strip.number, span, config.read, width, config.decompose),
            external=strip.digests,
        )

    def split(k: int) -> Task:
        part = chunk_name(strip.number, k)
        work = partial(sources.scattered, part, grid)
        return Task("split", part, SPLIT.version, sizes, work, needs=(("decompose", part),))

    each = range(len(spans))
    if not pulses:
        return Tasks.of("decompose", each, echoes) + Tasks.of("split", each, split)
    pulse = Tasks.held([_pulse_task(config, strip, pulses, len(spans))])
    return (
        Tasks.of("read", each, read) + pulse + Tasks.of("decompose", each, decompose) + Tasks.of("split", each, split)
    )


def _pulse_task(config: Config, strip: Strip, pulses: int, spans: int) -> Task:
    parts, cell = tuple(chunk_name(strip.number, k) for k in range(spans)), config.decompose.envelope_cell
    return Task(
        "pulse",
        f"{strip.number:05d}",
        PULSE.version,
        {**plain(config.pulse), "cell": cell},
        partial(sources.measured_pulse, strip.number, pulses, parts, config.pulse, cell),
        needs=tuple(("read", p) for p in parts),
    )


def cloud_tasks(config: Config, files: Iterable[tuple[Location, FileDigests, int]]) -> Tasks:
    """Splits of the reference files, `CLOUD_ROWS` points at a time."""
    grid, sizes, listed = TileGrid(config.tile.size), plain(config.tile), list(files)
    numbered = numbers(path.name for path, _, _ in listed)
    pieces = [
        (path, digests, k, first, min(points, first + sources.CLOUD_ROWS))
        for path, digests, points in listed
        for k, first in enumerate(range(0, points, sources.CLOUD_ROWS))
    ]

    def made(piece: tuple[Location, FileDigests, int, int, int]) -> Task:
        path, digests, k, first, last = piece
        work = partial(sources.scattered_cloud, path, first, last, grid)
        part = chunk_name(numbered[path.name], k)
        return Task("reference-split", part, SPLIT.version, {**sizes, "rows": [first, last]}, work, external=digests)

    return Tasks.of("reference-split", pieces, made)


def polygon_tasks(config: Config, survey: Survey) -> list[Task]:
    """One part for every file of reference polygons: corners in the survey's system, with codes."""
    asked, made = config.survey.reference, []
    params = {
        "field": asked.field,
        "values": {str(k): v for k, v in asked.values.items()},
        "crs": survey.crs,
        "classes": [[c.name, c.code, list(c.codes)] for c in config.classes],
    }
    for number, file in enumerate(survey.polygons):
        work = partial(of_reference.polygons_read, file, asked.field or "", asked.values, config.classes, survey.crs)
        own = {**params, "layer": file.layer, "from": file.crs}
        made.append(Task("polygons", f"{number:03d}", 1, own, work, external=file.digests))
    return made


def _fragments(splits: Mapping[Name, Receipt], stage: str) -> dict[str, list[tuple[str, int]]]:
    """For every tile the (chunk, row group) pairs that hold its rows, in chunk order."""
    found: dict[str, list[tuple[str, int]]] = {}
    for name in sorted(splits):
        if name[0] == stage:
            for key, (group, _) in splits[name].meta["tiles"].items():
                found.setdefault(key, []).append((name[1], group))
    return found


def tile_tasks(config: Config, splits: Mapping[Name, Receipt]) -> Tasks:
    """Tiles of echoes and of reference points."""
    sizes = plain(config.tile)
    blocks = tuple(sorted({float(config.ground.block), float(config.terrain.block)}))
    of_echoes, of_points = _fragments(splits, "split"), _fragments(splits, "reference-split")

    def tile(key: str) -> Task:
        pairs = of_echoes[key]
        return Task(
            "tile",
            key,
            TILE.version,
            {**sizes, "blocks": list(blocks)},
            partial(sources.tiled, key, tuple(pairs), blocks),
            needs=tuple(("split", p) for p, _ in pairs),
            within=key,
        )

    def reference(key: str) -> Task:
        pairs = of_points[key]
        return Task(
            "reference",
            key,
            REFERENCE.version,
            sizes,
            partial(sources.tiled_cloud, tuple(pairs)),
            needs=tuple(("reference-split", p) for p, _ in pairs),
            within=key,
        )

    return Tasks.of("tile", sorted(of_echoes), tile) + Tasks.of("reference", sorted(of_points), reference)


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
            held.setdefault(strip, set()).update(splits[task.name].meta["tiles"] if task.name in splits else ())
    return {s: tuple(p) for s, p in parts.items()}, {s: tuple(sorted(t)) for s, t in held.items()}
