"""A model that meets data unlike its own says so, and ends with exit code 4 where most of it is."""

from __future__ import annotations

import json

import laspy
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey

from fwclass.report.drift import with_returns

FEATURES = "survey.features=[amplitude,zc,height_range_c100]"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A run ``r`` with its model, and ``loud.las``: the same points with 200 times their intensity."""
    place = tmp_path_factory.mktemp("drift")
    small_survey(place)
    ended = fwclass("run", "s.yaml", "--out", "r", "--workers", 0, "--set", FEATURES, cwd=place)
    assert ended.returncode == 0, ended.stderr
    las = laspy.read(place / "a.las")
    las.intensity = np.asarray(las.intensity) * 200
    las.write(place / "loud.las")
    return place


def test_at_home_nothing_is_said(place):
    report = json.loads((place / "r" / "report.json").read_text())
    assert set(report["drift"]["outside"]) == {"amplitude", "zc", "height_range_c100"}
    assert max(report["drift"]["outside"].values()) < 0.05 and report["drift"]["remarks"] == []
    ended = fwclass("classify", "a.las", "home.las", "--model", "r/model", cwd=place)
    assert ended.returncode == 0 and "has not seen" not in ended.stderr, ended.stderr


def test_another_scale_of_intensity_is_said_and_ends_with_4(place):
    ended = fwclass("classify", "loud.las", "o.las", "--model", "r/model", cwd=place)
    assert ended.returncode == 4 and "100 % of amplitude" in ended.stderr and (place / "o.las").is_file()
    ended = fwclass("classify", "loud.las", "o2.las", "--model", "r/model", "--accept-drift", "--json", cwd=place)
    assert ended.returncode == 0 and json.loads(ended.stdout)["drift"]["outside"]["amplitude"] == 1.0
    assert "the model has not seen such data" in ended.stderr
    assert (place / "o.las").read_bytes() == (place / "o2.las").read_bytes()


def test_a_run_by_a_given_model_says_it_too(place):
    words = ("run", "s.yaml", "--workers", 0, "--set", "survey.sources=[loud.las]", "--set", "survey.model=r/model")
    ended = fwclass(*words, "--out", "m", cwd=place)
    assert ended.returncode == 4 and "the model has not seen such data" in ended.stderr, ended.stderr
    assert "100 % of amplitude" in (place / "m" / "report.html").read_text()
    again = fwclass(*words, "--out", "m", "--accept-drift", cwd=place)
    assert again.returncode == 0, again.stderr
    tiles = fwclass(*words, "--out", "n", "--accept-drift", "--set", "tile.size=40", cwd=place)
    assert tiles.returncode == 0
    one, other = (json.loads((place / n / "report.json").read_text())["drift"] for n in ("m", "n"))
    assert one == other


def test_a_card_has_the_density_and_sparser_data_is_told(place):
    """Also where no feature is one of density; the exit code stays."""
    card = json.loads((place / "r" / "model" / "card.json").read_text())
    drift = json.loads((place / "r" / "report.json").read_text())["drift"]
    assert drift["density"]["learned"] == card["density"] and 0.5 < drift["density"]["here"] / card["density"] < 2
    las = laspy.read(place / "a.las")
    las.points = las.points[np.arange(0, len(las.points), 4)]
    las.write(place / "sparse.las")
    ended = fwclass("classify", "sparse.las", "o4.las", "--model", "r/model", "--accept-drift", "--json", cwd=place)
    told = json.loads(ended.stdout)["drift"]
    assert told["density"]["learned"] == card["density"] > 2 * told["density"]["here"] > 0
    assert f"the model learned from {card['density']:.2g} echoes per m²" in ended.stderr, ended.stderr
    words = ("run", "s.yaml", "--workers", 0, "--set", "survey.sources=[sparse.las]", "--set", "survey.model=r/model")
    ended = fwclass(*words, "--out", "sparse", "--accept-drift", "--accept-implausible", cwd=place)
    assert f"the model learned from {card['density']:.2g} echoes per m²" in ended.stderr, ended.stderr
    cut = fwclass(
        "train", "s.yaml", "--model", "cut", "--out", "c", "--set", "tile.size=17", "--set", FEATURES, cwd=place
    )
    assert cut.returncode == 0, cut.stderr
    assert json.loads((place / "cut" / "card.json").read_text())["density"] == card["density"], "tiles cut squares"


def test_training_areas_as_narrow_as_a_corridor_teach_no_other_density(place):
    """They were counted by their own echoes, the survey by the area that its echoes cover: two measures."""
    x0, y0, x1, y1 = _bounds(place)
    strips = [[x, y0, x + 0.3, y1] for x in np.arange(x0 + 1, x0 + 0.6 * (x1 - x0), 1.0).tolist()]
    areas = f"areas.train={strips}"
    ended = fwclass("run", "s.yaml", "--out", "narrow", "--workers", 0, "--set", FEATURES, "--set", areas, cwd=place)
    assert ended.returncode == 0, ended.stderr
    drift = json.loads((place / "narrow" / "report.json").read_text())["drift"]
    wide = json.loads((place / "r" / "report.json").read_text())["drift"]
    assert drift["density"]["here"] == wide["density"]["here"] == pytest.approx(drift["density"]["learned"], rel=0.2)
    assert "echoes per m²" not in ended.stderr


def _bounds(place):
    las = laspy.read(place / "a.las")
    return float(las.x.min()), float(las.y.min()), float(las.x.max()), float(las.y.max())


def test_a_model_of_before_says_nothing(place):
    """Its card does not hold what it has seen."""
    import shutil

    shutil.copytree(place / "r" / "model", place / "old", symlinks=False)
    for path in (place / "old").iterdir():
        path.chmod(0o644)
    card = json.loads((place / "old" / "card.json").read_text())
    del card["ranges"]
    (place / "old" / "card.json").write_text(json.dumps(card))
    ended = fwclass("classify", "loud.las", "o3.las", "--model", "old", cwd=place)
    assert ended.returncode == 0 and "does not say what it has seen" in ended.stderr, ended.stderr


def test_a_survey_without_the_returns_that_a_model_learned_by_ends_with_4(place):
    las = laspy.read(place / "a.las")
    several = np.asarray(las.classification) == 5
    las.number_of_returns, las.return_number = np.where(several, 2, 1), np.where(several, 2, 1)
    las.write(place / "several.las")
    features = "survey.features=[number_of_echoes,height_above_ground,height_range_c100]"
    words = ("--set", "survey.sources=[several.las]", "--set", features)
    ended = fwclass("train", "s.yaml", "--model", "by", "--no-assess", "--out", "b", "--workers", 0, *words, cwd=place)
    assert ended.returncode == 0, ended.stderr
    las.number_of_returns[:], las.return_number[:] = 1, 1
    las.write(place / "single.las")
    words = ("classify", "single.las", "o5.las", "--model", "by", "--overwrite")
    ended = fwclass(*words, cwd=place)
    assert ended.returncode == 4 and "pulses of up to 2 echoes, every pulse here has one" in ended.stderr, ended.stderr
    ended = fwclass(*words, "--accept-drift", cwd=place)
    assert ended.returncode == 0 and "every pulse here has one" in ended.stderr, ended.stderr
    given = ("--set", "survey.sources=[single.las]", "--set", "survey.model=by", "--set", "areas.train=[]")
    ended = fwclass("run", "s.yaml", "--out", "s", "--workers", 0, *given, cwd=place)
    assert ended.returncode == 4 and "by returns that this survey does not have" in ended.stderr, ended.stderr
    accepted = (*given, "--accept-drift", "--accept-implausible")
    ended = fwclass("run", "s.yaml", "--out", "s", "--workers", 0, *accepted, cwd=place)
    assert ended.returncode == 0 and "every pulse here has one" in ended.stderr, ended.stderr
    assert "every pulse here has one" in (place / "s" / "report.html").read_text()


def test_bare_ground_needs_no_returns():
    def said(card, single, ground, echoes=1000):
        made = with_returns({"remarks": ["before"]}, card, single and {"single": True}, ground, echoes)
        assert made["remarks"] == ["before", *filter(None, [made["returns"]])]
        return made["returns"]

    card = {"ranges": {"number_of_echoes": [1.0, 4.0]}}
    assert said(card, True, 950) == ""
    assert "50 % of the echoes" in said(card, True, 500)
    assert with_returns({"remarks": []}, card, {"single": False}, 500, 1000) == {"returns": "", "remarks": []}
    for other in ({}, {"ranges": {"number_of_echoes": [1.0, 1.0]}}, {"ranges": {"zc": [0.0, 9.0]}}):
        assert said(other, True, 500) == ""
    assert said(card, None, 500) == said(card, True, 0, 0) == ""
