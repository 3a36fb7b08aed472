"""`fwclass train` and `fwclass classify`: what they write, and what they refuse."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from commandline import fwclass
from pyproj import CRS
from smallsurvey import small_survey
from tolerances import FLOAT32_UNIT

from fwclass import conf
from fwclass.cli import cli
from fwclass.errors import ConfigError, InputError
from fwclass.graph.model_fit import check_computed, check_model
from fwclass.model import FORMAT, LEAF, LinearMachine, assemble
from fwclass.store.models import load_model, save_model

sys.path.insert(0, str(Path(__file__).parent))


def call(*words):
    return CliRunner().invoke(cli, [str(w) for w in words])


def card(names, codes, **more):
    classes = [{"name": f"c{c}", "code": c, "codes": [c]} for c in codes]
    ready = {"fill": [0.0] * len(names), "shift": [0.0] * len(names), "scale": [1.0] * len(names)}
    return {"format": FORMAT, "features": list(names), "classes": classes, "preparation": ready, "computed": {}, **more}


@pytest.fixture
def model(tmp_path):
    """Bright points are the second class, others the first."""
    made = LinearMachine(np.array([[0.1, 0.0]]), np.array([-50.0]), card(("intensity", "number_of_echoes"), (2, 64)))
    save_model(tmp_path / "m", made)
    return tmp_path / "m"


def cloud(path, n=300, point_format=6):
    r = np.random.default_rng(4)
    head = laspy.LasHeader(point_format=point_format, version="1.4" if point_format > 5 else "1.2")
    head.scales, head.offsets = [0.001] * 3, [500_000, 5_000_000, 0]
    head.add_crs(CRS.from_epsg(32633))
    las = laspy.LasData(head)
    las.x, las.y, las.z = (r.random((3, n)) * 50).T.T + np.array([[500_000], [5_000_000], [100]])
    las.intensity = r.integers(0, 1000, n)
    las.return_number = las.number_of_returns = np.ones(n, np.uint8)
    las.gps_time = r.permutation(n).astype(float)
    las.user_data = np.arange(n) % 200
    las.write(path)
    return path


def test_points_keep_their_order_and_get_class_confidence_and_entropy(tmp_path, model):
    source = cloud(tmp_path / "in.las")
    made = call("classify", source, tmp_path / "out.laz", "--model", model, "--json")
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    old, new = laspy.read(source), laspy.read(tmp_path / "out.laz")
    for name in ("X", "Y", "Z", "intensity", "gps_time", "user_data"):
        np.testing.assert_array_equal(old[name], new[name])
    bright = np.asarray(old.intensity) > 500
    np.testing.assert_array_equal(new.classification, np.where(bright, 64, 2))
    score = 0.2 * (np.asarray(old.intensity, float) * 0.5 - 250)
    share = 1 / (1 + np.exp(-np.abs(score)))
    entropy = -(share * np.log2(share) + (1 - share) * np.log2(np.maximum(1 - share, 1e-300)))
    for name, values in (("confidence", share), ("entropy", entropy)):
        step = float(next(d for d in new.point_format.dimensions if d.name == name).scales[0])
        assert step <= 0.02
        np.testing.assert_allclose(new[name], values, atol=0.5001 * step)
    assert told["points"] == 300 and told["classes"] == {"2": int((~bright).sum()), "64": int(bright.sum())}
    assert told["kind"] == "linear-svm" and told["filled"] == 0


def test_every_class_has_its_share_where_asked(tmp_path, model):
    source = cloud(tmp_path / "in.las")
    asked = ("--set", "classify.probabilities=true")
    assert call("classify", source, tmp_path / "out.laz", "--model", model, *asked).exit_code == 0
    new = laspy.read(tmp_path / "out.laz")
    np.testing.assert_allclose(new["probability 2"] + new["probability 64"], 1, atol=FLOAT32_UNIT)


def test_old_point_formats_cannot_hold_every_class(tmp_path, model):
    source = cloud(tmp_path / "in.las", point_format=1)
    made = call("classify", source, tmp_path / "out.laz", "--model", model)
    assert isinstance(made.exception, ConfigError) and "--legacy-code 64=" in str(made.exception)
    assert not (tmp_path / "out.laz").exists()
    assert call("classify", source, tmp_path / "out.laz", "--model", model, "--legacy-code", "64=20").exit_code == 0
    assert set(np.unique(laspy.read(tmp_path / "out.laz").classification)) == {2, 20}


def test_a_class_brings_its_legacy_code(tmp_path):
    told = card(("intensity",), (2, 64))
    told["classes"][1]["legacy_code"] = 31
    save_model(tmp_path / "m", LinearMachine(np.full((1, 1), 0.2), np.full(1, -100.0), told))
    for form, codes in ((1, {2, 31}), (6, {2, 64})):
        source = cloud(tmp_path / f"in{form}.las", point_format=form)
        made = call("classify", source, tmp_path / f"out{form}.laz", "--model", tmp_path / "m")
        assert made.exit_code == 0, made.output
        assert set(np.unique(laspy.read(tmp_path / f"out{form}.laz").classification)) == codes
    told["classes"][1]["legacy_code"] = 64
    save_model(tmp_path / "n", LinearMachine(np.full((1, 1), 0.2), np.full(1, -100.0), told))
    made = call("classify", source, tmp_path / "out.laz", "--model", tmp_path / "n")
    assert isinstance(made.exception, InputError) and "legacy code" in str(made.exception)


def test_heights_of_another_filter_than_the_models_are_told(tmp_path):
    for learned in ("csf", "smrf"):
        told = card(("height_above_ground",), (2, 64), computed={"ground": learned})
        save_model(tmp_path / learned, LinearMachine(np.ones((1, 1)), np.zeros(1), told))
        source = cloud(tmp_path / "in.las")
        words = ("--model", tmp_path / learned, "--method", "smrf", "--accept-drift")
        made = call("classify", source, tmp_path / f"{learned}.laz", *words)
        assert made.exit_code == 0, made.output
        assert ("--method csf" in made.stderr) == (learned == "csf")


def test_heights_by_another_way_than_the_models_are_told(tmp_path):
    told = card(("height_above_ground",), (2, 64), computed={"ground": "smrf", "height": "nearest"})
    save_model(tmp_path / "m", LinearMachine(np.ones((1, 1)), np.zeros(1), told))
    source = cloud(tmp_path / "in.las")
    words = ("--model", tmp_path / "m", "--method", "smrf", "--accept-drift")
    made = call("classify", source, tmp_path / "tin.laz", *words)
    assert made.exit_code == 0 and "--set terrain.height=nearest" in made.stderr
    made = call("classify", source, tmp_path / "nearest.laz", *words, "--set", "terrain.height=nearest")
    assert made.exit_code == 0 and "terrain.height" not in made.stderr


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("nope.laz", "out.laz"), "no such file"),
        (("in.las", "out.txt"), "written as LAS or LAZ"),
        (("in.las", "out.laz", "--legacy-code", "46=20"), "no class of code 46"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_any_work(tmp_path, model, monkeypatch, words, told):
    cloud(tmp_path / "in.las")
    monkeypatch.chdir(tmp_path)
    made = call("classify", *words, "--model", model)
    assert isinstance(made.exception, (ConfigError, InputError)) and told in str(made.exception)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.las", "m"]


def test_nothing_is_overwritten_unasked(tmp_path, model):
    source, output = cloud(tmp_path / "in.las"), tmp_path / "out.laz"
    output.write_bytes(b"precious")
    made = call("classify", source, output, "--model", model)
    assert isinstance(made.exception, ConfigError) and output.read_bytes() == b"precious"
    assert call("classify", source, output, "--model", model, "--overwrite").exit_code == 0
    assert isinstance(call("classify", source, source, "--model", model, "--overwrite").exception, ConfigError)


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("intensity", "width"), "'width'"),
        (("backscatter", "intensity"), "'backscatter'"),
        (("nonsense", "a"), "'nonsense'"),
    ],
)
def test_a_feature_that_the_file_lacks_is_named(tmp_path, names, told):
    save_model(
        tmp_path / "m",
        LinearMachine(np.ones((1, 2)), np.zeros(1), card(names, (2, 6), computed={"normal_radius": 1.0})),
    )
    made = call("classify", cloud(tmp_path / "in.las"), tmp_path / "out.laz", "--model", tmp_path / "m")
    assert isinstance(made.exception, (ConfigError, InputError)) and told in str(made.exception)
    assert not (tmp_path / "out.laz").exists()


def test_no_two_classes_are_written_as_one_code(tmp_path, model):
    for words, told in ((["64=2"], "c2 and c64"), (["64=9", "2=9"], "code 9")):
        asked = [w for word in words for w in ("--legacy-code", word)]
        made = call("classify", cloud(tmp_path / "in.las"), tmp_path / "out.las", "--model", model, *asked)
        assert isinstance(made.exception, ConfigError) and told in str(made.exception)
    asked = ("--legacy-code", "64=2", "--legacy-code", "2=64")
    made = call("classify", cloud(tmp_path / "in.las"), tmp_path / "out.las", "--model", model, *asked)
    assert made.exit_code == 0, made.output


def stump(names, **more):
    leaf = (np.array([LEAF], np.uint16), np.zeros(1, np.float32), np.zeros(1, np.uint32))
    return assemble([leaf], card(names, (2, 6), **more))


@pytest.mark.parametrize(
    ("name", "computed", "told"),
    [
        ("zc", {"cell_x": 5.0, "cell_y": 10.0}, "cell_x"),
        ("zc", {}, "cell_x"),
        ("height_std_k20", {"nearest_reach": 1.0}, "nearest_reach"),
        ("linearity_opt", {"optimal_radii": [1.0]}, "optimal_radii"),
        ("pulse_intensity_variance", {"pulse_reach": 5.0}, "pulse_reach"),
        ("pulse_intensity_variance", {"noise_counts": True}, "noise_counts"),
    ],
)
def test_features_computed_in_another_way_are_refused(tmp_path, name, computed, told):
    save_model(tmp_path / "m", stump((name,), computed=computed))
    made = call("classify", cloud(tmp_path / "in.las"), tmp_path / "out.laz", "--model", tmp_path / "m")
    assert isinstance(made.exception, ConfigError) and told in str(made.exception)


def test_a_card_that_is_silent_on_parameters_said_later_is_accepted():
    check_computed(stump(("pulse_intensity_variance",), computed={}), conf.section("features"), "m")


def test_other_classes_than_the_survey_s_are_refused():
    config = conf.load("demo")
    codes = [c.code for c in config.classes]
    check_model(
        assemble(
            [(np.array([LEAF], np.uint16), np.zeros(1, np.float32), np.zeros(1, np.uint32))],
            card(("intensity",), codes),
        ),
        config,
        "m",
    )
    with pytest.raises(ConfigError, match="other classes"):
        check_model(stump(("intensity",)), config, "m")


def test_what_is_no_model_is_refused(tmp_path):
    (tmp_path / "m").mkdir()
    made = call("classify", cloud(tmp_path / "in.las"), tmp_path / "out.laz", "--model", tmp_path / "m")
    assert isinstance(made.exception, InputError) and "not a model" in str(made.exception)


@pytest.mark.parametrize(
    "words", [(), ("--model", "m", "--compare", "all"), ("--compare", "all", "--method", "boosting")]
)
def test_train_wants_a_model_or_a_comparison(words):
    assert call("train", "demo", *words).exit_code == 2


def test_train_refuses_before_it_works(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("dear")
    save_model(tmp_path / "old", stump(("intensity",)))
    for target, more in (("full", ("--overwrite",)), ("old", ()), ("full/letter.txt/x", ())):
        made = call("train", "demo", "--model", tmp_path / target, "--out", tmp_path / "run", *more)
        assert isinstance(made.exception, ConfigError), target
    for words in (("--model", tmp_path / "x", "--method", "oracle"), ("--compare", "forest,oracle")):
        made = call("train", "demo", "--out", tmp_path / "run", *words)
        assert isinstance(made.exception, ConfigError) and "oracle" in str(made.exception)
        assert f"where: {words[-2]}" in str(made.exception)
    words = ("--model", tmp_path / "x", "--set", "train.class_weights={bilding: 3}")
    made = call("train", "demo", "--out", tmp_path / "run", *words)
    assert isinstance(made.exception, ConfigError) and "did you mean 'building'" in str(made.exception)
    assert not (tmp_path / "run").exists() and (tmp_path / "full" / "letter.txt").exists()


@pytest.mark.parametrize("words", [("--model", "m"), ("--compare", "forest,boosting")])
def test_train_says_before_it_works_that_nothing_is_left_to_test_on(tmp_path: Path, words: tuple[str, ...]) -> None:
    path = small_survey(tmp_path)
    line = ("train", path, words[0], tmp_path / "m" if words[1] == "m" else words[1], "--out", tmp_path / "r")
    ended = fwclass(*line, "--workers", 0, "--set", "areas.train=all")
    assert ended.returncode == 2 and "all of the survey trains" in ended.stderr and "--no-assess" in ended.stderr
    assert not list((tmp_path / "r").glob("store/index/*")), "files were read"
    ended = fwclass(*line, "--workers", 0, "--set", "areas.train=[[0, 0, 1000000, 10000000]]")
    assert ended.returncode != 0 and "no tile lies in a test area" in ended.stderr, ended.stderr
    assert not (tmp_path / "r" / "store" / "features").exists() and not (tmp_path / "r" / "store" / "train").exists()
    if words[1] == "m":
        assert fwclass(*line, "--workers", 0, "--set", "areas.train=all", "--no-assess").returncode == 0


def test_select_wants_something_to_choose(tmp_path):
    for asked, told in (
        ("zc", "nothing to choose"),
        ("height_std_r100", "nothing to choose"),
        ("fan2014", "no such feature set"),
        ("zc,planarity_k999", "at most 500"),
    ):
        words = ("--method", "forward", "--candidates", asked, "--out", tmp_path / "run", "--workers", 0)
        made = call("select", "demo", *words)
        assert isinstance(made.exception, ConfigError), made.output
        assert told in str(made.exception) and "where: --candidates" in str(made.exception)


def test_what_a_training_tells():
    from fwclass.study.training_text import describe

    drop = {f"f{k:02d}": {"mean": k / 100, "std": 0.001} for k in range(12)}
    told = {
        "kind": "forest",
        "features": list(drop),
        "samples": [6, 4],
        "notes": ["odd"],
        "classes": [{"name": "ground"}, {"name": "roof"}],
        "importance": {"repeats": 3, "drop": drop},
        "out_of_bag": {"accuracy": 0.75, "rows": 8, "per_class": [0.5, None]},
    }
    text = describe({"card": told, "accuracy": None})
    assert "75.00 % right (ground 50.00, roof n/a, judged on 8 of 10 rows)" in text and "guessing" not in text
    assert text.index("f11") < text.index("f10") and "f02" in text and "f01" not in text and "and 2 more" in text
    assert "11.00 ± 0.10 %" in text
    blind = {**told, "out_of_bag": {"accuracy": 0.0, "rows": 4, "per_class": [0.0, 0.0]}, "importance": None}
    assert "no better than guessing" in describe({"card": blind, "accuracy": None})
    blind["out_of_bag"] = {"accuracy": None, "rows": 0, "per_class": [None, None]}
    assert "out of bag  n/a" in describe({"card": blind, "accuracy": None})


@pytest.mark.slow
def test_train_compare_and_classify_a_simulated_survey(tmp_path):
    small = ("--set", "simulate.size=80", "--set", "simulate.strips=2")
    assert call("simulate", "demo", "--out", tmp_path / "s", "--workers", 0, *small).exit_code == 0
    settings = (
        f"survey.directory={tmp_path / 's'}",
        "survey.features=[echo_number,amplitude,width,number_of_echoes]",
        "areas.train=[[512000,5403000,512040,5403080]]",
        "areas.gap=2",
        "ground.block=64",
        "terrain.block=64",
        "train.trees=8",
        "train.samples_per_class=1000",
        "features.also=[]",
    )
    words = ("--out", tmp_path / "run", "--workers", 0, *(w for s in settings for w in ("--set", s)))
    made = call("train", "demo", "--model", tmp_path / "m", "--json", *words)
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    assert told["accuracy"]["overall_accuracy"] > 0.5
    assert load_model(tmp_path / "m").card["computed"].keys() == {"quantities"}
    assert isinstance(call("train", "demo", "--model", tmp_path / "m", *words).exception, ConfigError)
    made = call(
        "train", "demo", "--model", tmp_path / "m", "--overwrite", "--method", "boosting", "--no-assess", *words
    )
    assert made.exit_code == 0 and load_model(tmp_path / "m").kind == "boosting"
    made = call("train", "demo", "--compare", "forest,linear-svm", "--json", *words)
    both = json.loads(made.stdout)["classifiers"]
    assert [b["method"] for b in both] == ["forest", "linear-svm"]
    assert np.sum(both[0]["figures"]["confusion"]) == np.sum(both[1]["figures"]["confusion"])
    assert both[0]["figures"]["overall_accuracy"] == told["accuracy"]["overall_accuracy"]
    strip = next((tmp_path / "s" / "strips").glob("*.las"))
    made = call("classify", strip, tmp_path / "out.laz", "--model", tmp_path / "m", "--legacy-code", "64=20")
    assert made.exit_code == 0, made.output
    assert (tmp_path / "out.wdp").exists() and len(laspy.read(tmp_path / "out.laz").points) == len(
        laspy.read(strip).points
    )


def test_a_model_that_learned_with_noise_among_neighbours_says_so(tmp_path: Path) -> None:
    survey, model = small_survey(tmp_path), tmp_path / "m"
    words = ("--set", "features.noise_counts=true", "--workers", "0")
    assert fwclass("train", survey, "--model", model, "--out", tmp_path / "t", *words).returncode == 0
    line = ("classify", tmp_path / "a.las", tmp_path / "out.las", "--model", model, "--crs", "EPSG:25832")
    refused = fwclass(*line)
    assert refused.returncode == 2 and "--set features.noise_counts=True" in refused.stderr, refused.stderr
    assert fwclass(*line, *words[:2]).returncode == 0
    loaded = load_model(model)
    computed = {n: v for n, v in loaded.card["computed"].items() if n != "noise_counts"}
    save_model(tmp_path / "older", replace(loaded, card={**loaded.card, "computed": computed}))
    older = fwclass(*line[:4], tmp_path / "older", *line[5:], "--overwrite")
    assert older.returncode == 0, older.stderr
