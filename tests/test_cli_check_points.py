"""Check points in `run --workflow quality`: figures, layer, page, threshold, and files that cannot be used."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
from commandline import fwclass
from pyproj import Transformer
from stripmaker import ground, line, write_lines

from fwclass.quality.judge import judge_check_points

LIFT = 0.05
"""m, of the one line that was flown."""

X, Y = 500_000.0, 5_400_000.0


def points(n: int = 40) -> np.ndarray:
    """x, y, true height, class code: open land in the west, plants in the east, where the survey is 0.1 m higher."""
    rng = np.random.default_rng(1)
    x, y = X + rng.uniform(5, 95, n), Y + rng.uniform(5, 235, n)
    code = np.where(x > X + 60, 4, 2)
    return np.stack([x, y, ground(x, y) - 0.1 * (code == 4), code], axis=1)


def run(place: Path, *settings: str, expect: int = 0, out: str = "run") -> tuple[dict[str, Any], str]:
    words = ("--workflow", "quality", "--workers", "0", "--set", "terrain.block=128", "--set", "ground.block=128")
    ended = fwclass("run", place / "s.yaml", "--out", place / out, *words, *settings)
    assert ended.returncode == expect, ended.stdout + ended.stderr
    path = place / out / "quality.json"
    return json.loads(path.read_text()) if path.is_file() else {}, ended.stdout + ended.stderr


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("checked")
    write_lines(place / "l0.las", [line(0, (LIFT, 0.0, 0.0))])
    (place / "s.yaml").write_text("survey: {name: checked, sources: ['l*.las']}\n")
    return place


def written(path: Path, rows: np.ndarray, head: str = "x,y,z,class\n") -> Path:
    path.write_text(head + "".join(",".join(f"{v:.3f}" for v in row[:3]) + f",{row[3]:.0f}\n" for row in rows))
    return path


FILE = ("--set", "quality.check_points.file=c.csv")


@pytest.fixture(scope="module")
def made(survey: Path) -> tuple[dict[str, Any], str]:
    written(survey / "c.csv", points())
    return run(survey, *FILE)


def test_a_shift_and_plants_are_told_apart(survey: Path, made: tuple[dict[str, Any], str]) -> None:
    facts, _ = made
    checked = facts["check_points"]
    assert checked["given"] == 40 == checked["all"]["count"] and checked["nearest_echo"] < 0.5
    assert checked["open"]["mean"] == pytest.approx(LIFT, abs=0.01) and checked["open"]["sd"] < 0.03
    assert checked["vegetated"]["mean"] == pytest.approx(LIFT + 0.1, abs=0.01)
    assert checked["open"]["count"] + checked["vegetated"]["count"] == 40
    assert any("above the check points on average" in r for r in facts["remarks"])
    layer = pyogrio.read_dataframe(survey / "run" / "quality.gpkg", layer="check_points")
    assert ["check_points", "Point"] in pyogrio.list_layers(survey / "run" / "quality.gpkg").tolist()
    assert len(layer) == 40 and "32633" in str(layer.crs) and "name" not in layer
    assert np.sqrt((layer["dz"] ** 2).mean()) == pytest.approx(checked["all"]["rmse"], rel=1e-12)
    assert (layer.geometry.x.to_numpy() == points()[:, 0].round(3)).all()
    page = (survey / "run" / "quality.html").read_text()
    assert "heights under plants" in page and "40 of 40 compared" in page


@pytest.mark.parametrize("size", ["40", pytest.param("1000", marks=pytest.mark.slow)])
def test_tiles_change_no_byte(survey: Path, made: tuple[dict[str, Any], str], size: str) -> None:
    again, _ = run(survey, *FILE, "--set", f"tile.size={size}", out=f"run{size}")
    assert again == made[0]
    for name in ("quality.json", "quality.gpkg", "quality.html"):
        assert (survey / f"run{size}" / name).read_bytes() == (survey / "run" / name).read_bytes()


def test_another_system_and_other_columns(survey: Path, made: tuple[dict[str, Any], str]) -> None:
    rows = points()
    rows[:, 0], rows[:, 1] = Transformer.from_crs(32633, 32632, always_xy=True).transform(rows[:, 0], rows[:, 1])
    head, lines = "name;height;northing;easting;remark\n", []
    lines = [f"Höhe {k};{z:.3f};{y:.4f};{x:.4f};stone\n" for k, (x, y, z, _) in enumerate(rows)]
    (survey / "d.csv").write_text(head + "".join(lines))
    words = ("--set", "quality.check_points.file=d.csv", "--set", "quality.check_points.crs=EPSG:32632")
    facts, _ = run(survey, *words)
    assert facts["check_points"]["all"]["mean"] == pytest.approx(made[0]["check_points"]["all"]["mean"], abs=0.002)
    assert facts["check_points"]["vegetated"] is None
    layer = pyogrio.read_dataframe(survey / "run" / "quality.gpkg", layer="check_points")
    assert layer["name"].tolist() == [f"Höhe {k}" for k in range(40)], "they were left out"


@pytest.mark.parametrize("code", ["4", "GCP"])
def test_a_surveyor_s_code_is_no_class(survey: Path, made: tuple[dict[str, Any], str], code: str) -> None:
    lines = [f"{x:.3f},{y:.3f},{z:.3f},{code}\n" for x, y, z, _ in points()]
    (survey / "code.csv").write_text("x,y,z,code\n" + "".join(lines))
    facts, _ = run(survey, "--set", "quality.check_points.file=code.csv", out="coded")
    assert facts["check_points"]["vegetated"] is None
    assert facts["check_points"]["all"]["rmse"] == pytest.approx(made[0]["check_points"]["all"]["rmse"], abs=1e-12)


def test_points_without_ground_around_them_are_told(survey: Path) -> None:
    rows = points(35)
    rows[:3, 0] += 2000.0
    written(survey / "far.csv", rows)
    facts, _ = run(survey, "--set", "quality.check_points.file=far.csv")
    assert facts["check_points"]["all"]["count"] == 32
    assert any("3 of 35 check points are not compared" in r for r in facts["remarks"])


def test_a_threshold_ends_with_exit_code_4(survey: Path) -> None:
    written(survey / "c.csv", points())
    facts, said = run(survey, *FILE, "--set", "quality.max_rmse_z=0.05", expect=4)
    assert "check points" in said and "quality.max_rmse_z" in said and facts["check_points"]["all"]["rmse"] > 0.05
    run(survey, *FILE, "--set", "quality.max_rmse_z=0.2")


def test_nothing_to_judge_by_misses_its_threshold(survey: Path) -> None:
    _, said = run(survey, "--set", "quality.max_rmse_z=0.2", expect=4, out="none")
    assert "nothing tells" in said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y,z\n5400010,500010,3\n", "x and y are exchanged"),
        ("x,y,z\n5400010,5400010,3\n", "no check point lies in the survey"),
        ("x,y,z\n500010,5400010,\n", "lacks a coordinate"),
        ("x,y\n500010,5400010\n", "z"),
        ("", "no points"),
        ("PK\x03\x04", "no text"),
        ("x,y,z\n500010,5400010,abc\n", "neither numbers nor a header"),
        (None, "c2.csv"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_runs(survey: Path, text: str | None, words: str) -> None:
    (survey / "c2.csv").unlink(missing_ok=True)
    if text is not None:
        (survey / "c2.csv").write_text(text)
    out = f"refused{abs(hash(text))}"
    _, said = run(survey, "--set", "quality.check_points.file=c2.csv", expect=1, out=out)
    assert words in said and "Traceback" not in said, said


def test_heights_of_another_system_are_said_and_end_with_4(survey: Path) -> None:
    rows = points()
    rows[:, 2] += 47.0
    written(survey / "geoid.csv", rows)
    words = ("--set", "quality.check_points.file=geoid.csv")
    _, told = run(survey, *words, expect=4, out="geoid")
    assert "the check points' heights are not the survey's" in told
    assert "checked     40 of 40: RMSEz 46.9" in told and "remark      the survey lies 46.9" in told
    run(survey, *words, "--accept-implausible", out="geoid")
    for nothing in (None, {"all": None, "given": 3}):
        judge_check_points(nothing, False, "s.yaml")
