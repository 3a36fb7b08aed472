"""Water under a green laser through a whole run: what tiles have, whatever their size, and what is made anew."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from lasmaker import write_las
from watermaker import lake

pytestmark = pytest.mark.slow

ON = ("--set", "bathymetry.enabled=true")
WORDS = ("--workers", "0", "--set", "plausibility.accept=true", "--set", "train.trees=3", "--set", "areas.gap=1")
COLUMNS = ("water", "water_decay", "water_depth")


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """A lake with its shore, and a file of returns beside it."""
    place = tmp_path_factory.mktemp("lake")
    lake(place / "a.las", 600, seed=2)
    k = np.arange(60.0)
    beside = np.c_[500_000.0 + 0.5 * k, 5_399_999.0 + 0.0 * k, 300.0 + 0.01 * k]
    write_las(place / "b.las", beside, point_format=6, classification=2)
    (place / "s.yaml").write_text(
        "survey: {name: s, directory: ., sources: [a.las, b.las], reference: {kind: source}, features: [zc],\n"
        "  classes: [{name: ground, code: 2, codes: [2]}, {name: water, code: 9, codes: [9]}]}\n"
        "areas: {train: [[500000, 5399990, 500016, 5400030]]}\n"
    )
    return place / "s.yaml"


def run(survey, name, *words):
    out = survey.parent / name
    ended = fwclass("run", survey, "--out", out, *WORDS, *words)
    assert ended.returncode == 0, ended.stderr
    tables = [pq.read_table(p) for p in sorted((out / "parquet").glob("*.parquet"))]
    names = [n for n in ("strip", "pulse", "echo_number", "z", *COLUMNS) if n in tables[0].column_names]
    columns = {n: np.concatenate([t[n].to_numpy() for t in tables]) for n in names}
    order = np.lexsort([columns[n] for n in ("echo_number", "pulse", "strip")])
    return out, {n: v[order] for n, v in columns.items()}


def test_tiles_of_any_size_tell_of_water(survey):
    out, one = run(survey, "one", *ON)
    told, deep = json.loads((out / "report.json").read_text())["bathymetry"], one["water"] == 2
    assert told["bottoms"] == deep.sum() and told["surfaces"] == (one["water"] == 1).sum() and not told["remarks"]
    assert abs(told["mean_depth"] - one["water_depth"][deep].mean()) < 2e-3
    assert f"{deep.sum():,} of them bottoms of water" in (out / "report.html").read_text()
    _, two = run(survey, "two", *ON, "--set", "tile.size=20")
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])
    assert (one["water"] == 2).sum() > 150
    assert np.isfinite(one["water_depth"][deep]).all() and np.isnan(one["water_depth"][~deep]).all()


def test_a_survey_without_water_that_is_asked_for_it_says_so(survey):
    settings = ("--set", "bathymetry.least_decay=0.299", "--set", "bathymetry.gain=1e6")
    ended = fwclass("run", survey, "--out", survey.parent / "dry", *WORDS, *ON, *settings)
    assert ended.returncode == 0 and "no waveform shows a bottom of water" in ended.stderr, ended.stderr


def test_without_the_setting_nothing_tells_of_water_and_nothing_is_read_again(survey):
    out, off = run(survey, "off")
    assert json.loads((out / "report.json").read_text())["bathymetry"] is None
    assert not set(COLUMNS) & set(off)
    ended = fwclass("run", survey, "--out", out, *WORDS, *ON)
    assert ended.returncode == 0, ended.stderr
    tables = [pq.read_table(p, columns=["water"]) for p in sorted((out / "parquet").glob("*.parquet"))]
    assert max(t["water"].to_numpy().max() for t in tables) == 2
