"""The papers' workflows on a small simulated survey: figures that belong together, pages, resuming."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from browser import seen
from runmaker import SETTINGS

from fwclass import conf
from fwclass.errors import ConfigError
from fwclass.operate.request import Request
from fwclass.operate.seams.walk import SeamRequest, seams
from fwclass.operate.status.replay import task_alone
from fwclass.operate.status.walk import RunStatus, Silent, look_at
from fwclass.report.summary import summary
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.store.lock import writer
from fwclass.store.run_store import Store
from fwclass.workflows import WORKFLOWS

SMALL = (
    *SETTINGS,
    "survey.classes=[{name: ground, code: 2, codes: [2]}, {name: building, code: 6, codes: [6]},"
    " {name: vegetation, code: 5, codes: [3, 4, 5]}]",
    "papers.more_classes=[{name: artificial, code: 64, codes: [64]}]",
    "papers.block=10",
    "papers.seeds=[1, 2]",
    "papers.test_echoes=20000",
    "papers.repeats=2",
    "select.block=15",
    "select.folds=2",
    "select.trees=4",
    "select.samples_per_class=500",
    "select.timing_repeats=1",
    "select.timing_echoes=1000",
    "select.rates=[1.0, 0.1]",
    "select.drop=0.5",
    "select.least=3",
    "compare.rbf_svm.max_rows=1000",
    "compare.rbf_svm.search_rows=300",
    "compare.rbf_svm.gamma=[0.3]",
)


def follow(name: str, survey: Path, root: Path, *settings: str, tiles=None):
    config = conf.load("demo", (*SMALL, f"survey.directory={survey}", *settings))
    root.mkdir(parents=True, exist_ok=True)
    with writer(root), Display() as display:
        runner = Runner(root, Loop(), display)
        report = WORKFLOWS[name](config, runner, tiles)
        runner.publish(config.run.keep_generations)
        return runner, report


@pytest.fixture(scope="module")
def fan(survey: Path, begun: Callable[[str], Path]):
    """(root, facts) of the workflow fan2013."""
    root = begun("fan")
    runner, _ = follow("fan2013", survey, root, "survey.features=fan2013-six", "features.also=[backscatter]")
    assert not runner.failures
    return root, json.loads((root / "fan2013.json").read_text())


@pytest.mark.slow
def test_variants_are_judged_on_the_same_echoes(fan) -> None:
    _, facts = fan
    made = [*facts["splits"].values(), *facts["machines"].values(), *facts["thesis"]["with"], facts["every_feature"]]
    rows = [np.sum(one["confusion"], axis=1).tolist() for one in made]
    assert all(r == rows[0] for r in rows)
    assert rows[0] == [facts["rows"][c["name"]][1] for c in facts["classes"]]
    assert list(facts["splits"]) == ["3", "4", "5", "6"]


@pytest.mark.slow
def test_classes_that_the_paper_lacks_are_told_but_do_not_count(fan) -> None:
    _, facts = fan
    assert sum(facts["unscored"]["artificial"].values()) == facts["rows"]["artificial"][1] > 0
    assert facts["splits"]["3"]["classes"] == ["ground", "building", "vegetation"]
    assert facts["every_class"]["classes"][-1] == "artificial"
    assert np.sum(facts["every_class"]["confusion"]) == sum(n for _, n in facts["rows"].values())


@pytest.mark.slow
def test_three_features_per_split_is_the_run_s_own_forest(fan) -> None:
    """int(lb 6 + 1) = 3: the variant must repeat the run's own trees; seed 1 with waveforms is the same forest too."""
    _, facts = fan
    assert facts["splits"]["3"]["confusion"] == facts["thesis"]["with"][0]["confusion"]
    own = json.loads((fan[0] / "model" / "card.json").read_text())
    assert facts["splits"]["3"]["out_of_bag"] == pytest.approx(own["out_of_bag"]["accuracy"])


@pytest.mark.slow
def test_differences_are_those_of_the_accuracies(fan) -> None:
    _, facts = fan
    for k, seed in enumerate(facts["thesis"]["seeds"]):
        one = facts["differences"][f"with-{seed}/without-{seed}"]["overall_accuracy"]
        gain = facts["thesis"]["with"][k]["overall_accuracy"] - facts["thesis"]["without"][k]["overall_accuracy"]
        assert one["value"] == pytest.approx(gain)
        assert one["low"] <= one["value"] <= one["high"]
    assert facts["thesis"]["features"]["without"] == ["zc", "echo_number", "echo_ratio_r100", "inclination_r100"]


@pytest.mark.slow
def test_every_claim_has_a_verdict_and_the_page_stands_alone(fan) -> None:
    root, facts = fan
    assert len(facts["claims"]) == 14
    assert {c["verdict"] for c in facts["claims"]} <= {"holds", "does not hold", "undecided", "not comparable"}
    page = (root / "fan2013.html").read_text()
    assert "http" not in page.replace("http-equiv", "")
    assert page.count("data:image/png") == 4
    for claim in facts["claims"]:
        assert claim["verdict"] in page


@pytest.mark.slow
def test_a_second_run_makes_nothing_and_says_where_the_page_is(fan, survey: Path) -> None:
    root, facts = fan
    runner, report = follow("fan2013", survey, root, "survey.features=fan2013-six", "features.also=[backscatter]")
    assert {o.status for o in runner.outcomes.values()} == {"skipped"}
    assert f"page        {root / 'fan2013.html'}" in summary(report, root).splitlines()
    assert json.loads((root / "fan2013.json").read_text()) == {
        **facts,
        "selection": json.loads((root / "fan2013.json").read_text())["selection"],
    }


def looked_at(name: str, survey: Path, root: Path, *settings: str) -> RunStatus:
    config = conf.load("demo", (*SMALL, f"survey.directory={survey}", *settings))
    return look_at(root, lambda runner: WORKFLOWS[name](config, runner))


@pytest.mark.slow
def test_status_tells_the_page_s_own_parts(fan, survey: Path) -> None:
    root, _ = fan
    settings = ("survey.features=fan2013-six", "features.also=[backscatter]")
    looked = looked_at("fan2013", survey, root, *settings)
    assert looked.all_done and {"select-trial", "paper-judged", "paper-time", "publish-tile"} <= {
        s for s, _ in looked.states
    }
    assert set(looked.states) == set(Store(root).parts())
    looked = looked_at("fan2013", survey, root, *settings, "select.trees=5")
    assert {s for (s, _), one in looked.states.items() if one.standing != "done"} == {"select-trial"}
    assert looked.ends is not None and looked.ends.startswith("select-trial/") and looked.ends.endswith(" is stale")
    more = SMALL[len(SETTINGS)].replace("]}]", "]}, {name: water, code: 9, codes: [9]}]")
    looked = looked_at("fan2013", survey, root, *settings, more)  # trials of three classes tell nothing of four
    assert looked.ends is not None and looked.ends.startswith("select-") and looked.ends.endswith(" is stale")
    looked = looked_at("fan2013", survey, root, *settings, "papers.seeds=[1, 2, 3]")
    assert not looked.all_done and "is missing" in (looked.ends or "")


def test_the_figures_need_the_whole_survey(survey: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="whole survey"):
        follow("fan2013", survey, tmp_path, tiles=frozenset({"5120_54030"}))
    with pytest.raises(ConfigError, match="trains its own"):
        follow("xiong2018", survey, tmp_path, "survey.model=some/model")
    with pytest.raises(ConfigError, match="code is given twice"):
        follow("fan2013", survey, tmp_path, "papers.more_classes=[{name: roof, code: 6, codes: [7]}]")
    with pytest.raises(ConfigError, match="too few features of the paper"):
        follow("fan2013", survey, tmp_path, "survey.features=[height_above_ground]", "features.also=[]")


NAMES = ["height_above_ground", *(f"{b}_r{r}" for r in (50, 100) for b in ("height_std", "inclination", "egi"))]
XIONG = (
    f"survey.features=[{', '.join(NAMES)}]",
    "features.also=[]",
    "train.split=exact",
    "train.criterion=gini",
    "train.bagging=0.9",
    "train.replacement=false",
    "papers.more_classes=[]",
)


@pytest.fixture(scope="module")
def xiong(survey: Path, tmp_path_factory: pytest.TempPathFactory):
    """(root, facts) of the workflow xiong2018 with few features."""
    root = tmp_path_factory.mktemp("xiong")
    runner, report = follow("xiong2018", survey, root, *XIONG)
    assert not runner.failures
    return root, json.loads((root / "xiong2018.json").read_text()), report


@pytest.mark.slow
def test_the_run_classifies_by_what_the_selection_kept(xiong) -> None:
    root, facts, report = xiong
    card = json.loads((root / "model" / "card.json").read_text())
    assert card["features"] == facts["chosen"] == report["training"]["features"]
    assert facts["strategies"]["rf_selected"]["features"] == len(facts["chosen"])
    assert facts["strategies"]["rf"]["features"] == 7


@pytest.mark.slow
def test_omission_and_commission_are_those_of_the_matrix(xiong) -> None:
    _, facts, _ = xiong
    for one in facts["strategies"].values():
        matrix = np.array(one["confusion"])
        lost, taken = matrix.sum(axis=1) - np.diag(matrix), matrix.sum(axis=0) - np.diag(matrix)
        for k, name in enumerate(one["classes"]):
            assert one["omission"][name] == pytest.approx(lost[k] / matrix[k].sum())
            if matrix[:, k].any():
                assert one["commission"][name] == pytest.approx(taken[k] / matrix[:, k].sum())


@pytest.mark.slow
def test_survivors_and_importances_count_every_feature_once(xiong) -> None:
    root, facts, _ = xiong
    survivors = [n for r in facts["radii"] for n in r["ours"]]
    assert len(survivors) == len([n for n in facts["chosen"] if n != "height_above_ground"])
    assert sorted(r["name"] for r in facts["importance"]["rows"]) == sorted(facts["candidates"])
    assert facts["importance"]["rows"][0]["score"] == pytest.approx(100)
    assert [s["rate"] for s in facts["thinning"]["steps"]] == [1.0, 0.1]
    assert (root / "xiong2018.html").read_text().count("data:image/png") == 5


@pytest.mark.slow
def test_status_replay_and_seams_of_a_run_that_chooses_its_features(xiong, survey: Path, tmp_path: Path) -> None:
    root = tmp_path / "copy"
    shutil.copytree(xiong[0], root, symlinks=True)
    looked = looked_at("xiong2018", survey, root, *XIONG)
    assert looked.all_done
    assert {"select-ranked", "select-cost", "select-rate", "paper-importance", "classify"} <= {
        s for s, _ in looked.states
    }
    shutil.rmtree(root / "store" / "paper-judged" / "rf")
    looked = looked_at("xiong2018", survey, root, *XIONG)
    waiting = [name for name, state in looked.states.items() if state.standing != "done"]
    assert waiting[0] == ("paper-judged", "rf") and {stage for stage, _ in waiting[1:]} == {"paper-difference"}
    assert looked.ends == "paper-judged/rf is missing"
    work = task_alone(looked, "paper-judged/rf", Request("demo", str(root), workflow="xiong2018"))
    assert work.name == ("paper-judged", "rf")
    config = conf.load("demo", (*SMALL, f"survey.directory={survey}", *XIONG))
    found = seams(config, root, SeamRequest((31.0, 17.0), 0.5, None, None, "xiong2018"), Silent())
    assert sum(s.differ for s in found.bounded) == 0 < sum(s.rows for s in found.bounded)
    assert {"features", "classify", "ground"} <= {s.stage for s in found.bounded}


@pytest.mark.slow
def test_features_that_the_paper_lacks_are_computed_once(survey: Path, tmp_path: Path) -> None:
    """The selection looks at the paper's own among them, in the tables that the run has anyway."""
    more = ("survey.features=[height_above_ground, amplitude, width, zc, height_std_r100]", "features.also=[egi_r50]")
    runner, _ = follow("fan2013", survey, tmp_path, *more, "papers.more_classes=[]")
    assert not runner.failures, runner.failures
    assert looked_at("fan2013", survey, tmp_path, *more, "papers.more_classes=[]").all_done
    runner, _ = follow("fan2013", survey, tmp_path, *more, "papers.more_classes=[]")
    assert {o.status for o in runner.outcomes.values()} == {"skipped"}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "claims"), [("fan2013", 14), ("xiong2018", 13)])
def test_a_survey_that_has_little_of_what_a_paper_has_gets_its_page(
    name: str, claims: int, survey: Path, tmp_path: Path
) -> None:
    """Two features, one that only a waveform tells: the claims on all others are not comparable, none ends the run."""
    runner, _ = follow(
        name, survey, tmp_path, "survey.features=[amplitude, width]", "features.also=[]", "papers.more_classes=[]"
    )
    assert not runner.failures
    facts = json.loads((tmp_path / f"{name}.json").read_text())
    assert len(facts["claims"]) == claims
    verdicts = {c["name"]: c["verdict"] for c in facts["claims"]}
    lacking = {"zc_alone", "steps", "split", "waveform", "tree_ratio", "height_statistics", "echoes", "nh_first"}
    assert {verdicts[n] for n in lacking & set(verdicts)} == {"not comparable"}
    assert (tmp_path / f"{name}.html").read_text().count("not comparable") >= 4


SHI = (
    "survey.features=[height_above_ground, height_variance_r100, pulse_intensity_variance, echo_ratio_r100]",
    "features.also=[inclination_r100, plane_std_r100]",
    "papers.more_classes=[]",
    "train.method=rbf-svm",
    "terrain.height=nearest",
    "compare.scaling=minmax",
    "compare.rbf_svm.c=[1.0, 10.0]",
    "compare.rbf_svm.folds=2",
    "compare.rbf_svm.trim=nearest",
    "classify.refine.between=[building, vegetation]",
    "classify.refine.features=shares",
    "classify.refine.scales=[0.6, 1.5, 3]",
    "classify.refine.samples_per_class=300",
)


@pytest.fixture(scope="module")
def shi_run(survey, tmp_path_factory):
    root = tmp_path_factory.mktemp("shi") / "run"
    runner, report = follow("shi2019", survey, root, *SHI)
    assert not runner.failures, runner.failures
    return root, json.loads((root / "shi2019.json").read_text()), report


@pytest.mark.slow
def test_shi_figures_belong_together(shi_run, survey):
    root, facts, report = shi_run
    assert set(facts["steps"]) == {"without_heights", "iptd", "iptd_heights", "svm_all", "svm", "nn_svm"}
    rows = [np.sum(one["confusion"], axis=1).tolist() for one in facts["steps"].values()]
    assert all(r == rows[0] for r in rows), "all steps answer the same echoes"
    at = [[r[0] for r in facts["steps"][n]["confusion"]] for n in ("iptd", "iptd_heights")]
    assert at[0] == at[1] and sum(at[0]) > 0, "the filter alone says what is ground"
    assert facts["steps"]["nn_svm"]["vectors"] < facts["steps"]["svm"]["vectors"]
    layers = facts["layers"]
    assert layers["fine"]["confusion"] == report["accuracy"]["confusion"], "the page judges what the run delivers"
    inside = np.array(layers["fine"]["confusion"]) - np.array(layers["fine_boundary"]["confusion"])
    before = np.array(layers["coarse"]["confusion"]) - np.array(layers["coarse_boundary"]["confusion"])
    np.testing.assert_array_equal(inside, before)
    kept = SHI[0].split("[")[1][:-1].split(", ")
    assert {n for n, _ in facts["fscores"]} == {*kept, "inclination_r100", "plane_std_r100"}
    page = (root / "shi2019.html").read_text()
    assert page.count("data:image/png") >= 4 and "Two squares" in page
    assert "What each step brings" in page and "Where the two classes meet" in page
    search = json.loads((root / "model" / "coarse" / "card.json").read_text())["search"]
    assert len(search["tried"]) == 2 and search["folds"] == 2


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize(("name", "of"), [("fan2013", "fan"), ("xiong2018", "xiong"), ("shi2019", "shi_run")])
def test_a_page_fits_its_window(name, of, width, request):
    path = request.getfixturevalue(of)[0] / f"{name}.html"
    page = seen(path.resolve(), width)
    assert page.width <= width, "no sideways scroll"
    assert page.requests == []
    assert path.stat().st_size < 2 << 20


@pytest.mark.slow
def test_shi_run_again_makes_nothing(shi_run, survey):
    runner, _ = follow("shi2019", survey, shi_run[0], *SHI)
    assert {o.status for o in runner.outcomes.values()} == {"skipped"}


def test_shi_needs_a_second_layer(survey, tmp_path):
    with pytest.raises(ConfigError, match="second layer"):
        follow("shi2019", survey, tmp_path, *SHI, "classify.refine.between=[]")
