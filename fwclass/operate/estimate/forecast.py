"""The forecast of a run: what the survey holds, what it will take, whether it fits, and which tiles suit it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fwclass.conf import Config
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stages import STAGES
from fwclass.operate.estimate.amounts import SurveyCounts, amounts, crowding, tile_halo
from fwclass.operate.estimate.costs import costs_of_survey, too_dense
from fwclass.operate.estimate.estimate import Choice, Estimate, choices, estimate_run, propose_size
from fwclass.operate.estimate.headers import SurveyFacts, with_returns
from fwclass.operate.estimate.limits import Limit, Room, allowed_mib, limits
from fwclass.operate.estimate.measured import MeasuredCosts, measure_costs, measured_base
from fwclass.operate.estimate.spread import Spread, spread_of
from fwclass.store.run_store import Store


@dataclass(frozen=True)
class Forecast:
    """See the modules of its parts. `begun` is what the stages are planned by before any file is read; `workers` 0 is
    the plain loop; `halo` is the widest around a tile [m]."""

    begun: Plan
    facts: SurveyFacts
    counts: SurveyCounts
    tiles: Spread
    halo: float
    crowding: float
    workers: int
    room: Room
    estimate: Estimate
    choices: tuple[Choice, ...]
    best: Choice | None
    limits: tuple[Limit, ...]
    measured: MeasuredCosts | None = None

    @property
    def config(self) -> Config:
        """The configuration that it is made by."""
        return self.begun.config

    @property
    def fits(self) -> bool:
        """No limit is exceeded."""
        return all(limit.fits for limit in self.limits)


def make_forecast(
    begun: Plan,
    facts: SurveyFacts,
    workers: int,
    room: Room,
    trial: Store | None = None,
    stages: Sequence[Stage] = STAGES,
) -> Forecast:
    """What `stages` will take, which are planned by `begun` (`Workflow.begin`), by the costs of section `plan`, or, as
    far as it goes, by receipts of a dry run, `trial`."""
    config, of_waveforms = begun.config, facts
    begun, facts = with_returns(begun, facts)
    size, counts = config.tile.size, SurveyCounts.of(config, facts)
    observed = measure_costs(trial, config.plan.stages, amounts(begun, facts, size, stages)) if trial else None
    costs = observed.costs if observed else costs_of_survey(begun, facts)
    estimate = estimate_run(begun, facts, size, workers, costs, stages)
    if observed:
        base = measured_base(observed, estimate, config.plan.base_mib)
        config = replace(config, plan=config.plan.model_copy(update={"base_mib": base}))
        begun = replace(begun, config=config)
        estimate = estimate_run(begun, facts, size, workers, costs, stages)
    compared = tuple(choices(begun, facts, workers, costs, allowed_mib(config, workers, room), stages))
    best = propose_size(config, list(compared))
    return Forecast(
        begun,
        of_waveforms,
        counts,
        spread_of(counts.pieces(facts), size),
        tile_halo(begun, stages),
        crowding(config, facts),
        workers,
        room,
        estimate,
        compared,
        best,
        tuple(limits(config, estimate, workers, room, best)),
        observed,
    )


def as_json(forecast: Forecast, written: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Plain data: sizes in metres, times in seconds, memory in MiB, disk in bytes."""
    facts, estimate, sample = forecast.facts, forecast.estimate, forecast.facts.sample
    tiles = forecast.tiles
    return {
        "survey": forecast.config.survey.name,
        "files": len(facts.sources),
        "simulated": facts.simulated,
        "box": list(facts.box.bounds),
        "points": round(float(forecast.counts.points.sum())),
        "pulses": round(float(forecast.counts.pulses.sum())),
        "echoes": round(float(forecast.counts.echoes.sum())),
        "reference_points": facts.reference_points,
        "sample": None
        if sample is None
        else {
            "file": sample.path.name,
            "points": sample.points,
            "density": sample.density,
            "even": sample.even,
            "returns_per_pulse": sample.returns_per_pulse,
            "too_dense": too_dense(forecast.config, facts),
        },
        "tiles": {
            "size": tiles.size,
            "number": tiles.number,
            "halo": forecast.halo,
            "mean_echoes": float(tiles.counts.sum()) / max(1, tiles.number),
            "most_echoes": float(tiles.counts.max()) * forecast.crowding,
            "crowding": forecast.crowding,
        },
        "workers": forecast.workers,
        "memory_mib": estimate.largest.memory_mib,
        "memory_stage": estimate.largest.name,
        "disk_bytes": round(estimate.bytes),
        "free_bytes": round(forecast.room.free),
        "seconds": estimate.seconds,
        "wall_seconds": estimate.wall,
        "compile_seconds": estimate.compile_seconds,
        "stages": [_stage(forecast, k) for k in range(len(estimate.stages))],
        "without_cost": list(estimate.unknown),
        "proposed": None if forecast.best is None else forecast.best.size,
        "choices": [
            {
                "size": c.size,
                "tiles": c.tiles,
                "wall_seconds": c.wall,
                "memory_mib": c.memory_mib,
                "enough": c.enough,
                "fits": c.fits,
            }
            for c in forecast.choices
        ],
        "limits": [
            {"what": m.what, "needed": m.needed, "allowed": m.allowed, "unit": m.unit, "fits": m.fits}
            for m in forecast.limits
        ],
        "fits": forecast.fits,
        "dry_run": None
        if forecast.measured is None
        else {
            "stages": list(forecast.measured.stages),
            "parts": forecast.measured.parts,
            "seconds": forecast.measured.seconds,
            "peak_mib": forecast.measured.peak_mib,
        },
        "outputs": [str(p) for p in written],
    }


def _stage(forecast: Forecast, k: int) -> dict[str, Any]:
    stage = forecast.estimate.stages[k]
    real = forecast.measured is not None and stage.name in forecast.measured.stages
    return {
        "name": stage.name,
        "parts": stage.amount.parts,
        "unit": stage.unit,
        "units": stage.amount.units,
        "seconds": stage.seconds,
        "longest_seconds": stage.longest,
        "bytes": round(stage.bytes),
        "memory_mib": stage.memory_mib,
        "source": "dry run" if real else "conf",
    }
