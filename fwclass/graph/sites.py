"""Surveys whose echoes lie in few places far apart: rasters of each place, not of the empty land between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fwclass.errors import first_few
from fwclass.graph.ground import terrain_blocks
from fwclass.grid import Box, Tile, TileGrid, groups, joint_box
from fwclass.pieces import linked_groups
from fwclass.survey.layout import Layout, Strip

WHOLE = "all"
"""Name of the one site of a survey that hangs together."""

FEW_CELLS = 1 << 25
"""A raster of so many cells, 5.8 km square at 1 m, is made as one, whatever it holds: it is finished in seconds."""

EMPTY = 16
"""A larger one is made as one while its blocks with echoes fill more than one part in so many of it."""

NAMED = 3
"""Sites, and files of each, that are named."""


@dataclass(frozen=True)
class Site:
    """Blocks that hang together and the rasters that they make.

    `name`: `WHOLE`, or the key of the first tile. `box`: of its tiles, within the survey's [m]. `blocks`: terrain
    blocks that touch it; `tiles`: that own an echo.
    """

    name: str
    box: Box
    blocks: tuple[Tile, ...]
    tiles: tuple[Tile, ...]


def in_sites(box: Box, cell: float, with_echoes: float, tile: int) -> bool:
    """Rasters of a survey's `box` [m], so many of whose cells of `cell` [m] lie in blocks with echoes, are made site by
    site. What counts is their whole tiles of `tile` x `tile` cells: a point far away makes a thin raster of very many.
    """
    edges = box.xmax - box.xmin, box.ymax - box.ymin
    across, up = (max(1.0, float(np.ceil(edge / (cell * tile)))) for edge in edges)
    return across * up * tile * tile > max(FEW_CELLS, EMPTY * with_echoes)


def sites(layout: Layout) -> tuple[Site, ...]:
    """One for the whole survey, unless most of its rasters would be empty."""
    config, blocks = layout.config, terrain_blocks(layout)
    edge, cell = config.terrain.block, min(config.terrain.cell, config.publish.class_cell)
    owned = len(layout.occupied[edge]) * (edge / cell) ** 2
    whole = Site(WHOLE, layout.box, blocks, layout.tiles)
    if not in_sites(layout.box, cell, owned, config.publish.cog_block):
        return (whole,)
    parts = groups(blocks)
    part_of = {b.key: k for k, part in enumerate(parts) for b in part}
    touched = [[part_of[k] for k in TileGrid(edge).keys_touching(tile.box) if k in part_of] for tile in layout.tiles]
    count, site_of = _joined(len(parts), touched)
    if count == 1:
        return (whole,)
    tiles: list[list[Tile]] = [[] for _ in range(count)]
    for tile, near in zip(layout.tiles, touched, strict=True):
        tiles[site_of[near[0]]].append(tile)
    together: list[list[Tile]] = [[] for _ in range(count)]
    for k, part in enumerate(parts):
        together[site_of[k]] += part
    groups_of_tiles = []
    for mine, joined in zip(tiles, together, strict=True):
        box = joint_box(t.box for t in mine).common(layout.box) or layout.box
        touching = tuple(b for b in sorted(joined) if b.box.touches(box))
        groups_of_tiles.append(Site(mine[0].key, box, touching, tuple(mine)))
    return tuple(groups_of_tiles)


def _joined(count: int, touched: Sequence[Sequence[int]]) -> tuple[int, list[int]]:
    """How many sites `count` parts are, and the site of each: a tile larger than a block may touch several parts, which
    it joins."""
    ends = [(near[0], k) for near in touched for k in near]
    if all(a == b for a, b in ends):
        return count, list(range(count))
    a, b = np.array(ends).T
    site_of = linked_groups(count, a, b)
    return int(site_of.max()) + 1, site_of.tolist()


def describe_sites(several: Sequence[Site], strips: Sequence[Strip], in_strip: Mapping[int, tuple[str, ...]]) -> str:
    """What a user should know of a survey of several sites; nothing of one. The smallest sites, which stray points
    make, are named with their files."""
    if len(several) == 1:
        return ""
    lines = [
        f"note: the echoes lie in {len(several)} places far apart; each gets rasters of its own, rasters/TILE/dtm.tif "
        "and so on, TILE being its first tile. Stray points make such places: `fwclass info` tells a file's extent"
    ]
    for site in sorted(several, key=lambda s: (len(s.tiles), s.name))[:NAMED]:
        keys = {t.key for t in site.tiles}
        files = [s.path.name for s in strips if not keys.isdisjoint(in_strip.get(s.number, ()))]
        x0, y0, x1, y1 = site.box.bounds
        lines.append(
            f"  rasters/{site.name}: {len(keys):,} tile{'s' if len(keys) > 1 else ''}, x {x0:.2f} to {x1:.2f}, "
            f"y {y0:.2f} to {y1:.2f}, echoes of {first_few(files, NAMED)}"
        )
    return "\n".join(lines)
