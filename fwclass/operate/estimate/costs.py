"""What the costs of a survey's stages depend on: waveforms, its features, its density, as every echo meets all that lie
around it, and water."""

from __future__ import annotations

import math

from fwclass.conf import Config
from fwclass.conf.planning import StageCost
from fwclass.graph.features import COMPUTE_FEATURES, neighbourhood_features
from fwclass.graph.ground_classes import CLASSIFY_GROUND
from fwclass.graph.outputs import DELIVER_TILE, delivered_features
from fwclass.graph.stage import Plan
from fwclass.operate.estimate.amounts import SurveyCounts
from fwclass.operate.estimate.estimate import Costs
from fwclass.operate.estimate.headers import SurveyFacts


def density_known(facts: SurveyFacts) -> float:
    """The greatest density that is known before anything is read [1/m²]: of the sample, or of its file's header; 0
    where nothing was read."""
    return max(facts.sample.density, facts.sample.even) if facts.sample else 0.0


def too_dense(config: Config, facts: SurveyFacts) -> bool:
    """So many echoes lie on level ground that not all of them count in neighbourhoods (`features.dense_echoes`)."""
    return density_known(facts) > config.features.dense_echoes / config.features.dense_cell**2


def costs_of_survey(begun: Plan, facts: SurveyFacts) -> Costs:
    """`plan.stages`, or what stands instead of them, by the share of echoes without waveforms and for classes by the
    ground filter; with what as many features take at the survey's density, and the time of a search for water."""
    plan, costs = begun.config.plan, dict(begun.config.plan.stages)
    counts = SurveyCounts.of(begun.config, facts)
    share = float(counts.echoes[~counts.waves].sum()) / max(float(counts.echoes.sum()), 1.0)
    costs |= {n: _between(costs[n], cost, share) for n, cost in plan.of_returns.items() if n in costs}
    costs |= plan.of_ground if CLASSIFY_GROUND.when(begun) else {}
    columns = len(COMPUTE_FEATURES.columns(begun))
    time = columns * plan.feature + _neighbours_met(begun, facts) * plan.neighbour * 1e-3
    more = {
        COMPUTE_FEATURES.name: (time, columns * plan.feature_bytes),
        DELIVER_TILE.name: (0.0, len(delivered_features(begun)) * plan.delivered_bytes),
    }
    if begun.config.bathymetry.enabled and any(s.waves for s in facts.sources):
        more["decompose"] = (plan.water, 0.0)
    return costs | {n: _with_more(costs[n], *amounts) for n, amounts in more.items() if n in costs}


def _between(cost: StageCost, other: StageCost, share: float) -> StageCost:
    """`cost` without a `share` of it, 0 to 1, and that of `other`."""
    both = cost.model_dump(), other.model_dump()
    return StageCost(**{n: (1.0 - share) * value + share * both[1][n] for n, value in both[0].items()})


def _with_more(cost: StageCost, each: float, stored: float) -> StageCost:
    return cost.model_copy(update={"each": cost.each + each, "stored": cost.stored + stored})


def _neighbours_met(begun: Plan, facts: SurveyFacts) -> float:
    """Echoes that the spheres and cylinders of an echo hold beyond those of the survey that the costs were measured on;
    where not all of them count, those that do."""
    config, density = begun.config, density_known(facts)
    if density <= config.plan.density:
        return 0.0
    count, share = density, 1.0
    if too_dense(config, facts):
        count = 1.0 / config.features.dense_step**2
        share = count / density
    asked = neighbourhood_features(begun)
    radii = [config.features.normal_radius, *(s.metres for s in asked.of_kind("rc"))]
    radii += [r for _ in asked.of_kind("o") for r in config.features.optimal_radii]
    return max(count - config.plan.density, 0.0) * sum(math.pi * r * r for r in radii) * share
