"""What is told of an echo: its row of the table, and the waveform of its pulse, against the files themselves."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from smallsurvey import deliver

from fwclass import conf
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_echo import BehindEchoes
from fwclass.errors import InputError
from fwclass.run.inputs import PartInputs
from fwclass.store.run_store import Store


@pytest.mark.slow
def test_an_echo_is_its_row_of_the_table_whatever_row_group_holds_it(small_run: Path) -> None:
    deliver(small_run.parent, "publish.row_group=200")
    scene = ViewedRun(open_run(small_run), conf.section("view", ()))
    asked, groups = 0, set()
    for tile in scene.tiles:
        table, opened = pq.read_table(scene.delivery.table(tile)), scene.open.tile(tile)
        for node, (first, last) in opened.nodes.items():
            told = scene.echo(node, last - first - 1) if node[0] >= scene.pyramid.own else None
            if told is None:
                continue
            assert told["row"] == opened.order[last - 1]
            groups.add((tile, told["row"] // 200))
            reference = scene.columns._behind.reference(tile)[told["row"]]
            assert told["reference"] == (int(reference) or None)
            for name, value in told["values"].items():
                there = table.column(name)[told["row"]].as_py()
                assert value == there or (value is None and (there is None or math.isnan(there))), name
            asked += 1
    assert asked > 1 and max(group for _, group in groups) > 1


def test_the_waveform_is_that_of_the_chunk_which_has_the_pulse(run: Path) -> None:
    """First and last pulse of every chunk, and a pulse that none has."""
    behind, inputs = BehindEchoes(open_run(run)), PartInputs(Store(run, read_only=True))
    parts = sorted(part for stage, part in Store(run, read_only=True).parts() if stage == "read")
    assert len(parts) > 2  # several chunks a strip
    for part in parts:
        strip = int(part.split("-")[0])
        pulses = inputs.table("read", part, ("pulse",), "pulses.parquet")["pulse"]
        samples = inputs.arrays("read", part, "waveforms")[0]
        for row in (0, len(pulses) - 1):
            told = behind.pulse(strip, int(pulses[row]))
            assert told["samples"] == samples["samples"][slice(*samples["offsets"][[row, row + 1]])].tolist()
    for of, pulse in ((strip, 10**9), (strip, -1), (9999, 0)):
        with pytest.raises(InputError, match="no waveform of the pulse"):
            behind.pulse(of, pulse)


def test_the_waveform_of_a_run_that_lacks_a_setting_is_shown(run: Path) -> None:
    """As one of an earlier version does."""
    delivery = open_run(run)
    part = min(p for s, p in Store(run, read_only=True).parts() if s == "read")
    pulse = int(PartInputs(Store(run, read_only=True)).table("read", part, ("pulse",), "pulses.parquet")["pulse"][0])
    told = BehindEchoes(delivery).pulse(int(part.split("-")[0]), pulse)
    assert delivery.report["config"]["decompose"].pop("beam_lengths")
    assert BehindEchoes(delivery).pulse(int(part.split("-")[0]), pulse) == told


@pytest.mark.slow
def test_the_fit_that_is_shown_is_the_one_whose_echoes_were_delivered(run: Path) -> None:
    """As many echoes, as high, of every fiftieth pulse."""
    behind, inputs = BehindEchoes(open_run(run)), PartInputs(Store(run, read_only=True))
    asked = 0
    for part in sorted(p for s, p in Store(run, read_only=True).parts() if s == "decompose"):
        table, strip = inputs.table("decompose", part), int(part.split("-")[0])
        for pulse in np.unique(table["pulse"])[::50]:
            rows = table["pulse"] == pulse
            told = sorted(e["amplitude"] for e in behind.pulse(strip, int(pulse))["echoes"])
            assert told == pytest.approx(sorted(table["amplitude"][rows].tolist()), rel=1e-4), (strip, pulse)
            asked += 1
    assert asked > 100


def test_the_viewer_draws_nothing_by_matplotlib() -> None:
    """Its import took longer than all else that stands before the first waveform."""
    words = (
        "import sys, fwclass.delivery.viewing, fwclass.single_file.waveforms.pictured; "
        "sys.exit('matplotlib' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", words], check=False).returncode == 0
