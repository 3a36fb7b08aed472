"""The search for a filter's parameters: it finds what is known to be best, and tells an honest figure."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

from fwclass import conf
from fwclass.errors import ConfigError, InputError
from fwclass.graph.ground_trial import halves, matrix_of, with_values
from fwclass.ground.search import curves, most_runs, pick_evenly, search
from fwclass.ground.tuning_params import GroundSearchParams
from fwclass.read.cloud import read_point_cloud
from fwclass.single_file.ground.labels import labels_of
from fwclass.single_file.ground.params import ground_params
from fwclass.single_file.ground.search import NO_BETTER, announcement, describe, fragment, optimize

LIMITS = GroundSearchParams(leading=2, coarse=3, rounds=3, ranges={})
RANGES = {"a": (0.0, 1.0, 2.0, 3.0, 4.0), "b": (0.0, 1.0, 2.0, 3.0), "c": (0.0, 0.5, 1.0)}


def hill(setting):
    a, b, c = setting
    return -((a - 3) ** 2) - (b - 1) ** 2 - (c - 0.5) ** 2 - 0.5 * (a - 3) * (b - 1)


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """A town on a slope, labelled: 0 ground, 1 buildings."""
    r = np.random.default_rng(2)
    x, y = r.uniform(0, 100, 9000) + 500_000, r.uniform(0, 100, 9000) + 5_000_000
    built = (np.abs(x % 40 - 20) < 9) & (np.abs(y % 40 - 20) < 9)
    z = 100 + 0.25 * (x - 500_000) + np.where(built, 6.0, 0.0)
    path = tmp_path_factory.mktemp("town") / "town.txt"
    np.savetxt(path, np.c_[x, y, z, built], fmt=["%.3f", "%.3f", "%.3f", "%d"])
    return path


def test_the_summit_of_a_hill_is_found():
    found = search(RANGES, (0.0, 0.0, 0.0), hill, LIMITS)
    assert found.setting == (3.0, 1.0, 0.5)
    assert found.value == 0.0


def test_a_start_beyond_the_ranges_stays_if_nothing_is_better():
    found = search(RANGES, (9.0, 9.0, 9.0), lambda s: float(s == (9.0, 9.0, 9.0)), LIMITS)
    assert found.setting == (9.0, 9.0, 9.0)


def test_no_more_runs_than_were_told():
    asked = []
    search(RANGES, (0.0, 0.0, 0.0), lambda s: asked.append(s) or hill(s), LIMITS)
    assert len(set(asked)) <= most_runs(RANGES, LIMITS)


def test_curves_have_their_summit_at_the_best_value():
    lines = curves(RANGES, (3.0, 1.0, 0.5), hill)
    assert {n: max(line, key=lambda p: p[1])[0] for n, line in lines.items()} == {"a": 3.0, "b": 1.0, "c": 0.5}


def test_thinned_values_are_spread():
    assert pick_evenly((1.0, 2.0, 3.0), 5) == (1.0, 2.0, 3.0)
    assert pick_evenly(tuple(range(8)), 4) == (1, 3, 5, 7)


def test_ranges_must_rise():
    with pytest.raises(ValueError, match="rising"):
        GroundSearchParams(leading=1, coarse=2, rounds=1, ranges={"smrf": {"slope": (0.2, 0.1)}})


def test_halves_are_opposite_quarters(town):
    cloud = read_point_cloud(town)
    half = halves(cloud.x, cloud.y, cloud.usable)
    east, north = cloud.x >= np.median(cloud.x), cloud.y >= np.median(cloud.y)
    assert (half == (east ^ north)).mean() > 0.97
    assert half.mean() == pytest.approx(0.5, abs=0.03)


def test_values_reach_their_sections_and_the_fragment_says_so():
    params = ground_params("csf+smrf")
    made = with_values(params, {"smrf.slope": 0.3, "csf.rigidness": 2.0})
    assert made.csf_smrf.smrf.slope == 0.3
    assert made.csf_smrf.csf.rigidness == 2
    text = fragment(params, {"smrf.slope": 0.3, "csf.rigidness": 2.0})
    assert yaml.safe_load(text) == {
        "ground": {"method": "csf+smrf", "csf_smrf": {"smrf": {"slope": 0.3}, "csf": {"rigidness": 2}}}
    }


def test_labels_of_text_and_of_a_reference_file_agree(town, tmp_path):
    cloud = read_point_cloud(town)
    own = labels_of(cloud)
    rows = np.random.default_rng(0).permutation(cloud.points)
    lines = town.read_text().splitlines()
    mixed = tmp_path / "mixed.txt"
    mixed.write_text("\n".join(lines[i] for i in rows) + "\n")
    np.testing.assert_array_equal(labels_of(cloud, mixed), own)
    assert set(np.unique(own)) == {0, 1}


def test_points_without_reference_do_not_count():
    truth = np.array([1, 1, 0, 0, -1], np.int8)
    ground = np.array([True, False, True, False, True])
    np.testing.assert_array_equal(matrix_of(truth, ground), [[1, 1], [1, 1]])


def test_a_cloud_without_labels_is_refused(tmp_path):
    path = tmp_path / "bare.txt"
    np.savetxt(path, np.random.default_rng(0).uniform(0, 20, (100, 3)), fmt="%.3f")
    with pytest.raises(InputError, match="no reference"):
        optimize(path, "smrf")


def test_a_method_without_ranges_is_refused(town):
    with pytest.raises(ConfigError, match="no ranges"):
        optimize(town, "consensus")


@pytest.fixture(scope="module")
def optimised(town, tmp_path_factory):
    out, said = tmp_path_factory.mktemp("out"), []
    small = ("ground_search.rounds=1", "ground_search.coarse=2")
    made = optimize(town, "pmf", out=out, settings=small, say=said.append)
    return out, said, made


def test_a_search_announces_the_slowest_run_as_its_most():
    assert announcement("smrf", 100, [0.1, 0.5, 0.3]) == (
        "smrf: at most 100 runs of 0.10 to 0.50 s; probably 9 s to 21 s, at most about 50 s"
    )


def test_parameters_that_are_no_better_elsewhere_are_not_recommended(town, monkeypatch):
    """Where every setting gives the same flags nothing is better than the start, which is kept."""
    small = ("ground_search.rounds=1", "ground_search.coarse=2")
    monkeypatch.setattr("fwclass.graph.ground_trial.with_values", lambda params, values: params)
    made, heard = optimize(town, "pmf", settings=small, tell=(steps := []).append), steps
    assert made["held_out"]["kappa"] == made["start"]["kappa"] and made["recommended"] == "start"
    told = describe(made)
    assert NO_BETTER in told and "--param" not in told
    assert made["param"].startswith(f"--param slope={made['start']['parameters']['slope']:g} ")
    assert heard[0] == "reading" and any("run 4 of at most" in text for text in heard)


@pytest.mark.slow
def test_the_search_beats_its_start_and_tells_held_out_points(optimised):
    _, said, made = optimised
    assert made["best"]["kappa"] >= made["start"]["kappa"]
    assert made["best"]["kappa"] > 0.9
    assert 0.8 < made["held_out"]["kappa"] <= 1.0
    assert sum(map(sum, made["held_out"]["confusion"])) == 9000
    assert "at most" in said[0] and "probably" in said[0]
    assert made["recommended"] == ("best" if made["held_out"]["kappa"] > made["start"]["kappa"] else "start")
    assert set(made["curves"]) == set(conf.section("ground_search").ranges["pmf"])
    assert "kappa" in describe(made)


@pytest.mark.slow
def test_what_is_written_can_be_used(optimised, town):
    out, _, made = optimised
    assert json.loads((out / "search.json").read_text()) == made
    assert (out / "kappa.png").read_bytes().startswith(b"\x89PNG")
    assert yaml.safe_load((out / "ground.yaml").read_text())["ground"]["method"] == "pmf"
    again = tuple(made["param"].replace("--param ", "").split())
    assert ground_params("pmf", None, again).pmf.slope == made["best"]["parameters"]["slope"]
    with pytest.raises(ConfigError, match="exists"):
        optimize(town, "pmf", out=out)
