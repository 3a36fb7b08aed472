"""Dense surveys take longer than the one that the costs were measured on, and one that no survey is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fwclass import conf
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.operate.estimate.costs import costs_of_survey, density_known, too_dense
from fwclass.operate.estimate.headers import PointSample, SurveyFacts, simulated_facts
from fwclass.workflows import workflow_of

SIX = ("height_range_r100", "height_std_r100", "height_std_c200", "planarity_r100", "planarity_k20", "echo_ratio_r100")

begin = workflow_of("classification").begin


def facts_at(config: conf.Config, density: float, even: float = 1.0) -> SurveyFacts:
    return replace(simulated_facts(config), sample=PointSample(Path("a.las"), 1000, density, even, 1.2))


@pytest.fixture(scope="module")
def config() -> conf.Config:
    return conf.load(Path(__file__).parents[2] / "conf" / "surveys" / "demo.yaml", [])


def test_features_take_longer_where_neighbourhoods_hold_more(config: conf.Config) -> None:
    plain = config.plan.stages["features"].each + config.plan.feature * len(COMPUTE_FEATURES.columns(begin(config)))
    each = [
        costs_of_survey(begin(config), facts_at(config, d))["features"].each for d in (1.0, 4.0, 33.0, 330.0, 3300.0)
    ]
    assert each[0] == each[1] == plain and plain < each[2] < each[3] < each[4]
    assert each[4] - plain == pytest.approx(10.0 * (each[3] - plain), rel=0.02)
    others = costs_of_survey(begin(config), facts_at(config, 330.0))
    same = config.plan.stages.keys() - {"features", "publish-tile"}
    assert all(others[name] == config.plan.stages[name] for name in same)


def test_as_many_features_are_stored_and_delivered(config: conf.Config) -> None:
    """Of 127 features an echo takes some 340 bytes of the store; 12 were planned for however many."""
    many, few = (replace(config, survey=config.survey.model_copy(update={"features": n})) for n in (SIX, SIX[:2]))
    none = replace(many, publish=config.publish.model_copy(update={"parquet_features": "none"}))
    stored = {
        name: [costs_of_survey(begin(c), facts_at(config, 1.0))[name].stored for c in (few, many, none)]
        for name in ("features", "publish-tile")
    }
    features, tiles = stored["features"], stored["publish-tile"]
    more = len(COMPUTE_FEATURES.columns(begin(many))) - len(COMPUTE_FEATURES.columns(begin(few)))
    assert features[1] - features[0] == pytest.approx(more * config.plan.feature_bytes) and more >= 3
    assert features[2] == features[1]
    assert tiles[1] - tiles[0] == pytest.approx(4 * config.plan.delivered_bytes)
    assert tiles[2] == config.plan.stages["publish-tile"].stored


def test_looking_for_water_is_planned(config: conf.Config) -> None:
    facts = simulated_facts(config)
    waves = replace(facts, sources=tuple(replace(s, waves=True) for s in facts.sources))
    asked = replace(config, bathymetry=config.bathymetry.model_copy(update={"enabled": True}))
    plain, wet = (costs_of_survey(begin(c), waves)["decompose"].each for c in (config, asked))
    assert wet - plain == config.plan.water > 10 * plain


def test_of_echoes_that_do_not_all_count_the_time_has_a_bound(config: conf.Config) -> None:
    """Known are the sample and the header: a file in no order shows its density in the header alone."""
    facts = facts_at(config, 1.0, even=1e6)
    assert density_known(facts) == 1e6 and too_dense(config, facts)
    bound = config.features.dense_echoes / config.features.dense_cell**2
    below = costs_of_survey(begin(config), facts_at(config, 0.99 * bound))["features"].each
    assert costs_of_survey(begin(config), facts)["features"].each < 0.01 * below
    assert not too_dense(config, facts_at(config, 0.99 * bound))
    assert density_known(simulated_facts(config)) == 0.0
