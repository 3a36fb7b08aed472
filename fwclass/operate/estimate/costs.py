"""What raises the costs of a survey's stages: its density, as every echo meets all that lie around it, and water."""

from __future__ import annotations

import math

from fwclass.conf import Config
from fwclass.graph.features import neighbourhood_features
from fwclass.graph.stage import Plan
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
    """`plan.stages` with the time of features at the survey's density, and that of a search for water."""
    plan, costs = begun.config.plan, dict(begun.config.plan.stages)
    more = {"features": _neighbours_met(begun, facts) * plan.neighbour * 1e-3}
    if begun.config.bathymetry.enabled and any(s.waves for s in facts.sources):
        more["decompose"] = plan.water
    return costs | {n: costs[n].model_copy(update={"each": costs[n].each + us}) for n, us in more.items() if n in costs}


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
