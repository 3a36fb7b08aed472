"""The classes that a draft proposes to learn, and how far from their training area tested echoes begin."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from fwclass import conf
from fwclass.classify.context import halo_of
from fwclass.conf.sets import feature_set
from fwclass.features.names import FeatureRequest, is_feature
from fwclass.operate.draft.areas import AreaSplit, best_split, outer_box
from fwclass.operate.draft.holdings import WORDS_OF_NO_CLASS, Holdings

LEAST = 500
"""Points of a class below which it is not proposed: too few to learn from and to judge by."""


class Meaning(NamedTuple):
    """A class as it is proposed: its name, the code it is delivered as, the codes of files that count as it."""

    name: str
    code: int
    codes: tuple[int, ...]


MEANINGS = (
    Meaning("ground", 2, (2,)),
    Meaning("vegetation", 5, (3, 4, 5)),
    Meaning("building", 6, (6,)),
    Meaning("water", 9, (9,)),
    Meaning("rail", 10, (10,)),
    Meaning("road", 11, (11,)),
    Meaning("wire", 14, (13, 14, 16)),
    Meaning("tower", 15, (15,)),
    Meaning("bridge", 17, (17,)),
)
"""Of the LAS specification's codes for point formats 6 to 10."""


def propose_classes(holdings: Holdings, features: str) -> tuple[list[Meaning], dict[str, str], AreaSplit | None]:
    """Classes to learn; why others were left out; where to train."""
    classes = [m for m in MEANINGS if sum(holdings.codes[c] for c in m.codes) >= LEAST]
    omitted = _left_out(holdings.codes, classes)
    bounds = [f["bounds"] for f in holdings.facts if f.get("bounds")]
    split = None
    while len(classes) > 1:
        split = best_split(holdings.places, [c.codes for c in classes], outer_box(bounds), gap_of(features, classes))
        if split is None:
            break
        both = (split.train >= LEAST / 10) & (split.test >= LEAST / 10)
        if both.all():
            return classes, omitted, split
        for one in (c for c, there in zip(classes, both, strict=True) if not there):
            omitted[codes_of(one)] = f"{one.name}: it does not lie on both sides of any line through the survey"
        classes = [c for c, there in zip(classes, both, strict=True) if there]
    return classes, omitted, None


def _left_out(codes: Counter[int], classes: Sequence[Meaning]) -> dict[str, str]:
    """Why codes that the files hold are in no class."""
    meaning_of = {code: m for m in MEANINGS for code in m.codes}
    covered = {code for m in classes for code in m.codes}
    omitted = {}
    for code, n in sorted(codes.items()):
        if n and code not in covered:
            words = WORDS_OF_NO_CLASS.get(code) or (
                meaning_of[code].name if code in meaning_of else "no code of the LAS specification"
            )
            omitted[str(code)] = f"{words}, {n:,} points"
    return omitted


def gap_of(features: str, classes: Iterable[Meaning]) -> float:
    """m, in whole metres: how far apart tested echoes share no neighbour with a training area's, and neither a second
    layer nor a line looks at any of its echoes."""
    reach = FeatureRequest.of(n for n in feature_set(features).features if is_feature(n)).reach(
        conf.section("features")
    )
    ways = conf.section("classify")
    lines = ways.lines.halo if ways.lines.among(one.code for one in classes) else 0.0
    return float(math.ceil(max(2 * reach, reach + halo_of(ways.context.auto_cells), lines)))


def codes_of(one: Meaning) -> str:
    """The codes of files that count as a class, as a list is written."""
    return ", ".join(map(str, one.codes))
