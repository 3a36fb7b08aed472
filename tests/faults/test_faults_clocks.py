"""Wall clocks that jump under a run, by hours and years, forwards and back, for the driver and its workers at once."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from faultmaker import lost, receipts, running, unharmed, words

pytestmark = pytest.mark.faults

HOUR, YEAR = 3600, 365 * 86400
JUMPS = (HOUR, -HOUR, 10 * YEAR, -20 * YEAR, 600, 0, -YEAR, 5)
"""s, that the clock is ahead of the true one, one after the other."""


@pytest.fixture(scope="module")
def shim(tmp_path_factory) -> Path:
    """A library that moves the wall clock of the processes that load it."""
    compiler, made = shutil.which("cc"), tmp_path_factory.mktemp("clock") / "clock.so"
    if compiler is None:
        pytest.skip("no C compiler")
    source = Path(__file__).with_name("clock.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", made, source, "-ldl"], check=True)
    return made


def test_workers_whose_clock_is_set_back_go_on(shim, tmp_path):
    ahead = tmp_path / "ahead"
    ahead.write_bytes(struct.pack("q", 0))
    given = {**os.environ, "LD_PRELOAD": str(shim), "JUMP": str(ahead), "PYTHONPATH": ":".join(sys.path)}
    line = "import sys; from pathlib import Path; from faultparts import set_back; set_back(*map(Path, sys.argv[1:]))"
    subprocess.run([sys.executable, "-c", line, tmp_path / "run", ahead], env=given, check=True, timeout=120)
    assert receipts(tmp_path / "run") == 10


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["0", "2"])
def test_a_run_under_a_clock_that_jumps(survey, finished, shim, tmp_path, monkeypatch, workers):
    root, ahead, step = tmp_path / "run", tmp_path / "ahead", receipts(finished) // (len(JUMPS) + 2)
    ahead.write_bytes(struct.pack("q", 0))
    monkeypatch.setenv("LD_PRELOAD", str(shim))
    monkeypatch.setenv("JUMP", str(ahead))
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL", "100ms")  # were it heeded, a jump would end workers
    with running(tmp_path / "told", *words(survey, root), "--workers", workers) as run:
        for k, seconds in enumerate(JUMPS):
            run.until(lambda done=k * step: receipts(root) > done)
            with ahead.open("r+b") as stream:  # in place: it is mapped
                stream.write(struct.pack("q", seconds))
        assert run.code() == 0, run.said
    monkeypatch.delenv("LD_PRELOAD")
    when = {line.split()[0] for p in (root / "logs").rglob("*.log") for line in p.read_text().splitlines()}
    assert len({w[:9] for w in when}) > 3, f"the clock did not jump: {when}"
    assert lost(root) == 0 and "Traceback" not in run.said, run.said
    unharmed(root, finished)
