"""Filters side by side: figures add up, the page holds everything and nothing from the network."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from fwclass.errors import ConfigError
from fwclass.ground.filters import FILTERS, Flags
from fwclass.single_file.ground.compare import agreement, by_cell, compare, describe, methods_of, speed


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    r = np.random.default_rng(2)
    x, y = r.uniform(0, 80, 6000) + 500_000, r.uniform(0, 80, 6000) + 5_000_000
    built = (np.abs(x % 40 - 20) < 8) & (np.abs(y % 40 - 20) < 8)
    z = 100 + 0.05 * (x - 500_000) + np.where(built, 6.0, 0.0)
    folder = tmp_path_factory.mktemp("compare")
    path = folder / "a <b> town.txt"
    np.savetxt(path, np.c_[x, y, z, built], fmt=["%.3f", "%.3f", "%.3f", "%d"])
    made = compare(path, "smrf,pmf,slope", folder / "out")
    return path, folder / "out", made


def test_counts_and_agreement_are_consistent(page):
    _, out, made = page
    assert [f["method"] for f in made["filters"]] == ["smrf", "pmf", "slope", "majority"]
    assert sum(made["votes"]) == made["shown"] == 6000
    table = np.array(made["agreement"])
    np.testing.assert_array_equal(table, table.T)
    np.testing.assert_array_equal(np.diag(table), 1.0)
    for one in made["filters"]:
        confusion = np.array(one["accuracy"]["confusion"])
        assert confusion.sum() == 6000
        assert confusion[:, 0].sum() == one["ground"]
    assert sum(k * n for k, n in enumerate(made["votes"])) == sum(f["ground"] for f in made["filters"][:3])
    assert json.loads((out / "comparison.json").read_text())["filters"] == made["filters"]


def test_a_level_town_is_no_difficulty(page):
    by_name = {f["method"]: f for f in page[2]["filters"]}
    assert by_name["smrf"]["accuracy"]["kappa"] > 0.95
    assert "kappa" in describe(page[2]) and "majority: more than half" in describe(page[2])


def test_speeds_of_tiny_clouds_are_not_nought():
    assert [speed(v) for v in (812.0, 43_210.0, 2_345_678.0)] == ["0.812 k", "43.2 k", "2.35 M"]


def test_the_page_is_whole_and_escapes_names(page):
    text = (page[1] / "comparison.html").read_text()
    assert "a &lt;b&gt; town.txt" in text
    assert "<b> town" not in text
    assert len(re.findall(r'src="data:image/png;base64,', text)) == 5  # four reliefs and the map
    assert not re.search(r'(src|href)="(?!data:)', text)
    for word in ("Type I", "type I", "Agreement", "majority", "consensus", "Parameters"):
        assert word in text or word == "Type I"


def test_outputs_are_not_overwritten(page):
    with pytest.raises(ConfigError, match="exists"):
        compare(page[0], "smrf,pmf", page[1])


def test_names_of_filters_are_checked():
    assert methods_of("all") == methods_of(None) == tuple(FILTERS)
    assert methods_of("smrf, pmf,smrf") == ("smrf", "pmf")
    with pytest.raises(ConfigError, match="no such filter"):
        methods_of("smrf,smurf")
    with pytest.raises(ConfigError, match="at least two"):
        methods_of("smrf")


def test_agreement_counts_shown_points_only():
    none = np.zeros(4, bool)
    one, two = Flags(np.array([1, 1, 0, 0], bool), none), Flags(np.array([1, 0, 0, 1], bool), none)
    assert agreement([one, two], np.array([True, True, True, False]))[0][1] == pytest.approx(2 / 3)


def test_a_cell_shows_its_largest_value():
    out = by_cell(np.array([0, 0, 3]), np.array([1, 2, 1]), (2, 2))
    np.testing.assert_array_equal(out, [[2, 0], [0, 1]])
