"""A command that refuses what it was asked for leaves nothing behind; and nothing is simulated unasked."""

from __future__ import annotations

import html
import json
import struct
from pathlib import Path

import pytest
from commandline import fwclass
from lasmaker import evlr_head, survey
from smallsurvey import small_survey

CONFIG = """
survey:
  name: mine
{more}
  sources: ["*.las"]
  reference: {{kind: source}}
  classes: [{{name: ground, code: 2, codes: [2]}}, {{name: vegetation, code: 5, codes: [3, 4, 5]}}]
areas: {{train: [{area}], gap: 0.1}}
train: {{trees: 3}}
publish: {{figure_pixels: 200}}
"""
HERE, ELSEWHERE = "[499000, 5390000, 500005.0, 5410000]", "[0, 0, 1, 1]"


def write(folder, area=HERE, more=""):
    path = folder / "mine.yaml"
    path.write_text(CONFIG.format(area=area, more=more))
    return path


def left(folder):
    return sorted(p.name for p in folder.iterdir())


@pytest.mark.parametrize(
    ("settings", "code"),
    [
        ((), 1),  # no file matches
        (("survey.sources=[a.las]", f"areas.train=[{ELSEWHERE}]"), 2),
        (("survey.sources=[a.las]", "survey.reference={kind: cloud, files: [b.laz]}"), 1),
        (("survey.sources=[a.las]", "survey.features=[nonsense]"), 2),
        (("survey.sources=[a.las]", "survey.model=nowhere"), 1),
    ],
)
def test_a_refused_run_leaves_no_directory(tmp_path, settings, code):
    survey(tmp_path / "a.las", 20)
    path = write(tmp_path, more="" if settings else "  directory: empty")
    (tmp_path / "empty").mkdir()
    before = left(tmp_path)
    words = [word for text in settings for word in ("--set", text)]
    for out in (("--out", tmp_path / "r" / "s"), ()):
        ended = fwclass("run", path, *out, *words, "--workers", 0, cwd=tmp_path)
        assert ended.returncode == code, ended.stderr
        assert left(tmp_path) == before


def test_a_directory_that_was_there_stays(tmp_path):
    path = write(tmp_path)
    (tmp_path / "r" / "store").mkdir(parents=True)
    assert fwclass("run", path, "--out", tmp_path / "r", "--workers", 0).returncode == 1
    assert (tmp_path / "r" / "store").is_dir()


def test_a_directory_left_out_is_the_configuration_s_own(tmp_path):
    survey(tmp_path / "a.las", 120)
    ended = fwclass("run", write(tmp_path), "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "r" / "laz" / "strips" / "a.laz").exists() and not (tmp_path / "r" / "survey").exists()


def test_a_survey_is_simulated_only_by_a_key(tmp_path):
    path = write(tmp_path)
    refused = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0)
    assert refused.returncode == 1 and "no file matches" in refused.stderr and str(tmp_path) in refused.stderr
    assert "left out: the directory of the survey's file" in refused.stderr
    assert fwclass("simulate", path, "--out", tmp_path / "s", "--workers", 0).returncode == 2
    assert not (tmp_path / "s").exists() and not (tmp_path / "r").exists()
    small = ("--set", "simulate.size=40", "--set", "simulate.strips=1", "--workers", 0)
    write(tmp_path, more="  simulated: true")
    assert fwclass("simulate", path, "--out", tmp_path / "s", *small).returncode == 0
    assert list((tmp_path / "s" / "strips").glob("*.las"))


def test_a_small_test_near_the_training_area_is_told_beside_the_accuracy(tmp_path):
    survey(tmp_path / "a.las", 120)
    ended = fwclass("run", write(tmp_path), "--out", tmp_path / "r", "--workers", 0)
    report = json.loads((tmp_path / "r" / "report.json").read_text())
    told = report["accuracy"]["remarks"]
    assert told == report["remarks"][:2] and len(told) == 2, told
    assert all("seen such data" in more or "those of many" in more for more in report["remarks"][2:])
    assert "squares of 25 m" in told[0] and "--set areas.gap=" in told[1]
    lines = ended.stderr.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("accuracy "))
    assert [line.removeprefix("remark      ") for line in lines[at + 1 : at + 3]] == told
    page = html.unescape((tmp_path / "r" / "report.html").read_text())
    assert all(page.count(text) == 1 for text in told), "once"
    assert all(page.index(text) < page.index('class="verdict"') for text in told), "at the top, below the headline"


def test_a_training_without_anything_left_to_test_says_so(tmp_path):
    survey(tmp_path / "a.las", 120)
    path = write(tmp_path, area="[499000, 5390000, 500050.0, 5410000]")
    ended = fwclass("train", path, "--model", tmp_path / "m", "--workers", 0, "--set", "areas.gap=0.2", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "Nothing is left to test on" in ended.stderr


def test_all_faults_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text(
        "survey: {name: x, sources: [a.las], classes: [{name: a}]}\nareas: {train: [[1, 2]], gap: -1}\ngrund: {}\n"
    )
    told = fwclass("run", tmp_path / "bad.yaml", "--out", tmp_path / "r")
    assert told.returncode == 2 and not (tmp_path / "r").exists()
    for words in ("unknown section 'grund'", "survey.classes.0.code is missing", "areas.train.0.2", "areas.gap"):
        assert words in told.stderr, told.stderr
    (tmp_path / "one.yaml").write_text(
        "survey: {name: x, sources: [a.las], classes: [{name: a, code: 3}, {name: a, code: 4}]}\n"
    )
    told = fwclass("run", tmp_path / "one.yaml", "--out", tmp_path / "r")
    assert told.returncode == 2 and "given twice" in told.stderr and "no training area" in told.stderr
    wrong = ("areas.test=[[5, 5, 1, 1]]", "quality.cell=3")
    told = fwclass("run", tmp_path / "one.yaml", *(w for one in wrong for w in ("--set", one)), "--out", tmp_path / "r")
    for words in ("given twice", "no training area", "do not divide a block", "xmin"):
        assert words in told.stderr, told.stderr


def copying(config, source, directory):
    """Every command that copies a file's records, one after another."""
    for words in (
        ("run", config, "--out", "r", "--workers", 0),
        ("plan", config, "--out", "r"),
        ("ground", source, "o.laz", "--method", "slope"),
        ("normalize", source, "o.laz", "--method", "slope"),
    ):
        yield fwclass(*words, cwd=directory)


@pytest.mark.parametrize(
    ("place", "count"),
    [(lambda size: size - 60, 2), (lambda size: size + 1, 1), (lambda size: 400, 1), (lambda size: 0, 1)],
    ids=["one more than there is", "behind the end", "among the points", "nowhere"],
)
def test_extended_records_that_are_not_where_the_header_says_stop_what_copies_them_first(tmp_path, place, count):
    """They were missed when the last stage of all copied them."""
    config, source = small_survey(tmp_path), tmp_path / "a.las"
    data = bytearray(source.read_bytes() + evlr_head("vendor", 9, 0))
    struct.pack_into("<QI", data, 235, place(len(data)), count)
    source.write_bytes(data)
    before = left(tmp_path)
    for ended in copying(config, source, tmp_path):
        assert ended.returncode == 1 and "extended record" in ended.stderr, ended.stderr
        assert "decompose" not in ended.stderr and left(tmp_path) == before
    told = fwclass("info", source, cwd=tmp_path)
    assert told.returncode == 0 and f"promises {count} extended records" in told.stdout
    struct.pack_into("<QI", data, 235, len(data) - 60, 1)
    source.write_bytes(data)
    assert fwclass("plan", config, "--out", "r", cwd=tmp_path).returncode == 0


def test_a_file_that_ends_in_an_extended_record_is_not_copied(tmp_path):
    """What was there of the record went into the copy, whose header promised more."""
    config, source = small_survey(tmp_path), tmp_path / "a.las"
    data = bytearray(source.read_bytes())
    struct.pack_into("<QI", data, 235, len(data), 1)
    data += evlr_head("vendor", 9, 5000) + bytes(4000)
    source.write_bytes(data)
    before = left(tmp_path)
    for ended in copying(config, source, tmp_path):
        assert ended.returncode == 1 and "the file ends in its extended record vendor 9" in ended.stderr, ended.stderr
        assert f"expected: {len(data) + 1000} bytes\n  got: {len(data)}" in ended.stderr and left(tmp_path) == before
    told = fwclass("info", source, cwd=tmp_path)
    assert told.returncode == 0 and "the file ends 1000 bytes before its extended record vendor 9" in told.stdout
    source.write_bytes(data + bytes(1000))
    assert fwclass("ground", source, "o.laz", "--method", "slope", cwd=tmp_path).returncode == 0
    assert (tmp_path / "o.laz").read_bytes().endswith(bytes(5000))


@pytest.mark.parametrize("inside", ["store/new", "laz/new", "current/new", "generations/x.gpkg", "tiles.gpkg"])
def test_no_output_goes_into_what_a_run_delivers(tmp_path: Path, inside: str) -> None:
    run = tmp_path / "run"
    for name in ("store", "generations/0001/laz"):
        (run / name).mkdir(parents=True)
    (run / "generations/0001/tiles.gpkg").touch()
    (run / "current").symlink_to("generations/0001")
    for name in ("laz", "tiles.gpkg"):
        (run / name).symlink_to(f"current/{name}")
    for words in (("label", "checkout", run), ("view", run, "--export"), ("suggest", run), ("export", run)):
        ended = fwclass(*words, run / inside)
        assert ended.returncode == 2 and "which commands leave as it is" in ended.stderr, ended.stderr
