"""Numbers that no stage can work with are refused when the configuration is read."""

from __future__ import annotations

import pytest

from fwclass import conf
from fwclass.errors import ConfigError


@pytest.mark.parametrize(
    "setting",
    [
        "label.max_distance=-1",
        "label.max_distance=0",
        "label.max_distance=1e9",
        "label.max_distance=.nan",
        "assess.block=0",
        "assess.quantiles=[0.5, 50]",
        "assess.quantiles=[]",
        "assess.min_kappa=2",
        "assess.objects.classes=[boat]",
        "assess.objects.sizes=[10, 2]",
        "assess.objects.cell=0",
        "papers.seeds=[-1]",
        "papers.block=-5",
        "papers.test_echoes=0",
        "papers.repeats=0",
        "thin.rate=0",
        "thin.rate=1.5",
        "thin.cell=0",
        "thin.reach=0",
        "thin.seed=-1",
        "select.rates=[0, 2]",
        "select.folds=1",
        "select.block=0",
        "select.gap=-1",
        "select.drop=1",
        "select.least=0",
        "compare.linear_svm.c=0",
        "compare.rbf_svm.gamma=[0]",
        "compare.boosting.learning_rate=2",
        "features.cell_x=0",
        "features.nearest_reach=0",
        "features.optimal_radii=[2, 1]",
        "features.pulse_reach=0",
        "train.trees=0",
        "train.bagging=0",
        "train.samples_per_class=0",
        "areas.gap=-1",
    ],
)
def test_a_number_out_of_bounds_is_refused(setting: str) -> None:
    with pytest.raises(ConfigError, match=setting.split("=", maxsplit=1)[0].split(".")[0]):
        conf.load("demo", (setting,))


@pytest.mark.parametrize(
    "setting",
    [
        "areas.gap=yes",
        "survey.trajectory.undulation=true",
        "areas.train=[[true, 0.0, 9.0, 9.0]]",
        "street.radii=[true]",
        "features.optimal_radii=[true, 2.0]",
        "survey.classes=[{name: ground, code: yes}, {name: plants, code: 5}]",
    ],
)
def test_yes_is_no_number_wherever_it_stands(setting: str) -> None:
    with pytest.raises(ConfigError, match="neither true nor false"):
        conf.load("demo", (setting,))
