"""Strips of a survey held against each other: which there are, how far they lie apart, and what would explain it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import first_few, refuse_unsound
from fwclass.hashing import hash_keys
from fwclass.pieces import linked_groups
from fwclass.quality.adjust import Adjusted, Pairs, adjust
from fwclass.quality.offsets import Offsets, SlopePairs
from fwclass.quality.params import PlaneParams
from fwclass.quality.pieces import Pieces, PlacedStrip, lines
from fwclass.quality.planes import PlanePairs
from fwclass.units import finite_or_none

NAMED = 5
"""Strips that are named."""

By = Literal["files", "times"]

ASTRAY = (20, 0.5)
"""Places, and their share of all, that two strips see further apart than `max_step`, from which a strip is wrong: that
one sees a flat roof where the other sees flat ground is the exception."""


STEPPED = (5, 0.75)
"""Places on both sides of the border of two files, and the share of them that is further apart than `max_step` the same
way, from which the files have other heights: a wall or a bank that follows the whole border is the exception. Of six
borders of public tiles none has a median above 0.26 m."""


LIFTED = (20, 0.75, 5.0)
"""Cells that two strips see, and the share of them where one's lowest echo is so far [m] above the other's, from which
one has heights of another unit or zero: where crowns let nothing through, both see their tops, and neither all the
higher. Nothing flat is needed: in feet even roofs are rougher than `max_residual`."""


ASIDE = (1.0, 5.0)
"""m that two strips lie apart in plan, and standard errors, from which one of them lies elsewhere: 0.02 to 0.13 m
between 16 pairs of lines of four public surveys."""

TOLD = 0.3
"""m from which it is told: some pulses' footprints."""


def strips_by(wanted: str, between_files: int, between_lines: int) -> By:
    """What strips are told by: as `wanted`, or where that is auto by files, unless pairs of planes between lines inside
    one file outnumber those between files."""
    if wanted == "auto":
        return "times" if between_lines > between_files else "files"
    return "times" if wanted == "times" else "files"


def numbers_of(pieces: Sequence[Pieces], by: By) -> list[NDArray[np.int64]]:
    """int64 (pieces,) for each of the blocks: the number of the strip of every piece."""
    file, span = (np.concatenate([np.empty(0, np.int64), *(getattr(p, n) for p in pieces)]) for n in ("file", "span"))
    number = lines(file, span) if by == "times" else np.unique(file, return_inverse=True)[1].astype(np.int64)
    return np.split(number, np.cumsum([len(p.file) for p in pieces])[:-1])


def of_strips(
    pairs: PlanePairs, number: NDArray[np.int64], max_step: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Strips of the first and second plane of every pair; whether it is of two strips and one surface, and whether it
    is of two strips further apart than `max_step` [m]."""
    first, second = number[pairs.first], number[pairs.second]
    differs, near = first != second, np.abs(pairs.dz) <= max_step
    return first, second, differs & near, differs & ~near


def largest_differences(
    pairs: PlanePairs, number: NDArray[np.int64], max_step: float, shape: tuple[int, int]
) -> NDArray[np.float32]:
    """The largest difference of two strips in every cell [m], float32 of `shape`; NaN where no two are compared."""
    good = of_strips(pairs, number, max_step)[2]
    out = np.full(shape, -np.inf, np.float32)
    np.maximum.at(out, (pairs.row[good], pairs.col[good]), np.abs(pairs.dz[good]).astype(np.float32))
    return np.where(np.isfinite(out), out, np.float32(np.nan))


class Comparison:
    """Pairs of planes of all strips, added up block by block, and a sample of them that is adjusted.

    Parameters
    ----------
    total : pairs that there are, of which about `params.most` are adjusted.
    """

    def __init__(self, params: PlaneParams, total: int) -> None:
        self.params, self.share = params, min(1.0, params.most / max(total, 1))
        self.apart = 0
        self._offsets = Offsets()
        self._sums: dict[tuple[int, int], NDArray[np.float64]] = {}
        self._sample: list[Pairs] = []

    def add(self, pairs: PlanePairs, slopes: SlopePairs, number: NDArray[np.int64], corner: tuple[int, int]) -> None:
        """Take in a block: `number` the strip of each of its pieces, int64 (pieces,), `corner` column and row of its
        first cell."""
        self._offsets.add(slopes, number)
        first, second, good, apart = of_strips(pairs, number, self.params.max_step)
        self.apart += int(apart.sum())
        first, second, dz, weight = first[good], second[good], pairs.dz[good], pairs.weight[good]
        swap = first > second
        first, second, dz = np.where(swap, second, first), np.where(swap, first, second), np.where(swap, -dz, dz)
        col, row = (pairs.col[good] + np.int64(corner[0])), (pairs.row[good] + np.int64(corner[1]))
        both, at = np.unique(np.stack([first, second], axis=1), axis=0, return_inverse=True)
        values = np.stack([np.bincount(at.reshape(-1), v, minlength=len(both)) for v in (np.ones(len(dz)), dz, dz**2)])
        for (a, b), one in zip(both.tolist(), values.T, strict=True):
            self._sums[a, b] = self._sums.get((a, b), np.zeros(3)) + one
        sampled = _draw(col, row, self.share)
        x, y = ((v[sampled].astype(np.float64) + 0.5) * self.params.cell for v in (col, row))
        self._sample.append(Pairs(first[sampled], second[sampled], x, y, dz[sampled], weight[sampled]))

    def facts(self, strips: Sequence[PlacedStrip], files: Mapping[int, str], by: By) -> dict[str, Any]:
        """What `report.json` tells of the strips (docs/quality.md); `files`: names of the source files by number."""
        sample = Pairs(*(np.concatenate([getattr(s, n) for s in self._sample]) for n in Pairs.__dataclass_fields__))
        adjustment = adjust(strips, sample, self.params.max_tilt_error)
        n, _, square = np.sum(list(self._sums.values()), axis=0) if self._sums else np.zeros(3)
        group = linked_groups(len(strips), *(np.array([k[i] for k in self._sums], np.int64) for i in (0, 1)))
        return {
            "by": by,
            "pairs": int(n),
            "adjusted": len(sample.dz),
            "apart": self.apart,
            "rms": math.sqrt(square / n) if n else None,
            "left": finite_or_none(adjustment.left),
            "sigma": finite_or_none(adjustment.sigma),
            "strips": [_strip(k, s, files, by, adjustment, int(group[k])) for k, s in enumerate(strips)],
            "between": [
                {
                    "first": a,
                    "second": b,
                    "pairs": int(c),
                    "mean": float(m / c),
                    "rms": math.sqrt(q / c),
                    "offset": self._offsets.facts(a, b, float(m / c), int(c)),
                }
                for (a, b), (c, m, q) in sorted(self._sums.items())
            ],
        }


def stepped_borders(
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    step: NDArray[np.float64],
    files: Mapping[int, str],
    max_step: float,
) -> dict[str, Any]:
    """Steps between files that lie beside each other, (steps,) each as `planes.border_steps` gives them: how many
    ``places`` were compared at how many ``borders``, and the borders that are ``stepped``, as `STEPPED` has it, with
    the median ``step`` [m]; `files`: names by number."""
    pairs, at = np.unique(np.stack([first, second], axis=1), axis=0, return_inverse=True)
    order = np.argsort(at.reshape(-1), kind="stable")
    parts = (
        np.split(step[order], np.cumsum(np.bincount(at.reshape(-1), minlength=len(pairs)))[:-1]) if len(pairs) else []
    )
    stepped = []
    for (a, b), values in zip(pairs.tolist(), parts, strict=True):
        share = max((values > max_step).mean(), (values < -max_step).mean())
        if len(values) >= STEPPED[0] and share >= STEPPED[1]:
            names = files.get(a, str(a)), files.get(b, str(b))
            stepped.append(
                {"first": names[0], "second": names[1], "places": len(values), "step": float(np.median(values))}
            )
    return {"places": len(step), "borders": len(pairs), "stepped": stepped}


def lifted_strips(
    lows: Sequence[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]],
    numbers: Sequence[NDArray[np.int64]],
) -> list[dict[str, Any]]:
    """Strips all of which lies above another, as `LIFTED` has it: the `first` and the ``second``, by the strip's number
    of every block's pieces (`numbers`), the ``places`` that both see and the median ``step`` [m].

    `lows`: of every block as `planes.low_steps` gives them.
    """
    first, second = (np.concatenate([n[block[k]] for n, block in zip(numbers, lows, strict=True)]) for k in range(2))
    step = np.concatenate([block[2] for block in lows])
    step = np.where(first > second, -step, step)
    both = np.minimum(first, second) << 32 | np.maximum(first, second)
    order = np.argsort(both, kind="stable")
    order = order[(first != second)[order]]
    keys, begin = np.unique(both[order], return_index=True)
    lifted = []
    for key, values in zip(keys.tolist(), np.split(step[order], begin[1:]), strict=bool(len(keys))):
        share = max((values > LIFTED[2]).mean(), (values < -LIFTED[2]).mean())
        if len(values) >= LIFTED[0] and share >= LIFTED[1]:
            a, b = key >> 32, key & 0xFFFFFFFF
            lifted.append({"first": a, "second": b, "places": len(values), "step": float(np.median(values))})
    return lifted


def _draw(col: NDArray[np.int64], row: NDArray[np.int64], share: float) -> NDArray[np.bool_]:
    """About `share` of the cells, by their place, the same whatever the blocks and their order."""
    if share >= 1:
        return np.ones(len(col), bool)
    cell = (col.astype(np.uint64) << np.uint64(32)) ^ (row.astype(np.uint64) & np.uint64(0xFFFFFFFF))
    return np.asarray((hash_keys(0, cell) >> np.uint64(11)) < np.uint64(share * 2**53))


def _strip(
    number: int, strip: PlacedStrip, files: Mapping[int, str], by: By, adjustment: Adjusted, group: int
) -> dict[str, Any]:
    names = sorted(files.get(f, str(f)) for f in strip.files)
    facts = {
        "name": names[0] if by == "files" else f"line {number + 1}",
        "files": names,
        "echoes": strip.echoes,
        "times": list(strip.times) if strip.times else None,
        "azimuth": strip.azimuth,
        "timed": strip.timed,
        "centre": list(strip.centre),
        "width": 2 * strip.half[0],
        "length": 2 * strip.half[1],
        "pairs": int(adjustment.pairs[number]),
        "group": group,
    }
    for k, name in enumerate(("height", "roll", "pitch")):
        facts[name], facts[f"{name}_error"] = (
            finite_or_none(v[number, k]) for v in (adjustment.values, adjustment.errors)
        )
    return facts


def unsound_strips(facts: Mapping[str, Any]) -> list[str]:
    """What no sound survey shows: strips that see one place at other heights, files that meet at a step."""
    apart, every = facts["apart"], facts["apart"] + facts["pairs"]
    out = []
    if apart >= ASTRAY[0] and apart > ASTRAY[1] * every:
        out.append(
            f"{apart:,} of {every:,} places where two strips see something flat are further apart than one surface can "
            "be (quality.planes.max_step): beams, times, units or the trajectory of a strip are wrong, or the area is "
            "all roofs and walls"
        )
    lifted = facts.get("lifted", ())
    if lifted and not out:
        worst = max(lifted, key=lambda s: abs(s["step"]))
        out.append(
            f"the lowest echoes of two {'files' if worst['by'] == 'files' else 'flight lines'} lie "
            f"{abs(worst['step']):.1f} m apart (median of {worst['places']:,} places that both see): heights of one of "
            "them are in another unit or from another zero"
        )
    aside = farthest_pair(facts)
    if aside is not None and aside["offset"]["distance"] >= max(ASIDE[0], ASIDE[1] * aside["offset"]["error"]):
        out.append(_in_plan(facts, aside))
    stepped = facts.get("borders", {}).get("stepped", ())
    if stepped:
        worst = max(stepped, key=lambda s: abs(s["step"]))
        out.append(
            f"{len(stepped)} of {facts['borders']['borders']} borders between files are a step along all their length, "
            f"the highest of {abs(worst['step']):.2f} m between {worst['first']} and {worst['second']} (median of "
            f"{worst['places']} places): heights of one of them are in another unit or from another zero (the "
            "ellipsoid, another geoid)"
        )
    return out


def farthest_pair(facts: Mapping[str, Any]) -> dict[str, Any] | None:
    """Of ``between`` the strips that lie furthest apart in plan; None where no slopes tell."""
    known = [b for b in facts["between"] if b.get("offset")]
    return max(known, key=lambda b: b["offset"]["distance"], default=None)


def offset_remarks(facts: Mapping[str, Any]) -> list[str]:
    """The strips that lie furthest apart in plan, from `TOLD` on."""
    aside = farthest_pair(facts)
    return [_in_plan(facts, aside)] if aside is not None and aside["offset"]["distance"] >= TOLD else []


def _in_plan(facts: Mapping[str, Any], pair: Mapping[str, Any]) -> str:
    names, offset = [s["name"] for s in facts["strips"]], pair["offset"]
    ways = [
        f"{abs(offset[axis]):.2f} m {axis if offset[axis] > 0 else other}"
        for axis, other in (("east", "west"), ("north", "south"))
        if abs(offset[axis]) >= 0.005
    ]
    return (
        f"{names[pair['first']]} lies {' and '.join(ways)} of {names[pair['second']]} (standard error "
        f"{offset['error']:.3f} m, by {offset['slopes']:,} roofs and slopes that both see): one of them is in another "
        "datum, or its trajectory or mounting is wrong"
    )


def judge_strips(facts: Mapping[str, Any], accepted: bool, where: object) -> None:
    """`QualityError` where strips or files do not lie at one height (`unsound_strips`); nothing where the user accepts
    it."""
    refuse_unsound(
        unsound_strips(facts),
        accepted,
        "the survey's strips or files do not fit together",
        where,
        expected="one surface where two strips see it, and from one file to the next",
        do="look at quality.html (`fwclass run --workflow quality`), which tells where, and at the files' coordinate "
        "systems (`fwclass info`)",
    )


def strip_remarks(facts: Mapping[str, Any]) -> list[str]:
    """What the differences of strips cannot tell, in words."""
    strips = facts["strips"]
    if len(strips) < 2:
        how = (
            "quality.strips=times tells lines inside one file apart by their GPS time"
            if facts["by"] == "files"
            else "a pause of less than quality.line_gap joins lines"
        )
        return [f"there is one strip: nothing tells how well strips agree ({how})"]
    if unsound := unsound_strips(facts):
        return unsound
    if not facts["pairs"]:
        return [
            f"no two of the {len(strips)} strips see one flat surface: nothing tells how well they agree "
            "(quality.planes says what counts as one; a larger cell takes more echoes together)"
        ]
    out = []
    if any(s["times"] is None for s in strips):
        out.append("some echoes have no GPS time: of their strips roll and pitch have no sign that the flight gives")
    out += offset_remarks(facts)
    alone = [s["name"] for s in strips if not s["pairs"]]
    if alone:
        have = "has" if len(alone) == 1 else "have"
        out.append(
            f"{len(alone)} of {len(strips)} strips {have} no flat surface in common with another, and no figures: "
            f"{first_few(alone, NAMED)}"
        )
    groups = len({s["group"] for s in strips if s["pairs"]})
    if groups > 1:
        out.append(f"the strips hang together in {groups} groups: heights tell nothing from one group to another")
    return out
