"""Dense surveys take longer than the one that the costs were measured on, and one that no survey is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fwclass import conf
from fwclass.operate.estimate.costs import costs_of_survey, density_known, too_dense
from fwclass.operate.estimate.headers import Sample, SurveyFacts, simulated_facts
from fwclass.workflows import workflow_of

begin = workflow_of("classification").begin


def facts_at(config: conf.Config, density: float, even: float = 1.0) -> SurveyFacts:
    return replace(simulated_facts(config), sample=Sample(Path("a.las"), 1000, density, even, 1.2))


@pytest.fixture(scope="module")
def config() -> conf.Config:
    return conf.load(Path(__file__).parents[2] / "conf" / "surveys" / "demo.yaml", [])


def test_features_take_longer_where_neighbourhoods_hold_more(config: conf.Config) -> None:
    plain = config.plan.stages["features"].each
    each = [
        costs_of_survey(begin(config), facts_at(config, d))["features"].each for d in (1.0, 4.0, 33.0, 330.0, 3300.0)
    ]
    assert each[0] == each[1] == plain and plain < each[2] < each[3] < each[4]
    assert each[4] - plain == pytest.approx(10.0 * (each[3] - plain), rel=0.02)
    others = costs_of_survey(begin(config), facts_at(config, 330.0))
    assert all(others[name] == cost for name, cost in config.plan.stages.items() if name != "features")


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
