"""`classify.only` and `classify.keep`: classes of the sources that stay, in runs and of one file."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from smallsurvey import small_survey

WATER, ODD = 9, 66
WORDS = ("--workers", 0)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small survey, of whose points 300 are water, 100 of a code without a name and 500 of no class; ``r`` by its
    labels, which are those of before."""
    place = tmp_path_factory.mktemp("kept")
    small_survey(place)
    las = laspy.read(place / "a.las")
    las.write(place / "labels.las")
    codes = np.asarray(las.classification).copy()
    codes[:300], codes[300:400], codes[400:900] = WATER, ODD, 1
    las.classification = codes
    las.write(place / "a.las")
    text = (place / "s.yaml").read_text().replace("{kind: source}", "{kind: cloud, files: [labels.las]}")
    (place / "s.yaml").write_text(text)
    ended = fwclass("run", "s.yaml", "--out", "r", *WORDS, cwd=place)
    assert ended.returncode == 0, ended.stderr
    return place


def classes(path: Path) -> np.ndarray:
    return np.asarray(laspy.read(path).classification)


def report_of(run: Path) -> dict:
    return json.loads((run / "report.json").read_text())


def scored(report: dict) -> int:
    accuracy = report["accuracy"]
    return int(np.sum(accuracy["confusion"]) + np.sum(accuracy.get("unclassified", 0)))


def test_what_the_sources_tell_apart_and_the_model_does_not_is_said(place: Path) -> None:
    remarks = report_of(place / "r")["remarks"]
    said = next(r for r in remarks if "not told apart here" in r)
    assert "400 echoes" in said and "9 water: 300" in said and "class 66: 100" in said and "--keep 9,66" in said
    assert said.split("(")[0].removeprefix("t") in (place / "r" / "report.html").read_text()
    assert set(classes(place / "r/laz/strips/a.laz")) == {2, 5}
    ended = fwclass("classify", "a.las", "all.las", "--model", "r/model", cwd=place)
    assert ended.returncode == 0 and "400 points of classes" in ended.stderr, ended.stderr


@pytest.mark.parametrize(
    "words, setting, stays",
    [(("--keep", "9, 66"), "classify.keep=[9,66]", {WATER, ODD}), (("--only", "0,1"), "classify.only=[0,1]", None)],
)
def test_kept_points_stay_in_a_run_and_in_a_file_and_others_are_answered_as_before(
    place: Path, tmp_path: Path, words: tuple[str, ...], setting: str, stays: set[int] | None
) -> None:
    own, before = classes(place / "a.las"), classes(place / "r/laz/strips/a.laz")
    kept = own != 1 if stays is None else np.isin(own, list(stays))
    told = fwclass("run", "s.yaml", "--out", tmp_path / "k", *WORDS, "--set", setting, cwd=place)
    assert told.returncode == 0, told.stderr
    assert f"{kept.sum():,} echoes keep the class of their source" in told.stderr
    assert (classes(tmp_path / "k/laz/strips/a.laz") == np.where(kept, own, before)).all()
    tiles = [pq.read_table(p).to_pydict() for p in (tmp_path / "k/parquet").glob("*.parquet")]
    sure = np.concatenate([np.array(t["confidence"], float) for t in tiles])
    assert np.isnan(sure).sum() == kept.sum()

    report, whole = report_of(tmp_path / "k"), report_of(place / "r")
    assert report["kept"] == {str(c): int((own[kept] == c).sum()) for c in np.unique(own[kept])}
    assert scored(report) + report["accuracy"]["kept"] == scored(whole)
    assert 0 < report["accuracy"]["kept"] < kept.sum()  # those in the training area were not tested before either
    assert {"name": "water", "code": WATER} in report["classes"]
    assert not any("not told apart" in r for r in report["remarks"])

    ended = fwclass("classify", "a.las", tmp_path / "f.las", "--model", "r/model", *words, "--json", cwd=place)
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["kept"] == report["kept"]
    written = classes(tmp_path / "f.las")
    assert (written[kept] == own[kept]).all() and set(written[~kept]) <= {2, 5}
    las = laspy.read(tmp_path / "f.las")
    assert ((las.points.array["confidence"] == 255) == kept).all(), "its value of no data"
    rows = {c["code"]: c for c in report["sureness"]["classes"]}
    assert rows[WATER]["echoes"] and rows[WATER]["confidence"] is None
    of_ground = (written == 2) & ~kept
    assert abs(rows[2]["confidence"] - np.asarray(las["confidence"])[of_ground].mean()) < 0.003, "of those classified"


@pytest.mark.slow
def test_kept_classes_do_not_depend_on_tiles(place: Path, tmp_path: Path) -> None:
    strips = []
    for size in (25, 60):
        words = ("--set", "classify.keep=[9]", "--set", f"tile.size={size}")
        assert fwclass("run", "s.yaml", "--out", tmp_path / f"{size}", *WORDS, *words, cwd=place).returncode == 0
        strips.append((tmp_path / f"{size}/laz/strips/a.laz").read_bytes())
    assert strips[0] == strips[1]


def test_a_source_without_any_point_is_told(place: Path, tmp_path: Path) -> None:
    las = laspy.read(place / "a.las")
    las.write(tmp_path / "a.las")
    las.points = las.points[:0]
    las.write(tmp_path / "b.las")
    (tmp_path / "s.yaml").write_text('survey: {name: z, sources: ["*.las"]}')
    told = fwclass("run", "s.yaml", "--workflow", "ground", "--out", "g", *WORDS, cwd=tmp_path)
    assert told.returncode == 0 and "files without any point: b.las" in told.stderr, told.stderr


def test_a_ground_run_keeps_them_too(place: Path, tmp_path: Path) -> None:
    words = ("--workflow", "ground", "--set", "classify.keep=[9]", *WORDS)
    told = fwclass("run", "s.yaml", "--out", tmp_path / "g", *words, cwd=place)
    assert told.returncode == 0, told.stderr
    own, written = classes(place / "a.las"), classes(tmp_path / "g/laz/strips/a.laz")
    assert (written[own == WATER] == WATER).all() and set(written[own != WATER]) <= {1, 2, 7, 18}
    assert "keep the class" in told.stderr and "class 66: 100" in told.stderr


@pytest.mark.parametrize(
    "words, said",
    [
        (("--keep", "water"), "no list of class codes"),
        (("--keep", "300"), "no list of class codes"),
        (("--keep", "9", "--only", "1,9"), "code 9 is to be classified (only) and to be kept (keep)"),
    ],
)
def test_codes_that_cannot_be_are_refused(place: Path, words: tuple[str, ...], said: str) -> None:
    ended = fwclass("classify", "a.las", "no.las", "--model", "r/model", *words, cwd=place)
    assert ended.returncode == 2 and said in ended.stderr, ended.stderr
    assert not (place / "no.las").exists()


def test_a_file_whose_every_point_stays(place: Path, tmp_path: Path) -> None:
    ended = fwclass("classify", "a.las", tmp_path / "f.las", "--model", "r/model", "--only", "40", cwd=place)
    assert ended.returncode == 0 and "mean confidence" not in ended.stderr, ended.stderr
    assert (classes(tmp_path / "f.las") == classes(place / "a.las")).all()
    assert "no points were classified: all have a class that is kept" in ended.stderr


def test_returns_of_waveforms_keep_their_own_class(shared_data: Path, tmp_path: Path) -> None:
    """Several returns of a pulse may be one echo: each point of a strip stays by its own class."""
    source = shared_data / "waveform" / "riegl_q680i.las"
    (tmp_path / "s.yaml").write_text(
        f"survey: {{name: w, directory: {source.parent}, sources: [{source.name}]}}\nclassify: {{keep: [4]}}\n"
    )
    told = fwclass("run", tmp_path / "s.yaml", "--out", tmp_path / "w", "--workflow", "ground", *WORDS)
    assert told.returncode == 0, told.stderr
    own, written = classes(source), classes(tmp_path / "w/laz/strips" / f"{source.stem}.laz")
    assert (written[own == 4] == 4).all() and 2 in written
