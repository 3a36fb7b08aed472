"""Files that change while a command reads them, also those beside the one that is named, are told; none is believed."""

from __future__ import annotations

import itertools
import os
import shutil
from pathlib import Path
from typing import Any

import lasmaker
import numpy as np
import plsmaker
import pytest
from commandline import fwclass
from smallsurvey import small_survey
from streetmaker import SHORT, directory

from fwclass.conf import section
from fwclass.errors import InputError
from fwclass.read.source import open_source
from fwclass.read.stage import index_source, read_span
from fwclass.store.unchanged import check_unchanged

CHANGED = "changed while"


def change_at(monkeypatch: pytest.MonkeyPatch, function: str, path: Path) -> None:
    """`path` gets other bytes, as many, when `function` is called; of ``function 60`` for the 60th time."""
    function, _, at = function.partition(" ")
    module, _, name = function.rpartition(".")
    owner = __import__(module, fromlist=[name])
    original, calls = getattr(owner, name), itertools.count(1)

    def changing(*args: Any, **named: Any) -> Any:
        made = original(*args, **named)
        if next(calls) == int(at or 1):
            data = bytearray(path.read_bytes())
            data[len(data) // 2] ^= 1
            path.write_bytes(data)
        return made

    monkeypatch.setattr(owner, name, changing)


def strip(place: Path, beside: str) -> Path:
    if beside in (".wvs", ".WVS"):
        plsmaker.survey(place / "a.pls", 30)
        (place / "a.wvs").rename(place / f"a{beside}")
        return place / "a.pls"
    lasmaker.survey(place / "a.las", 30)
    (place / "a.wdp").rename(place / f"a{beside}")
    return place / "a.las"


@pytest.mark.parametrize("beside", [".wdp", ".WDP", ".wvs"])
@pytest.mark.parametrize(
    ("command", "function"),
    [
        ("decompose", "fwclass.single_file.decompose.strip_of"),
        ("info", "fwclass.read.info.open_source"),
        ("waveforms", "fwclass.single_file.waveforms.view.strip_of"),
    ],
)
def test_samples_beside_a_file_that_change_are_told(
    beside: str, command: str, function: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, out = strip(tmp_path, beside), tmp_path / "out.laz"
    picture = tmp_path / "out.png"
    words = {
        "decompose": ("decompose", source, out),
        "info": ("info", source),
        "waveforms": ("info", "--waveforms", source, "--out", picture),
    }[command]
    change_at(monkeypatch, function, source.with_suffix(beside))
    ended = fwclass(*words)
    assert ended.returncode == 1 and CHANGED in ended.stderr and f"a{beside}" in ended.stderr, ended.stderr
    assert not out.exists() and not picture.exists() and not ended.stdout.replace("null", "").strip()


def test_samples_that_come_while_a_file_is_read_are_told(tmp_path: Path) -> None:
    source = strip(tmp_path, ".wdp")
    (tmp_path / "a.wdp").rename(tmp_path / "later")
    with pytest.raises(Exception, match=CHANGED), check_unchanged(source):
        (tmp_path / "later").rename(tmp_path / "a.wdp")


def test_what_breaks_in_a_file_that_changed_is_told_as_its_change(tmp_path: Path) -> None:
    source = strip(tmp_path, ".wdp")
    with pytest.raises(Exception, match=CHANGED), check_unchanged(source):
        source.write_bytes(b"")
        raise IndexError
    with pytest.raises(IndexError), check_unchanged(source):
        raise IndexError


@pytest.mark.parametrize("name", ["a.las", "b.las"])
def test_clouds_that_change_while_they_are_assessed_are_told(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small_survey(tmp_path)
    shutil.copy(tmp_path / "a.las", tmp_path / "b.las")
    change_at(monkeypatch, "fwclass.single_file.assess._codes_of_pair", tmp_path / name)
    ended = fwclass("assess", tmp_path / "a.las", tmp_path / "b.las")
    assert ended.returncode == 1 and CHANGED in ended.stderr and name in ended.stderr and not ended.stdout


STREET = [
    pytest.param("info", "fwclass.single_file.street.info.open_on_trajectory", marks=pytest.mark.slow),
    pytest.param("run", "fwclass.graph.street_answers.classify_frame 60", marks=pytest.mark.slow),
    ("classify", "fwclass.single_file.street.batch.open_on_trajectory 2"),
    ("annotate", "fwclass.single_file.street.annotate.open_on_trajectory"),
    ("train", "fwclass.single_file.street.train.sample_of"),
]


@pytest.mark.parametrize(("command", "function"), STREET)
def test_recordings_that_change_while_they_are_read_are_told(
    command: str, function: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive, model, out = tmp_path / "drive.parquet", directory() / "model", tmp_path / "out"
    shutil.copy(directory() / "drive.parquet", drive)
    sets = [word for s in SHORT for word in ("--set", s)]
    words = {
        "info": (drive,),
        "run": (drive, "--model", model, "--out", out),
        "classify": (drive, out, "--model", model, "--workers", 0),
        "annotate": (drive, tmp_path / "a.csv", "--out", tmp_path / "labelled.parquet"),
        "train": ("street-sim", "--model", out, "--recordings", tmp_path, "--set", "train.trees=2"),
    }[command]
    change_at(monkeypatch, function, drive)
    ended = fwclass("street", command, *words, *sets)
    assert ended.returncode in (1, 3) and CHANGED in ended.stderr, ended.stderr
    assert not (tmp_path / "labelled.parquet").exists() and not (out / "card.json").exists()


def test_a_source_that_changes_between_its_header_and_its_digest_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its system and the kind of its numbers would have been the old file's, its points the new one's."""
    survey = small_survey(tmp_path)
    change_at(monkeypatch, "fwclass.survey.gather.open_all", tmp_path / "a.las")
    ended = fwclass("run", survey, "--out", tmp_path / "run", "--workers", 0)
    assert ended.returncode == 1 and CHANGED in ended.stderr and "a.las" in ended.stderr, ended.stderr
    assert not (tmp_path / "run" / "laz").exists()


def test_a_system_of_polygons_that_changes_before_their_digest_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pyogrio.raw
    import shapely

    survey = small_survey(tmp_path)
    corners = np.add([[0, 0], [80, 0], [80, 40], [0, 40], [0, 0]], [500_000, 5_400_000])
    geometry = np.array([shapely.to_wkb(shapely.Polygon(corners))], object)
    pyogrio.raw.write(
        tmp_path / "p.shp",
        geometry,
        [np.array([2])],
        ["code"],
        geometry_type="Polygon",
        crs="EPSG:32633",
        driver="ESRI Shapefile",
    )
    survey.write_text(
        survey.read_text().replace("{kind: source}", "{kind: polygons, files: [p.shp], field: code, values: {2: 2}}")
    )
    change_at(monkeypatch, "fwclass.survey.reference.source_crs", tmp_path / "p.prj")
    ended = fwclass("run", survey, "--out", tmp_path / "run", "--workers", 0)
    assert ended.returncode == 1 and CHANGED in ended.stderr and "p.prj" in ended.stderr, ended.stderr


@pytest.mark.parametrize("beside", [".wdp", ".wvs"])
@pytest.mark.parametrize("left", [0, 100])
def test_samples_that_are_cut_off_behind_their_opening_are_not_read_beyond_their_end(
    beside: str, left: int, tmp_path: Path
) -> None:
    """Kernels read on behind the end of what is there: zeros, or the end of the process."""
    path, params = strip(tmp_path, beside), section("read", ())
    source = open_source(path)
    spans = index_source(source, params)
    os.truncate(path.with_suffix(beside), left)
    with pytest.raises(InputError, match="changed while it was read"):
        read_span(source, spans[0], params)
