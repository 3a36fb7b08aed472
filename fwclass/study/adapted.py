"""A ready model that learns further from the echoes of a survey of which it is sure: self-training, without labels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.shares import answer
from fwclass.errors import InputError
from fwclass.hashing import hash_keys
from fwclass.model import Contextual, Forest, Layered, Model
from fwclass.model.ranges import RANGES
from fwclass.train.params import AdaptParams, TrainParams
from fwclass.train.sample import Sample, join, thin
from fwclass.train.stage import grow_trees, train

ADAPTED = "adapted"
"""Key of an adapted model's card: ``rounds``, and ``changed``, the share of echoes with another class than before."""


@dataclass(frozen=True)
class Round:
    """What a model says of the survey's sample: mean `confidence`, and the share of `unsure` echoes, 0 to 1."""

    confidence: float
    unsure: float


@dataclass(frozen=True)
class SeenEchoes:
    """Echoes of a survey, by key.

    `key`: uint64 (rows,), `schema.canonical_key`. `X`: float32 (rows, features), in the order of the model's.
    """

    key: NDArray[np.uint64]
    X: NDArray[np.float32]


def draw_seen(parts: Iterable[SeenEchoes], most: int, seed: int) -> SeenEchoes:
    """Of the echoes of all `parts` (tiles) the `most` with the smallest hashes, whatever the tiles and their order."""
    kept: SeenEchoes | None = None
    for part in parts:
        both = part
        if kept is not None:
            both = SeenEchoes(np.concatenate([kept.key, part.key]), np.concatenate([kept.X, part.X]))
        order = np.argsort(hash_keys(seed, both.key), kind="stable")[:most]
        order = order[np.argsort(both.key[order])]
        kept = SeenEchoes(both.key[order], both.X[order])
    if kept is None or not len(kept.key):
        raise InputError("the run has no echo to learn from", where="adapt")
    return kept


def adapt(model: Model, base: Sample, seen: SeenEchoes, params: AdaptParams, training: TrainParams) -> Model:
    """The model after `params.rounds` rounds; its card says what it and those before it say of the survey (`ADAPTED`).

    In each round a forest learns from the base's rows and from those of `seen` of which the last one is sure, of every
    class as many at most as the base has of its largest. A layer that decides in context stays as it is.

    `InputError`: the model's first layer is no forest, or it is unsure of too many echoes.
    """
    first = model.coarse if isinstance(model, Layered) else model
    if not isinstance(first, Forest):
        raise InputError(
            "a forest is adapted", where="adapt", expected=Forest.kind, got=first.kind, do="give a model of that kind"
        )
    classes, per_class = first.classes, int(base.counts.max())
    winner, sure = _answers(first, seen)
    before, rounds = winner, [_round(sure, params)]
    if rounds[0].unsure > params.most_unsure:
        raise InputError(
            "the model is unsure of too many echoes to learn from those of which it is sure",
            where="adapt.most_unsure",
            expected=f"at most {100 * params.most_unsure:.1f} % with a confidence below {params.unsure:g}",
            got=f"{100 * rounds[0].unsure:.1f} %",
            do="give some labels: `fwclass suggest` names the places (docs/labels.md)",
        )
    current: Forest = first
    for _ in range(params.rounds):
        rows = np.flatnonzero(sure >= params.sure)
        key, none = seen.key[rows], np.zeros(len(classes), np.int64)
        y, drawn, nowhere = (
            winner[rows].astype(np.uint8),
            hash_keys(training.seed, key),
            np.zeros((len(rows), 2), np.int64),
        )
        own = Sample(base.features, seen.X[rows], y, key, drawn, none, none, nowhere)
        both = join((base, thin(own, per_class)), 2 * per_class)
        current = train(both, grow_trees(both, classes, 0, training.trees, training), training, classes)
        winner, sure = _answers(current, seen)
        rounds.append(_round(sure, params))
    facts = {"rounds": [asdict(r) for r in rounds], "changed": float((winner != before).mean())}
    card = {**current.card, "computed": first.card.get("computed", {}), ADAPTED: facts}
    adapted = replace(current, card=card)
    if not isinstance(model, Contextual):
        return adapted
    of_both = {k: v for k, v in model.card.items() if k not in ("measured", "rows", "digest", "layers")}
    of_both |= {RANGES: card[RANGES], "training": card["training"], "samples": card["samples"], ADAPTED: facts}
    return Contextual(adapted, model.fine, of_both)


def _answers(model: Forest, seen: SeenEchoes) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    winner, shares = answer(seen.X, model)
    sure = np.take_along_axis(shares, winner[:, None], axis=1)[:, 0]
    return np.asarray(winner, np.int64), np.asarray(sure, np.float64)


def _round(sure: NDArray[np.float64], params: AdaptParams) -> Round:
    return Round(float(sure.mean()), float((sure < params.unsure).mean()))


def describe(card: dict[str, Any]) -> str:
    """What an adapted model's card says, for a terminal."""
    facts = card[ADAPTED]
    first, last = facts["rounds"][0], facts["rounds"][-1]
    return (
        f"after {len(facts['rounds']) - 1} rounds {100 * facts['changed']:.1f} % of the echoes looked at have another "
        f"class; {100 * first['unsure']:.1f} % of them were unsure to its first layer, "
        f"{100 * last['unsure']:.1f} % are: a model that is surer is not right more often for that"
    )
