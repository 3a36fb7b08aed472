"""`fwclass status`, `run --only` and `--fail-fast` as a user meets them."""

from __future__ import annotations

import json
import os
import shlex
import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass

CONFIG = """
survey:
  name: small
  directory: .
  sources: [a.las]
  reference: {kind: source}
  crs: none
  features: [zc, height_range_c100]
  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 6, codes: [6]}]
areas: {train: [[0, 0, 5, 10]], gap: 0.5}
tile: {size: 5.0}
train: {trees: 5}
plausibility: {accept: true}
"""
RUN = ("--workers", 0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A directory with a survey of four tiles, run into `r`."""
    root = tmp_path_factory.mktemp("status")
    r = np.random.default_rng(0)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales = [0.001] * 3
    las.x, las.y, las.z = r.uniform(0, 10, (3, 400))
    las.classification = r.choice([2, 6], 400)
    las.write(root / "a.las")
    (root / "c.yaml").write_text(CONFIG)
    ended = fwclass("run", root / "c.yaml", "--out", root / "r", *RUN)
    assert ended.returncode == 0, ended.stderr
    return root


@pytest.fixture
def copy(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "s", symlinks=True)
    request = tmp_path / "s" / "r" / "store" / "run.json"
    words = json.loads(request.read_text().replace(str(whole), str(tmp_path / "s")))
    del words["seal"]
    request.write_text(json.dumps(words))
    return tmp_path / "s"


def data(*words):
    ended = fwclass("status", *words, "--json")
    found = json.loads(ended.stdout)
    assert ended.returncode == (0 if found["done"] else 3), ended.stderr
    return found


def test_a_whole_run_is_done_by_configuration_and_by_directory(copy):
    for words in ((copy / "r",), (copy / "c.yaml", "--out", copy / "r")):
        ended = fwclass("status", *words)
        assert ended.returncode == 0, ended.stdout
        assert "parts are done" in ended.stdout and "publish-tile" in ended.stdout
    assert data(copy / "r")["parts"] == []
    every = fwclass("status", copy / "r", "--parts", "--json")
    assert {p["status"] for p in json.loads(every.stdout)["parts"]} == {"done"}


def test_what_is_done_and_not_delivered_is_told(copy):
    """A run was killed at its end, or what says which delivery is shown is damaged."""
    shown = copy / "r" / "current" / "generation.json"
    facts = {**json.loads(shown.read_text()), "digest": "0" * 32}
    del facts["seal"]
    shown.unlink()
    for text in (json.dumps(facts), "{}"):  # an earlier delivery, and none
        shown.write_text(text)
        ended = fwclass("status", copy / "r")
        assert ended.returncode == 3 and "readers do not see them yet; deliver them: fwclass run" in ended.stdout
        assert not data(copy / "r")["done"]
    assert fwclass("run", copy / "c.yaml", "--out", copy / "r", *RUN).returncode == 0
    assert data(copy / "r")["done"]


def test_a_changed_setting_is_told(copy):
    ended = fwclass("status", copy / "c.yaml", "--out", copy / "r", "--set", "train.trees=6")
    assert ended.returncode == 3
    assert "parameter trees: 5 to 6" in ended.stdout and "needs train, stale" in ended.stdout
    assert "--set train.trees=6" in ended.stdout
    (copy / "c.yaml").write_text(CONFIG.replace("trees: 5", "trees: 7"))
    found = data(copy / "r")
    assert any("parameter trees: 5 to 7" in why for p in found["parts"] for why in p["why"])


def test_a_failed_part_is_told_replayed_alone_and_done(copy):
    """A file stands where a part's directory is to be: that part fails, and only what needs it is not made."""
    tile = sorted(p.name for p in (copy / "r" / "store" / "features").iterdir())[0]
    place = copy / "r" / "store" / "features" / tile
    shutil.rmtree(place)
    place.write_text("in the way")
    words = ("run", copy / "c.yaml", "--out", copy / "r", *RUN)
    ended = fwclass(*words, "--set", "publish.class_cell=1.0")
    assert ended.returncode == 3
    [line] = [x for x in ended.stderr.splitlines() if x.strip().startswith("alone: ")]
    replay = shlex.split(line.split("alone: ")[1])
    assert replay[-2:] == ["--only", f"features/{tile}"]
    found = data(copy / "r")
    failed = [p for p in found["parts"] if p["status"] == "failed"]
    assert [(p["stage"], p["part"]) for p in failed] == [("features", tile)]
    assert (
        "one of its directories is a file" in failed[0]["message"] or "file where a directory" in failed[0]["message"]
    )
    assert shlex.split(failed[0]["replay"]) == replay
    again = fwclass(*replay[1:])
    assert again.returncode == 3 and "alone: " in again.stderr
    place.unlink()
    again = fwclass(*replay[1:])
    assert again.returncode == 0 and "is made, in" in again.stderr, again.stderr
    found = data(copy / "r")
    assert not any(p["stage"] == "features" for p in found["parts"])
    assert fwclass(*words, "--set", "publish.class_cell=1.0").returncode == 0
    assert data(copy / "r")["done"]


def test_only_makes_one_part(copy):
    kept = copy / "r" / "store"
    for stage in ("height", "features"):
        shutil.rmtree(kept / stage)
    tile = sorted(p.name for p in (kept / "tile").iterdir())[0]
    words = ("run", copy / "c.yaml", "--out", copy / "r")
    early = fwclass(*words, "--only", f"classify/{tile}")
    assert early.returncode == 1 and "cannot be made alone" in early.stderr
    assert fwclass(*words, "--only", f"height/{tile}").returncode == 0
    assert [p.name for p in (kept / "height").iterdir()] == [tile] and not (kept / "features").exists()
    assert "was done already" in fwclass(*words, "--only", f"height/{tile}").stderr
    assert fwclass(*words, "--only", "hight/1").returncode == 2
    assert fwclass(*words, "--only", f"height/{tile}", "--workers", 2).returncode == 2


def test_fail_fast_and_keep_going(copy):
    places = [copy / "r" / "store" / "label" / p.name for p in sorted((copy / "r" / "store" / "label").iterdir())]
    for place in places[:2]:
        shutil.rmtree(place)
        place.write_text("in the way")
    words = ("run", copy / "c.yaml", "--out", copy / "r", *RUN)
    fast = fwclass(*words, "--fail-fast")
    assert fast.returncode == 3 and "1 part failed" in fast.stderr and "stopped at the first" in fast.stderr
    on = fwclass(*words, "--keep-going")
    assert on.returncode == 3 and "2 parts failed" in on.stderr and on.stderr.count("alone: ") == 2


def test_what_cannot_be_told(copy, tmp_path):
    (tmp_path / "empty").mkdir()
    for command in ("status", "seams", "history"):
        ended = fwclass(command, tmp_path / "empty")
        assert ended.returncode == 2 and "no such run directory" in ended.stderr, ended.stderr
        ended = fwclass(command, "")
        assert ended.returncode == 2 and "it is empty" in ended.stderr
        ended = fwclass(command, "s3:/bucket/run")
        assert ended.returncode == 2 and "two slashes" in ended.stderr
        ended = fwclass(command, os.fsdecode(bytes(tmp_path / "M") + b"\xfcller"))
        assert ended.returncode == 2 and "no name in UTF-8" in ended.stderr
    (tmp_path / "empty" / "store").mkdir()
    ended = fwclass("status", tmp_path / "empty")
    assert ended.returncode == 1 and "nothing tells which configuration" in ended.stderr
    assert fwclass("status", copy / "r", "--set", "train.trees=6").returncode == 2
    assert fwclass("status", "nowhere.yaml").returncode == 2
    ended = fwclass("status", copy / "c.yaml", "--out", copy / "r", "--workflow", "xiong2018")
    assert ended.returncode == 3, ended.stderr
    assert "once those are made (select-" in ended.stdout  # what is chosen decides which parts follow
    ended = fwclass("status", tmp_path / "none")
    assert ended.returncode == 2 and "no such run directory" in ended.stderr
    ended = fwclass("status", copy / "c.yaml", "--out", tmp_path / "none")
    assert ended.returncode == 3 and "index/13507 is missing" in ended.stdout
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("key", ["directory", "model", "base_model"])
def test_kept_words_lead_to_no_object_storage(copy, key, monkeypatch):
    """A stranger's run directory sent signed requests to a bucket that it named."""
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("a request"))
    kept = copy / "r" / "store" / "run.json"
    words = json.loads(kept.read_text())
    kept.write_text(json.dumps({**words, "settings": [f"survey.{key}=s3://b/m"]}))
    for command in ("status", "seams"):
        ended = fwclass(command, copy / "r")
        assert ended.returncode == 2 and "words that this run directory keeps lead to" in ended.stderr, ended.stderr
        assert "fwclass status CONF --out" in ended.stderr and "s3://b/m" in ended.stderr


def test_a_file_that_is_gone_is_named_beside_what_is_there(copy):
    """It hid everything else."""
    made = fwclass("status", copy / "r", "--parts", "--json")
    stages = {row["stage"]: row["parts"] for row in json.loads(made.stdout)["stages"]}
    (copy / "a.las").unlink()
    ended = fwclass("status", copy / "r")
    assert ended.returncode == 3 and ended.stderr == "", ended.stderr
    assert "a run would end here: " in ended.stdout and "a.las" in ended.stdout
    assert f"features {stages['features']}" in ended.stdout and "the delivery" in ended.stdout
    told = data(copy / "r")
    assert not told["done"] and told["stages"] == [] and told["not_in_plan"] == stages
    assert told["fault"].startswith(told["plan_ends"]) and "a.las" in told["fault"]
    assert fwclass("status", copy / "r", "--verify").returncode == 3
    for words in (("status", copy / "c.yaml", "--out", copy / "none"), ("run", copy / "c.yaml", "--out", copy / "r")):
        ended = fwclass(*words)
        assert ended.returncode in (1, 2) and "a.las" in ended.stderr and ended.stdout == ""
    ended = fwclass("run", copy / "c.yaml", "--out", copy / "r", "--only", "features/0_0")
    assert ended.returncode in (1, 2) and "a.las" in ended.stderr


@pytest.mark.parametrize(
    ("words", "rc", "told"),
    [
        (("--tiles", "../x"), 2, "not a tile key"),
        (("--tiles", ""), 2, "no tile is named"),
        (("--aoi", "nowhere.gpkg"), 2, "no such file"),
        (("--aoi", "broken.geojson"), 1, "cannot be read"),
        (("--aoi", "empty.geojson"), 1, "has no polygon"),
        (("--aoi", "empty.geojson", "--tiles", "1_1"), 2, "chosen twice"),
    ],
)
def test_bad_choices_are_told_before_anything_is_made(tmp_path, words, rc, told):
    (tmp_path / "broken.geojson").write_text('{"type": "FeatureCollection", "features": [')
    (tmp_path / "empty.geojson").write_text('{"type": "FeatureCollection", "features": []}')
    ended = fwclass("run", "demo", "--out", "r", *words, cwd=tmp_path)
    assert ended.returncode == rc and told in ended.stderr, ended.stderr
    assert not (tmp_path / "r").exists()
