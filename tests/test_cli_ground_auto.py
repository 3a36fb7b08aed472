"""`ground.method: auto` in a survey: parameters by squares of the fixed grid, the same for any tiles, and told."""

from __future__ import annotations

import json
from pathlib import Path

import lasmaker
import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import fwclass

from fwclass import conf
from fwclass.ground.auto import lowest_points

WORDS = ("--workflow", "ground", "--workers", "0", "--set", "ground.method=auto")
AUTO = """survey: {name: two, sources: [a.las]}
ground: {block: 64}
terrain: {block: 64}
ground_auto: {blocks: 2, least: 3000, square: 64, tried: 2, building_most: 60}
contours: {enabled: false}
publish: {figure_pixels: 200}
"""


@pytest.fixture(scope="module")
def land(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three squares of 128 m: level with a hall of 44 m, a hillside of 60 % with bushes, a few echoes."""
    place, rng = tmp_path_factory.mktemp("land"), np.random.default_rng(3)
    x, y = rng.uniform(0, 262, 40_000), rng.uniform(0, 128, 40_000)
    x, y = x[(x < 256) | (y < 100)], y[(x < 256) | (y < 100)]
    z = np.where(x < 128, 0.0, 0.6 * (x - 128)) + rng.normal(0, 0.02, len(x))
    hall = (np.abs(x - 60) < 22) & (np.abs(y - 60) < 22)
    bush = (x > 128) & (rng.random(len(x)) < 0.2)
    z = z + 12.0 * hall + bush * rng.uniform(0.6, 3, len(x))
    lasmaker.write_las(place / "a.las", np.c_[512_000 + x, 5_401_600 + y, 300 + z], point_format=6)
    (place / "two.yaml").write_text(AUTO)
    return place


@pytest.fixture(scope="module")
def run(land: Path) -> Path:
    told = fwclass("run", land / "two.yaml", "--out", land / "run", *WORDS, "--set", "tile.size=40")
    assert told.returncode == 0, told.stderr
    return land / "run"


def echoes(run: Path) -> dict[str, np.ndarray]:
    names = ("x", "y", "z", "pulse", "ground", "height_above_ground")
    tables = [pq.read_table(p, columns=list(names)) for p in (run / "parquet").glob("*.parquet")]
    rows = {n: np.concatenate([t.column(n).to_numpy() for t in tables]) for n in names}
    order = np.argsort(rows["pulse"])
    return {n: v[order] for n, v in rows.items()}


@pytest.mark.slow
def test_every_square_has_its_own_parameters_and_says_by_what_evidence(run: Path) -> None:
    told = json.loads((run / "report.json").read_text())["ground"]
    level, steep, few = sorted(told["auto"]["squares"], key=lambda s: s["bounds"])
    assert told["method"] == "auto" and told["auto"]["edge"] == 128 and told["auto"]["fixed"] == 1
    assert level["parameters"]["max_building_size"] > 50 and level["evidence"]["building"] == pytest.approx(44, abs=4)
    assert steep["parameters"]["values"]["slope"] > level["parameters"]["values"]["slope"]
    assert steep["evidence"]["agreement"] > steep["evidence"]["agreement_before"]
    assert few["evidence"] is None and few["occupied"] < 3000
    assert few["parameters"] == {"method": "smrf", "max_building_size": 36.0, "values": {}}
    page = (run / "report.html").read_text()
    assert "as set, too few echoes to choose by" in page and "kappa with the referees" in page
    assert "by the parameters of the other side" in page
    across = told["seams"]["across"]
    assert across["echoes"] > 500 and 0 <= across["flags_differ"] < across["echoes"] / 10
    assert "ground-auto" in {s["name"] for s in json.loads((run / "report.json").read_text())["stages"]}


@pytest.mark.slow
def test_neither_hall_nor_hillside_is_lost_as_with_one_set(land: Path, run: Path) -> None:
    told = fwclass("run", land / "two.yaml", "--out", land / "one", *WORDS[:4])
    assert told.returncode == 0, told.stderr
    shares = []
    for rows in (echoes(run), echoes(land / "one")):
        x, y, ground = rows["x"] - 512_000, rows["y"] - 5_401_600, rows["ground"].astype(bool)
        hall, hill = (np.abs(x - 60) < 20) & (np.abs(y - 60) < 20), (x > 140) & (x < 250)
        truth = rows["z"] - 300 - 0.6 * (x - 128) < 0.3
        shares.append((ground[hall].mean(), (ground != truth)[hill].mean()))
    assert shares[0][0] == 0.0 < 0.5 < shares[1][0]  # the hall is wider than the window that is set
    assert shares[0][1] < 0.05 and shares[0][1] < shares[1][1]


SMALL = pytest.param(("--set", "tile.size=25", "--workers", "2"), marks=pytest.mark.slow)


@pytest.mark.parametrize("setting", [("--set", "tile.size=300"), SMALL])
def test_tiles_and_workers_change_nothing(land: Path, run: Path, setting: tuple[str, ...], tmp_path: Path) -> None:
    told = fwclass("run", land / "two.yaml", "--out", tmp_path / "run", *WORDS, *setting)
    assert told.returncode == 0, told.stderr
    one, other = (json.loads((r / "report.json").read_text())["ground"] for r in (run, tmp_path / "run"))
    assert one["auto"] == other["auto"]
    before, after = echoes(run), echoes(tmp_path / "run")
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    for name in ("laz/strips/a.laz", "rasters/dtm.tif"):
        assert (tmp_path / "run" / name).read_bytes() == (run / name).read_bytes(), name


@pytest.mark.slow
def test_plan_status_and_seams_know_it(land: Path, run: Path) -> None:
    assert "parts are done" in fwclass("status", run).stdout
    planned = fwclass("plan", land / "two.yaml", *WORDS[:2], *WORDS[4:], "--out", land / "plan", "--json")
    assert any(s["name"] == "ground-auto" for s in json.loads(planned.stdout)["stages"]), planned.stderr
    told = fwclass("seams", run, "--share", "1")
    assert told.returncode == 0, told.stdout + told.stderr
    again = fwclass("run", land / "two.yaml", "--out", run, *WORDS, "--set", "tile.size=40")
    assert again.returncode == 0 and "computed" not in again.stdout + again.stderr


@pytest.mark.slow
def test_quality_and_a_file_of_its_own(land: Path, tmp_path: Path) -> None:
    told = fwclass("run", land / "two.yaml", "--out", tmp_path, "--workflow", "quality", *WORDS[2:])
    assert told.returncode == 0 and "ground-auto" in told.stdout + told.stderr
    told = fwclass("ground", land / "a.las", tmp_path / "out.laz", "--set", "ground.method=auto")
    assert told.returncode == 2 and "--auto" in told.stderr


def test_what_may_read_too_far_is_refused(land: Path, tmp_path: Path) -> None:
    told = fwclass("run", land / "two.yaml", "--out", tmp_path, *WORDS, "--set", "ground_auto.building_most=5000")
    assert told.returncode == 2 and "ground_auto" in told.stderr and "1,000 m" in told.stderr


def test_the_lowest_of_every_cell_are_the_same_however_the_points_are_cut() -> None:
    rng = np.random.default_rng(1)
    x, y, z = rng.integers(-5000, 5000, (3, 4000)) / 1000.0
    z = np.round(z, 1)  # many of one height
    whole = lowest_points([(x, y, z)], 1.0)
    mixed = rng.permutation(4000)
    pieces = [(x[r], y[r], z[r]) for r in np.array_split(mixed, 7)]
    for a, b in zip(whole, lowest_points(pieces, 1.0), strict=True):
        np.testing.assert_array_equal(a, b)
    cell = {}
    for a, b, c in zip(np.floor(x), np.floor(y), z, strict=True):
        cell[a, b] = min(c, cell.get((a, b), np.inf))
    assert sorted(cell.values()) == sorted(whole[2].tolist()) and len(cell) == len(whole[0])
    assert conf.section("ground_auto").cell == 1.0
