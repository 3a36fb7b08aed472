"""A survey in feet: drafted, planned and run in metres, like the same survey that came in metres."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import lasmaker
import laspy
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import yaml
from commandline import fwclass
from numpy.typing import NDArray
from pyproj import CRS

from fwclass import conf
from fwclass.formats.projected import metric_twin, project
from fwclass.graph.model_fit import feature_parameters
from fwclass.model import FORMAT, LinearMachine
from fwclass.store.models import save_model

FEET = 1200.0 / 3937.0
PLANE = {"metres": 32118, "feet": 2263}
"""New York Long Island; x and y in feet are those in metres, divided."""


def cloud(n: int = 6000) -> NDArray[np.float64]:
    """Points of a slope with sheds on it, in whole steps of 0.01 feet [m]."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 60, n), rng.uniform(0, 40, n)
    z = 20 + 0.05 * x + 3.0 * ((x // 10 % 2 == 1) & (y // 10 % 2 == 1)) + rng.normal(0, 0.02, n)
    return np.round(np.c_[300_230 + x, 60_910 + y, z] / (0.01 * FEET)) * 0.01 * FEET


def survey(place: Path, unit: str, heights: str) -> Path:
    """The cloud as a survey of one file whose x and y are in a unit, and whose heights are."""
    place.mkdir()
    xyz = cloud() / np.array([FEET if of == "feet" else 1.0 for of in (unit, unit, heights)])
    keys = {3072: PLANE[unit], 4096: 6360 if heights == "feet" else 5703}
    times = 3e8 + 1e-3 * np.arange(len(xyz))
    step = 0.01 if unit == heights == "feet" else 0.0001
    lasmaker.write_las(place / "a.las", xyz, point_format=6, gps_time=times, keys=keys, scale=step, classification=2)
    return place


@pytest.mark.parametrize(("unit", "heights"), [("feet", "feet"), ("metres", "feet")])
def test_a_survey_in_feet_is_drafted_and_run_as_one_in_metres(tmp_path: Path, unit: str, heights: str) -> None:
    tiles = []
    for name, place in {
        "m": survey(tmp_path / "m", "metres", "metres"),
        "f": survey(tmp_path / "f", unit, heights),
    }.items():
        drafted = fwclass("init", place, "--to", place / "s.yaml")
        assert drafted.returncode == 0, drafted.stderr
        text = (place / "s.yaml").read_text()
        assert yaml.safe_load(text).get("read", {}) == ({"project_to": "EPSG:32118+5703"} if name == "f" else {})
        assert "2.5/m2 on 0.0024 km2" in text
        assert fwclass("plan", place / "s.yaml", "--workflow", "ground", "--out", place / "r").returncode == 0
        tiles.append(json.loads((place / "r" / "plan" / "plan.json").read_text())["tiles"])
        ended = fwclass("run", place / "s.yaml", "--workflow", "ground", "--out", place / "r", "--workers", 0)
        assert ended.returncode == 0, ended.stderr
    (made,) = (tmp_path / "f" / "r" / "laz" / "tiles").glob("*.laz")
    tile, like = laspy.read(made), laspy.read(tmp_path / "m" / "r" / "laz" / "tiles" / made.name)
    assert [part.to_epsg() for part in tile.header.parse_crs().sub_crs_list] == [32118, 5703]
    order, same = (np.argsort(np.asarray(one["pulse"])) for one in (tile, like))
    assert np.abs(tile.xyz[order] - like.xyz[same]).max() <= 0.001 + 1e-9
    alike = np.asarray(tile.classification)[order] == np.asarray(like.classification)[same]
    assert alike.mean() > 0.998 and (np.asarray(tile.classification) == 2).sum() > 3000
    strip, source = (laspy.read(tmp_path / "f" / part) for part in ("r/laz/strips/a.laz", "a.las"))
    assert (strip.X == source.X).all() and (strip.Z == source.Z).all()
    assert strip.header.parse_crs().equals(source.header.parse_crs())
    assert tiles[0] == tiles[1]


def test_a_run_of_feet_tells_the_setting_that_brings_them_into_metres(tmp_path: Path) -> None:
    place = survey(tmp_path / "f", "feet", "feet")
    (place / "s.yaml").write_text("survey: {name: s, sources: ['*.las']}\n")
    words = ("run", place / "s.yaml", "--workflow", "quality", "--out", place / "r", "--workers", 0)
    refused = fwclass(*words)
    assert refused.returncode == 1 and "--set read.project_to=EPSG:32118+5703 brings" in refused.stderr
    assert fwclass(*words, "--set", "read.project_to=EPSG:32118+5703").returncode == 0
    refused = fwclass(*words, "--set", "read.project_to=EPSG:2263")
    assert refused.returncode == 1 and "not in metres" in refused.stderr, refused.stderr


def test_feet_that_a_setting_alone_names_are_not_sent_to_read_project_to(tmp_path: Path) -> None:
    """It brings only what names its own system: the advice was to set what was set."""
    place = survey(tmp_path / "f", "feet", "feet")
    lasmaker.write_las(place / "a.las", cloud() / FEET, point_format=6, keys=None, scale=0.01)
    (place / "s.yaml").write_text("survey: {name: f, sources: ['*.las'], crs: 'EPSG:2263', reference: {kind: none}}")
    target = ("--set", "read.project_to=EPSG:32118")
    for more in ((), target):
        ended = fwclass("run", place / "s.yaml", "--workflow", "ground", "--out", place / "r", "--workers", 0, *more)
        assert ended.returncode == 1 and "not in metres" in ended.stderr, ended.stderr
        assert "--set read.project_to" not in ended.stderr and "leave survey.crs out" in ended.stderr
        ended = fwclass("features", place / "a.las", tmp_path / "f.parquet", "--crs", "EPSG:2263", *target)
        assert ended.returncode == 1 and "not in metres" in ended.stderr, ended.stderr
        assert "--set read.project_to" not in ended.stderr


def test_files_in_metres_do_not_stay_where_they_are_in_silence(tmp_path: Path) -> None:
    place = survey(tmp_path / "m", "metres", "metres")
    (place / "s.yaml").write_text("survey: {name: s, sources: ['*.las']}\n")
    words = ("run", place / "s.yaml", "--workflow", "quality", "--out", place / "r", "--workers", 0)
    for other in ("EPSG:32116", "EPSG:32116+5703"):
        refused = fwclass(*words, "--set", f"read.project_to={other}")
        assert refused.returncode == 2 and "in metres are not brought into another system" in refused.stderr
    for same in ("EPSG:32118", "EPSG:32118+5703"):
        assert fwclass(*words, "--set", f"read.project_to={same}").returncode == 0


@pytest.mark.parametrize(
    ("feet", "metres"),
    [
        ("EPSG:2263+6360", "EPSG:32118+5703"),
        ("EPSG:2235", "EPSG:26957"),  # a false easting that was rounded in feet
        ("EPSG:2868", "EPSG:2762"),  # international feet
        ("EPSG:25832+5702", "EPSG:25832"),  # NGVD29 has no code in metres
        ("EPSG:2992", ""),
        ("EPSG:4326", ""),
        ("+proj=lcc +lat_0=40 +lon_0=-74 +lat_1=41 +lat_2=40.6 +ellps=GRS80 +towgs84=0,0,0 +units=us-ft", ""),
    ],
)
def test_the_same_projection_in_metres(feet: str, metres: str) -> None:
    crs = CRS.from_user_input(feet)
    assert metric_twin(crs) == metres
    if metres and crs.axis_info[0].unit_conversion_factor != 1.0:
        place = np.array([[985_000.0, 200_000.0, 100.0]])
        unit = crs.axis_info[0].unit_conversion_factor
        assert np.abs(project(crs, CRS.from_user_input(metres), place) - place * unit).max() < 1e-3


def test_heights_in_feet_over_degrees_become_metres() -> None:
    place = np.array([[-73.9, 40.7, 100.0]])
    (there,) = project(CRS.from_user_input("EPSG:4269+6360"), CRS.from_epsg(32118), place)
    assert there[2] == pytest.approx(100.0 * FEET)


def test_check_points_and_breaklines_in_feet_are_metres(tmp_path: Path) -> None:
    """Both lie on the ground; by heights in feet they would hang tens of metres above it."""
    place = survey(tmp_path / "f", "feet", "feet")
    x, y = np.random.default_rng(5).uniform((1, 1), (9, 39), (40, 2)).T
    points = np.c_[300_230 + x, 60_910 + y, 20 + 0.05 * x] / FEET
    (place / "c.csv").write_text("x,y,z\n" + "".join(f"{a:.3f},{b:.3f},{c:.3f}\n" for a, b, c in points))
    line = np.array([[300_235, 60_912, 20.25], [300_235, 60_948, 20.25]]) / FEET
    wkb = struct.pack("<BII", 1, 1002, 2) + line.astype("<f8").tobytes()
    shapes = np.array([wkb, None], object)[:-1]
    pyogrio.raw.write(
        place / "l.gpkg", shapes, [], np.array([], object), geometry_type="LineString Z", crs="EPSG:2263", driver="GPKG"
    )
    (place / "s.yaml").write_text(
        "survey: {name: s, sources: ['*.las']}\nread: {project_to: EPSG:32118+5703}\nbreaklines: {file: l.gpkg}\n"
        "quality: {check_points: {file: c.csv, crs: EPSG:2263+6360}}\n"
    )
    ended = fwclass("run", place / "s.yaml", "--workflow", "ground", "--out", place / "r", "--workers", 0)
    assert ended.returncode == 0 and "of one kind" not in ended.stderr, ended.stderr
    report = json.loads((place / "r" / "report.json").read_text())
    assert abs(report["quality"]["check_points"]["all"]["mean"]) < 0.03


def test_a_labelled_cloud_in_feet_labels_a_survey_in_feet(tmp_path: Path) -> None:
    place = survey(tmp_path / "f", "feet", "feet")
    held = laspy.read(place / "a.las")
    held.classification = np.where(np.asarray(held.x) * FEET > 300_260, 6, 2)
    held.write(place / "labelled.laz")
    (place / "s.yaml").write_text(
        "survey:\n  name: s\n  sources: [a.las]\n  reference: {kind: cloud, files: [labelled.laz]}\n  "
        "features: [zc, echo_ratio_r100]\n"
        "  classes: [{name: low, code: 2}, {name: high, code: 6}]\nread: {project_to: EPSG:32118+5703}\n"
        "areas: {train: [[300200, 60900, 300300, 60925]], gap: 2}\n"
        "train: {trees: 3}\nclassify: {context: {cells: []}}\n"
    )
    ended = fwclass("run", place / "s.yaml", "--out", place / "r", "--workers", 0, "--accept-implausible")
    assert ended.returncode == 0, ended.stderr
    sampling = json.loads((place / "r" / "report.json").read_text())["sampling"]
    labelled = [int(one["labelled"]) for one in sampling["classes"]]
    assert sum(labelled) == 6000 and min(labelled) > 2000


def test_features_of_one_file_in_feet_are_those_of_its_metres(tmp_path: Path) -> None:
    feet, metres = (survey(tmp_path / unit, unit, unit) / "a.las" for unit in ("feet", "metres"))
    words = ("--features", "height_above_ground,height_std_c200,planarity_k20")
    refused = fwclass("features", feet, tmp_path / "f.parquet", *words)
    assert refused.returncode == 1 and "--set read.project_to=EPSG:32118+5703 brings it" in refused.stderr
    into = ("--set", "read.project_to=EPSG:32118+5703")
    ended = fwclass("features", feet, tmp_path / "f.parquet", *words, *into)
    assert ended.returncode == 0, ended.stderr
    assert fwclass("features", metres, tmp_path / "m.parquet", *words).returncode == 0
    one, like = (pq.read_table(tmp_path / name).sort_by("pulse") for name in ("f.parquet", "m.parquet"))
    assert json.loads(one.schema.metadata[b"geo"])["columns"]["geometry"]["crs"]["components"][0]["id"]["code"] == 32118
    assert np.abs(one["x"].to_numpy() - like["x"].to_numpy()).max() <= 0.001 + 1e-9
    off = np.abs(one["height_std_c200"].to_numpy() - like["height_std_c200"].to_numpy())
    assert np.median(off) < 0.001 and np.mean(off < 0.01) > 0.98  # whole millimetres move an echo over an edge
    refused = fwclass("features", feet, tmp_path / "o.parquet", *words, *into, "--crs", "EPSG:2263")
    assert refused.returncode == 2 and "leave --crs out" in refused.stderr
    refused = fwclass("features", feet, tmp_path / "o.parquet", *words, "--set", "read.project_to=EPSG:2263")
    assert refused.returncode == 1 and "where: read.project_to" in refused.stderr, refused.stderr


def test_classes_of_one_file_in_feet_are_those_of_its_metres(tmp_path: Path) -> None:
    """Its points stay in feet, as they were."""
    feet, metres = (survey(tmp_path / unit, unit, unit) / "a.las" for unit in ("feet", "metres"))
    names = ("height_above_ground", "planarity_k20")
    prepared: dict[str, list[float]] = {"fill": [0.0, 0.0], "shift": [0.0, 0.0], "scale": [1.0, 1.0]}
    classes = [{"name": f"c{code}", "code": code, "codes": [code]} for code in (2, 6)]
    card: dict[str, Any] = {"format": FORMAT, "features": list(names), "classes": classes, "preparation": prepared}
    card["computed"] = feature_parameters(names, conf.section("features"))
    above_1_5_m = LinearMachine(np.array([[1.0, 0.0]]), np.array([-1.5]), card)
    save_model(tmp_path / "m", above_1_5_m)
    words = ("--model", tmp_path / "m")
    refused = fwclass("classify", feet, tmp_path / "f.laz", *words)
    assert refused.returncode == 1 and "--set read.project_to=EPSG:32118+5703 brings it" in refused.stderr
    ended = fwclass("classify", feet, tmp_path / "f.laz", *words, "--set", "read.project_to=EPSG:32118+5703")
    assert ended.returncode == 0, ended.stderr
    assert fwclass("classify", metres, tmp_path / "m.laz", *words).returncode == 0
    made, like, source = (laspy.read(path) for path in (tmp_path / "f.laz", tmp_path / "m.laz", feet))
    assert all((made[axis] == source[axis]).all() for axis in "XYZ")
    assert made.header.parse_crs().equals(source.header.parse_crs())
    assert np.mean(np.asarray(made.classification) == np.asarray(like.classification)) > 0.998
    assert (np.asarray(made.classification) == 6).sum() > 1000
