"""The stage that searches C and gamma of the RBF SVM: a part for each, and each fold."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from fwclass.errors import InputError
from fwclass.graph.stage import Plan
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.run.inputs import PartInputs
from fwclass.select.folds import spatial_folds
from fwclass.train.baselines.params import RbfSvmParams
from fwclass.train.baselines.search import Folding, Places, by_pulses, pairs_of, right, search_rows, search_summary
from fwclass.train.sample import Sample

MACHINE_SEARCH = "machine-search"


@dataclass(frozen=True)
class MachineTrial:
    """One (C, gamma, fold); `key` names its part."""

    key: str
    c: float
    gamma: float
    fold: int


def trials(plan: Plan) -> list[MachineTrial]:
    """All trials of the settings, fold by fold of every pair."""
    svm = plan.config.compare.rbf_svm
    return [MachineTrial(f"{c:g}-{g:g}-{f:02d}", c, g, f) for c, g in pairs_of(svm) for f in range(svm.folds)]


def searches(plan: Plan) -> bool:
    """Whether the settings name more than one pair of C and gamma."""
    return plan.config.train.method == "rbf-svm" and len(pairs_of(plan.config.compare.rbf_svm)) > 1


def folds_of_squares(block: float, gap: float) -> Places:
    """Squares of `block` [m], folds of which lie `gap` [m] apart."""
    return Places(block, partial(make_folds, block, gap))


def make_folds(block: float, gap: float, sample: Sample, folds: int) -> Folding:
    """Folds of whole squares; of consecutive pulses where the training areas have too few squares, which is noted."""
    if len(sample.place) == 0:
        return by_pulses(sample, folds)
    x, y = sample.place[:, 0].astype(np.float64) * 0.001, sample.place[:, 1].astype(np.float64) * 0.001
    try:
        division = spatial_folds(x, y, sample.y, block, gap, folds)
    except InputError as fault:
        note = f"C and gamma were searched in pieces of consecutive pulses: {fault.got} (select.block)"
        return by_pulses(sample, folds, note)
    return Folding(division.fold, ~division.near, blocks=division.blocks)


def judge(
    here: StageInputs,
    sample: Sample,
    trial: tuple[float, float, int],
    svm: RbfSvmParams,
    scaling: str,
    weights: object,
    places: Places,
) -> Result:
    """What one trial has right."""
    searched = search_rows(sample, svm, places.edge)
    c, gamma, fold = trial
    return right(searched, places.folding(searched, svm.folds), fold, c, gamma, svm, scaling, weights)


def gather_trials(
    inputs: PartInputs, parts: tuple[str, ...], sample: Sample, svm: RbfSvmParams, places: Places
) -> dict[str, object]:
    """What all trials together say; see `search_summary`."""
    searched = search_rows(sample, svm, places.edge)
    pairs = pairs_of(svm)
    metas = [{n: int(inputs.meta(MACHINE_SEARCH, p)[n]) for n in ("right", "judged")} for p in parts]
    counts = [metas[k * svm.folds : (k + 1) * svm.folds] for k in range(len(pairs))]
    return search_summary(searched.rows, places.folding(searched, svm.folds), pairs, counts)
