"""Maps: light as physics has it, areas outlined, colours told apart, the same bytes again."""

from __future__ import annotations

import io
import itertools
import math

import numpy as np
import pytest
from matplotlib import image

from fwclass.grid import Window
from fwclass.publish.drawing import area_edges, round_length
from fwclass.publish.figures import class_map, downsample, fill_gaps, relief
from fwclass.publish.palette import BY_NAME, colours, css
from fwclass.publish.params import PublishParams
from fwclass.publish.shade import hillshade

WINDOW = Window(1.0, 500_000, 5_400_000, 80, 60)
NAMES = [{"name": "ground", "code": 2}, {"name": "building", "code": 6}, {"name": "cars", "code": 64}]


def scene() -> tuple[np.ndarray, np.ndarray]:
    classes = np.full(WINDOW.shape, 2, np.uint8)
    classes[10:30, 20:50] = 6
    classes[40:, :20] = 0
    dtm = np.add.outer(np.arange(60) * 0.1, np.arange(80) * 0.05).astype(np.float32)
    dtm[50:, :10] = np.nan
    return classes, dtm


def test_figures_are_png_with_the_classes_colours_and_the_same_bytes(params: PublishParams) -> None:
    classes, dtm = scene()
    areas = {"train": [[500_000, 5_400_000, 500_040, 5_400_030]], "test": [[500_040, 5_400_000, 500_080, 5_400_030]]}
    made = class_map(classes, WINDOW, NAMES, params, (dtm, WINDOW), areas)
    assert made == class_map(classes, WINDOW, NAMES, params, (dtm, WINDOW), areas)
    assert b"Software" not in made and b"tIME" not in made and b"Creation" not in made
    plain = class_map(classes, WINDOW, NAMES, params)
    pixels = np.rint(image.imread(io.BytesIO(plain))[..., :3] * 255).astype(int).reshape(-1, 3)
    for name in ("ground", "building"):
        share = (np.abs(pixels - BY_NAME[name]).sum(axis=1) == 0).mean()
        assert share > 0.05, name


def test_relief_of_anything_is_drawn(params: PublishParams) -> None:
    _, dtm = scene()
    assert relief(dtm, WINDOW, params) == relief(dtm, WINDOW, params)
    nothing = np.full(WINDOW.shape, np.nan, np.float32)
    assert relief(nothing, WINDOW, params).startswith(b"\x89PNG")
    one = Window(1.0, 0, 0, 1, 1)
    assert relief(np.ones((1, 1), np.float32), one, params).startswith(b"\x89PNG")
    assert class_map(np.zeros((1, 1), np.uint8), one, NAMES, params).startswith(b"\x89PNG")


def test_light_is_the_cosine_between_normal_and_sun(params: PublishParams) -> None:
    """On a plane z = a x + b y the normal is (-a, -b, 1) / |…|, whatever the cell."""
    true = params.model_copy(update={"exaggeration": 1.0, "sun_azimuth": 300.0, "sun_altitude": 40.0})
    azimuth, altitude = math.radians(300), math.radians(40)
    sun = np.array([math.sin(azimuth) * math.cos(altitude), math.cos(azimuth) * math.cos(altitude), math.sin(altitude)])
    for a, b in ((0.0, 0.0), (0.3, -0.2), (-1.0, 0.5)):
        normal = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
        for cell in (0.5, 2.0):
            plane = np.add.outer(b * cell * np.arange(9), a * cell * np.arange(7)).astype(np.float32)
            assert hillshade(plane, cell, true) == pytest.approx(max(0.0, normal @ sun), abs=1e-5)


def test_an_unknown_height_is_lit_as_level_ground(params: PublishParams) -> None:
    light = hillshade(np.full((4, 4), np.nan, np.float32), 1.0, params)
    assert light == pytest.approx(math.sin(math.radians(params.sun_altitude)))


def test_single_gaps_are_filled_and_larger_ones_stay() -> None:
    codes = np.full((9, 9), 5, np.uint8)
    codes[2, 2] = codes[0, 0] = codes[8, 4] = 0
    codes[5:8, 5:8] = 0
    codes[2, 1] = codes[1, 2] = codes[3, 2] = codes[2, 3] = 2
    made = fill_gaps(codes)
    assert made[2, 2] == 2, "four against four: the smaller code"
    assert made[0, 0] == 5 and made[8, 4] == 5
    assert (made == 0).sum() == 9 and (made[5:8, 5:8] == 0).all()
    assert (fill_gaps(np.zeros((3, 4), np.uint8)) == 0).all()


def test_a_large_raster_is_thinned_from_the_south_west() -> None:
    array = np.arange(60 * 80).reshape(60, 80)
    part, view = downsample(array, WINDOW, 30)
    assert part.shape == (20, 27) and part[0, 0] == 0 and part[1, 1] == 3 * 80 + 3
    assert (view.xmin, view.ymin, view.cell) == (500_000, 5_400_000, 3.0)


def test_scale_bars_have_round_lengths() -> None:
    assert [round_length(v) for v in (75, 20, 19.9, 0.7, 999, 1000)] == [50, 20, 10, 0.5, 500, 1000]


def test_edges_inside_an_area_are_left_out() -> None:
    two = [(0.0, 0.0, 10.0, 10.0), (10.0, 0.0, 20.0, 10.0)]
    lines = area_edges(two, 0.0)
    assert len(lines) == 6 and [(10.0, 0.0), (10.0, 10.0)] not in lines
    length = sum(math.dist(*line) for line in lines)
    assert length == 60
    (one,) = [line for line in area_edges(two[:1], 1.0) if line[0][1] == line[1][1] == 1.0]
    assert one == [(1.0, 1.0), (9.0, 1.0)]


def test_every_class_has_a_colour_of_its_own() -> None:
    made = colours([*NAMES, {"name": "fences", "code": 65}, {"name": "Tree", "code": 5}, {"name": "x", "code": 9}])
    assert made[2] == BY_NAME["ground"] and made[5] == BY_NAME["vegetation"] and made[9] == BY_NAME["water"]
    assert len(set(made.values())) == len(made) and css((1, 2, 255)) == "#0102ff"


# Machado, Oliveira & Fernandes 2009, table 1, severity 1.0; on linear RGB
VISION = {
    "normal": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}
TOLD_APART = 15.0
"""CIE 1976 difference; about six times a just noticeable one (2.3, Mahy 1994)."""


def lab(rgb: tuple[int, int, int], matrix: list[list[float]]) -> np.ndarray:
    s = np.array(rgb) / 255
    linear = np.clip(matrix @ np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4), 0, 1)
    xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]] @ linear
    t = xyz / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > 216 / 24389, np.cbrt(t), (24389 / 27 * t + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISION)
def test_classes_are_told_apart_by_colour_blind_readers(vision: str) -> None:
    for group in (
        ("ground", "vegetation", "building", "water", "artificial", "noise", "bridge", "unclassified"),
        ("ground", "low vegetation", "medium vegetation", "high vegetation", "building"),
    ):
        for a, b in itertools.combinations(group, 2):
            apart = np.linalg.norm(lab(BY_NAME[a], VISION[vision]) - lab(BY_NAME[b], VISION[vision]))
            assert apart > TOLD_APART, (a, b, apart)
