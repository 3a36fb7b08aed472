"""What the pages of all papers hold, as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fwclass import __version__
from fwclass.assess.intervals import caution
from fwclass.conf import Config
from fwclass.run.part import Name
from fwclass.store.receipts import Receipt
from fwclass.study.papers.work import Variant

Receipts = Mapping[Name, Receipt]


def heading(paper: str, config: Config, printed: Mapping[str, Any], tables: Sequence[str]) -> dict[str, Any]:
    """The paper, the survey, the figures that the paper prints in `tables`, and the survey's classes."""
    return {
        "paper": paper,
        "survey": config.survey.name,
        "fwclass": __version__,
        **{k: printed[k] for k in ("citation", "doi", "data", "notes")},
        "printed": {k: printed[k] for k in tables},
        "classes": [{"name": c.name, "code": c.code} for c in config.survey.classes],
    }


def rows_by_class(receipts: Receipts, variant: Variant, names: Sequence[str]) -> dict[str, list[int]]:
    """Numbers of training rows and of test echoes of every class, the latter as `variant` was judged on them."""
    counts = receipts["paper-training", "all"].meta["counts"]
    tested = np.array(receipts["paper-judged", variant.name].meta["matrix"]).sum(axis=1).tolist()
    return {name: [int(counts[k]), int(tested[k])] for k, name in enumerate(names)}


def differences(receipts: Receipts, pairs: Sequence[tuple[Variant, Variant]]) -> dict[str, Any]:
    """How much better the first of each pair is, with what is to be said where it rests on few blocks (``caution``)."""
    metas = {f"{a.name}/{b.name}": receipts["paper-difference", f"{a.name}-{b.name}"].meta for a, b in pairs}
    return {pair: {**meta, "caution": caution(meta["blocks"])} for pair, meta in metas.items()}


def times(receipts: Receipts, variants: Sequence[Variant]) -> dict[str, Any]:
    """How long each of `variants` trained and answered."""
    return {v.name: dict(receipts["paper-time", v.name].meta) for v in variants}
