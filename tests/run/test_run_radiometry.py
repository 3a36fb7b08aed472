"""Radiometry along the whole road: trajectory, balance of strips, target, what is delivered, and what is refused."""

from __future__ import annotations

import json

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from plsmaker import survey as pulsewaves
from rawmaker import scene, write_parquet
from runmaker import walk

from fwclass import conf
from fwclass.errors import ConfigError
from fwclass.graph.stages import check_features

pytestmark = pytest.mark.slow

NAMES = [
    "strip",
    "x",
    "y",
    "z",
    "classification",
    "number_of_echoes",
    "range",
    "incidence",
    "cross_section",
    "backscatter",
    "reflectance",
    "radiometry_flags",
]
POLYGON = "[[512000, 5403000], [512120, 5403000], [512120, 5403120], [512000, 5403120]]"


def echoes(root):
    parts = [pq.read_table(p, columns=NAMES) for p in sorted((root / "parquet").glob("*.parquet"))]
    return {n: np.concatenate([p.column(n).to_numpy() for p in parts]) for n in NAMES}


def test_ranges_come_from_the_trajectory_and_columns_are_delivered(finished):
    root, report = finished
    found = echoes(root)
    assert np.isfinite(found["range"]).all()
    heights = 669.0 - found["z"]
    assert (found["range"] > heights - 10.0).all() and (found["range"] < heights * 1.3).all()
    assert report["waveforms"]["pointing_error"] < 0.01 and report["waveforms"]["without_range"] == 0
    assert report["waveforms"]["calibration"]["source"] == "given"
    ground = (found["classification"] == 2) & (found["radiometry_flags"] == 0) & (found["incidence"] < 30)
    assert ground.sum() > 1000
    # the scene's ground is asphalt and grass: backscatter is 4 times the reflectance
    assert 0.1 < np.median(found["backscatter"][ground]) / 4.0 < 0.6
    cosine = np.cos(np.radians(found["incidence"][ground].astype(float)))
    share = 10.0 ** (found["reflectance"][ground] / 10.0)
    # reflectance [dB], backscatter and incidence are each rounded to 2^-12 of themselves on delivery
    np.testing.assert_allclose(share, found["backscatter"][ground] / 4.0 * cosine, rtol=1e-3)
    assert ((found["number_of_echoes"] > 1) == (found["radiometry_flags"] & 1 > 0)).all()
    with laspy.open(next((root / "laz" / "tiles").glob("*.laz"))) as file:
        names = set(file.header.point_format.extra_dimension_names)
    assert names >= {"Amplitude", "Reflectance", "echo width", "incidence angle", "pulse"}


@pytest.fixture(scope="module")
def balanced(survey, tmp_path_factory):
    root = tmp_path_factory.mktemp("balanced")
    settings = (
        "radiometry.balance=true",
        "radiometry.calibration=null",
        f"radiometry.target={{polygon: {POLYGON}, reflectance: 0.3}}",
    )
    _, report = walk(survey, root, *settings)
    return root, report, settings


def test_strips_of_one_sensor_have_one_gain(balanced):
    _, report, _ = balanced
    found = report["waveforms"]["calibration"]
    assert found["source"] == "target" and found["target_echoes"] > 1000 and len(found["pairs"]) == 1
    assert all(abs(s["gain"] - 1.0) < 0.03 and s["error"] < 0.02 for s in found["strips"])
    assert [s["gain"] for s in report["waveforms"]["strips"]] == [s["gain"] for s in found["strips"]]


def test_the_target_has_its_reflectance(balanced):
    root, _, _ = balanced
    found = echoes(root)
    single = (found["radiometry_flags"] == 0) & (found["incidence"] < 30)
    assert np.median(found["backscatter"][single]) / 4.0 == pytest.approx(0.3, rel=0.1)
    assert (found["radiometry_flags"] & 32 == 0).all()


@pytest.mark.slow
def test_tiles_do_not_change_the_calibration(balanced, survey, tmp_path):
    _, report, settings = balanced
    _, other = walk(survey, tmp_path, *settings, "tile.size=37.5")
    assert json.dumps(other["waveforms"]["calibration"]) == json.dumps(report["waveforms"]["calibration"])


def test_no_range_no_radiometry(survey):
    config = conf.load("demo", (f"survey.directory={survey}", "survey.trajectory.files=[]"))
    with pytest.raises(ConfigError, match="backscatter"):
        check_features(config, ("backscatter",), "survey.features")
    known = conf.load("demo", (f"survey.directory={survey}", "radiometry.platform_altitude=669"))
    check_features(known, ("backscatter", "reflectance"), "survey.features")


@pytest.mark.slow
def test_pulsewaves_go_the_whole_road(finished, tmp_path):
    """A format without returns, classified by a given forest: ranges of its own, no strips to deliver."""
    pulsewaves(tmp_path / "a.pls", pulses=300)
    settings = (
        "survey.sources=[a.pls]",
        "survey.trajectory.files=[]",
        f"survey.model={finished[0] / 'model'}",
        "survey.reference={kind: none}",
    )
    road, report = walk(tmp_path, tmp_path / "run", *settings)
    assert not road.failures
    assert report["counts"]["pulses"] == 300 <= report["counts"]["echoes_in_tiles"]
    assert report["counts"]["echoes_in_tiles"] == report["counts"]["echoes_decomposed"]
    found = echoes(tmp_path / "run")
    assert (found["range"] > 0).all() and (found["classification"] > 0).all()
    assert not list((tmp_path / "run" / "laz").glob("strips/*"))


@pytest.mark.slow
def test_raw_waveforms_go_the_whole_road(finished, tmp_path):
    """A Parquet file of waveforms, classified by a given forest, as PulseWaves are."""
    told = {"crs": "EPSG:25832", "spacing_ns": "1.0"}
    write_parquet(tmp_path / "a.parquet", scene(pulses=400).columns("unit", "sensor"), told)
    settings = (
        "survey.sources=[a.parquet]",
        "survey.trajectory.files=[]",
        f"survey.model={finished[0] / 'model'}",
        "survey.reference={kind: none}",
    )
    road, report = walk(tmp_path, tmp_path / "run", *settings)
    assert not road.failures
    assert report["counts"]["pulses"] == 400 <= report["counts"]["echoes_in_tiles"]
    found = echoes(tmp_path / "run")
    assert np.abs(np.median(found["range"]) - 600.0) < 30.0 and (found["classification"] > 0).all()
