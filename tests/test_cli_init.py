"""`fwclass init`: what it drafts is a survey file that runs, and what it cannot know it says."""

from __future__ import annotations

import json
import unicodedata
from dataclasses import replace

import lasmaker
import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from commandline import fwclass

from fwclass import conf
from fwclass.cli import cli
from fwclass.errors import InputError
from fwclass.grid import Box
from fwclass.operate.draft import areas, survey
from fwclass.operate.draft.areas import ClassPlaces, best_split
from fwclass.survey.files import find_files
from fwclass.survey.gather import directory_of

CODES = np.array([2, 5, 6])


def town(folder, name="a", n=12_000, east=0.0, codes=CODES, crs=lasmaker.UTM33, seed=0):
    """A file of points on 200 m × 60 m whose class changes every few metres; its x and codes."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 200, n), rng.uniform(0, 60, n)
    held = codes[(x // 7 + y // 9).astype(int) % len(codes)]
    xyz = np.c_[500_000 + east + x, 5_400_000 + y, 200 + (held == 6) * 8.0]
    lasmaker.write_las(
        folder / f"{name}.las", xyz, point_format=6, classification=held, gps_time=1000 + np.arange(n) * 1e-3, keys=crs
    )
    return xyz[:, 0], held


def test_a_draft_is_a_survey_that_plans(tmp_path):
    x, codes = town(tmp_path)
    ended = fwclass("init", "a.las", "--to", "s.yaml", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    config = conf.load(tmp_path / "s.yaml")
    assert [(c.name, c.code, c.codes) for c in config.survey.classes] == [
        ("ground", 2, (2,)),
        ("vegetation", 5, (3, 4, 5)),
        ("building", 6, (6,)),
    ]
    box, gap = Box(*config.areas.train[0]), config.areas.gap
    inside = (x >= box.xmin) & (x < box.xmax)
    tested = (x < box.xmin - gap) | (x >= box.xmax + gap)
    for code in CODES:
        assert (codes[inside] == code).sum() > 1000 and (codes[tested] == code).sum() > 1000
        assert f"{(codes[inside] == code).sum():,} points to train on" in (tmp_path / "s.yaml").read_text()
    planned = fwclass("plan", "s.yaml", cwd=tmp_path)
    assert planned.returncode == 0, planned.stderr


def test_standard_output_is_the_file_alone(tmp_path):
    town(tmp_path)
    alone = yaml.safe_load(fwclass("init", ".", cwd=tmp_path).stdout)
    town(tmp_path, "b", east=200.0)
    ended = fwclass("init", ".", cwd=tmp_path)
    assert ended.returncode == 0 and ended.stderr == ""
    made = yaml.safe_load(ended.stdout)
    assert all(alone["survey"][n] == made["survey"][n] for n in ("name", "sources", "directory")), "of one file too"
    assert made["survey"]["sources"] == ["*.las"] and made["survey"]["directory"] == "."
    ended = fwclass("init", "b.las", "--name", "x", cwd=tmp_path)
    assert yaml.safe_load(ended.stdout)["survey"]["sources"] == ["b.las"]
    assert yaml.safe_load(ended.stdout)["survey"]["name"] == "x"


def test_a_draft_is_not_written_onto_what_it_is_of(tmp_path):
    town(tmp_path)
    before = (tmp_path / "a.las").read_bytes()
    (tmp_path / "b.yaml").symlink_to("a.las")
    for files, to in (("a.las", "a.las"), (".", "a.las"), ("a.las", "b.yaml")):
        ended = fwclass("init", files, "--to", to, "--overwrite", cwd=tmp_path)
        assert ended.returncode == 2 and "onto itself" in ended.stderr, ended.stderr
    assert (tmp_path / "a.las").read_bytes() == before


def test_files_elsewhere_are_named_from_there(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "work").mkdir()
    town(tmp_path / "data")
    ended = fwclass("init", "../data/a.las", "--to", "s.yaml", cwd=tmp_path / "work")
    assert ended.returncode == 0, ended.stderr
    assert conf.load(tmp_path / "work" / "s.yaml").survey.directory == str(tmp_path / "data")
    again = fwclass("init", "../data/a.las", "--to", "s.yaml", cwd=tmp_path / "work")
    assert again.returncode == 2 and "exists" in again.stderr


def test_a_directory_of_las_and_laz_with_brackets_in_its_name_is_a_pattern_each(tmp_path):
    folder = tmp_path / "Los [1] Süd"
    folder.mkdir()
    town(folder, n=6000)
    town(folder, "b", n=6000, east=200.0)
    (folder / "b.las").rename(folder / "b.LAS")
    for words, sources in (((folder.name,), ["*.LAS", "*.las"]), ((f"{folder.name}/a.las",), ["a.las"])):
        (tmp_path / "s.yaml").unlink(missing_ok=True)
        ended = fwclass("init", *words, "--to", "s.yaml", cwd=tmp_path)
        assert ended.returncode == 0, ended.stderr
        config = conf.load(tmp_path / "s.yaml")
        assert [name.split("/")[-1] for name in config.survey.sources] == sources
        found = find_files(config.survey.sources, tmp_path, "", tmp_path, config.store)
        assert len(found) == len(sources) and all(path.parent == folder for path in found)


@pytest.mark.parametrize(("here", "there"), [("NFC", "NFD"), ("NFD", "NFC")])
def test_names_with_umlauts_are_found_however_they_are_written(here, there, tmp_path):
    folder = tmp_path / unicodedata.normalize(there, "Los Süd")
    folder.mkdir()
    town(folder, unicodedata.normalize(there, "Fläche"), n=600)
    pattern = unicodedata.normalize(here, "Los Süd/Fläche.*")
    assert len(find_files([pattern], tmp_path, "", tmp_path, conf.load("demo").store)) == 1
    drafted = yaml.safe_load(fwclass("init", folder, cwd=tmp_path).stdout)
    assert drafted["survey"]["name"] == "Los Süd", "no letter is lost"
    config = conf.load("p1")
    survey = config.survey.model_copy(update={"directory": pattern.split("/")[0]})
    config = replace(config, path=tmp_path / "s.yaml", survey=survey)
    assert directory_of(config, tmp_path) == folder
    (tmp_path / survey.directory).mkdir()
    assert directory_of(config, tmp_path) != folder, "what is named is there"


def test_all_files_that_cannot_be_read_are_told_at_once(tmp_path):
    for name in "abc":
        town(tmp_path, name, n=600)
        if name != "a":
            (tmp_path / f"{name}.las").write_bytes((tmp_path / f"{name}.las").read_bytes()[:300])
    ended = fwclass("init", ".", cwd=tmp_path)
    assert ended.returncode == 1 and not ended.stdout
    assert "2 of 3 source files cannot be used" in ended.stderr
    assert "b.las: " in ended.stderr and "c.las: " in ended.stderr and "a.las" not in ended.stderr


def test_what_files_do_not_tell_is_said(tmp_path):
    town(tmp_path, codes=np.array([1, 2, 64]), crs=None)
    ended = fwclass("init", "a.las", cwd=tmp_path)
    assert ended.returncode == 0
    assert "survey.crs" in ended.stderr and "fewer than two classes" in ended.stderr
    assert "64 (no code of the LAS specification" in ended.stdout and "1 (unclassified" in ended.stdout
    made = yaml.safe_load(ended.stdout)
    assert made["areas"]["train"] == [] and made["survey"]["reference"] == {"kind": "none"}
    assert ended.stdout.count("TO DO") == 3


def test_what_is_wrong_with_all_files_stands_there_once(tmp_path):
    """A line a file and fault: 500 tiles of one delivery had thousands of them above the first key."""
    for k, name in enumerate("abc"):
        town(tmp_path, name, east=200.0 * k, crs=None)
    draft = fwclass("init", ".", cwd=tmp_path).stdout
    wrong = [line for line in draft.splitlines() if line.startswith("# !")]
    assert [line for line in wrong if "CRS" in line] == [
        "# ! a.las: no usable CRS: name one in the configuration (alike in 2 other files)"
    ], wrong


def test_files_without_classes_are_no_leftovers(tmp_path):
    """Of 24,000 points half are unclassified as their file is: no class is proposed for them."""
    town(tmp_path, "Süd")
    town(tmp_path, "neu", east=200.0, codes=np.array([1]))
    draft = fwclass("init", ".", "--name", "Süd", cwd=tmp_path).stdout
    assert "# 1 file without classes, 12,000 points: neu.las" in draft and "TO DO" not in draft
    assert 'name: "Süd"' in draft and yaml.safe_load(draft)["survey"]["name"] == "Süd"


def test_sparse_files_without_classes_get_tiles_by_the_plan_of_their_terrain(tmp_path):
    xyz = np.array([500_000, 5_400_000, 0]) + np.random.default_rng(0).uniform(0, [1500, 1500, 5], (40_000, 3))
    lasmaker.write_las(tmp_path / "a.las", xyz, point_format=6, keys=lasmaker.UTM33)
    ended = fwclass("init", "a.las", cwd=tmp_path)
    assert yaml.safe_load(ended.stdout)["tile"]["size"] > 100, ended.stdout
    assert "--workflow ground needs neither" in ended.stderr


@pytest.mark.parametrize("edge", [20, 30])
def test_a_file_too_small_to_train_and_test_is_said_to_be(tmp_path, edge):
    xyz = np.array([500_000, 5_400_000, 0]) + np.random.default_rng(0).uniform(0, edge, (3000, 3))
    codes = np.resize(CODES, 3000)
    lasmaker.write_las(tmp_path / "a.las", xyz, point_format=6, classification=codes, keys=lasmaker.UTM33)
    ended = fwclass("init", "a.las", cwd=tmp_path)
    assert "on both of its sides" in ended.stderr and "fewer than two" not in ended.stderr


def test_a_class_in_one_corner_is_left_out(tmp_path):
    """No straight line has it on both sides, a gap apart."""
    town(tmp_path)
    rng = np.random.default_rng(1)
    xyz = np.c_[500_190 + rng.uniform(0, 5, 900), 5_400_000 + rng.uniform(0, 5, 900), np.full(900, 190.0)]
    lasmaker.write_las(tmp_path / "b.las", xyz, point_format=6, classification=np.full(900, 9), keys=lasmaker.UTM33)
    ended = fwclass("init", "a.las", "b.las", cwd=tmp_path)
    assert "water: it does not lie on both sides" in ended.stdout
    assert [c["name"] for c in yaml.safe_load(ended.stdout)["survey"]["classes"]] == [
        "ground",
        "vegetation",
        "building",
    ]


def test_names_break_no_yaml(tmp_path):
    place = tmp_path / 'q"uo: te #'
    place.mkdir()
    town(place)
    (place / "a.las").rename(place / 'a" #: x.las')
    ended = fwclass("init", place / 'a" #: x.las', cwd=place)
    made = yaml.safe_load(ended.stdout)
    assert made["survey"]["sources"] == ['a" #: x.las'] and conf.find(_written(place, ended.stdout))


def _written(place, text):
    (place / "s.yaml").write_text(text)
    return place / "s.yaml"


@pytest.mark.parametrize("odd", ["\uffff", "\ufffe", "\ufdd0", "\u202e"])
def test_a_name_with_what_is_no_letter_is_refused(tmp_path, odd):
    town(tmp_path)
    (tmp_path / "a.las").rename(tmp_path / f"w{odd}.las")
    refused = fwclass("init", tmp_path)
    assert refused.returncode == 1 and "cannot be seen" in refused.stderr and odd not in refused.stderr


def test_files_that_are_none(tmp_path):
    (tmp_path / "a.las").write_bytes(b"no lidar")
    (tmp_path / "b.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": []}))
    for name, words in (("a.las", "a.las"), ("b.geojson", "no file of points or pulses")):
        ended = fwclass("init", name, cwd=tmp_path)
        assert ended.returncode in (1, 2) and words in ended.stderr and "Traceback" not in ended.stderr


def test_two_files_of_one_name_are_no_survey(tmp_path):
    """As `run` says: a draft that cannot be run is none."""
    town(tmp_path)
    (tmp_path / "b").mkdir()
    town(tmp_path / "b", seed=2)
    ended = fwclass("init", "a.las", "b/a.las", cwd=tmp_path)
    assert ended.returncode == 1 and "two files of the survey have the same name" in ended.stderr, ended.stderr


@pytest.mark.parametrize("most", [1_100, 10**6])
def test_cells_double_and_keep_their_counts(monkeypatch, most):
    monkeypatch.setattr(areas, "MOST_CELLS", most)
    rng = np.random.default_rng(2)
    places = ClassPlaces()
    for _ in range(3):
        places.add(*rng.uniform(-500, 500, (2, 4000)), rng.choice(CODES, 4000).astype(np.uint8))
    assert sum(places.counts.values()) == 12_000 and len(places.counts) <= most
    split = best_split(places, [[2], [5], [6]], Box(-500, -500, 500, 500), 5.0)
    assert split is None or 0.25 <= split.train.sum() / 12_000 <= 0.65


def test_the_whole_survey_at_one_place_is_not_split():
    places = ClassPlaces()
    places.add(np.zeros(10), np.zeros(10), np.full(10, 2, np.uint8))
    assert best_split(places, [[2], [5]], Box(0, 0, 1, 1), 5.0) is None


def test_places_far_apart_cost_no_memory():
    places = ClassPlaces()
    x, codes = np.tile([-1e17, 1e17], 1000), np.repeat([2, 6], 1000).astype(np.uint8)
    places.add(x, np.zeros(len(x)), codes)
    split = best_split(places, [(2,), (6,)], Box(-1e17, 0.0, 1e17, 1.0), 20.0)
    assert split is not None and split.train.tolist() == split.test.tolist() == [500, 500]


def test_a_draft_is_planned_without_a_file_beside_the_sources(tmp_path, monkeypatch):
    """A killed `init` left one there."""
    town(tmp_path)
    there = []

    def facts(config, root):
        there.append(sorted(p.name for p in root.iterdir()))
        raise InputError("looked")

    monkeypatch.setattr(survey, "survey_facts", facts)
    with monkeypatch.context() as here:
        here.chdir(tmp_path)
        assert CliRunner().invoke(cli, ["init", "a.las"]).exit_code == 0
    assert there == [["a.las"]]


def test_a_directory_of_texts_is_told_what_makes_files_of_points(tmp_path):
    (tmp_path / "a.xyz").write_text("500000.0 5400000.0 190.0\n")
    ended = fwclass("init", tmp_path)
    assert ended.returncode == 1 and "`fwclass ground a.xyz OUT.laz` makes a file of points" in ended.stderr
