"""A run of which `fwclass clean` has kept the delivery alone, in the viewer and in the folder that it writes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from commandline import fwclass

import fwclass as program
from fwclass import conf
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun


@pytest.mark.slow
def test_votes_stay_and_what_is_gone_is_said(run: Path, tmp_path: Path) -> None:
    cleaned = tmp_path / "cleaned"
    shutil.copytree(run, cleaned, symlinks=True)
    whole = ViewedRun(open_run(run), conf.section("view", ()))
    echo = whole.work()["places"][0]
    rows = open_run(run).echoes(box=tuple(echo["box"])).to_pandas().iloc[0]
    who = tuple(int(rows[n]) for n in ("strip", "pulse", "echo_number"))
    before = whole.why(*who)
    assert fwclass("clean", cleaned, "--keep", "delivery").returncode == 0
    after = ViewedRun(open_run(cleaned), conf.section("view", ())).why(*who)
    assert after["shares"] == pytest.approx(before["shares"], abs=0.1) and after["given"] == before["given"]
    assert " in tile " in after["of"]
    assert program.open(cleaned).explain(who).shares == pytest.approx(after["shares"])
    ended = fwclass("view", cleaned, "--export", tmp_path / "page")
    assert (
        ended.returncode == 0
        and "shown without what is lacking: this run has no waveform of the pulse" in ended.stderr
        and "no waveform" in ended.stderr
    ), ended.stderr
    for path in (tmp_path / "page" / "data" / "0" / "why").iterdir():
        assert "shares" in json.loads(path.read_bytes())
