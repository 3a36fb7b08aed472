"""Dense surveys take longer than the one that the costs were measured on, and one that no survey is told."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import lasmaker
import numpy as np
import pytest

from fwclass import conf
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.operate.estimate.costs import costs_of_survey, density_known, too_dense
from fwclass.operate.estimate.forecast import make_forecast
from fwclass.operate.estimate.headers import PointSample, SurveyFacts, simulated_facts, survey_facts
from fwclass.operate.estimate.limits import room_at
from fwclass.store.run_store import Store
from fwclass.workflows import workflow_of

SIX = ("height_range_r100", "height_std_r100", "height_std_c200", "planarity_r100", "planarity_k20", "echo_ratio_r100")

begin = workflow_of("classification").begin


def facts_at(config: conf.Config, density: float, even: float = 1.0) -> SurveyFacts:
    return replace(simulated_facts(config), sample=PointSample(Path("a.las"), 1000, density, even, 1.2))


@pytest.fixture(scope="module")
def config() -> conf.Config:
    return conf.load(Path(__file__).parents[2] / "conf" / "surveys" / "demo.yaml", [])


def test_files_without_waveforms_are_reckoned_by_costs_of_their_own(config: conf.Config) -> None:
    """By their share of the echoes; classes by the ground filter too. Both were reckoned as a fit and a forest."""
    facts, plan = simulated_facts(config), config.plan
    with_waves = [True] * len(facts.sources)
    for waves, share in ((with_waves, 0.0), ([False] * len(with_waves), 1.0), ([False, *with_waves[1:]], None)):
        some = replace(facts, sources=tuple(replace(s, waves=w) for s, w in zip(facts.sources, waves, strict=True)))
        costs = costs_of_survey(begin(config), some)
        for name, other in plan.of_returns.items():
            if share is None:
                assert other.each < costs[name].each < plan.stages[name].each, name
            else:
                assert costs[name].each == (1.0 - share) * plan.stages[name].each + share * other.each, name
                assert costs[name].held == plan.stages[name].held == other.held, name
        assert costs["classify"] == plan.stages["classify"]
    ground = replace(begin(config), names=())
    assert costs_of_survey(ground, facts)["classify"] == plan.of_ground["classify"]


@pytest.mark.slow
def test_a_survey_of_returns_is_planned_by_what_it_takes(tmp_path: Path) -> None:
    """Four to ten times as much was planned, and 16 to 39 times for its classes."""
    rng = np.random.default_rng(0)
    xyz = np.c_[rng.uniform(0, 120, (120_000, 2)), rng.uniform(0, 3, 120_000)].round(2)
    lasmaker.write_las(tmp_path / "a.las", xyz, point_format=6, scale=0.01)
    (tmp_path / "s.yaml").write_text("survey: {name: s, sources: [a.las], crs: 'EPSG:2154'}")
    line = [sys.executable, "-m", "fwclass", "run", tmp_path / "s.yaml", "--workflow", "ground", "--workers", "0"]
    subprocess.run([*line, "--accept-implausible", "--out", tmp_path / "run"], check=True, capture_output=True)
    begun = workflow_of("ground").begin(conf.load(tmp_path / "s.yaml", classifies=False))
    stages = workflow_of("ground").stages
    forecast = make_forecast(begun, survey_facts(begun.config, tmp_path), 0, room_at(tmp_path), stages=stages)
    planned, store = {s.name: s for s in forecast.estimate.stages}, Store(tmp_path / "run")
    for name in ("decompose", "split", "tile", "classify"):
        receipts = list(store.receipts(name))
        assert planned[name].bytes < 2.5 * sum(o["bytes"] for r in receipts for o in r.outputs.values()) + 20_000, name
        assert planned[name].seconds < 3.0 * sum(r.seconds for r in receipts), name


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


MEASURED = {
    "km_*.laz": (
        39.0,
        {"tile": 4.0, "ground-filter": 6.6, "terrain": 4.5, "publish-tile": 4.4, "publish-rasters": 3.3},
    ),
    "urban_*.laz": (7.8, {"ground-filter": 0.87, "terrain": 0.90, "publish-tile": 0.79, "publish-strip": 0.69}),
}
"""Processor time [s] of the parts of `--workflow ground`, two workers on cores that other work had too: of all, and of
some stages. Two square kilometres of 0.26 points/m2, and a town of 28."""


@pytest.mark.parametrize("files", MEASURED)
def test_ground_of_returns_takes_half_to_twice_of_what_is_planned(
    files: str, shared_data: Path, tmp_path: Path
) -> None:
    """A town's was planned with 2.2 times the processor time, its tiles with 4.6 times, its ground with 3.8."""
    survey = f"survey: {{name: s, directory: {shared_data / 'ign_hd'}, sources: ['{files}'], crs: 'EPSG:2154'}}"
    (tmp_path / "s.yaml").write_text(survey)
    ground = workflow_of("ground")
    begun = ground.begin(conf.load(tmp_path / "s.yaml", classifies=False))
    facts, room = survey_facts(begun.config, shared_data / "ign_hd"), room_at(tmp_path)
    estimate = make_forecast(begun, facts, 2, room, stages=ground.stages).estimate
    whole, stages = MEASURED[files]
    planned = {s.name: s.seconds for s in estimate.stages}
    assert whole / 2 < estimate.seconds < 2 * whole
    for name, seconds in stages.items():
        assert seconds / 2 < planned[name] < 2 * seconds, name
