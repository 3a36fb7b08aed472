"""Packets of other returns, times and beam vectors of another unit, and vectors that point elsewhere: every sample is
sound, and so is every fit. The returns tell, by their strength and by how they lie to each other."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass
from lasmaker import Descriptor, digitise, gaussian, survey, write_las

BLOCK = ("wavepacket_index", "wavepacket_offset", "wavepacket_size")
ALL = (*BLOCK, "return_point_wave_location", "x_t", "y_t", "z_t")
MIXED = "the other way round in strength than their echoes"
UNITS = "do not lie as far apart as light goes between their locations"


def of_neighbours(points, columns=BLOCK, step: int = 40) -> None:
    for name in columns:
        points[name] = np.roll(points[name], step)


def with_all_beside(points) -> None:
    of_neighbours(points, ALL)


def shuffled(points) -> None:
    order = np.argsort(np.arange(len(points)) + np.random.default_rng(1).uniform(0, 80, len(points)))
    for name in ALL:
        points[name] = points[name][order]


def one_way(points) -> None:
    points["return_point_wave_location"] *= 0.5


def slow(points) -> None:
    for name in ALL[-3:]:
        points[name] *= 0.8


def mirrored_from_the_middle(points) -> None:
    for name in ALL[-3:-1]:
        points[name][len(points) // 2 :] *= -1.0


def turned_from_the_middle(points) -> None:
    for name in ALL[-3:]:
        points[name][len(points) // 2 :] *= -1.0


def straight_down(points) -> None:
    points["z_t"] = np.sqrt(sum(points[name] ** 2 for name in ALL[-3:]))
    points["x_t"] = points["y_t"] = 0.0


def decompose(folder: Path, change, echoes: int = 3) -> tuple[int, str]:
    path = survey(folder / "a.las", 400, max_echoes=echoes).path
    las = laspy.read(path)
    change(las.points.array)
    las.write(path)
    ended = fwclass("decompose", path, folder / "a.laz", "--overwrite")
    return ended.returncode, ended.stderr


@pytest.mark.parametrize(
    ("change", "said", "echoes"),
    [
        (of_neighbours, MIXED, 1),
        (with_all_beside, MIXED, 1),
        (with_all_beside, UNITS, 3),
        (shuffled, MIXED, 1),
        (one_way, UNITS, 3),
        (slow, UNITS, 3),
        (mirrored_from_the_middle, UNITS, 3),
        (turned_from_the_middle, UNITS, 3),
        (straight_down, UNITS, 3),
    ],
)
def test_it_is_told_and_ends_with_4(tmp_path: Path, change, said: str, echoes: int) -> None:
    code, words = decompose(tmp_path, change, echoes)
    assert code == 4 and said in words, words


def test_a_sound_file_is_none_of_it(tmp_path: Path) -> None:
    code, words = decompose(tmp_path, lambda points: None)
    assert code == 0 and MIXED not in words and UNITS not in words, words


def test_samples_of_another_gain_are_no_other_returns(tmp_path: Path) -> None:
    """Every other pulse recorded at a quarter of the scale, and its descriptor says so."""
    rng = np.random.default_rng(3)
    n, full = 400, rng.uniform(60.0, 220.0, 400)
    gain = np.where(np.arange(n) % 2, 4.0, 1.0)
    waves = [
        digitise(gaussian(60, [(a / g, 25.0, 3.5)], 10.0) + rng.normal(0, 0.7, 60))
        for a, g in zip(full, gain, strict=True)
    ]
    path = write_las(
        tmp_path / "g.las",
        np.stack([500000.0 + np.arange(n), np.full(n, 5.4e6), np.full(n, 100.0)], axis=1),
        waveforms=waves,
        descriptor_of=np.where(gain == 1.0, 1, 2),
        descriptors={1: Descriptor(), 2: Descriptor(gain=4.0)},
        pulse=np.arange(n),
        location=25.0,
        intensity=np.rint(100.0 * full),
        gps_time=1e-4 * np.arange(n),
    )
    ended = fwclass("decompose", path, tmp_path / "g.laz")
    assert ended.returncode == 0 and MIXED not in ended.stderr, ended.stderr


def test_intensities_that_do_not_differ_tell_nothing(tmp_path: Path) -> None:
    def constant(points) -> None:
        points["intensity"] = 7

    code, words = decompose(tmp_path, constant)
    assert code == 0 and MIXED not in words, words


def test_vectors_of_the_way_there_alone_are_refused(tmp_path: Path) -> None:
    def half(points) -> None:
        for name in ALL[-3:]:
            points[name] *= 0.501

    code, words = decompose(tmp_path, half, 1)
    assert code == 1 and "times as long as light's way" in words, words
