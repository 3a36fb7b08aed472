"""Outputs of commands: whole, and of one command alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from commandline import fwclass
from lasmaker import write_las
from modelmaker import models

from fwclass.errors import ConfigError
from fwclass.operate.draft import survey
from fwclass.publish.files import check_free, written_whole
from fwclass.single_file import model_directory


def test_what_another_command_writes_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    target = tmp_path / "out.laz"
    check_free(target, False)
    with pytest.raises(ConfigError, match="another command has written the output"), written_whole(target) as beside:
        beside.write_text("mine")
        target.write_text("theirs")
    assert target.read_text() == "theirs" and [p.name for p in tmp_path.iterdir()] == ["out.laz"]


def test_with_overwrite_only_what_stood_there_is_replaced(tmp_path: Path) -> None:
    target = tmp_path / "out.laz"
    target.write_text("old")
    with pytest.raises(ConfigError, match="the output exists"):
        check_free(target, False)
    check_free(target, True)
    for text in ("first", "second"):
        with written_whole(target) as beside:
            beside.write_text(text)
        assert target.read_text() == text
    with pytest.raises(ConfigError, match="another command"), written_whole(target) as beside:
        beside.write_text("third")
        target.unlink()
        target.write_text("theirs")
    assert target.read_text() == "theirs"


def test_a_model_of_another_command_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target, model = tmp_path / "m", models()["forest"]
    load = model_directory.load_model

    def theirs(path: Path) -> object:
        if not target.exists():
            shutil.copytree(path, target)
            (target / "theirs").touch()
        return load(path)

    monkeypatch.setattr(model_directory, "load_model", theirs)
    with pytest.raises(ConfigError, match="the model exists"):
        model_directory.write_model(model, target, False)
    assert (target / "theirs").exists() and [p.name for p in tmp_path.iterdir()] == ["m"]


def test_a_draft_replaces_nothing_that_came_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    to = tmp_path / "s.yaml"
    write_las(tmp_path / "a.las", np.random.default_rng(0).uniform(0, 50, (500, 3)), point_format=6)
    draft = survey.draft

    def later(*words: object) -> object:
        to.write_text("theirs")
        return draft(*words)

    monkeypatch.setattr(survey, "draft", later)
    assert fwclass("init", tmp_path / "a.las", "--to", to).returncode == 2
    assert to.read_text() == "theirs"


def test_a_file_system_without_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    check_free(tmp_path / "out.laz", False)
    with written_whole(tmp_path / "out.laz") as beside:
        beside.write_text("mine")
    assert (tmp_path / "out.laz").read_text() == "mine"
