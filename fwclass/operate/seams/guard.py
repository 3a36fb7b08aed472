"""What must hold of a run before, and after, it is compared with: finished, and nobody writing to it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from fwclass.errors import StoreError, first_few
from fwclass.grid import Box, Tile, TileGrid
from fwclass.operate.status.walk import StatusWalk
from fwclass.store.run_location import RunLocation, address_of, held_by, open_store
from fwclass.survey.layout import Layout


def check_idle(location: RunLocation) -> None:
    """`StoreError` while a run writes to `location`; its lock is not taken."""
    where, writer = address_of(location), held_by(location)
    if isinstance(where, Path) and not (where / "store").is_dir():
        raise StoreError("this is no run directory", where=where, expected="a directory with `store`", do="name a run")
    if writer is not None:
        raise StoreError(
            "a run is writing to this directory",
            where=where,
            got=f"pid {writer.get('pid')} on {writer.get('host')}",
            do="wait for it to end",
        )


def check_done(look: StatusWalk, tiles: Iterable[str], stages: Sequence[str]) -> None:
    """`StoreError` if a stage of one of `tiles` is not done from the inputs and parameters as they are now."""
    here = [(s, t) for t in sorted(tiles) for s in stages if (s, t) in look.states]
    late = [n for n in here if look.states[n].standing != "done"]
    if late or not here:
        raise StoreError(
            "the run is not finished: nothing can be compared with what it would make now",
            where=look.store.where,
            got=first_few([f"{'/'.join(n)} {look.states[n].standing}" for n in late], 3),
            do="finish it first; `fwclass status` tells what is missing or stale, and why",
        )


def whole_blocks(
    stage: str, blocks: list[Tile], layout: Layout, look: StatusWalk, reads: Callable[[Tile], Box]
) -> list[Tile]:
    """Blocks that are done, as are flags and heights of all tiles that they are made from: all blocks of a whole run,
    those in the middle of one that was restricted to some tiles. `reads` tells where a block reads; `stage` empty: only
    the tiles count."""
    whole, keys, grid = [], layout.keys, TileGrid(layout.config.tile.size)
    for block in blocks:
        near = [t.key for t in grid.touching(reads(block)) if t.key in keys]
        names = [(s, t) for t in near for s in ("ground", "height")] + ([(stage, block.key)] if stage else [])
        if near and all(n in look.states and look.states[n].standing == "done" for n in names):
            whole.append(block)
    return whole


def check_unchanged(look: StatusWalk, tiles: Iterable[str], stages: Sequence[str]) -> None:
    """`StoreError` if a part that was compared with has been made anew meanwhile."""
    check_idle(look.location)
    now = open_store(look.location, read_only=True)
    parts = sorted(tiles)
    now.look_up((stage, part) for part in parts for stage in stages)
    for part in parts:
        for stage in stages:
            before = look.store.receipt(stage, part)
            if before is not None and now.receipt(stage, part) != before:
                raise StoreError(
                    "the run was changed while it was compared",
                    where=f"{stage}/{part} in {now.where}",
                    do="run it again",
                )
