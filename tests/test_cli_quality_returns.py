"""`run --workflow quality` of files with waveforms: their own returns tell density, voids and strips."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import lasmaker
import laspy
import plsmaker
import pyarrow.parquet as pq
import pytest
from commandline import fwclass

WORDS = ("--workflow", "quality")
FIGURES = ("echoes", "noise", "pulses", "density", "voids", "strips")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    for k in range(2):
        lasmaker.survey(tmp_path / f"a{k}.las", 400, seed=k)
    (tmp_path / "s.yaml").write_text("survey: {name: waves, sources: ['a*.las'], crs: EPSG:32633}\n")
    return tmp_path


def run(place: Path, out: str, *settings: str, workers: int = 0) -> tuple[dict[str, Any], str]:
    words = ["--workers", workers, *(w for s in ("plausibility.accept=true", *settings) for w in ("--set", s))]
    ended = fwclass("run", place / "s.yaml", "--out", place / out, *WORDS, *words)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return json.loads((place / out / "quality.json").read_text()), ended.stderr


def stages(place: Path, out: str) -> set[str]:
    return {p.name for p in (place / out / "store").iterdir()}


def test_returns_are_enough_and_it_is_said(place: Path) -> None:
    facts, told = run(place, "run")
    assert facts["judged_by"] == "returns" and "waveforms are left aside" in facts["remarks"][0]
    assert "waveforms are left aside" in told and "waveforms are left aside" in (place / "run/quality.html").read_text()
    assert not stages(place, "run") & {"read", "pulse", "places"}
    points = [laspy.read(place / f"a{k}.las") for k in range(2)]
    assert facts["echoes"] == sum(len(p.points) for p in points)
    assert facts["pulses"] + facts["noise"] >= sum(int((p.return_number == 1).sum()) for p in points) >= facts["pulses"]


def test_as_if_the_files_had_no_waveforms(place: Path) -> None:
    facts, _ = run(place, "run")
    for k in range(2):
        las = laspy.read(place / f"a{k}.las")
        laspy.convert(las, point_format_id=6).write(place / f"a{k}.las")
    plain, told = run(place, "plain")
    assert "judged_by" not in plain and "left aside" not in told
    assert {n: facts[n] for n in FIGURES} == {n: plain[n] for n in FIGURES}


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_tiles_chunks_and_workers_change_no_byte(place: Path, workers: int) -> None:
    run(place, "run")
    run(place, "other", "tile.size=50", "read.chunk_pulses=150", workers=workers)
    for name in ("quality.json", "rasters/pulse_density.tif"):
        assert (place / "other" / name).read_bytes() == (place / "run" / name).read_bytes(), name
    pages = [(place / out / "quality.html").read_text() for out in ("other", "run")]
    # only this process draws the tests' coarse pictures
    one, two = (re.sub('base64,[^"]*|--wide: [0-9]+px| class="long"', "", page) for page in pages)
    assert one == two


def test_waveforms_on_request_and_where_the_run_has_them(place: Path) -> None:
    facts, told = run(place, "run", "survey.echoes=waveforms")
    assert "judged_by" not in facts and "left aside" not in told and "pulse" in stages(place, "run")
    again, told = run(place, "run")
    assert again == facts and "computed" not in told.split("report")[0]
    asked, _ = run(place, "run", "survey.echoes=returns")
    assert asked["judged_by"] == "returns"


def test_pulses_without_returns_are_decomposed(tmp_path: Path) -> None:
    plsmaker.survey(tmp_path / "a0.pls", 60)
    (tmp_path / "s.yaml").write_text("survey: {name: waves, sources: ['a*.pls'], crs: EPSG:32633}\n")
    facts, _ = run(tmp_path, "run")
    assert "judged_by" not in facts and "pulse" in stages(tmp_path, "run")
    ended = fwclass(
        "run", tmp_path / "s.yaml", "--out", tmp_path / "no", *WORDS, "--workers", "0", "--set", "survey.echoes=returns"
    )
    assert ended.returncode == 2 and "no returns" in ended.stderr and "a0.pls" in ended.stderr


def test_the_plan_and_the_graph_follow(place: Path) -> None:
    named = {}
    for echoes in ("auto", "waveforms"):
        words = ("plan", place / "s.yaml", "--workflow", "quality", "--json", "--set", f"survey.echoes={echoes}")
        graph = fwclass(*words, "--graph")
        planned = fwclass(*words, "--out", place / echoes)
        assert graph.returncode == planned.returncode == 0, graph.stderr + planned.stderr
        of_plan = {s["name"] for s in json.loads(planned.stdout)["stages"]}
        named[echoes] = {s["name"] for s in json.loads(graph.stdout)}, of_plan
    assert all({"read", "pulse", "places"} <= some for some in named["waveforms"])
    assert not any({"read", "pulse", "places"} & some for some in named["auto"])
    assert all("decompose" in some for some in named["auto"])


def test_noise_is_what_the_ground_filter_takes_for_it(place: Path) -> None:
    """Check points ask for the ground, and so for the whole filter."""
    las = laspy.read(place / "a0.las")
    las.z[::90] -= 40.0
    las.write(place / "a0.las")
    (place / "checks.csv").write_text(f"x,y,z\n{las.x[0]},{las.y[0]},{las.z[0]}\n")
    alone, _ = run(place, "run")
    filtered, _ = run(place, "filtered", "quality.check_points.file=checks.csv")
    assert alone["noise"] > 0 and {n: alone[n] for n in FIGURES} == {n: filtered[n] for n in FIGURES}
    assert "noise-filter" in stages(place, "run") and "ground-filter" not in stages(place, "run")
    assert "ground-filter" in stages(place, "filtered") and "noise-filter" not in stages(place, "filtered")


def test_a_survey_of_returns_alone(place: Path) -> None:
    """`survey.echoes: returns`: the terrain and all else is made of what the files bring."""
    words = [w for s in ("plausibility.accept=true", "survey.echoes=returns") for w in ("--set", s)]
    ended = fwclass("run", place / "s.yaml", "--out", place / "g", "--workflow", "ground", "--workers", "0", *words)
    assert ended.returncode == 0 and "waveforms are left aside (survey.echoes" in ended.stderr, ended.stderr
    assert "ground-filter" in stages(place, "g") and not stages(place, "g") & {"read", "pulse", "places", "noise"}
    points = [laspy.read(place / f"a{k}.las") for k in range(2)]
    strips = [laspy.read(place / f"g/laz/strips/a{k}.laz") for k in range(2)]
    for one, other in zip(points, strips, strict=True):
        assert (one.X == other.X).all() and (one["wavepacket_offset"] == other["wavepacket_offset"]).all()
    tables = [pq.read_table(p) for p in (place / "g/parquet").iterdir()]
    assert sum(t.num_rows for t in tables) == sum(len(p.points) for p in points)
    assert all(t["amplitude"].to_pylist() == t["intensity"].to_pylist() for t in tables)
    ended = fwclass("status", place / "g")
    assert ended.returncode == 0 and "are done" in ended.stdout
    plsmaker.survey(place / "p.pls", 60)
    (place / "p.yaml").write_text("survey: {name: p, sources: ['p.pls'], crs: EPSG:32633, echoes: returns}\n")
    ended = fwclass("run", place / "p.yaml", "--out", place / "p", "--workflow", "ground", "--workers", "0")
    assert ended.returncode == 2 and "--set survey.echoes=waveforms" in ended.stderr
