"""Steps in height between files, or flight lines, that see one surface or lie beside each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import first_few, refuse_unsound
from fwclass.quality.planes import PlanePairs
from fwclass.units import SIGMA_PER_MAD

BINS = 1000
"""Classes of steps between -`max_step` and `max_step`, 2 mm each of 1 m."""

TOLD = 0.08
"""m from which a step is told: root mean square difference of overlapping swaths, at most, of quality levels 1 and 2
(USGS Lidar Base Specification 2022, table 2); 0.006 to 0.03 m between lines of public surveys."""

PLACES, SURE = 5, 5.0
"""Places that tell a step at least, and standard errors of their median that it is large by."""

NAMED = 3
"""Steps that are named."""


class HeightSteps:
    """Differences in height of planes of two files (or lines), counted by class, block by block.

    Parameters
    ----------
    max_step : differences up to this are of one surface [m].
    """

    def __init__(self, max_step: float) -> None:
        self._reach = max_step
        self._counts: dict[tuple[int, int], NDArray[np.int64]] = {}

    def add_pairs(self, pairs: PlanePairs, number: NDArray[np.int64]) -> None:
        """Take in the pairs of a block; `number` of the file or line of every piece, int64 (pieces,)."""
        first, second = number[pairs.first].astype(np.int64), number[pairs.second].astype(np.int64)
        self.add(first, second, pairs.dz)

    def add(self, first: NDArray[np.int64], second: NDArray[np.int64], step: NDArray[np.float64]) -> None:
        """Take in how much higher the planes of the `first` lie than those of the `second` [m], (steps,) each."""
        one = (first != second) & (np.abs(step) <= self._reach)
        first, second, step = first[one], second[one], step[one]
        swap = first > second
        low, high = np.where(swap, second, first), np.where(swap, first, second)
        kind = np.minimum((np.where(swap, -step, step) / self._reach + 1) * (BINS / 2), BINS - 1).astype(np.int64)
        both, at = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True)
        counts = np.bincount(at.reshape(-1) * BINS + kind, minlength=len(both) * BINS).reshape(-1, BINS)
        for (a, b), some in zip(both.tolist(), counts, strict=True):
            self._counts[a, b] = self._counts.get((a, b), np.zeros(BINS, np.int64)) + some

    def facts(self) -> list[dict[str, Any]]:
        """Of every two, by number ``first`` and ``second``: ``places``, the median ``step`` [m] of the first above the
        second, and its standard ``deviation`` [m] between places, by their quartiles."""
        return [
            {"first": a, "second": b, "places": int(counts.sum()), **self._describe(counts)}
            for (a, b), counts in sorted(self._counts.items())
        ]

    def _describe(self, counts: NDArray[np.int64]) -> dict[str, float]:
        edges = np.linspace(-self._reach, self._reach, BINS + 1)
        summed = np.concatenate([[0], np.cumsum(counts)]) / counts.sum()
        low, middle, high = (float(np.interp(share, summed, edges)) for share in (0.25, 0.5, 0.75))
        return {"step": middle, "deviation": max((high - low) / 2 * SIGMA_PER_MAD, edges[1] - edges[0])}


def told_steps(
    ways: Mapping[
        tuple[Literal["files", "times"], Literal["overlap", "border"]], tuple[HeightSteps, Mapping[int, str]]
    ],
) -> list[dict[str, Any]]:
    """Steps that are sure and from `TOLD` on, the largest first: as `HeightSteps.facts` has them, ``first`` and
    ``second`` by name, ``by`` files or times and ``seen`` in an overlap or across a border.

    `ways`: what was counted, and the names by number. Lines are told only where no files are: the lines of a file that
    was lifted lie higher there, too.
    """
    notable = []
    for (by, seen), (steps, names) in ways.items():
        for one in steps.facts():
            error = math.sqrt(math.pi / 2) * one["deviation"] / math.sqrt(one["places"])
            if one["places"] >= PLACES and abs(one["step"]) >= max(TOLD, SURE * error):
                a, b = (names.get(one[n], str(one[n])) for n in ("first", "second"))
                notable.append({"by": by, "seen": seen, **one, "first": a, "second": b})
    by_files = [one for one in notable if one["by"] == "files"]
    return sorted(by_files or notable, key=lambda one: (-abs(one["step"]), one["first"], one["second"], one["seen"]))


def step_remarks(facts: Mapping[str, Any]) -> list[str]:
    """The steps that are told, in one sentence; `facts` of the strips."""
    notable = facts.get("steps", ())
    return [_words(notable)] if notable else []


def judge_steps(facts: Mapping[str, Any], most: float, accepted: bool, where: object) -> None:
    """`QualityError` where a step is more than `most` [m]; nothing where the user accepts it."""
    beyond = [one for one in facts.get("steps", ()) if abs(one["step"]) > most]
    refuse_unsound(
        [_words(beyond)] if beyond else [],
        accepted,
        "files or flight lines of the survey do not lie at one height",
        where,
        expected=f"steps of at most {most:g} m (plausibility.max_height_step)",
        do="ask for a delivery that was adjusted as a whole, and look at the heights' datum of what came last",
    )


def _words(notable: Sequence[Mapping[str, Any]]) -> str:
    listed = []
    for one in notable:
        high, low = (one[n] for n in (("first", "second") if one["step"] > 0 else ("second", "first")))
        how = "that both see" if one["seen"] == "overlap" else "along their border"
        listed.append(
            f"{high} lies {abs(one['step']):.3f} m above {low} (standard deviation {one['deviation']:.3f} m, "
            f"{one['places']:,} places {how})"
        )
    return first_few(listed, NAMED, "; ")
