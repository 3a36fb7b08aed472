"""Surveys of public data that come with fwclass: where their files lie, and what is said where they do not."""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

import pytest
import yaml
from commandline import fwclass

SURVEYS = Path(__file__).parents[2] / "conf" / "surveys"
PUBLIC = sorted(p.stem for p in SURVEYS.glob("*.yaml") if "directory: data:" in p.read_text())


def test_no_survey_leads_out_of_the_program() -> None:
    assert len(PUBLIC) == 8
    for path in SURVEYS.glob("*.yaml"):
        directory = yaml.safe_load(path.read_text())["survey"].get("directory")
        assert directory is None or directory.startswith("data:"), path


@pytest.mark.parametrize("name", PUBLIC)
def test_without_files_it_says_where_they_are_to_be_had(name, tmp_path, monkeypatch) -> None:
    monkeypatch.delenv("FWCLASS_DATA", raising=False)
    workflow = re.findall(r"`fwclass run \S+ (--workflow) (\S+)`", (SURVEYS / f"{name}.yaml").read_text())
    ended = fwclass("run", name, *chain(*workflow), "--out", tmp_path / "r")
    assert ended.returncode == 2 and not (tmp_path / "r").exists()
    assert "do not come with fwclass" in ended.stderr and "site-packages" not in ended.stderr
    assert any(place in ended.stderr for place in ("geoservices.ign.fr", "github.com/PulseWaves", "itc.nl"))
    assert "--set survey.directory=DIR" in ended.stderr and "FWCLASS_DATA=DIR" in ended.stderr


def test_the_variable_names_the_directory_of_all(shared_data, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("FWCLASS_DATA", str(shared_data))
    ended = fwclass("plan", "p1", "--out", tmp_path / "p")
    assert ended.returncode == 0 and "p1: 6 files" in ended.stdout + ended.stderr, ended.stderr
    monkeypatch.setenv("FWCLASS_DATA", str(tmp_path / "none"))
    ended = fwclass("plan", "p1", "--out", tmp_path / "q")
    assert ended.returncode == 1 and str(tmp_path / "none" / "ign_hd") in ended.stderr
