"""What the shifted grid changed: as a table, as plain data, as polygons."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import QualityError
from fwclass.formats.gdal import write_shapes
from fwclass.formats.wkb import box_wkb, point_wkb
from fwclass.grid import Box
from fwclass.operate.seams.differ import Seam
from fwclass.operate.seams.measure import BlockShiftEffect
from fwclass.operate.seams.shifted_squares import ShiftedSquare
from fwclass.publish.files import written_whole
from fwclass.store.url import Url

NAMED = 5
"""Columns that are named of those that differ."""


@dataclass(frozen=True)
class SeamResult:
    """Attributes
    ----------
    shift, width : of the tiles, and how near to a border is near [m].
    borders : length of all borders between tiles [m].
    squares : what was computed once more.
    bounded : stages that no grid may change; `moved` : those that other blocks may.
    other : edge of the tiles that blocks were read from [m].
    crs : WKT of the survey, or None.
    """

    where: Path | Url
    shift: tuple[float, float]
    width: float
    borders: float
    squares: tuple[ShiftedSquare, ...]
    bounded: tuple[Seam, ...]
    moved: tuple[BlockShiftEffect, ...]
    other: float
    crs: str | None = None

    @property
    def length(self) -> float:
        """Of the borders that were computed along [m]."""
        return sum(p.length for p in self.squares)

    @property
    def equal(self) -> bool:
        """No bounded stage differs."""
        return not any(s.differ for s in self.bounded)

    def judge(self) -> None:
        """`QualityError` where a bounded stage differs."""
        wrong = [s for s in self.bounded if s.differ]
        if wrong:
            raise QualityError(
                "the way the survey was cut into tiles shows in the results",
                where=self.where,
                expected="no difference under a shifted grid",
                got=", ".join(f"{s.stage}: {s.differ:,} of {s.rows:,} {s.units}" for s in wrong),
                do="`fwclass seams --json` names them; the store is damaged (remove STAGE/PART from its store and run "
                "again), or a stage reads further than the halo that it declares: report it",
            )


def as_data(result: SeamResult, seconds: float) -> dict[str, Any]:
    """Plain data; lengths in metres, shares as fractions."""
    return {
        "run": str(result.where),
        "equal": result.equal,
        "shift": list(result.shift),
        "width": result.width,
        "borders": {"all": result.borders, "computed": result.length, "share": result.length / result.borders},
        "other_tile": result.other,
        "seconds": round(seconds, 3),
        "bounded": [s.as_json() for s in result.bounded],
        "unbounded": [a.as_json() for a in result.moved],
        "strips": [
            {"part": p.tile.key, "length": p.length, "boxes": [list(b.bounds) for b in p.bands]} for p in result.squares
        ],
    }


def as_text(result: SeamResult, seconds: float) -> str:
    """A table by stage."""
    rows = [
        f"{result.where}: {result.length:,.0f} of {result.borders:,.0f} m of tile borders, {result.width:g} m to "
        f"either side, in tiles shifted by {result.shift[0]:g}, {result.shift[1]:g} m; blocks from tiles of "
        f"{result.other:g} m",
        "",
        f"{'stage':<12}{'columns':>8}{'compared':>20}{'differ':>10}{'share':>11}  worst",
    ]
    for s in result.bounded:
        share = f"{100 * s.differ / max(s.rows, 1):.4f} %"
        rows.append(
            f"{s.stage:<12}{len(s.columns):>8}{f'{s.rows:,} {s.units}':>20}{s.differ:>10,}{share:>11}{_worst(s)}"
        )
    rows += [
        "",
        _verdict(result),
        "",
        "blocks moved by half their size (their support has no bound; tiles do not enter):",
    ]
    rows += [_apart(a) for a in result.moved]
    return "\n".join([*rows, f"took {seconds:.1f} s"])


def _worst(seam: Seam) -> str:
    wrong = {n: c for n, c in seam.columns.items() if c.differ}
    some = sorted(wrong, key=lambda n: (-wrong[n].differ, n))[:NAMED]
    columns = [f"{n} {wrong[n].differ:,}" + ("" if (w := wrong[n].worst) is None else f" (by {w:.3g})") for n in some]
    more = f" and {len(wrong) - NAMED} more" if len(wrong) > NAMED else ""
    at = sorted((p for p, (_, d) in seam.at.items() if d))[:NAMED]
    return f"  {', '.join(columns)}{more}; in {', '.join(at)}" if columns else ""


def _verdict(result: SeamResult) -> str:
    if result.equal:
        return "no value differs: where the borders of tiles lie changes nothing"
    return "values differ: where the borders of tiles lie shows in the results"


def _apart(a: BlockShiftEffect) -> str:
    if not a.blocks:
        return f"{a.stage:<12}one block only: no border"
    what = (
        "another flag"
        if a.p999 is None and a.stage == "ground"
        else f"another height by more than {100 * a.within:g} cm"
    )
    height = "" if a.worst is None else f"; 99.9 % within {a.p999:.3g} m, worst {a.worst:.3g} m"
    return (
        f"{a.stage:<12}{a.off:,} of {a.echoes:,} echoes near block borders have {what} "
        f"({100 * a.off / max(a.echoes, 1):.4f} %){height}"
    )


def write_gpkg(result: SeamResult, path: Path, crs: str | None) -> None:
    """Layers ``strips`` and, where there are any, ``echoes``.

    Strips lie along the borders; ``part`` is the tile of the shifted grid, ``differ`` how many of its echoes do, in the
    stage with most of them. Echoes are those listed: stage, column, the run's value and the other.
    """
    bands: list[Box] = []
    fields: dict[str, list[Any]] = {"part": [], "differ": []}
    tiles = [s for s in result.bounded if s.parts == "tile"]
    for square in result.squares:
        wrong = max((s.at.get(square.tile.key, (0, 0))[1] for s in tiles), default=0)
        for band in square.bands:
            bands.append(band)
            fields["part"].append(square.tile.key)
            fields["differ"].append(wrong)
    listed = [{"stage": s.stage, **e} for s in result.bounded for e in s.examples]
    with written_whole(path) as beside:
        write_shapes(beside, "strips", box_wkb(bands), fields, crs)
        if listed:
            located = point_wkb(*(np.array([e[axis] for e in listed], np.float64) for axis in "xy"))
            names = ("stage", "part", "strip", "pulse", "echo_number", "column")
            columns: dict[str, list[Any]] = {n: [e[n] for e in listed] for n in names}
            columns |= {n: [str(e[n]) for e in listed] for n in ("run", "shifted")}
            write_shapes(beside, "echoes", located, columns, crs, "Point")
