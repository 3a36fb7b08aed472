"""Costs as a dry run measured them: from the receipts of the parts that it really made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fwclass.conf.planning import StageCost
from fwclass.graph.outputs import DELIVER_STRIP
from fwclass.graph.stages import STAGES
from fwclass.operate.estimate.amounts import Amount
from fwclass.operate.estimate.estimate import Costs, Estimate
from fwclass.store.receipts import Receipt
from fwclass.store.run_store import Store

WHOLE = frozenset(s.name for s in STAGES if s.over == "survey")
"""Parts of a whole survey: those of a few tiles tell nothing of their memory."""


@dataclass(frozen=True)
class MeasuredCosts:
    """What a dry run told.

    Attributes
    ----------
    costs : of every stage; those in `stages` are measured, the others as they were.
    stages : names.
    parts : made.
    seconds : of all of them.
    peak_mib : the most memory that a process took which made one of them.
    """

    costs: Costs
    stages: tuple[str, ...]
    parts: int
    seconds: float
    peak_mib: float


def measure_costs(store: Store, costs: Costs, work: Mapping[str, Amount]) -> MeasuredCosts:
    """Costs from all receipts of `store`.

    A stage's time of a unit is the median over its parts, less what a part costs that holds nothing, so that the parts
    that were compiled for do not count. `work` tells how many echoes a tile has around it.
    """
    by_stage, seconds, parts, peak = dict(costs), 0.0, 0, 0.0
    counted = _units(store, work)
    for directory in sorted(p for p in store.directory.iterdir() if p.is_dir() and p.name != "staging"):
        receipts = list(store.receipts(directory.name))
        seconds, parts = seconds + sum(r.seconds for r in receipts), parts + len(receipts)
        if directory.name not in WHOLE:
            peak = max((peak, *(r.peak_mib for r in receipts)))
        units = counted.get(directory.name, {})
        observed = [(r.seconds, units[r.part], _bytes(r)) for r in receipts if units.get(r.part, 0) > 0]
        if observed and directory.name in by_stage:
            amount = work.get(directory.name)
            around = amount.units / amount.written if amount else 1.0
            by_stage[directory.name] = _cost(by_stage[directory.name], observed, around)
    return MeasuredCosts(by_stage, tuple(sorted(n for n in by_stage if by_stage[n] != costs[n])), parts, seconds, peak)


def measured_base(measured_costs: MeasuredCosts, estimate: Estimate, base_mib: float) -> float:
    """Memory of a worker that holds nothing [MiB], so that the most reckoned for what ran is what it took.

    `estimate` was reckoned with `base_mib`.
    """
    needs = [
        s.memory_mib - base_mib for s in estimate.stages if s.name in measured_costs.stages and s.name not in WHOLE
    ]
    return max(0.0, measured_costs.peak_mib - max(needs, default=0.0))


def _cost(known: StageCost, observed: list[tuple[float, float, float]], around: float) -> StageCost:
    """`around`: units of a part, its halo's too, over those that it writes for."""
    seconds, units, written = (np.array(v, float) for v in zip(*observed, strict=True))
    each = float(np.median(np.maximum(0.0, seconds - known.part * 1e-3) / units)) * 1e6
    stored = known.stored if known.waves else float(written.sum() / units.sum()) * around
    return known.model_copy(update={"each": round(each, 3), "stored": round(stored, 2)})


def _bytes(receipt: Receipt) -> float:
    return float(sum(int(o["bytes"]) for o in receipt.outputs.values()))


def _units(store: Store, work: Mapping[str, Amount]) -> dict[str, dict[str, float]]:
    """Units of every part, by stage and part."""
    rows = {r.part: float(r.meta["rows"]) for r in store.receipts("tile")}
    read = [r for stage in ("read", "decompose") for r in store.receipts(stage) if "returns" in r.meta]
    pulses = {r.part: float(r.meta["waveforms"] or r.meta["returns"]) for r in read}
    units: dict[str, dict[str, float]] = {}
    for stage in STAGES:
        name = stage.name
        if stage.unit == "reference":
            units[name] = {r.part: float(r.meta["rows"]) for r in store.receipts(name)}
        elif stage.over == "chunk":
            units[name] = pulses
        elif stage.over == "strip" and name != DELIVER_STRIP.name:
            count = "points" if stage.unit == "point" else "pulses"
            units[name] = {r.part: float(r.meta[count]) for r in store.receipts("index")}
        elif stage.over == "block" and stage.unit == "echo":
            units[name] = {r.part: _pieces(r.meta) for r in store.receipts(name)}
        elif stage.over == "tile" and name in work:
            around = work[name].units / work[name].parts / (work["tile"].units / work["tile"].parts)
            units[name] = {part: n * around if stage.reads else n for part, n in rows.items()}
    return units


def _pieces(meta: Mapping[str, Any]) -> float:
    """Echoes that a block owns."""
    return float(sum(int(n) for _, n in meta.get("pieces", ())))
