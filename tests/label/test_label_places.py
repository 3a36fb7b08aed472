"""Places whose labels teach most: what they are ranked by, whatever the tiles; what is done with their file."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import shapely
from commandline import fwclass
from smallsurvey import small_survey

import fwclass as package
from fwclass import conf
from fwclass.formats.echo_labels import EchoLabels
from fwclass.formats.wkb import box_wkb
from fwclass.grid import Box
from fwclass.label.places import PlaceCounts
from fwclass.publish.gpkg import Layer, write_gpkg
from fwclass.read.polygons import open_polygons, read_polygons
from fwclass.store.corrections import add_corrections, read_corrections

PARAMS = conf.section("suggest", ("suggest.echoes=0",))


def no_place(place):
    return False


def echoes(seed=1, n=20_000, across=100.0):
    """Places [mm], classes and entropies: the east is mixed, the north is unsure."""
    rng = np.random.default_rng(seed)
    x, y, z = (np.rint(rng.uniform(0, across, n) * 1000).astype(np.int64) for _ in range(3))
    mixed, unsure = x > 50_000, y > 50_000
    code = np.where(mixed, rng.choice([2, 5, 6], n), 2).astype(np.uint8)
    entropy = np.where(unsure, rng.uniform(0.5, 1, n), rng.uniform(0, 0.1, n)).astype(np.float32)
    return x, y, z, code, entropy


def counts(columns, size=10.0):
    made = PlaceCounts(size)
    made.add(*columns)
    return made


def test_mixed_places_of_which_the_model_is_unsure_come_first():
    made = counts(echoes())
    places = made.suggest(PARAMS.model_copy(update={"places": 6}), no_place)
    assert all(p.box.xmin >= 50 and p.box.ymin >= 50 for p in places)
    assert [p.score for p in places] == sorted((p.score for p in places), reverse=True)
    assert all(np.isclose(p.mixture, 1, atol=0.05) and 0.7 < p.entropy < 0.8 for p in places)
    squares = {(p.box.xmin / 10, p.box.ymin / 10) for p in places}
    assert all(max(abs(a - c), abs(b - d)) > 1 for a, b in squares for c, d in squares if (a, b) != (c, d))


def test_a_far_better_place_that_touches_another_comes_before_one_alone():
    x, y, z, code, _ = echoes()
    good, poor = (x < 20_000) & (y < 10_000), (x > 50_000) & (x < 60_000) & (y < 10_000)
    keep, rng = good | poor, np.random.default_rng(5)
    code = rng.choice([2, 5], len(x)).astype(np.uint8)
    for share, order in ((0.2, [0, 10, 50]), (0.5, [0, 50, 10])):
        told = np.where(poor, share * 0.9, np.where(x < 10_000, 0.95, 0.9)).astype(np.float32)
        places = counts(tuple(c[keep] for c in (x, y, z, code, told))).suggest(PARAMS, no_place)
        assert [p.box.xmin for p in places] == order


def test_tiles_and_their_order_change_nothing():
    columns = echoes()
    pieces = PlaceCounts(10.0)
    for part in np.array_split(np.random.default_rng(3).permutation(len(columns[0])), 7):
        pieces.add(*(c[part] for c in columns))
    assert pieces.suggest(PARAMS, no_place) == counts(columns).suggest(PARAMS, no_place)


def test_against_counts_of_another_kind():
    x, y, z, code, entropy = echoes(7)
    for place in counts((x, y, z, code, entropy)).places()[::9]:
        low_x, low_y, high_x, high_y = (1000 * v for v in place.box.bounds)
        here = (x >= low_x) & (x < high_x) & (y >= low_y) & (y < high_y)
        share = np.unique(code[here], return_counts=True)[1] / here.sum()
        assert place.echoes == here.sum()
        assert np.isclose(place.entropy, entropy[here].mean(), atol=2e-6)
        assert np.isclose(place.mixture, -(share * np.log(share)).sum() / np.log(3))
        assert np.isclose(place.z, z[here].mean() / 1000)


def test_echoes_that_no_model_classified_do_not_count():
    x, y, z, code, entropy = echoes()
    known = np.arange(len(x)) % 3 > 0
    some = counts((x, y, z, code, np.where(known, entropy, np.nan).astype(np.float32)))
    assert some.places() == counts(tuple(c[known] for c in (x, y, z, code, entropy))).places()


def test_where_echoes_are_few_places_are_wider():
    columns = tuple(c[:1000] for c in echoes())  # 10 a square
    wide = counts(columns).widened(60)
    assert wide.size == 40.0 and wide.middling >= 60
    assert wide.places() == counts(columns, 40.0).places()
    assert counts(columns).widened(10**9).size <= 1000 and PlaceCounts(10.0).widened(100).places() == []


def test_a_rim_a_pure_place_and_one_without_use_are_left_out():
    x, y, z, code, entropy = echoes()
    rim = (x < 10_000) & (np.arange(len(x)) % 100 > 0)
    keep = ~rim
    made = counts(tuple(c[keep] for c in (x, y, z, code, entropy)))
    places = made.suggest(PARAMS.model_copy(update={"places": 1000}), lambda p: p.box.ymin >= 50)
    assert places and all(p.box.xmin >= 50 and p.box.ymin < 50 for p in places)
    assert counts((x, y, z, np.full_like(code, 2), entropy)).suggest(PARAMS, no_place) == []


# ------------------------------------------------------------------ the commands


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run of a small survey, which no test writes to, and its places: (survey, root, file)."""
    place = tmp_path_factory.mktemp("suggested")
    survey = small_survey(place)
    ended = fwclass("run", survey, "--out", place / "run", "--workers", 0)
    assert ended.returncode == 0, ended.stderr
    ended = fwclass("suggest", place / "run", place / "places.gpkg", "--size", 5, "--places", 4)
    assert ended.returncode == 0 and "layer places" in ended.stderr, ended.stderr
    return survey, place / "run", place / "places.gpkg"


@pytest.fixture
def run(made, tmp_path) -> Path:
    shutil.copytree(made[1], tmp_path / "run", symlinks=True)
    return tmp_path / "run"


def boxes(path):
    opened = open_polygons(path)
    shapes = read_polygons(opened, None)[1]
    first = shapes.ring_start[:-1]
    return np.stack([f.reduceat(v, first) for f in (np.minimum, np.maximum) for v in (shapes.x, shapes.y)], axis=1)


def test_the_file_has_places_outside_of_what_trains_and_is_tested(made):
    found = boxes(made[2])
    assert 1 <= len(found) <= 4 and np.allclose(found[:, 2:] - found[:, :2], 5)
    config = package.open(made[1]).report["config"]["areas"]
    for x0, y0, x1, y1 in config["train"] + config["test"]:
        assert not ((found[:, 0] < x1) & (found[:, 2] > x0) & (found[:, 1] < y1) & (found[:, 3] > y0)).any()


def test_what_is_there_already_is_not_replaced(made):
    ended = fwclass("suggest", made[1], made[2])
    assert ended.returncode == 2 and "--overwrite" in ended.stderr
    assert fwclass("suggest", made[1], made[2].with_suffix(".shp")).returncode == 2


def test_confirmed_echoes_are_corrections_and_what_was_corrected_stays(made, run):
    box = boxes(made[2])[0]
    inside = package.open(run).echoes(box=tuple(map(float, box))).to_pandas()
    one = {n: inside[n].to_numpy()[:1] for n in ("strip", "pulse", "echo_number", "x", "y", "z")}
    other = 5 if inside["classification"][0] == 2 else 2
    add_corrections(run, lambda _: EchoLabels.of(one, [other], 1, "earlier"))
    ended = fwclass("label", "confirm", run, made[2], "--who", "me")
    assert ended.returncode == 0 and "1 had been corrected" in ended.stderr, ended.stderr
    stands = read_corrections(run).standing()
    mine = stands.who == "me"
    assert {"earlier", "me"} == set(stands.who.tolist()) and int((~mine).sum()) == 1
    everywhere = np.zeros(len(package.open(run).echoes(columns=["x"]).to_pandas()), bool)
    columns = package.open(run).echoes(columns=["x", "y", "classification"]).to_pandas()
    for b in boxes(made[2]):
        everywhere |= Box(*map(float, b)).contains(columns["x"].to_numpy(), columns["y"].to_numpy())
    assert stands.rows == int(everywhere.sum())
    again = fwclass("label", "confirm", run, made[2], "--who", "me")
    assert again.returncode == 0 and read_corrections(run).rows == stands.rows


def test_what_is_labelled_is_not_suggested_again(made, run, tmp_path):
    assert fwclass("label", "confirm", run, made[2]).returncode == 0
    ended = fwclass("suggest", run, tmp_path / "more.gpkg", "--size", 5, "--places", 4)
    assert ended.returncode == 0, ended.stderr
    before = {tuple(b) for b in boxes(made[2]).tolist()}
    more = boxes(tmp_path / "more.gpkg") if "empty" not in ended.stderr else np.empty((0, 4))
    assert not before & {tuple(b) for b in more.tolist()}


def test_tiles_of_the_places_are_checked_out(made, run, tmp_path):
    ended = fwclass("label", "checkout", run, tmp_path / "out", "--places", made[2])
    assert ended.returncode == 0, ended.stderr
    there = {p.name.removesuffix(".copc.laz") for p in (tmp_path / "out").glob("*.copc.laz")}
    near = {
        t["tile"]
        for t in package.open(run).tiles
        for a, b, c, d in boxes(made[2])
        if t["bounds"][0] <= c and t["bounds"][3] >= a and t["bounds"][1] <= d and t["bounds"][4] >= b
    }
    assert there == near
    both = fwclass("label", "checkout", run, tmp_path / "two", "--places", made[2], "--least-sure", 1)
    assert both.returncode == 2


@pytest.mark.parametrize("words", [("label", "confirm"), ("label", "checkout", "--places")])
def test_places_elsewhere_are_refused(words, made, run, tmp_path):
    path = tmp_path / "far.gpkg"
    write_gpkg(
        [Layer("places", box_wkb([Box(0.0, 0.0, 10.0, 10.0)]), {"rank": np.array([1])})], path, package.open(run).crs
    )
    line = [*words[:2], run, path] if words[1] == "confirm" else [*words[:2], run, tmp_path / "out", "--places", path]
    ended = fwclass(*line)
    assert ended.returncode == 1 and "any of these places" in ended.stderr, ended.stderr
    assert not (run / "labels").exists() and not (tmp_path / "out").exists()


def test_places_away_from_the_survey_are_counted(run, tmp_path):
    shown = package.open(run)
    x, y, *_ = shown.tiles[0]["bounds"]
    places = [Box(x, y, x + 5, y + 5), Box(0.0, 0.0, 10.0, 10.0)]
    path = tmp_path / "some.gpkg"
    write_gpkg([Layer("places", box_wkb(places), {"rank": np.array([1, 2])})], path, shown.crs)
    ended = fwclass("label", "confirm", run, path)
    assert ended.returncode == 0 and ended.stderr.startswith("2 places (1 of them away from the survey): "), (
        ended.stderr
    )
    shutil.rmtree(run / "labels")


def test_places_that_cross_themselves_are_told(run, tmp_path):
    shown = package.open(run)
    x, y, *_ = shown.tiles[0]["bounds"]
    corners = [(x, y), (x + 9, y + 9), (x + 9, y), (x, y + 9)]
    path = tmp_path / "tie.gpkg"
    places = [shapely.to_wkb(shapely.Polygon(corners)), *box_wkb([Box(x, y, x + 5, y + 5)])]
    write_gpkg([Layer("places", places, {"rank": np.array([1, 2])})], path, shown.crs)
    ended = fwclass("label", "confirm", run, path)
    assert ended.returncode == 0 and "note: 1 place with an outline that crosses itself" in ended.stderr, ended.stderr
    shutil.rmtree(run / "labels")


def test_a_file_that_is_none_is_refused(run, tmp_path):
    (tmp_path / "a.gpkg").write_bytes(b"SQLite format 3\0" + bytes(100))
    ended = fwclass("label", "confirm", run, tmp_path / "a.gpkg")
    assert ended.returncode == 1 and "Traceback" not in ended.stderr and "a.gpkg" in ended.stderr
