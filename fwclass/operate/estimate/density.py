"""What a survey's density does to the time of its features: every echo meets all that lie around it."""

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


def costs_at_density(begun: Plan, facts: SurveyFacts) -> Costs:
    """`plan.stages` with the time of features raised by the echoes that spheres and cylinders hold beyond those of the
    survey that the costs were measured on; where not all of them count, by those that do."""
    config = begun.config
    plan, costs, density = config.plan, dict(config.plan.stages), density_known(facts)
    if "features" not in costs or density <= plan.density:
        return costs
    count, share = density, 1.0
    if too_dense(config, facts):
        count = 1.0 / config.features.dense_step**2
        share = count / density
    asked = neighbourhood_features(begun)
    radii = [config.features.normal_radius, *(s.metres for s in asked.of_kind("rc"))]
    radii += [r for _ in asked.of_kind("o") for r in config.features.optimal_radii]
    met = max(count - plan.density, 0.0) * sum(math.pi * r * r for r in radii) * share
    cost = costs["features"]
    return costs | {"features": cost.model_copy(update={"each": cost.each + met * plan.neighbour * 1e-3})}
