"""Whether labels and classes can be what they are said to be: labels that lie elsewhere, plants and roofs exchanged."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fwclass.assess.remarks import percent_words
from fwclass.classes import BUILDING, PLANTS
from fwclass.decompose.params import PlausibilityParams
from fwclass.errors import refuse_named
from fwclass.label.cloud_offset import CELL, offset_of_cloud
from fwclass.store.receipts import Receipt

GAIN = 0.05
"""Share of the features' variance that labels explain more where they fit best, from which they lie elsewhere: 0.12 and
more where those of two towns were moved by 2 m, at most 0.03 where boxes lie right."""

WORTH = 1000
"""Echoes of plants and of buildings from which on they are compared."""

OTHER_HEIGHTS = 20
"""cm between a reference cloud and the echoes that it labels, in the median, from which it is told: flights of one
height system differ by some centimetres."""

ASIDE = 0.5
"""m to the east or north by which a reference cloud lies aside, from which it is told: known to 0.2 m where heights
agree."""

PIERCED = 0.2
"""Share of echoes of pulses with several by which buildings may lead plants: in ten public tiles plants of all heights
lead, by 0.2 and more; where low ones are the only ones, by 0.04."""


def label_facts(
    labelled: Iterable[Receipt],
    tiles: Iterable[Receipt],
    params: PlausibilityParams,
    clouds: Iterable[Receipt] = (),
    uncounted: float = 0.0,
) -> dict[str, Any] | None:
    """``remarks`` on labels and classes, and what of them is not sound: ``elsewhere``, ``exchanged`` and ``uncounted``,
    each a sentence or ""; None where nothing is delivered and nothing was learned.

    `labelled`: of the survey's sample, and of its assessment. `tiles`: of the delivery. `clouds`: of the tiles' labels,
    which tell of clouds alone. `uncounted`: share of the classified echoes whose reference is a code of no class, which
    is remarked on beside the accuracy.
    """
    labelled, tiles, clouds = list(labelled), list(tiles), list(clouds)
    if not labelled and not tiles:
        return None
    elsewhere, far = max(_elsewhere(labelled), _aside(clouds), key=lambda said: said[1])
    exchanged = exchanged_words(t.meta["facts"] for t in tiles)
    return {
        "remarks": [text for text in (elsewhere, exchanged, _other_heights(clouds)) if text],
        "elsewhere": elsewhere if far > params.max_label_offset else "",
        "exchanged": exchanged,
        "uncounted": f"{percent_words(uncounted)} of the echoes" if uncounted > params.max_uncounted else "",
    }


def judge_labels(facts: Mapping[str, Any] | None, params: PlausibilityParams, where: object) -> None:
    """`QualityError` where labels lie elsewhere, or classes are exchanged; nothing where the user accepts it."""
    ways = (
        (
            "elsewhere",
            "the labels do not lie where the echoes are",
            f"labels that fit best within {params.max_label_offset:g} m of where they are "
            "(plausibility.max_label_offset)",
            "bring them into the survey's system (polygons by survey.reference.crs), or mend their places",
        ),
        (
            "exchanged",
            "classes are exchanged",
            "plants that pulses pass through, and roofs that they do not",
            "look at survey.classes, at the labels' codes, or at the model's classes",
        ),
        (
            "uncounted",
            "much of the survey is of none of its classes, and every echo is given one",
            f"at most {percent_words(params.max_uncounted)} with a reference that no class counts "
            "(plausibility.max_uncounted)",
            "add their codes to survey.classes, as a class of its own where they are another thing, or leave them as "
            "they are (classify.keep)",
        ),
    )
    refuse_named(facts, ways, params.accept, where)


def _elsewhere(labelled: Iterable[Receipt]) -> tuple[str, float]:
    """That labels fit better where they are not, by the first that says so, and how far off that is [m]."""
    for offset in (receipt.meta["offset"] for receipt in labelled if receipt.meta.get("offset")):
        x, y = offset["x"], offset["y"]
        if offset["explained"] - offset["unmoved"] >= GAIN and (x, y) != (0, 0):
            return (
                f"the labels' polygons fit the echoes best when they are moved by {_ways(x, y)}, to within "
                f"{offset['cell']:g} m: their classes "
                f"explain {100 * offset['explained']:.0f} % of what the echoes differ by there, and "
                f"{100 * offset['unmoved']:.0f} % where they lie",
                float(max(abs(x), abs(y))),
            )
    return "", 0.0


def _aside(clouds: Iterable[Receipt]) -> tuple[str, float]:
    """That a reference cloud fits the echoes better where it does not lie, and how far off that is [m]."""
    moved = [receipt.meta["moved"] for receipt in clouds if "moved" in receipt.meta]
    if not moved:
        return "", 0.0
    sums, counts = (np.array([m[name] for m in moved], np.int64).sum(axis=0) for name in ("sums", "counts"))
    offset = offset_of_cloud(sums, counts)
    if offset is None or max(abs(offset.x), abs(offset.y)) < ASIDE:
        return "", 0.0
    text = (
        f"the points of the reference cloud fit the echoes best when they are moved by some "
        f"{_ways(round(offset.x, 1), round(offset.y, 1))}{' or more' if offset.edge else ''}"
    )
    if offset.least < offset.unmoved:  # in other cells than their own
        text += (
            f": the highest in cells of {CELL:g} m differ by {offset.least:.2f} m there, and by {offset.unmoved:.2f} m "
            "where they lie"
        )
    return text, math.hypot(offset.x, offset.y)


def _ways(x: float, y: float) -> str:
    named = ((x, ("to the east", "to the west")), (y, ("to the north", "to the south")))
    return " and ".join(f"{abs(v):g} m {names[v < 0]}" for v, names in named if v)


def _other_heights(clouds: Iterable[Receipt]) -> str:
    """That a reference cloud has other heights than the echoes that it labels."""
    counts = np.sum([receipt.meta["above"] for receipt in clouds if "above" in receipt.meta] or [[0]], axis=0)
    if counts.sum() < WORTH:
        return ""
    median = int(np.searchsorted(np.cumsum(counts), counts.sum() / 2)) - len(counts) // 2
    if abs(median) < OTHER_HEIGHTS:
        return ""
    return (
        f"the points of the reference cloud lie {abs(median) / 100:.2f} m {'below' if median > 0 else 'above'} the "
        f"{counts.sum():,} echoes that they label (median): another height system, unit or flight?"
    )


def exchanged_words(counts: Iterable[Mapping[str, Any]]) -> str:
    """That buildings are pierced by pulses, and plants are not; "" for nothing.

    counts : echoes by the text of their code, ``classes``, and those of pulses with ``several``, where that is known.
    """
    facts = [f for f in counts if "several" in f]

    def share(codes: Iterable[int]) -> tuple[int, float]:
        """Echoes with such a class, and the share of them that are of pulses with several."""
        echoes, several = (sum(f[name].get(str(c), 0) for f in facts for c in codes) for name in ("classes", "several"))
        return echoes, several / max(echoes, 1)

    (plants, of_plants), (buildings, of_buildings) = share(PLANTS), share([BUILDING])
    if min(plants, buildings) < WORTH or of_buildings - of_plants < PIERCED:
        return ""
    return (
        f"{100 * of_buildings:.0f} % of the echoes that are classified as building (6) are of pulses with several, and "
        f"{100 * of_plants:.0f} % of those of vegetation (3 to 5): pulses pass through plants, not through roofs"
    )
