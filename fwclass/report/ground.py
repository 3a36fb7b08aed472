"""Whether the ground that a filter found can be: told where it had nothing to look at, refused where there is none."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.remarks import SLIGHT
from fwclass.classes import BUILDING, GROUND, HIGH_NOISE, LOW_NOISE, WATER
from fwclass.decompose.params import PlausibilityParams
from fwclass.errors import refuse_unsound
from fwclass.ground.params import GroundParams

FEW = 0.01
"""Share of last returns in a block below which return numbers are wrong: under the densest crowns it is a third."""

WORTH = 1000
"""Echoes of a block that tell such a share."""

NOISY = 0.005
"""Share of a survey's echoes that are noise from which on it is told; up to 0.0016 in four sound ones."""

PITS, PITTED = 10, 3e-4
"""Ground echoes in pits, and share of the ground, from which they are told: 1 of 54,461 at most in seven tiles of
0.3 to 84 echoes/m2, none of ten ISPRS samples (quarries, steep rock) is told; 4.4e-4 with 0.2 % of a town's echoes 1 to
5 m too low."""

SEEN_FROM = 0.001
"""Share of a survey's echoes in such blocks from which on it is told."""


MOST_BUILDING = 0.05
"""Share of the echoes that the sources call building which a filter may make ground: 0.010 to 0.025 on four public
surveys of 15 to 84 echoes/m2, 0.12 on one of 0.3."""

LEAST_GROUND = 0.9
"""Share of the echoes that the sources call ground which it should: 0.997 to 1.000 on these five."""


def sunken_remarks(height: NDArray[np.floating], codes: NDArray[np.uint8], bounds: PlausibilityParams) -> list[str]:
    """What says that a ground which was given, class 2 of a file, is none: echoes that lie below it.

    `height` above it [m], NaN for none, and class of every echo, (n,) each.
    """
    known = np.isfinite(height) & ~np.isin(codes, (LOW_NOISE, HIGH_NOISE, WATER))
    below = int((height[known] < -bounds.sunken).sum())
    if below <= bounds.max_sunken * int(known.sum()):
        return []
    return [
        f"{below:,} of {int(known.sum()):,} points lie more than {bounds.sunken:g} m below what the file calls ground "
        "(class 2): that class is something else there, or stands alone high up"
    ]


def judge_sunken(remarks: Sequence[str], bounds: PlausibilityParams, where: object) -> None:
    """`QualityError` with what `sunken_remarks` says; nothing where the user accepts it."""
    refuse_unsound(
        remarks,
        bounds.accept,
        "what the file calls ground is not its lowest surface",
        where,
        expected=f"at most {100 * bounds.max_sunken:g} % of the points further below it",
        do="look at the file's classes (`fwclass info`), or let the ground be looked for (--method smrf)",
    )


def hall_facts(blocks: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Of the ``halls`` of all `blocks`: the greatest ``width`` [m], 0 for none, and the ``ground`` echoes on them."""
    halls = [b["halls"] for b in blocks if "halls" in b and b["halls"]["ground"]]
    return {"width": max((h["width"] for h in halls), default=0.0), "ground": sum(h["ground"] for h in halls)}


def pits_of(blocks: Iterable[Mapping[str, Any]]) -> int:
    """Ground echoes of all `blocks` that lie far below all ground around."""
    return sum(b.get("pits", 0) for b in blocks)


def filter_facts(blocks: Sequence[Mapping[str, Any]], ground: int) -> dict[str, dict[str, Any]]:
    """What `judge_halls` and `judge_pits` judge of one file's `blocks`, of whose echoes so many are `ground`."""
    return {
        "halls": {"halls": hall_facts(blocks), "ground": ground},
        "pits": {"pits": pits_of(blocks), "ground": ground},
    }


def filter_remarks(facts: Mapping[str, Mapping[str, Any]], params: GroundParams) -> list[str]:
    """What `filter_facts` are told of."""
    halls, pits = facts["halls"], facts["pits"]
    return [*hall_remarks(halls["halls"], halls["ground"], params), *pit_remarks(pits["pits"], pits["ground"])]


def hall_remarks(halls: Mapping[str, Any], ground: int, params: GroundParams) -> list[str]:
    """That ground lies on what looks like wide roofs. `halls`: of all blocks, `ground`: echoes that are."""
    if not halls["ground"]:
        return []
    size = math.ceil(1.3 * halls["width"])
    auto = "" if params.method == "auto" else ", or ground.method=auto (--auto), which measures it"
    return [
        f"{halls['ground']:,} ground echoes ({100 * halls['ground'] / ground:.1f} %) lie on something flat, up to "
        f"{halls['width']:.0f} m wide, from which it goes down on all sides: a filter takes roofs that are wider than "
        f"ground.max_building_size ({params.max_building_size:g} m) for ground; take {size}{auto}"
    ]


def pit_remarks(pits: int, ground: int) -> list[str]:
    """That ground lies below the ground. `pits`: echoes of all blocks, `ground`: echoes that are."""
    return [_pit_words(pits, ground)] if pits >= PITS and pits > PITTED * ground else []


def _pit_words(pits: int, ground: int) -> str:
    return (
        f"{pits:,} of {ground:,} ground echoes lie deeper below all ground around them than that is away: echoes that "
        "came over two surfaces, or noise, of which the filter makes its ground, so that the real one around is lost, "
        "and classes with it"
    )


def judge_halls(facts: Mapping[str, Any] | None, bounds: PlausibilityParams, where: object) -> None:
    """`QualityError` where more of the ground than `max_on_halls` lies on what looks like wide roofs (`hall_remarks`);
    nothing where the user accepts it. `facts`: ``halls`` (`hall_facts`), and ``ground`` echoes in all."""
    if not facts or facts["halls"]["ground"] <= bounds.max_on_halls * facts["ground"]:
        return
    halls = facts["halls"]
    refuse_unsound(
        [f"{halls['ground']:,} of {facts['ground']:,} ground echoes, on things up to {halls['width']:.0f} m wide"],
        bounds.accept,
        "wide roofs are taken for ground",
        where,
        expected=f"at most {100 * bounds.max_on_halls:g} % of the ground on flat things from which it goes down on all "
        "sides",
        do=f"look for wider buildings: ground.max_building_size={math.ceil(1.3 * halls['width'])}, or "
        "ground.method=auto (--auto), which measures them",
    )


def judge_pits(facts: Mapping[str, Any] | None, bounds: PlausibilityParams, where: object) -> None:
    """`QualityError` where more of the ground than `max_pits` lies below all ground around (`pit_remarks`); nothing
    where the user accepts it. `facts`: ``pits`` (`pits_of`), and ``ground`` echoes in all."""
    pits, ground = (facts["pits"], facts["ground"]) if facts else (0, 0)
    refuse_unsound(
        [_pit_words(pits, ground)] if pits >= PITS and pits > bounds.max_pits * ground else [],
        bounds.accept,
        "ground lies below the ground",
        where,
        expected=f"at most {100 * bounds.max_pits:g} % of the ground in pits of one echo (plausibility.max_pits)",
        do="ground.noise.surface=true takes single echoes below a surface out; what it misses, flag as withheld",
    )


def ground_remarks(
    blocks: Sequence[Mapping[str, Any]],
    withheld: int,
    params: GroundParams,
    by_source: Iterable[Mapping[str, Sequence[int]]] = (),
    accuracy: Mapping[str, Any] | None = None,
) -> list[str]:
    """What is to be said of the ground.

    Parameters
    ----------
    blocks : receipts' facts of the blocks of the filter: ``rows``, ``noise`` of them; ``seen`` echoes, ``last`` ones
        of their pulses among them.
    withheld : returns that their source flags as withheld or synthetic.
    by_source : of every tile [echoes, ground] by the class that their source has.
    accuracy : of the filter against the reference's class ground, where there is one.
    """
    remarks = []
    if withheld:
        remarks.append(
            f"the sources flag {withheld:,} returns as withheld or synthetic: no ground is made of them, and they "
            "neither train nor are tested; --set read.use_flagged=true takes them like all others"
        )
    noise, rows = (sum(b[name] for b in blocks) for name in ("noise", "rows"))
    if noise >= WORTH and noise > NOISY * rows:
        remarks.append(
            f"the noise filter took out {noise:,} echoes ({100 * noise / rows:.1f} %): they are no ground and nobody's "
            "neighbours; classify.noise=true, or --workflow ground, writes them as 7 and 18"
        )
    without = [b for b in blocks if b["seen"] >= WORTH and b["last"] < FEW * b["seen"]]
    echoes, whole = sum(b["seen"] for b in without), sum(b["seen"] for b in blocks)
    if params.last_returns and echoes > SEEN_FROM * whole:
        remarks.append(
            f"hardly one of {echoes:,} echoes ({100 * echoes / whole:.1f} %), in {len(without)} of {len(blocks)} "
            f"blocks of {params.block:g} m, is the last of its pulse, so that no ground is there and terrain is "
            "stretched over it: return numbers are wrong, or files without last returns were given; --set "
            "ground.last_returns=false lets all returns be ground"
        )
    remarks += filter_remarks(filter_facts(blocks, sum(b["ground"] for b in blocks)), params)
    kappa = _kappa(accuracy)
    if kappa is not None and kappa <= SLIGHT:
        remarks.append(
            f"the filter and the reference hardly agree on what is ground (kappa {kappa:.2f}): does the reference's "
            "class ground have the codes of another class, or the labels other heights? A classifier learns wrong "
            "labels as well as right ones, and is then tested on wrong ones"
        )
    return [*remarks, *_against_sources(by_source, params)]


def _kappa(accuracy: Mapping[str, Any] | None) -> float | None:
    """Of the filter against the reference, None where echoes of ground or of all else are too few to tell."""
    if accuracy is None or min(map(sum, accuracy["confusion"])) < WORTH:
        return None
    kappa: float | None = accuracy["kappa"]
    return kappa


def _against_sources(by_source: Iterable[Mapping[str, Sequence[int]]], params: GroundParams) -> list[str]:
    """Where the ground contradicts the classes that the sources have."""
    counts = np.zeros((256, 2), np.int64)
    for tile in by_source:
        for code, pair in tile.items():
            counts[int(code)] += pair
    remarks = []
    echoes, ground = counts[BUILDING].tolist()
    if echoes >= WORTH and ground > MOST_BUILDING * echoes:
        auto = "" if params.method == "auto" else ", or --set ground.method=auto measures it"
        remarks.append(
            f"{ground:,} of {echoes:,} echoes that the sources call building became ground: are there halls wider than "
            f"ground.max_building_size ({params.max_building_size:g} m)? A larger one{auto}"
        )
    echoes, ground = counts[GROUND].tolist()
    if echoes >= WORTH and ground < LEAST_GROUND * echoes:
        remarks.append(
            f"only {ground:,} of {echoes:,} echoes that the sources call ground became ground: look at the terrain, or "
            "compare filters (`fwclass ground FILE --compare all`)"
        )
    return remarks


def judge_ground(facts: Mapping[str, Any], bounds: PlausibilityParams, where: object) -> None:
    """`QualityError` where a filter looked at echoes and found no ground, or finds it where the reference has none;
    nothing where the user accepts it."""
    kappa = _kappa(facts.get("accuracy"))
    refuse_unsound(
        [f"kappa {kappa:.2f}"] if kappa is not None and kappa <= 0.0 else [],
        bounds.accept,
        "the filter's ground is not what the reference calls ground",
        where,
        expected="agreement that chance does not give: kappa above 0",
        do="look at survey.classes (code, codes) and at the labels' heights",
    )
    refuse_unsound(
        [f"0 of {facts['echoes']:,}"] if facts["echoes"] and not facts["ground"] else [],
        bounds.accept,
        "no echo is ground",
        where,
        expected="some, or there is no terrain and no height",
        do="look at return numbers and units (`fwclass info`), or try another ground.method",
    )
