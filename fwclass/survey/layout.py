"""What stages are planned by: the source strips, the tiles there are, and where their columns come from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from functools import cached_property

from fwclass.conf import Config
from fwclass.errors import InputError
from fwclass.features.names import is_feature
from fwclass.features.stage import FEATURE_COMPUTATION
from fwclass.grid import Box, Tile, TileGrid
from fwclass.read.quantities import Quantities
from fwclass.run.part import Name
from fwclass.store.external_file import ExternalFile
from fwclass.store.receipts import Receipt
from fwclass.store.remote_file import Location

FileDigests = tuple[ExternalFile, ...]
"""The files of one source, with the digests of their bytes."""


@dataclass(frozen=True)
class Strip:
    """A source file with its number in the survey, which follows from its name (`numbering`)."""

    number: int
    path: Location
    digests: FileDigests
    point_format: int

    @property
    def key(self) -> str:
        """The strip's number as part of the names of its parts."""
        return f"{self.number:05d}"


@dataclass(frozen=True)
class PolygonFile:
    """Polygons, breaklines or check points; `crs`: of the file's coordinates (WKT; None: the survey's)."""

    path: Location
    digests: FileDigests
    layer: str
    crs: str | None


@dataclass(frozen=True)
class Survey:
    """Files that can be used, checked.

    `strips` by name; `reference` is (file, digests, points); `crs` is WKT or None;
    `standard_time`: all GPS times are adjusted standard time; `trajectory` is (file, digests); `polygons` are the
    reference's files of polygons; `quantities`: what amplitudes and widths are, by name of the file; `echo_labels`:
    the reference's labels by echo; `corrections`: what corrects labels of any kind, `water`: what is
    flattened, `breaklines`: what the terrain passes through, `check_points`: what heights are held against, `area`:
    what was to be flown, all None for nothing; `overruled`: by name of the file the system (WKT) that it names where
    the user names another; `weekly`: names of the files whose header calls their GPS times seconds of the week;
    `excluded`: names of the files that ``survey.exclude`` leaves out; `heightless`: of those that say nothing of
    heights, where the others do; `stated`: by name of the file the least and greatest x, y, z of its header [m].
    """

    strips: tuple[Strip, ...]
    reference: tuple[tuple[Location, FileDigests, int], ...]
    crs: str | None
    standard_time: bool
    trajectory: tuple[tuple[Location, FileDigests], ...] = ()
    polygons: tuple[PolygonFile, ...] = ()
    quantities: Mapping[str, Quantities] = field(default_factory=dict)
    echo_labels: tuple[tuple[Location, FileDigests], ...] = ()
    corrections: tuple[Location, FileDigests] | None = None
    water: PolygonFile | None = None
    breaklines: PolygonFile | None = None
    check_points: PolygonFile | None = None
    area: PolygonFile | None = None
    overruled: Mapping[str, str] = field(default_factory=dict)
    weekly: tuple[str, ...] = ()
    excluded: tuple[str, ...] = ()
    heightless: tuple[str, ...] = ()
    stated: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Layout:
    """The tiles of a survey: where and when their echoes lie, and which of them have reference points.

    `occupied` has for every size of block [m] those that own an echo; `times` is (first, last) GPS time [s], NaN
    without any; `passes` the same of every tile, for each strip that has times there; `lowest` the least z [m];
    `polygons` are parts of the reference that are no tiles; `quantities`: what amplitudes and widths are; `providers`:
    the stage that writes each column; `echo_labels`: by tile the parts that hold labels by echo; `corrected`: the tiles
    whose echoes may be corrected, `near_corrected`: those where a correction keeps echoes from being tested.
    """

    config: Config
    tiles: tuple[Tile, ...]
    occupied: Mapping[float, frozenset[str]]
    clouds: frozenset[str]
    box: Box
    times: tuple[float, float]
    passes: Mapping[str, tuple[tuple[float, float], ...]]
    lowest: float
    echoes: int
    polygons: tuple[str, ...] = ()
    quantities: Quantities | None = None
    providers: Mapping[str, str] = field(default_factory=dict)
    echo_labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    corrected: frozenset[str] = frozenset()
    near_corrected: frozenset[str] = frozenset()

    @classmethod
    def of(cls, config: Config, receipts: Mapping[Name, Receipt]) -> Layout:
        """The layout by the receipts of the tiles that are done; `InputError` where there is none."""
        grid = TileGrid(config.tile.size)
        mine = [part for stage, part in receipts if stage == "tile"]
        if not mine:
            raise InputError(
                "there is no echo to classify",
                where=config.path,
                expected="source files with points",
                got="no tile with an echo",
                do="look at the files with `fwclass info`, and at the failed parts above",
            )
        occupied: dict[float, set[str]] = {}
        passes, bounds, rows = {}, [], 0
        for key in mine:  # one receipt at a time: a large survey has many
            meta = receipts["tile", key].meta
            for size, blocks in meta["blocks"].items():
                occupied.setdefault(float(size), set()).update(blocks)
            passes[key] = tuple((a, b) for _, a, b in meta["times"])
            bounds.append(meta["bounds"])
            rows += meta["rows"]
        times = [one for some in passes.values() for one in some]
        low = [min(b[k] for b in bounds) for k in range(3)]
        high = [max(b[k] for b in bounds) for k in range(3, 5)]
        return cls(
            config,
            tuple(sorted(grid.tile(k) for k in mine)),
            {size: frozenset(blocks) for size, blocks in occupied.items()},
            frozenset(part for stage, part in receipts if stage == "reference"),
            Box(low[0], low[1], high[0] + 0.001, high[1] + 0.001),
            (min((t[0] for t in times), default=math.nan), max((t[1] for t in times), default=math.nan)),
            passes,
            low[2],
            rows,
            tuple(sorted(part for stage, part in receipts if stage == "polygons")),
        )

    @cached_property
    def keys(self) -> frozenset[str]:
        """The keys of all tiles."""
        return frozenset(t.key for t in self.tiles)

    def around(self, box: Box, among: AbstractSet[str]) -> tuple[str, ...]:
        """Tiles of `among` that touch `box`."""
        return tuple(key for key in TileGrid(self.config.tile.size).keys_touching(box) if key in among)

    def blocks(self, size: float, margin: int = 0) -> tuple[Tile, ...]:
        """Blocks of edge `size` [m] that own an echo, and `margin` blocks around them: the same set whatever the
        tiles."""
        grid, blocks = TileGrid(size), set()
        for key in self.occupied[size]:
            tile = grid.tile(key)
            span = range(-margin, margin + 1)
            blocks |= {Tile(tile.ix + a, tile.iy + b, size) for a in span for b in span}
        return tuple(sorted(blocks))

    def columns(self, names: Iterable[str]) -> dict[str, str]:
        """The stage whose tables hold each of `names`."""
        return {n: self.providers[n] if n in self.providers else _of_features(n) for n in names}


def _of_features(name: str) -> str:
    """A feature of a neighbourhood that nobody asked for yet has the stage of those that are."""
    if not is_feature(name):
        raise KeyError(f"no stage writes {name!r}")
    return FEATURE_COMPUTATION.name
