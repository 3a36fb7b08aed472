"""What the files' returns say of themselves: scales of intensity, coarse places, numbers and times that are lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.params import PlausibilityParams
from fwclass.errors import first_few, refuse_named, visible
from fwclass.formats.area_of_use import kind_faults
from fwclass.graph.quantities import quantity_of_feature
from fwclass.graph.sources import strip_of
from fwclass.read.return_counts import (
    NUMBER_FAULTS,
    backward_fault,
    coarse_step,
    coarse_steps,
    join_counts,
    lattice_of,
    median_intensity,
    thinned_fault,
    unit_fault,
)
from fwclass.store.receipts import Receipt
from fwclass.survey.layout import Strip
from fwclass.units import GPS_WEEK

FEW = 1_000
"""Returns of a file below which nothing is said of them."""

NAMED = 3
"""Files that are named."""

MISSING = 0.1
"""Share of a file's returns of pulses with several that are missing at least before it is said."""

SEVERAL = 0.05
"""Share of another file's returns that are of pulses with several before a file without any is told."""

ANOTHER_SCALE = 4.0
"""Ratio of medians from which it is said; flight lines of one survey differ by 1.7."""


def returns_facts(
    receipts: Iterable[Receipt],
    strips: Iterable[Strip],
    names: Iterable[str],
    params: PlausibilityParams,
    weekly: Iterable[str] = (),
) -> dict[str, Any] | None:
    """``remarks`` on the returns of the files, and what of them is not sound: ``coarse``, ``scales``, ``backward`` and
    ``units``, of which each is what `judge_returns` refuses, or ""; ``single``, whether no pulse of any file
    has several, nor waveforms, which show several echoes; None where nothing was counted.

    `receipts`: of the parts that counted returns; `names`: the features that decide; `weekly`: names of the files that
    call their GPS times seconds of the week.
    """
    by_strip: dict[int, list[Mapping[str, Any]]] = {}
    points, unnumbered = Counter[int](), Counter[int]()
    waves = False
    for receipt in receipts:
        if "values" in receipt.meta:
            waves |= receipt.meta["waveforms"] > 0
            strip = strip_of(receipt.part)
            by_strip.setdefault(strip, []).append(receipt.meta["values"])
            points[strip] += receipt.meta["returns"]
            unnumbered[strip] += sum(receipt.meta.get("faults", {}).get(name, 0) for name in NUMBER_FAULTS)
    files = {s.number: visible(s.path.name) for s in strips}
    counted = {files[s]: join_counts(parts) for s, parts in sorted(by_strip.items()) if points[s] >= FEW}
    if not counted:
        return None
    many = {files[s]: n for s, n in points.items() if n >= FEW}
    single = not waves and not any(values["several"] for parts in by_strip.values() for values in parts)
    by_intensity = any(quantity_of_feature(name) == "amplitude" for name in names)
    coarse, step = _coarse(counted)
    scales, ratio = _scales(counted) if by_intensity else ("", 0.0)
    backward, units = _backward(counted), _units(counted)
    return {
        "remarks": [t for t in (coarse, scales, backward, units) if t]
        + _numbers(counted, many, single)
        + _unnumbered({n: (unnumbered[s], points[s]) for s, n in files.items() if n in many})
        + _times(counted, {visible(name) for name in weekly}),
        "coarse": coarse if step >= params.coarse_places else "",
        "scales": scales if ratio >= params.max_intensity_ratio else "",
        "backward": backward,
        "units": units,
        "single": single,
    }


def heights_of_returns(receipts: Iterable[Receipt]) -> tuple[float, float] | None:
    """Least and greatest height [m] of the returns of parts that counted them; None without one."""
    counted = join_counts(r.meta["values"] for r in receipts if "values" in r.meta)
    if counted["lattice"] is None or not any(counted["lattice"][2]):
        return None
    low, high, _ = counted["lattice"][2]
    return 0.001 * low, 0.001 * high


def places_facts(
    places: Sequence[NDArray[np.float64]], beams: Mapping[str, list[int]], name: str, params: PlausibilityParams
) -> dict[str, Any]:
    """As `returns_facts`, of x, y and z [m] of one file's points and their `beams` (`count_pairs`) alone."""
    facts = {"lattice": [*map(lattice_of, places)], "following": (0, 0), "slants": (), **beams}
    counted = {visible(name): facts} if len(places[0]) >= FEW else {}
    (coarse, step), backward, units = _coarse(counted), _backward(counted), _units(counted)
    return {
        "remarks": [text for text in (coarse, backward, units) if text],
        "coarse": coarse if step >= params.coarse_places else "",
        "scales": "",
        "backward": backward,
        "units": units,
        "single": False,
    }


def judge_returns(facts: Mapping[str, Any] | None, params: PlausibilityParams, where: object) -> None:
    """`QualityError` where places are coarse, intensities of several scales, returns numbered backwards, or heights in
    another unit than places; nothing where the user accepts it."""
    ways = (
        (
            "coarse",
            "places in the sources are coarse",
            f"steps below {params.coarse_places:g} m (plausibility.coarse_places)",
            "export the files again with their decimals",
        ),
        (
            "scales",
            "intensities of the sources are not of one scale",
            f"medians within a factor of {params.max_intensity_ratio:g} (plausibility.max_intensity_ratio)",
            "bring them to one scale, or decide by features without amplitude (`fwclass features --list`)",
        ),
        (
            "backward",
            "returns of the sources are numbered backwards",
            "returns of a pulse that lie lower one after the other",
            "mend the return numbers: ground is made of last returns",
        ),
        (
            "units",
            "heights of the sources are in another unit than their places",
            "returns of a pulse one below the other as its scan angle has it",
            "export the files again in metres, or name the vertical unit in their coordinate system",
        ),
    )
    refuse_named(facts, ways, params.accept, where)


def _coarse(counted: Mapping[str, Mapping[str, Any]]) -> tuple[str, float]:
    """That places are whole multiples of a coarse step, and the greatest step [m]."""
    steps: dict[str, list[str]] = {}
    greatest = 0
    for name, facts in counted.items():
        if axes := coarse_steps(facts["lattice"]):
            steps.setdefault(axes, []).append(name)
            greatest = max(greatest, *map(coarse_step, facts["lattice"]))
    if not steps:
        return "", 0.0
    which = "; ".join(f"{first_few(names, NAMED)}: {axes} m" for axes, names in steps.items())
    return f"places lie on a lattice, as if they were rounded ({which})", 0.001 * greatest


def _scales(counted: Mapping[str, Mapping[str, Any]]) -> tuple[str, float]:
    """That intensities of files are of several scales, and the ratio of the greatest median to the least."""
    medians = {
        n: median_intensity(f["intensities"]) for n, f in counted.items() if sum(f["intensities"].values()) >= FEW
    }
    if len(medians) < 2:
        return "", 0.0
    low, high = min(medians, key=lambda n: medians[n]), max(medians, key=lambda n: medians[n])
    ratio = medians[high] / max(medians[low], 1)
    if ratio < ANOTHER_SCALE:
        return "", 0.0
    return (
        f"single returns of {high} have an intensity of some {medians[high]:,} in the median, those of {low} of "
        f"{medians[low]:,}: features of amplitude do not mean the same in both",
        ratio,
    )


def _backward(counted: Mapping[str, Mapping[str, Any]]) -> str:
    """That later returns of a pulse lie higher."""
    names = [n for n, f in counted.items() if backward_fault(f["following"])]
    if not names:
        return ""
    fault = backward_fault([sum(counted[n]["following"][k] for n in names) for k in (0, 1)])
    return f"{fault} ({first_few(names, NAMED)}): they are numbered from the ground up"


def _units(counted: Mapping[str, Mapping[str, Any]]) -> str:
    """That beams lean as they would if heights were in feet where places are in metres, or the other way round."""
    faults = {n: fault for n, f in counted.items() if (fault := unit_fault(f["slants"]))}
    if not faults:
        return ""
    pairs = sum(sum(counted[n]["slants"]) for n in faults)
    first = next(iter(faults.values()))
    return f"{pairs:,} returns below others of their pulse ({first_few(list(faults), NAMED)}) {first}"


def _numbers(counted: Mapping[str, Mapping[str, Any]], points: Mapping[str, int], single: bool) -> list[str]:
    """That returns are missing, or their numbers are; `single`: no pulse of any file has several."""
    remarks = []
    cut = [
        n for n, f in counted.items() if f["missing"] > MISSING * (f["several"] + f["missing"]) and f["missing"] >= FEW
    ]
    if cut:
        remarks.append(
            f"some returns of pulses with several are missing in {first_few(cut, NAMED)} (filtered, or first or last "
            "returns alone): features of returns do not mean what they mean elsewhere"
        )
    thinned = [n for n, f in counted.items() if n not in cut and thinned_fault(f["kept"])]
    if thinned:
        fault = thinned_fault([sum(counted[n]["kept"][k] for n in thinned) for k in (0, 1)])
        remarks.append(
            f"{fault} ({first_few(thinned, NAMED)}): points were thinned one by one, as on a raster, and not pulse by "
            "pulse; features of returns do not mean what they mean elsewhere"
        )
    alone = [n for n, f in counted.items() if f["several"] == 0]
    if single:
        remarks.append(
            "no pulse has several returns: they, or their numbers, were left out; features of returns say nothing, and "
            "a model that learned by them takes plants for something else"
        )
    others = [n for n, f in counted.items() if f["several"] > SEVERAL * points[n]]
    if alone and others:
        remarks.append(
            f"every return of {first_few(alone, NAMED)} is numbered as its pulse's only one, those of "
            f"{first_few(others, NAMED)} are not: features of returns do not mean the same in both"
        )
    return remarks


def _unnumbered(counts: Mapping[str, tuple[int, int]]) -> list[str]:
    """That return numbers are none, by the counts of such and of all returns of every file."""
    some = {name: pair for name, pair in counts.items() if pair[0] > MISSING * pair[1]}
    if not some:
        return []
    wrong, every = (sum(pair[k] for pair in some.values()) for k in (0, 1))
    return [
        f"{wrong:,} of {every:,} returns in {first_few(list(some), NAMED)} have number 0, or one above the number of "
        "returns: which is the last of its pulse is not known, and ground is made of last returns"
    ]


def _times(counted: Mapping[str, Mapping[str, Any]], called_weekly: Container[str]) -> list[str]:
    """That GPS times do not pass, are of two kinds, or of another kind than their file says."""
    still = [n for n, f in counted.items() if f["times"] and f["times"][0] == f["times"][1]]
    times = {n: f["times"] for n, f in counted.items() if f["times"] and n not in still}
    # adjusted time is within a week's seconds in one week of 2011 alone
    weekly = [n for n, (first, last) in times.items() if first >= 0 and last <= GPS_WEEK]
    others = [n for n in times if n not in weekly]
    said = []
    if still:
        said.append(
            f"all returns of {first_few(still, NAMED)} have one GPS time: lines, returns of a pulse and echoes that "
            "stand twice cannot be told by it"
        )
    if weekly and others:
        said.append(
            f"GPS times of {first_few(weekly, NAMED)} are seconds of the week, those of {first_few(others, NAMED)} are "
            "not: lines, trajectories and dates mean something else in both; bring them to one kind"
        )
    other = [n for n in times if n in called_weekly and kind_faults(times[n][0], times[n][1], standard=False)]
    if other:
        said.append(
            f"GPS times of {first_few(other, NAMED)} are called seconds of the week and are beyond one: where they "
            "are adjusted standard time, their headers must say so (global encoding, bit 0), or what is delivered has "
            "no dates"
        )
    return said
