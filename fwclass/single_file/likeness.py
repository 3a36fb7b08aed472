"""Whether two files of points that are compared show the same points: what their places and systems tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.errors import first_few, refuse_unsound
from fwclass.formats.epsg import epsg_of
from fwclass.neighbours import Points

SHIFTED, ALIKE = 0.1, 0.05
"""m: two clouds are shifted against each other by more, if half of their pairs are as far apart, to this."""

ROUNDED = 0.02
"""m, by which coordinates that were rounded to centimetres are apart at most."""

SAID_FROM = 0.01
"""Share of the points from which something is said of them."""

FEW = 0.9
"""Share of a file's points with a partner, below which the file is named."""

NAMED = 3


@dataclass(frozen=True)
class Likeness:
    """What one pair of files shows.

    Attributes
    ----------
    names : of reference and prediction. systems : their coordinate systems (WKT or None).
    points, matched : of the reference, and those with a predicted point; apart : pairs further apart than `ROUNDED`.
    offset : median of prediction less reference (3,) [m] of pairs; alike : share of the pairs that are that far apart.
    ambiguous : predicted points at the place of another of another code.
    same : both are one file.
    """

    names: tuple[str, str]
    systems: tuple[str | None, str | None]
    points: int
    matched: int
    apart: int
    offset: tuple[float, float, float]
    alike: float
    ambiguous: int
    same: bool

    @classmethod
    def of(
        cls,
        names: tuple[str, str],
        systems: tuple[Any, Any],
        clouds: tuple[Points, Points],
        rows: NDArray[np.int64],
        codes: NDArray[np.uint8],
        same: bool,
    ) -> Likeness:
        """`clouds` : reference and prediction; `rows` of the prediction for each of the reference, -1 for none; `codes`
        of the prediction."""
        known = np.flatnonzero(rows >= 0)
        wkt = tuple(None if s is None else s.to_wkt() for s in systems)
        away = np.stack([clouds[1][k][rows[known]] - clouds[0][k][known] for k in range(3)])
        apart = int((np.abs(away) > ROUNDED).any(axis=0).sum())
        middle, alike, ambiguous = np.zeros(3), 0.0, 0
        if apart:
            middle = np.median(away, axis=1)
            alike = float((np.abs(away - middle[:, None]) < ALIKE).all(axis=0).mean())
        if len(codes) != len(rows) or not np.array_equal(rows, np.arange(len(rows))):
            ambiguous = _ambiguous(clouds[1], codes)
        x, y, z = middle.tolist()
        return cls(names, (wkt[0], wkt[1]), len(rows), len(known), apart, (x, y, z), alike, ambiguous, same)

    @property
    def shifted(self) -> bool:
        """Half of the pairs and more are one way apart."""
        return self.alike >= 0.5 and float(np.linalg.norm(self.offset)) > SHIFTED


def _ambiguous(cloud: Points, codes: NDArray[np.uint8]) -> int:
    order = np.lexsort((codes, *cloud))
    same = np.logical_and.reduce([np.diff(a[order]) == 0 for a in cloud])
    return int((same & (np.diff(codes[order].astype(np.int64)) != 0)).sum())


def faults(pairs: Sequence[Likeness]) -> list[str]:
    """What makes figures of these pairs those of nothing, a sentence each; none for sound ones."""
    said = []
    other = [p for p in pairs if all(p.systems) and not _alike(*p.systems)]
    if other:
        one, two = (CRS.from_wkt(str(s)).name for s in other[0].systems)
        said.append(f"reference and prediction are in different systems, {one} and {two} ({_names(other)})")
    shifted = [p for p in pairs if p.shifted]
    if shifted:
        x, y, z = shifted[0].offset
        said.append(
            f"the prediction lies {x:+.2f}, {y:+.2f}, {z:+.2f} m (x, y, z) from the reference, so that points are held "
            f"against their neighbours ({_names(shifted)})"
        )
    ambiguous = [p for p in pairs if p.ambiguous > SAID_FROM * p.points]
    if ambiguous:
        said.append(
            f"{sum(p.ambiguous for p in ambiguous):,} predicted points lie at the place of another that has another "
            f"class, so that their order decides ({_names(ambiguous)})"
        )
    return said


def remarks(pairs: Sequence[Likeness]) -> list[str]:
    """What is to be known beside the figures of sound pairs."""
    said = []
    if same := [p for p in pairs if p.same]:
        said.append(f"a file is compared with itself ({_names(same)})")
    few = [p for p in pairs if p.matched < FEW * p.points]
    if few and len(pairs) > 1:
        each = first_few([f"{p.names[0]}: {p.matched:,} of {p.points:,}" for p in few], NAMED)
        said.append(f"few points of some files have a predicted one ({each})")
    apart, matched = sum(p.apart for p in pairs), sum(p.matched for p in pairs)
    if apart > SAID_FROM * matched and not any(p.shifted for p in pairs):
        said.append(
            f"{100 * apart / matched:.1f} % of the points are held against the nearest predicted one, as there is none "
            "at their place: figures are those of neighbours"
        )
    return said


def judge_likeness(sentences: Sequence[str], accepted: bool, where: object) -> None:
    """`QualityError` of `faults`; nothing where there is none, or the user accepts them."""
    refuse_unsound(
        sentences,
        accepted,
        "the two do not show the same points",
        where,
        expected="the same points, in one coordinate system",
        do="mend it, and compare again",
        accept="--accept-implausible takes the figures as they are",
    )


def _alike(one: str | None, other: str | None) -> bool:
    a, b = (CRS.from_wkt(str(s)) for s in (one, other))
    codes = [epsg_of(c.sub_crs_list[0] if c.is_compound else c) for c in (a, b)]
    return a == b or (codes[0] is not None and codes[0] == codes[1]) or a.to_2d() == b.to_2d()


def _names(pairs: Sequence[Likeness]) -> str:
    return first_few([p.names[1] for p in pairs], NAMED)
