"""Files whose returns are not what others' are: rounded places, other scales of intensity, numbers and times lost."""

from __future__ import annotations

import json
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey
from stripmaker import line


def two_files(place: Path, change) -> Path:
    """The small survey as two files over the same ground, the second after `change`."""
    path = small_survey(place)
    whole = laspy.read(place / "a.las")
    whole.gps_time = np.random.default_rng(1).uniform(0, 100, len(whole.points))
    whole.intensity = np.random.default_rng(2).integers(40, 90, len(whole.points))
    several = np.arange(len(whole.points)) % 8 < 4  # of rows 0, 2 of a, 1, 3 of b
    whole.number_of_returns = np.where(several, 2, 1)
    whole.return_number = np.where(np.arange(len(several)) % 8 // 2 == 1, 2, 1)
    for name, first in (("a", 0), ("b", 1)):
        part = laspy.LasData(whole.header, whole.points[np.arange(first, len(several), 2)])
        if name == "b":
            change(part)
        part.write(place / f"{name}.las")
    text = path.read_text().replace("[a.las]", "[a.las, b.las]")
    path.write_text(text.replace("height_range_c100]", "height_range_c100, amplitude_mean_c200]"))
    return path


def rounded(part):
    part.z = np.round(np.asarray(part.z))


def stretched(part):
    part.intensity = np.asarray(part.intensity).astype(int) * 256


def doubled(part):
    part.intensity = np.asarray(part.intensity) * 2


def still(part):
    part.gps_time = np.zeros(len(part.points))


def adjusted(part):
    part.gps_time = np.asarray(part.gps_time) + 3e8


def unnumbered(part):
    part.return_number[:], part.number_of_returns[:] = 1, 1


def backward(part):
    """Pulses of three returns, of which the first lies lowest."""
    pulse, number = np.divmod(np.arange(len(part.points)), 3)
    part.gps_time, part.return_number, part.number_of_returns = 0.1 * pulse, number + 1, np.full(len(pulse), 3)
    part.z = np.asarray(part.z)[3 * pulse] + 0.3 * number


def in_feet(part):
    """Pulses of two returns along beams of 15 to 25 degrees, heights in feet."""
    pulse, number = np.divmod(np.arange(len(part.points)), 2)
    angle = np.random.default_rng(3).uniform(15, 25, len(pulse))[pulse]
    x, y, z = (np.asarray(v)[2 * pulse] for v in (part.x, part.y, part.z))
    part.gps_time, part.return_number, part.number_of_returns = 0.1 * pulse, number + 1, np.full(len(pulse), 2)
    part.x, part.y = x + 6.0 * number * np.tan(np.radians(angle)), y
    part.z = (z + 6.0 * (1 - number)) / 0.3048
    part.scan_angle = np.rint(angle / 0.006).astype(np.int16)


def thinned(part):
    """Of three pulses of two returns one has both, one the first and one the second."""
    rows = np.arange(len(part.points))
    pulse = rows - (rows % 4 == 1)
    part.gps_time, part.return_number, part.number_of_returns = 0.1 * pulse, 1 + rows % 2, np.full(len(rows), 2)
    part.z = np.asarray(part.z)[pulse] - 0.3 * (rows % 4 == 1)


def cut(part):
    part.number_of_returns[:], part.return_number[:] = 2, 1


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (rounded, 4, "places lie on a lattice, as if they were rounded (b.las: z 1 m)"),
        (stretched, 4, "single returns of b.las have an intensity of some"),
        (backward, 4, "returns that follow another of their pulse"),
        (in_feet, 4, "heights are in feet, where places are in metres"),
        *(
            pytest.param(*only_told, marks=pytest.mark.slow)
            for only_told in (
                (doubled, 0, ""),
                (still, 0, "all returns of b.las have one GPS time"),
                (adjusted, 0, "GPS times of a.las are seconds of the week, those of b.las are not"),
                (unnumbered, 0, "every return of b.las is numbered as its pulse's only one"),
                (thinned, 0, "50 % are not followed (b.las): points were thinned one by one"),
                (cut, 0, "some returns of pulses with several are missing in b.las"),
            )
        ),
    ],
)
def test_it_is_told_and_refused_where_the_result_is_wrong(tmp_path, change, code, words):
    path, root = two_files(tmp_path, change), tmp_path / "r"
    line = ("run", path, "--out", root, "--workers", 0)
    ended = fwclass(*line)
    assert ended.returncode == code, ended.stderr
    facts = json.loads((root / "report.json").read_text())["returns"]
    assert words in "\n".join(facts["remarks"]) and (words != "" or facts["remarks"] == [])
    assert words in ended.stderr
    if code:
        assert fwclass(*line, "--accept-implausible").returncode == 0


@pytest.mark.slow
def test_intensities_that_nothing_is_decided_by_are_nobodys_fault(tmp_path):
    path = two_files(tmp_path, stretched)
    path.write_text(path.read_text().replace(", amplitude_mean_c200", ""))
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 0 and "an intensity of some" not in ended.stderr, ended.stderr


def test_of_one_file_too(tmp_path):
    path = two_files(tmp_path, rounded)
    line = ("features", path.parent / "b.las", tmp_path / "f.parquet", "--features", "zc", "--crs", "EPSG:25832")
    ended = fwclass(*line)
    assert ended.returncode == 4 and "b.las: z 1 m" in ended.stderr, ended.stderr
    assert (tmp_path / "f.parquet").exists()
    assert fwclass(*line, "--overwrite", "--accept-implausible").returncode == 0
    told = fwclass("info", path.parent / "b.las").stdout
    assert "! places lie on a lattice, as if they were rounded: z 1 m" in told
    two_files(tmp_path, backward)
    ended = fwclass("ground", path.parent / "b.las", tmp_path / "g.las", "--crs", "EPSG:25832")
    assert ended.returncode == 4 and "numbered from the ground up" in ended.stderr, ended.stderr
    assert "! of " in fwclass("info", path.parent / "b.las").stdout
    two_files(tmp_path, thinned)
    assert "50 % are not followed: points were thinned one by one" in fwclass("info", path.parent / "b.las").stdout
    two_files(tmp_path, in_feet)
    ended = fwclass(*line, "--overwrite")
    assert ended.returncode == 4 and "heights are in feet" in ended.stderr, ended.stderr
    told = fwclass("info", path.parent / "b.las").stdout
    assert "! returns below others of their pulse lie 0.3" in told and "heights are in feet" in told
    assert "feet" not in fwclass("info", path.parent / "a.las").stdout
    two_files(tmp_path, still)
    assert "! all GPS times are 0.000 s" in fwclass("info", path.parent / "b.las").stdout


def test_a_survey_without_several_returns_says_so(tmp_path):
    path = small_survey(tmp_path)
    whole = laspy.read(tmp_path / "a.las")
    whole.return_number[:], whole.number_of_returns[:] = 1, 1
    whole.write(tmp_path / "a.las")
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 0 and "no pulse has several returns" in ended.stderr, ended.stderr
    assert json.loads((tmp_path / "r" / "report.json").read_text())["returns"]["single"]
    few = whole[:900]
    few.number_of_returns[:] = 2
    few.write(tmp_path / "few.las")
    path.write_text(path.read_text().replace("[a.las]", "[a.las, few.las]"))
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0)
    assert "no pulse has several returns" not in ended.stderr, ended.stderr
    assert not json.loads((tmp_path / "r" / "report.json").read_text())["returns"]["single"]


def test_the_quality_of_a_survey_with_x_and_y_exchanged_ends_with_4(tmp_path):
    one = line(0)
    place = np.stack([one["y"], one["x"], one["z"]], axis=1)
    lasmaker.write_las(tmp_path / "s.las", place, point_format=6, gps_time=one["t"])
    (tmp_path / "s.yaml").write_text("survey: {name: swapped, sources: [s.las]}\n")
    words = ("run", tmp_path / "s.yaml", "--out", tmp_path / "r", "--workflow", "quality", "--workers", 0)
    words += ("--set", "terrain.block=128", "--set", "ground.block=128")
    ended = fwclass(*words)
    assert ended.returncode == 4 and "are x and y swapped" in ended.stderr, ended.stderr
    assert "are x and y swapped" in (tmp_path / "r" / "report.html").read_text()
    assert fwclass(*words, "--accept-implausible").returncode == 0


@pytest.mark.parametrize("command", ["ground", "normalize"])
def test_terrain_of_coarse_places_ends_with_4(tmp_path, command):
    path = two_files(tmp_path, rounded)
    more = ("--method", "smrf") if command == "normalize" else ()
    ended = fwclass(command, path.parent / "b.las", tmp_path / "o.las", "--crs", "EPSG:25832", *more)
    assert ended.returncode == 4 and "b.las: z 1 m" in ended.stderr, ended.stderr
    assert (tmp_path / "o.las").exists()


@pytest.mark.slow
def test_much_noise_is_told(tmp_path):
    path = small_survey(tmp_path)
    whole = laspy.read(tmp_path / "a.las")
    z, far = np.array(whole.z), np.random.default_rng(4).random(len(whole.points)) < 0.25
    whole.z = np.where(far, z + np.random.default_rng(5).uniform(300, 3_000, len(z)), z)
    whole.write(tmp_path / "a.las")
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0, "--accept-implausible")
    assert ended.returncode == 0 and "the noise filter took out 1,4" in ended.stderr, ended.stderr
    ways = {"r": (), "small": ("--set", "tile.size=20"), "lined": ("--set", "classify.regularize.strength=0.1")}
    for name, more in ways.items():
        words = ("--workers", 0, "--accept-implausible", "--set", "classify.noise=true", *more)
        assert fwclass("run", path, "--out", tmp_path / name, *words).returncode == 0
    first, small, lined = (
        np.asarray(laspy.read(tmp_path / name / "laz" / "strips" / "a.laz").classification) for name in ways
    )
    assert (first == 18).sum() > 1_400 and not (first[~far] == 18).any()
    assert (first == small).all() and (lined == 18)[first == 18].all()
    out = tmp_path / "o.las"
    line = ("classify", tmp_path / "a.las", out, "--model", tmp_path / "r" / "model", "--crs", "EPSG:25832")
    one = fwclass(*line, "--set", "classify.noise=true", "--accept-implausible", "--accept-drift")
    assert one.returncode == 0, one.stderr
    assert (np.asarray(laspy.read(out).classification) == first).all()


def test_a_file_whose_points_are_all_flagged_says_why_nothing_is_labelled(tmp_path):
    path = small_survey(tmp_path)
    whole = laspy.read(tmp_path / "a.las")
    whole.synthetic = np.ones(len(whole.points), bool)
    whole.write(tmp_path / "a.las")
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 2 and "flags as withheld or synthetic count for none" in ended.stderr


@pytest.mark.parametrize("number", [0, 3])
def test_return_numbers_that_are_none_are_told(tmp_path, number):
    path = small_survey(tmp_path)
    whole = laspy.read(tmp_path / "a.las")
    whole.return_number[:] = number
    whole.number_of_returns[:] = np.where(np.arange(6000) % 3, 1, 2)
    whole.write(tmp_path / "a.las")
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0, "--workflow", "ground")
    assert "6,000 of 6,000 returns in a.las have number 0, or one above" in ended.stderr, ended.stderr
