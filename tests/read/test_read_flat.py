"""Degrees and geocentric coordinates are recognised, by name or by number, told by `info` and refused by all else."""

from __future__ import annotations

import json

import laspy
import numpy as np
import pytest
from commandline import fwclass
from lasmaker import survey, write_las
from pyproj import CRS, Transformer

from fwclass.errors import InputError
from fwclass.formats.flat import DEGREES, DOWN, GEOCENTRIC, not_flat, refuse_unless_flat

RNG = np.random.default_rng(1)
LONLAT = np.column_stack(
    [5.99 + RNG.uniform(0, 0.002, 200), 45.11 + RNG.uniform(0, 0.002, 200), RNG.uniform(9, 30, 200)]
)
EARTH = np.array([4_201_000.0, 170_000.0, 4_780_000.0]) + RNG.uniform(0.0, 60.0, (200, 3))
KINDS = {
    "degrees without a system": (LONLAT, {"keys": None, "scale": 1e-7}, "like degrees"),
    "degrees": (LONLAT, {"keys": {2048: 4326}, "scale": 1e-7}, "in degrees"),
    "geocentric without a system": (EARTH, {"keys": None}, "geocentric"),
    "geocentric": (EARTH, {"keys": None, "wkt": CRS(4978).to_wkt("WKT1_GDAL")}, "geocentric"),
}
CONFIG = """
survey:
  name: t
  sources: ["*.las"]
  reference: {kind: source}
  features: [height_above_ground]
  classes: [{name: ground, code: 2, codes: [2]}, {name: rest, code: 1, codes: [1]}]
areas: {train: [[0, 0, 1, 1]]}
"""


def write(folder, kind):
    places, options, words = KINDS[kind]
    return write_las(folder / "a.las", places, point_format=6, gps_time=np.arange(200.0), **options), words


@pytest.mark.parametrize("kind", KINDS)
def test_every_command_that_measures_refuses(tmp_path, kind):
    path, words = write(tmp_path, kind)
    out = tmp_path / "out.laz"
    for line in (
        ("decompose", path, out),
        ("ground", path, out),
        ("normalize", path, out, "--method", "smrf"),
        ("features", path, tmp_path / "out.parquet"),
    ):
        ended = fwclass(*line)
        assert ended.returncode == 1 and words in ended.stderr and "reproject" in ended.stderr, (line, ended.stderr)
    (tmp_path / "t.yaml").write_text(CONFIG)
    for more in ((), ("--set", "survey.crs=none")):
        ended = fwclass("run", tmp_path / "t.yaml", *more, "--out", tmp_path / "r", "--workers", 0)
        assert ended.returncode == 1 and words in ended.stderr, ended.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.las", "t.yaml"]


@pytest.mark.parametrize("kind", KINDS)
def test_naming_a_projected_system_turns_no_degrees_into_metres(tmp_path, kind):
    """1000 footprints were written to 64 places, a thousandth of a degree apart."""
    path, _ = write(tmp_path, kind)
    (tmp_path / "t.yaml").write_text(CONFIG)
    ended = fwclass(
        "run", tmp_path / "t.yaml", "--set", "survey.crs=EPSG:32631", "--out", tmp_path / "r", "--workers", 0
    )
    assert ended.returncode == 1 and "transforms nothing" in ended.stderr, ended.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.las", "t.yaml"]
    ended = fwclass("decompose", path, tmp_path / "out.laz", "--crs", "EPSG:32631")
    if "without" in kind:
        assert ended.returncode == 1 and "look" in ended.stderr and "transforms nothing" in ended.stderr, ended.stderr
        return
    las = laspy.read(tmp_path / "out.laz")
    way = Transformer.from_crs(4326 if kind == "degrees" else 4978, 32631, always_xy=True)
    there = np.stack(way.transform(*KINDS[kind][0].T), axis=1)[:, :2]
    assert ended.returncode == 0 and len(las) == 200
    off = [np.hypot(*(there - place).T).min() for place in np.stack([las.x, las.y], axis=1)]
    assert max(off) < 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_info_says_so(tmp_path, kind):
    path, words = write(tmp_path, kind)
    faults = json.loads(fwclass("info", path, "--json").stdout)["faults"]
    assert any(words in fault for fault in faults), faults


def test_waveforms_in_degrees_are_refused_before_they_are_fitted(tmp_path):
    path = survey(tmp_path / "a.las", 20, keys={2048: 4326}).path
    ended = fwclass("decompose", path, tmp_path / "o.laz")
    assert ended.returncode == 1 and "in degrees" in ended.stderr and not (tmp_path / "o.laz").exists()
    assert fwclass("decompose", path, tmp_path / "o.laz", "--crs", "EPSG:25832").returncode == 0, (
        "the user knows better"
    )


def test_text_in_degrees(tmp_path):
    np.savetxt(tmp_path / "a.xyz", LONLAT, fmt="%.8f")
    ended = fwclass("ground", tmp_path / "a.xyz", tmp_path / "o.xyz")
    assert ended.returncode == 1 and "like degrees" in ended.stderr


@pytest.mark.parametrize(
    ("low", "high", "step", "kind"),
    [
        ((0.0, 0.0, 0.0), (1.0, 1.0, 0.3), 0.001, ""),  # a square metre, metres
        ((0.0, 0.0, 0.0), (1.0, 1.0, 0.3), None, ""),
        ((5.0, 5.0, 5.0), (5.0, 5.0, 5.0), 1e-7, ""),  # one place
        ((0.0, 0.0, 200.0), (60.0, 50.0, 230.0), 1e-5, ""),  # a local system
        ((500_000.0, 5_400_000.0, 200.0), (500_100.0, 5_400_100.0, 300.0), 0.001, ""),
        (
            (500_000.0, 6_350_000.0, 200.0),
            (500_100.0, 6_350_100.0, 300.0),
            0.001,
            "",
        ),  # as far from 0 as the earth's radius
        ((-70.1, -33.5, 500.0), (-70.0, -33.4, 900.0), 1e-7, DEGREES),
        ((-70.1, -33.5, 500.0), (-70.0, -33.4, 900.0), None, DEGREES),
        ((-70.1, -133.5, 500.0), (-70.0, -133.4, 900.0), 1e-7, ""),  # no latitude
        ((4.2e6, 1.7e5, 4.78e6), (4.2001e6, 1.7001e5, 4.7801e6), 0.001, GEOCENTRIC),
        ((np.inf,) * 3, (-np.inf,) * 3, 0.001, ""),
        ((np.nan,) * 3, (1.0,) * 3, 0.001, ""),
    ],
)
def test_numbers(low, high, step, kind):
    assert not_flat(None, low, high, step) == kind
    sure = kind == GEOCENTRIC or (kind == DEGREES and step is not None)  # a projected system was named for degrees
    assert not_flat(CRS(25832), low, high, step) == (kind if sure else "")


def test_depths_are_no_heights():
    low, high = (652_000.0, 6_862_000.0, -43.0), (653_000.0, 6_863_000.0, -20.0)
    assert not_flat(CRS.from_user_input("EPSG:2154+5715"), low, high) == DOWN
    assert not_flat(CRS.from_user_input("EPSG:2154+5720"), low, high) == ""
    with pytest.raises(InputError, match="heights are depths"):
        refuse_unless_flat(CRS.from_user_input("EPSG:2154+5715"), low, high, "a.laz")
