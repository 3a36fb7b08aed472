"""Feature sets: the shipped ones are what the papers list, a user's own are read and refused in words."""

from __future__ import annotations

import pytest

from fwclass import conf
from fwclass.conf.sets import feature_set, shipped_sets
from fwclass.errors import ConfigError
from fwclass.schema import column


def test_shipped_sets_are_of_declared_columns_and_have_the_papers_sizes():
    sizes = {name: len(feature_set(name).features) for name in shipped_sets()}
    assert (sizes["fan2013"], sizes["fan2013-six"], sizes["shi2019"], sizes["xiong2018"]) == (7, 6, 6, 127)
    for name in shipped_sets():
        names = feature_set(name).features
        assert [column(feature).name for feature in names] == list(names)
    assert set(feature_set("fan2013").features) - set(feature_set("fan2013-six").features) == {"backscatter"}


def test_a_file_of_one_s_own_beside_the_survey(tmp_path):
    (tmp_path / "mine.yaml").write_text("features: [zc]\neach:\n- {bases: [planarity, linearity], scales: [r50, k20]}")
    want = ("zc", "planarity_r50", "linearity_r50", "planarity_k20", "linearity_k20")
    assert feature_set("mine.yaml", tmp_path).features == want
    assert feature_set(str(tmp_path / "mine.yaml")).features == want
    assert feature_set(str(tmp_path / "mine.yaml")).name == "mine"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("about: nothing", "without features"),
        ("features: [zc, zc]", "twice"),
        ("featurs: [zc]", "not a feature set"),
        ("features: 3", "not a feature set"),
        ("- zc", "mapping"),
    ],
)
def test_a_faulty_file_is_refused(tmp_path, text, word):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(ConfigError, match=word):
        feature_set("bad.yaml", tmp_path)


def test_wrong_entries_of_a_list_are_told_without_its_length():
    with pytest.raises(ConfigError, match=r"select\.rates\.0") as told:
        conf.load("demo", ("select.rates=[0, 2]",))
    assert "select.rates.1" in str(told.value) and "at least 1 item" not in str(told.value)
    with pytest.raises(ConfigError, match="at least one is wanted"):
        conf.load("demo", ("select.rates=[]",))


def test_class_weights_are_of_the_survey_s_classes():
    assert conf.load("demo", ("train.class_weights={building: 3}",)).train.class_weights == {"building": 3.0}
    with pytest.raises(ConfigError, match=r"bilding[\s\S]*train\.class_weights[\s\S]*did you mean 'building'"):
        conf.load("demo", ("train.class_weights={bilding: 3}",))


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("planarity_k501", "at most 500 nearest echoes"),
        ("planarity_k0", "size must be positive"),
        ("planarty_k20", "did you mean 'planarity_k20'"),
        ("amplitud", "did you mean 'amplitude'"),
        ("backscatter", "needs the range"),
        ("count_R100", "did you mean 'count_r100'"),
        ("omnivarianc", "did you mean 'omnivariance_r100'"),
    ],
)
def test_a_survey_s_features_have_a_size_that_can_be_had(name, says):
    from fwclass.graph.stages import check_features

    config = conf.load("demo", ("survey.trajectory.files=[]", "radiometry.platform_altitude=null"))
    check_features(config, ("planarity_k500", "planarity_opt", "zc"), "here")
    with pytest.raises(ConfigError, match=says):
        check_features(config, ("zc", name), "here")


def test_an_unknown_set_names_who_asked_and_the_nearest():
    with pytest.raises(ConfigError, match=r"survey\.features[\s\S]*xiong2018"):
        conf.load("demo", ("survey.features=xiong2017",))
    assert conf.load("demo", ("survey.features=xiong2018",)).features_asked[0] == "height_above_ground"


def test_a_feature_listed_twice_is_refused_wherever_it_stands():
    with pytest.raises(ConfigError, match=r"listed twice[\s\S]*survey\.features[\s\S]*planarity_k20"):
        conf.load("demo", ("survey.features=[planarity_k20, zc, planarity_k20]",))


@pytest.mark.parametrize(
    "selection", ["{method: 1}", "{method: a, pick: b, survey: c, steps: [{size: -1}, {size: 2}]}"]
)
def test_a_selection_that_cannot_be_shown_is_none(tmp_path, selection):
    (tmp_path / "s.yaml").write_text(f"features: [zc]\nselection: {selection}\n")
    assert feature_set("s.yaml", tmp_path).selection is None
