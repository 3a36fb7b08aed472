"""Places and beams in a projected system, against the geometry of the ellipsoid."""

import numpy as np
import pytest
from pyproj import CRS

from fwclass.errors import InputError
from fwclass.formats.projected import project, project_beams, utm_of

A, F = 6378137.0, 1.0 / 298.257223563
E2 = F * (2.0 - F)
SPEED = 0.149896229


def geocentric(lon: np.ndarray, lat: np.ndarray, h: np.ndarray) -> np.ndarray:
    """The ellipsoid's own formula, in place of PROJ."""
    lon, lat = np.radians(lon), np.radians(lat)
    n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    rim = (n + h) * np.cos(lat)
    return np.stack([rim * np.cos(lon), rim * np.sin(lon), (n * (1.0 - E2) + h) * np.sin(lat)], axis=1)


def axes(lon: float, lat: float) -> np.ndarray:
    """East, north, up as rows."""
    lon, lat = np.radians(lon), np.radians(lat)
    east = [-np.sin(lon), np.cos(lon), 0.0]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    return np.array([east, north, [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]])


@pytest.mark.parametrize(
    ("lon", "lat", "code"),
    [
        (9.0, 48.0, 32632),
        (-76.5, 39.0, 32618),
        (283.5, 39.0, 32618),
        (147.0, -42.0, 32755),
        (-180.0, 1.0, 32601),
        (179.999, 1.0, 32660),
        (20.0, 85.0, 32661),
        (20.0, -81.0, 32761),
    ],
)
def test_zone(lon, lat, code):
    assert utm_of(np.array([lon]), np.array([lat])).to_epsg() == code


@pytest.mark.parametrize(("lon", "codes"), [([179.9, -179.95, -179.9], {32601}), ([359.9, 0.2, 0.3], {32631})])
def test_zone_across_a_seam(lon, codes):
    assert utm_of(np.array(lon), np.full(3, 10.0)).to_epsg() in codes


def test_central_meridian_is_the_law_of_utm():
    """On it x is 500 km, and a metre north is 0.9996 m."""
    lat = np.array([47.0, 47.00001])
    found = project(CRS.from_epsg(4326), CRS.from_epsg(32632), np.stack([np.full(2, 9.0), lat, [5.0, 7.0]], axis=1))
    assert np.abs(found[:, 0] - 500_000.0).max() < 1e-6
    assert list(found[:, 2]) == [5.0, 7.0]
    apart = np.linalg.norm(np.diff(geocentric(np.full(2, 9.0), lat, np.zeros(2)), axis=0))
    assert np.diff(found[:, 1])[0] / apart == pytest.approx(0.9996, abs=1e-6)


def test_geocentric_and_degrees_are_one_place():
    rng = np.random.default_rng(4)
    lon, lat, h = rng.uniform(8.0, 10.0, 50), rng.uniform(46.0, 48.0, 50), rng.uniform(0.0, 3000.0, 50)
    target = CRS.from_epsg(32632)
    a = project(CRS.from_epsg(4979), target, np.stack([lon, lat, h], axis=1))
    b = project(CRS.from_epsg(4978), target, geocentric(lon, lat, h))
    assert np.abs(a - b).max() < 1e-5


@pytest.mark.parametrize("lon", [7.2, 9.0, 11.0])
def test_beam_is_turned_by_the_convergence(lon):
    """East, north and up of a geocentric beam become those of the grid, turned by its convergence."""
    lat, h = 47.0, 800.0
    place, frame = geocentric(np.array([lon]), np.array([lat]), np.array([h])), axes(lon, lat)
    local = np.array([0.3, -0.2, 0.9])
    step = SPEED * local / np.linalg.norm(local)
    here, found = project_beams(CRS.from_epsg(4978), CRS.from_epsg(32632), place, (step @ frame)[None])
    assert here[0, 2] == pytest.approx(h, abs=1e-6)
    turn = np.arctan(np.tan(np.radians(lon - 9.0)) * np.sin(np.radians(lat)))
    c, s = np.cos(turn), np.sin(turn)
    grid = np.array([step[0] * c - step[1] * s, step[0] * s + step[1] * c])
    scale = np.linalg.norm(found[0, :2]) / np.linalg.norm(grid)
    assert 0.9994 < scale < 1.0003  # 0.9996 on the meridian, less the height over the radius of the earth
    assert np.abs(found[0, :2] / scale - grid).max() < 1e-6 * SPEED * 10
    assert found[0, 2] == pytest.approx(step[2], rel=1e-5)


def test_what_is_not_finite_stays_so():
    found = project(CRS.from_epsg(4326), CRS.from_epsg(32632), np.array([[9.0, 47.0, 1.0], [np.nan, 47.0, 1.0]]))
    assert np.isfinite(found[0]).all() and not np.isfinite(found[1]).all()


@pytest.mark.parametrize(
    ("target", "place", "words"),
    [
        (4326, [9.0, 47.0, 0.0], "metres on a plane"),
        (2263, [-74.0, 40.7, 0.0], "metres on a plane"),
        (32632, [9.0, 400.0, 0.0], "does not reach"),
    ],
)
def test_refused(target, place, words):
    with pytest.raises(InputError, match=words):
        project(CRS.from_epsg(4326), CRS.from_epsg(target), np.array([place]), "a.file")
