"""What returns say of themselves, counted so that the spans of a file add up: intensities, times, numbers, and the
lattice that their places lie on."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.header_counts import MOST
from fwclass.grid import millimetres
from fwclass.schema import Table

COARSE = 50
"""mm; no survey rounds its places to so much."""

LEVELS = 5
"""Steps from the least coordinate to the greatest; fewer are those of level surfaces."""

WIDEST = 1e12
"""m; coordinates beyond are no places."""

NUMBER_FAULTS = "return number 0", "return number above the number of returns"
"""Of a file's faults those that say that return numbers are none."""

EDGES = np.unique(np.rint(2.0 ** (np.arange(65) / 4.0)).astype(np.int64))
"""Where classes of intensities begin, a fourth of a doubling each; 0 has its own."""

PAIRED = 50_000
"""Returns of pulses with several that are looked at in a span for how they follow each other."""

ASIDE, FALL = (10.0, 60.0), 2.0
"""Degrees from the vertical and m of height between two returns whose slant is looked at: nearer the vertical a beam
leans by the aircraft's pitch as much as by its scan."""

SLANTS = 2.0 ** np.linspace(-3, 3, 61)
"""Classes of ratios of slants, of 7 % each."""

FIRST_LOOK = 1_000
"""Places that are looked at first."""

SLANTED = 200
"""Pairs of returns of a file whose slants say something."""

FOOT = 0.3048
"""m"""

NEAR_UNIT, OF_ONE_UNIT = 0.15, 1.3
"""Logarithm by which the ratio of slants may be off a foot's, and third quartile over first: in nine public files it is
0.99 to 1.1 and 1.01 to 1.15, on a drone whose angles count from its own axes 0.6 and 2.5."""

BACK = 0.05
"""Share of steps back in time from which on a file is in another order (0 to 0.04 in files as they were measured, a
half where they are sorted otherwise), and of times that several pulses share."""

MUST, KEPT = 1_000, 0.8
"""Returns that another must follow before they tell whether a file is thinned, and share of them that are followed
below which it is: 0.96 to 1 in 12 public files, 0.006 and 0.008 in two that were, 0.5 and 0.7 where one point was kept
for every half metre."""

PAIRS = 100
"""Returns of a file that follow another before they tell in which order they are numbered; all fall in nine files."""

FINE = 20
"""mm; a lattice of so few among the first places is looked into no further."""


def count_returns(
    returns: Table, scan_angle: NDArray[np.float32] | None = None, octree: bool = False
) -> dict[str, Any]:
    """Plain data of the returns of a span and their scan angles [degrees], as `join_counts` joins them. `octree`: the
    file has them by depth, so that returns of a pulse are spans apart.

    ``numbers``: returns by number, of `MOST`.

    ``intensities``: single returns by class of `EDGES` (the number of edges not above the value), where intensity is
    what a return's amplitude is, else empty. ``intensity``: least and greatest. ``times``: first and last GPS time [s],
    None without one. ``several``: returns of pulses with more than one. ``missing``: returns that such pulses lack at
    least. ``following``: among the first `PAIRED` of them, those that follow another of their pulse by number, and of
    these the ones that do not lie higher. ``kept``: of the first `PAIRED`, those that another of their pulse must
    follow, and how many are followed; zeros where the file's order or its times do not tell. ``slants``: of those that
    follow another, aside of the vertical, how many have which ratio, by class of `SLANTS`, of the slant by their places
    to that by their scan angle. ``lattice``: for x, y and z [mm] the least and the greatest, and the longest step of
    which all are multiples from there on; 0 where all are alike, and at most `FINE` where it need not be the longest.
    """
    number, of = (returns[n] for n in ("return_number", "number_of_returns"))
    intensity, time = returns["intensity"], returns["gps_time"]
    time = time[np.isfinite(time)]
    singles = intensity[of <= 1] if np.isnan(returns["vendor_amplitude"]).all() else intensity[:0]
    kinds, counts = np.unique(np.searchsorted(EDGES, singles, "right"), return_counts=True)
    pairs = pairs_of(number, of)
    return {
        "numbers": np.bincount(np.minimum(number, MOST - 1), minlength=MOST).tolist(),
        "intensities": {str(k): n for k, n in zip(kinds.tolist(), counts.tolist(), strict=True)},
        "intensity": [int(f(intensity)) for f in (np.min, np.max)] if len(intensity) else None,
        "times": [float(time.min()), float(time.max())] if len(time) else None,
        "several": int((of > 1).sum()),
        "missing": missing_returns(pairs),
        "kept": [0, 0] if octree else count_kept(returns),
        **count_pairs(returns, scan_angle),
        "lattice": [lattice_of(returns[axis]) for axis in "xyz"],
    }


def join_counts(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """What `count_returns` says of all spans of a file together; spans without a return say nothing."""
    parts = [p for p in parts if p["intensity"] is not None]
    intensities: Counter[str] = Counter()
    for part in parts:
        intensities.update(part["intensities"])
    times = [p["times"] for p in parts if p["times"]]
    return {
        "intensities": dict(intensities),
        "intensity": _span(p["intensity"] for p in parts),
        "times": _span(times),
        "several": sum(p["several"] for p in parts),
        "missing": sum(p["missing"] for p in parts),
        "following": [sum(p.get("following", (0, 0))[k] for p in parts) for k in (0, 1)],
        "kept": [sum(p.get("kept", (0, 0))[k] for p in parts) for k in (0, 1)],
        "slants": [sum(column) for column in zip(*(p["slants"] for p in parts if "slants" in p), strict=True)],
        "lattice": [join_lattices(p["lattice"][k] for p in parts) for k in range(3)] if parts else None,
    }


def coarse_steps(lattice: Iterable[list[int]]) -> str:
    """Axes whose coordinates lie on a coarse lattice, with the step [m]; "" for none."""
    return ", ".join(
        f"{axis} {0.001 * step:g}" for axis, step in zip("xyz", map(coarse_step, lattice), strict=True) if step
    )


def coarse_step(lattice: Sequence[int]) -> int:
    """The step of a coarse lattice [mm], 0 for another one."""
    least, greatest, step = lattice
    return step if step >= COARSE and greatest - least >= LEVELS * step else 0


def slant_ratio(slants: Sequence[int]) -> tuple[float, float]:
    """Median of ratios by class of `SLANTS`, and third quartile over first; NaN for fewer than `SLANTED` ratios."""
    if sum(slants) < SLANTED:
        return np.nan, np.nan
    middle = np.concatenate([SLANTS[:1], np.sqrt(SLANTS[1:] * SLANTS[:-1]), SLANTS[-1:]])
    low, median, high = (middle[np.searchsorted(np.cumsum(slants), share * sum(slants))] for share in (0.25, 0.5, 0.75))
    return float(median), float(high / low)


def backward_fault(following: Sequence[int]) -> str:
    """That later returns of a pulse lie higher, by ``following`` of `count_pairs`; "" for nothing of the kind."""
    pairs, falling = following
    if pairs < PAIRS or 2 * falling >= pairs:
        return ""
    return f"of {pairs:,} returns that follow another of their pulse {pairs - falling:,} lie higher"


def thinned_fault(kept: Sequence[int]) -> str:
    """That returns were left out one by one, by ``kept`` of `count_returns`; "" for nothing of the kind."""
    before, after = kept
    if before < MUST or after >= KEPT * before:
        return ""
    lost = 100 * (1 - after / before)
    return f"of {before:,} returns that another of their pulse must follow {lost:.0f} % are not followed"


def unit_fault(slants: Sequence[int]) -> str:
    """That heights are in feet where places are in metres, or the other way round, by ``slants`` of `count_pairs`; ""
    for nothing of the kind."""
    ratio, wide = slant_ratio(slants)
    for factor, words in ((FOOT, "heights are in feet, where places"), (1 / FOOT, "places are in feet, where heights")):
        if abs(math.log(ratio / factor)) < NEAR_UNIT and wide < OF_ONE_UNIT:
            return f"lie {ratio:.2f} times as far aside as their scan angles tell: {words} are in metres"
    return ""


def median_intensity(intensities: Mapping[str, int]) -> int:
    """Where the class of `EDGES` begins that the median of so many intensities lies in; 0 without any."""
    total, seen = sum(intensities.values()), 0
    for kind in sorted(map(int, intensities)):
        seen += intensities[str(kind)]
        if 2 * seen >= total:
            return int(EDGES[kind - 1]) if kind else 0
    return 0


def pairs_of(number: NDArray[np.integer], of: NDArray[np.integer]) -> NDArray[np.int64]:
    """Counts (`MOST`, `MOST`) of returns by number and number of returns, (n,) each; more count as the most."""
    number, of = (np.minimum(np.asarray(v, np.int64), MOST - 1) for v in (number, of))
    return np.bincount(number * MOST + of, minlength=MOST**2).reshape(MOST, MOST)


def pulses_without_last(pairs: NDArray[np.int64]) -> tuple[int, int]:
    """How many pulses with several returns there are at least, and how many of them lack their last one, by the counts
    of `pairs_of`."""
    several = lacking = 0
    for of in range(2, MOST):
        counts = pairs[1 : of + 1, of]
        several += int(counts.max())
        lacking += int(counts.max() - counts[-1])
    return several, lacking


def missing_returns(pairs: NDArray[np.int64]) -> int:
    """How many returns are missing at least, by counts (return number, number of returns): of pulses with m returns
    there must be as many of each return number 1 to m."""
    missing = 0
    for of in range(2, MOST - 1):
        counts = pairs[1 : of + 1, of]
        missing += int((counts.max() - counts).sum())
    return missing


def count_pairs(returns: Mapping[str, NDArray] | Table, scan_angle: NDArray[np.float32] | None) -> dict[str, list[int]]:
    """``following`` and, where scan angles are told, ``slants``, as `count_returns` has them.

    returns : x, y, z [m], gps_time [s], return_number and number_of_returns, (n,) each; scan_angle [degrees], (n,).
    """
    first, second = _pairs(returns)
    fall = returns["z"][first] - returns["z"][second]
    counts = {"following": [len(first), int((fall >= 0).sum())]}
    if scan_angle is None:
        return counts
    angle = np.abs(scan_angle[first].astype(np.float64))
    far = (fall >= FALL) & (angle >= ASIDE[0]) & (angle <= ASIDE[1])
    first, second = first[far], second[far]
    aside = np.hypot(*(returns[axis][first] - returns[axis][second] for axis in "xy"))
    ratio = aside / fall[far] / np.tan(np.radians(angle[far]))
    return counts | {"slants": np.bincount(np.searchsorted(SLANTS, ratio), minlength=len(SLANTS) + 1).tolist()}


def count_kept(returns: Mapping[str, NDArray] | Table) -> list[int]:
    """``kept`` of `count_returns`: what is thinned pulse by pulse keeps all that follow, what is thinned return by
    return as many as returns are left."""
    time, number, of = (returns[n] for n in ("gps_time", "return_number", "number_of_returns"))
    some = np.flatnonzero((of > 1) & np.isfinite(time))[:PAIRED]
    if len(some) < 2 or (np.diff(time[some]) < 0).mean() > BACK:
        return [0, 0]
    some = some[np.lexsort((number[some], time[some]))]
    first, second = some[:-1], some[1:]
    same = time[first] == time[second]
    after = same & (number[first].astype(int) + 1 == number[second]) & (of[first] == of[second])
    if (same & (number[first] == number[second])).mean() > BACK or not after.any():  # or each has its own time
        return [0, 0]
    return [int((number[first] < of[first]).sum()), int(after.sum())]


def _pairs(returns: Mapping[str, NDArray] | Table) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of returns of one time and neighbouring numbers, among the first `PAIRED` of pulses with several."""
    time, number, of, z = (returns[n] for n in ("gps_time", "return_number", "number_of_returns", "z"))
    some = np.flatnonzero((of > 1) & np.isfinite(time) & np.isfinite(z))[:PAIRED]
    some = some[np.lexsort((number[some], time[some]))]
    first, second = some[:-1], some[1:]
    pair = (time[first] == time[second]) & (number[first].astype(int) + 1 == number[second]) & (of[first] == of[second])
    return first[pair], second[pair]


def lattice_of(values: NDArray[np.float64]) -> list[int]:
    """Least and greatest of some coordinates [m] in mm, and the step from there on, as `count_returns` says it."""
    known = millimetres(values[np.abs(values) < WIDEST])
    if not len(known):
        return [0, 0, 0]
    least = int(known.min())
    step = int(np.gcd.reduce(known[:FIRST_LOOK] - least))
    if step == 0 or step > FINE:
        step = int(np.gcd.reduce(known - least))
    return [least, int(known.max()), step]


def join_lattices(lattices: Iterable[list[int]]) -> list[int]:
    """What `lattice_of` says of all coordinates, by what it says of parts of them."""
    known = [lattice for lattice in lattices if any(lattice)]
    if not known:
        return [0, 0, 0]
    least = min(low for low, _, _ in known)
    step = math.gcd(*(its for _, _, its in known), *(low - least for low, _, _ in known))
    return [least, max(high for _, high, _ in known), step]


def _span(pairs: Iterable[Any]) -> list[Any] | None:
    pairs = list(pairs)
    return [min(a for a, _ in pairs), max(b for _, b in pairs)] if pairs else None
