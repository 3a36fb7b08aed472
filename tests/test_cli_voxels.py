"""Products of waveforms where a survey has none, or only some of its files have."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace as Thing

import pytest
from click.testing import CliRunner
from smallsurvey import small_survey

from fwclass.cli import cli
from fwclass.errors import ConfigError
from fwclass.graph.backscatter import check_waves


@pytest.mark.parametrize("words", [("voxels",), ("profile",), ("run", "--set", "voxels.write=true")])
def test_a_survey_of_returns_alone_has_no_product_of_waveforms(words: tuple[str, ...], tmp_path: Path) -> None:
    command, *more = words
    survey = str(small_survey(tmp_path))
    told = CliRunner().invoke(cli, [command, survey, *more, "--out", str(tmp_path / "run"), "--workers", "0"])
    assert isinstance(told.exception, ConfigError) and "this survey has none" in str(told.exception)
    assert not (tmp_path / "run" / "voxels.zarr").exists()


def test_files_without_waveforms_among_others_are_counted() -> None:
    off, on = Thing(write=False), Thing(write=True)
    plan = Thing(
        config=Thing(samples=off, voxels=on, profile=off, path="s.yaml"),
        survey=Thing(strips=[Thing(key="00001"), Thing(key="00002")]),
        indexed={("index", "00001"): Thing(meta={"pulses": 10}), ("index", "00002"): Thing(meta={"pulses": 0})},
        returns=False,
    )
    assert check_waves(plan).startswith("1 of 2 files have no waveforms")
    plan.config.voxels = off
    assert check_waves(plan) == ""
