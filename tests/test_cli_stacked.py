"""Roofs under a tree and still water through a whole run, from raw waveforms written here: what is delivered."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from rawmaker import write_parquet
from test_cli_water import features
from woodmaker import STEP, over_surface

pytestmark = pytest.mark.slow

CORNER = np.array([500_000.0, 5_400_000.0, 0.0])
POND = [(42, 20), (56, 20), (56, 40), (42, 40), (42, 20)]
# At 0.9, weak echoes that single pulses have of the roof stand in the way of the stacked ones (docs/waveforms.md).
WHOLE = ("--set", "decompose.further_detection=1")
WORDS = ("--workflow", "ground", "--workers", "0", "--set", "water.file=water.geojson", "--set", "stack.enabled=true")
WORDS += WHOLE
ALL = "stack.surfaces=[ground,roof,water]"


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """A plain of 60 m with a house, whose roof rises to the east and lies open for its first 10 m, and a pond."""
    place, rng = tmp_path_factory.mktemp("stacked"), np.random.default_rng(3)
    x, y = (v.ravel() + 0.3 for v in np.meshgrid(STEP * np.arange(100), STEP * np.arange(100)))
    n, house = len(x), (x >= 12) & (x < 36) & (y >= 12) & (y < 36)
    pond = (x > 42) & (x < 56) & (y > 20) & (y < 40)
    tree = house & (x >= 22)
    z = np.where(house, 106.0 + 0.3 * (x - 12.0), 100.0) + np.where(pond, 0.0, 0.02) * rng.standard_normal(n)
    heights = np.c_[np.where(tree, rng.uniform(6.0, 9.0, n), np.nan), np.zeros(n)]
    amplitude = np.c_[np.full(n, 60.0), np.where(tree | pond, 1.5 * 1.5, 30.0)]
    waves = over_surface(np.c_[x, y, z] + CORNER, heights, amplitude, seed=4)
    columns = {a: waves.pulses[f"anchor_{a}"] for a in "xyz"}
    columns |= {f"d{a}": -waves.pulses[f"step_{a}"] for a in "xyz"}
    columns |= {"begin_ns": -waves.pulses["anchor_time"], "gps_time": 1000.0 + np.arange(n) * 1e-5}
    columns["samples"] = np.split(waves.samples, waves.offsets[1:-1])
    write_parquet(place / "a.parquet", columns, {"crs": "EPSG:25832", "spacing_ns": "1.0"})
    (place / "water.geojson").write_text(features("EPSG:25832", POND))
    (place / "s.yaml").write_text("survey: {name: s, directory: ., sources: [a.parquet]}\n")
    return place / "s.yaml"


@pytest.fixture(scope="module")
def delivered(survey):
    out = survey.parent / "run"
    ended = fwclass("run", survey, "--out", out, *WORDS, "--set", ALL)
    assert ended.returncode == 0, ended.stderr
    tables = [pq.read_table(p) for p in sorted((out / "stacked").glob("*.parquet"))]
    names = ("x", "y", "z", "classification", "origin", "stacked_pulses", "range_sigma", "significance")
    return out, {n: np.concatenate([t[n].to_numpy() for t in tables]) for n in names}


def test_what_roof_and_water_are_given(delivered):
    _, e = delivered
    x, y, roof, water = e["x"] - CORNER[0], e["y"] - CORNER[1], e["classification"] == 6, e["classification"] == 9
    assert roof.sum() > 100 and water.sum() > 200
    assert ((x > 23.5) & (x < 30) & (y > 11.5) & (y < 36.5))[roof].all()
    assert np.abs(e["z"] - 106.0 - 0.3 * (x - 12.0))[roof].max() < 0.4
    assert ((x > 42) & (x < 56) & (y > 20) & (y < 40))[water].all()
    assert np.abs(e["z"] - 100.0)[water].max() < 0.4
    assert (e["origin"] == 3).all() and (e["stacked_pulses"] >= 4).all() and (e["significance"] > 4.0).all()
    off = np.where(roof, e["z"] - 106.0 - 0.3 * (x - 12.0), e["z"] - 100.0)
    assert 0.75 < np.sqrt(np.mean((off / e["range_sigma"])[roof | water] ** 2)) < 1.25


def test_the_terrain_takes_none_of_them(survey, delivered):
    out, _ = delivered
    other = survey.parent / "ground"
    ended = fwclass("run", survey, "--out", other, *WORDS)
    assert ended.returncode == 0, ended.stderr
    one, two = ((r / "rasters" / "dtm.tif").read_bytes() for r in (out, other))
    assert one == two
    tables = [pq.read_table(p) for p in sorted((other / "stacked").glob("*.parquet"))]
    assert all((t["classification"].to_numpy() == 2).all() for t in tables)


def test_water_without_polygons_is_refused(survey):
    ended = fwclass("plan", survey, "--set", "stack.enabled=true", "--set", "stack.surfaces=[water]", "--json")
    assert ended.returncode == 2 and "water.file" in ended.stderr and not ended.stdout.strip().startswith("{")
    ended = fwclass("plan", survey, "--set", "stack.surfaces=[lawn]")
    assert ended.returncode == 2 and "roof" in ended.stderr
