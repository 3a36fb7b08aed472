"""What stands beside an accuracy whose test says less than the figure does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from fwclass.assess.intervals import FEW, LEAST
from fwclass.assess.params import AssessParams
from fwclass.errors import refuse_unsound

SLIGHT = 0.2
"""Kappa up to which two classifications agree slightly at best (Landis and Koch 1977)."""

ONE_CLASS = 0.99
"""A block is of one class from this share of its echoes on: a few strays make no border."""


NEVER_SORTED = frozenset({"0", "1"})
"""Codes that say nothing of an echo (LAS: never classified, unclassified): no class to learn."""


@dataclass(frozen=True)
class Extent:
    """What was tested, and where.

    Attributes
    ----------
    echoes : of the survey; scored : with a reference class, in the test areas.
    others : echoes of the survey whose reference is a code that no class counts, by code.
    apart : distance of the nearest tested echo from a training area [m], at least; None where none trained.
    reach : of the widest feature [m].
    """

    echoes: int
    scored: int
    others: Mapping[str, int]
    apart: float | None
    reach: float


def pure_share(blocks: NDArray[np.int64]) -> float | None:
    """Share of the echoes, 0 to 1, that lie in blocks of one class; `blocks` int64 (blocks, classes, classes) are the
    counts of `BlockCounts`. None without any."""
    reference = blocks.sum(axis=2)
    whole = reference.sum(axis=1)
    if not whole.sum():
        return None
    return float(whole[reference.max(axis=1) >= ONE_CLASS * whole].sum() / whole.sum())


def remarks(accuracy: Mapping[str, Any], tested: Extent, params: AssessParams) -> list[str]:
    """Sentences, each with why and what to do; none for a test that is large, mixed and apart.

    Parameters
    ----------
    accuracy : with ``blocks``, how many hold a tested echo, and ``pure_share``.
    """
    sentences, blocks, pure = [], int(accuracy["blocks"]), accuracy["pure_share"]
    edge = f"{params.block:g} m"
    sentences += chance_remarks(accuracy)
    narrow = params.block < tested.reach
    if blocks < FEW:
        without = f", and no interval is told below {LEAST}" if blocks < LEAST else ""
        hang = f", and even of neighbours, as what decides reaches {tested.reach:g} m" if narrow else ""
        wanted = f" of {2 * tested.reach:g} m, which takes a larger survey or smaller training areas" if narrow else ""
        sentences.append(
            f"The accuracy is uncertain: it was tested in {blocks} squares of {edge} (assess.block), and echoes of a "
            f"square{hang} are right or wrong together{without}: test on {FEW} squares or more{wanted}."
        )
    if pure is not None and pure >= params.pure:
        sentences.append(
            f"The survey's accuracy is lower than this: {100 * pure:.0f} % of the tested echoes lie in squares of "
            f"{edge} with one class, and borders between classes, where most errors are, were hardly tested: label "
            "whole places, not the inside of objects."
        )
    if tested.apart is not None and tested.apart < tested.reach:
        sentences.append(
            f"The accuracy may be too good: it was tested {tested.apart:.3g} m from the training areas, and what "
            f"decides reaches {tested.reach:g} m, so that the classifier has seen part of what it is tested on: "
            f"--set areas.gap={tested.reach:g} or more."
        )
    if narrow and blocks >= FEW:
        sentences.append(
            f"The intervals of the accuracy are too narrow: errors hang together over the {tested.reach:g} m that what "
            f"decides reaches, and squares of {edge} (assess.block) are smaller: "
            f"--set assess.block={2 * tested.reach:g} or more."
        )
    share = tested.scored / tested.echoes if tested.echoes else 0.0
    if share < params.tested:
        sentences.append(
            "The accuracy holds where the survey is like the tested places: "
            f"{percent_words(share)} of the echoes were tested, the others never: label places of every kind."
        )
    lost = sum(tested.others.values())
    if tested.echoes and lost > params.unscored * tested.echoes:
        codes = ", ".join(f"{code} ({n:,} echoes)" for code, n in tested.others.items())
        sorted_codes = set(tested.others) - NEVER_SORTED
        advice = (
            "add them to survey.classes, or know that they are missing here"
            if sorted_codes
            else ("nobody has sorted them; know that they are missing here, or label some")
        )
        sentences.append(
            f"The accuracy leaves out {percent_words(lost / tested.echoes)} of the echoes, whose reference no class "
            f"counts: they are classified, and not scored; codes {codes}: {advice}."
        )
    return sentences


def chance_remarks(accuracy: Mapping[str, Any]) -> list[str]:
    """That kappa is no better than that of classes drawn at random, as far as its interval tells; nothing where the
    reference has one class alone."""
    interval = _interval_of_kappa(accuracy)
    if interval is None or interval[0] > 0.0:
        return []
    return [
        f"Kappa is {_kappa_words(accuracy, interval)}: chance may agree with the reference as well. Are the labels "
        "those of these echoes (files, codes, places)? Do the features tell the classes apart?"
    ]


def judge_chance(accuracy: Mapping[str, Any], accepted: bool, where: object) -> None:
    """`QualityError` where there are `chance_remarks` and kappa is at most `SLIGHT`; nothing where the user accepts."""
    interval = _interval_of_kappa(accuracy)
    if interval is not None and interval[0] <= 0.0 and accuracy["kappa"] <= SLIGHT:
        _refuse_chance(_kappa_words(accuracy, interval), accepted, where)


def judge_folds(validated: Mapping[str, Any], accepted: bool, where: object) -> None:
    """As `judge_chance`, by the mean ``kappa`` of ``folds`` and the ``kappa_std`` between them: their t interval."""
    kappa, folds = validated["kappa"], validated["folds"]
    if kappa is None or kappa > SLIGHT or folds < 2:
        return
    half = float(scipy.special.stdtrit(folds - 1, 0.975)) * (validated["kappa_std"] or 0.0) / math.sqrt(folds)
    if kappa - half <= 0.0:
        _refuse_chance(f"{kappa:.3f} in folds (95 %: {kappa - half:.3f} to {kappa + half:.3f})", accepted, where)


def _refuse_chance(kappa: str, accepted: bool, where: object) -> None:
    refuse_unsound(
        [f"kappa {kappa}"],
        accepted,
        "the classes agree with the reference no better than chance does",
        where,
        expected="kappa above 0, with its interval",
        do="look whether the labels are those of these echoes, and at the confusion matrix",
    )


def _interval_of_kappa(accuracy: Mapping[str, Any]) -> tuple[float, float] | None:
    """95 % interval of kappa by blocks, where these are too few as of echoes that are right or wrong each for itself
    (Congalton and Green 1999), which is too narrow; None without kappa, or two classes in the reference."""
    counts, kappa = np.asarray(accuracy["confusion"], float), accuracy.get("kappa")
    reference = counts.sum(axis=1)
    if np.count_nonzero(reference) < 2 or kappa is None:
        return None
    if by_blocks := (accuracy.get("intervals") or {}).get("kappa"):
        return float(by_blocks[0]), float(by_blocks[1])
    rows = reference.sum()
    right, chance = np.trace(counts) / rows, reference @ counts.sum(axis=0)[: len(reference)] / rows**2
    half = 1.96 * math.sqrt(right * (1.0 - right) / rows) / (1.0 - chance)
    return kappa - half, kappa + half


def _kappa_words(accuracy: Mapping[str, Any], interval: tuple[float, float]) -> str:
    return f"{accuracy['kappa']:.3f} ({interval[0]:.3f} to {interval[1]:.3f})"


def percent_words(share: float) -> str:
    """A share, 0 to 1, in percent: small ones with two digits."""
    return f"{100 * share:.1f} %" if share >= 0.001 else f"{100 * share:.2g} %"
