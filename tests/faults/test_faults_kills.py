"""Workers and driving processes killed at random moments: the same bytes come out, and nothing is left behind."""

from __future__ import annotations

import os
import random
import signal
import time

import psutil
import pytest
from faultmaker import Reader, Run, gone, kill_workers, receipts, running, words
from runmaker import delivered

from fwclass.store.lock import holder

pytestmark = pytest.mark.faults

LONG = pytest.param(50, marks=pytest.mark.slow)


@pytest.mark.parametrize("times", [5, LONG])
def test_killed_workers_change_nothing(survey, expected, tmp_path, times):
    root = tmp_path / "run"
    more = () if times < 10 else ("train.trees=100", "read.chunk_pulses=500", "tile.size=10")
    if more:  # a longer run, of more parts
        with running(tmp_path / "other", *words(survey, tmp_path / "undisturbed", *more), "--workers", "0") as run:
            assert run.code() == 0, run.said
        expected = delivered(tmp_path / "undisturbed")
    with running(tmp_path / "told", *words(survey, root, *more), "--workers", "2") as run:
        run.until(lambda: list((root / "store").glob("staging/*/*/*")))
        killed = kill_workers(run, times, 7, (0.2, 1.5) if times < 10 else (0.5, 3.0))
        assert run.code() == 0, run.said
    assert killed == times and "Traceback" not in run.said, run.said
    assert delivered(root) == expected
    assert not list((root / "store" / "failures").rglob("*.json"))


@pytest.mark.parametrize("times", [2, pytest.param(20, marks=pytest.mark.slow)])
def test_a_killed_driver_goes_on_where_it_was(survey, expected, tmp_path, times):
    root, rng, begun = tmp_path / "run", random.Random(times), 0  # noqa: S311
    line = (*words(survey, root), "--workers", "2")
    with Reader(root) as reader:
        for _ in range(times):
            run = Run.begin(tmp_path / "told", *line)
            try:
                before = receipts(root)
                run.until(lambda now=before: receipts(root) > now)
                time.sleep(rng.uniform(0.0, 1.5))
                workers = run.workers()
                run.kill()
                begun += len(workers)
                assert gone(workers, 30.0), "workers without a driver"
                assert holder(root) is None
            finally:
                killed_group(run)
        with running(tmp_path / "told", *line) as run:
            assert run.code() == 0, run.said
    assert begun > 0 and not reader.torn
    assert delivered(root) == expected
    assert not list((root / "store").glob("staging/*")) and "Traceback" not in run.said


@pytest.mark.slow
def test_readers_see_whole_generations_while_drivers_are_killed(survey, finished, tmp_path):
    """Killed about the time of delivery, again and again, with other results each time."""
    root = tmp_path / "run"
    with running(tmp_path / "told", *words(survey, root), "--workers", "0") as run:
        assert run.code() == 0, run.said
    with Reader(root) as reader:
        for k in range(3):
            run = Run.begin(tmp_path / "told", *words(survey, root, f"publish.class_cell={k + 2}"), "--workers", "0")
            try:
                run.until(lambda: list((root / "generations" / ".pending").glob("*")))
                time.sleep(0.02 * k)
                run.kill()
            finally:
                killed_group(run)
    assert reader.looks > 3 and not reader.torn


def test_a_second_run_on_one_directory_is_refused(survey, tmp_path):
    root = tmp_path / "run"
    line = (*words(survey, root), "--workers", "0")
    with running(tmp_path / "first", *line) as first:
        first.until(lambda: receipts(root))
        with running(tmp_path / "second", *line) as second:
            assert second.code() == 1
        assert "another run is writing" in second.said and f'"pid": {first.process.pid}' in second.said
        assert os.uname().nodename in second.said and "Traceback" not in second.said
        assert not first.ended, first.said


def killed_group(run: Run) -> None:
    """End what is left of a run, also after the test has failed."""
    for worker in run.workers() if psutil.pid_exists(run.process.pid) else []:
        worker.kill()
    if not run.ended:
        os.killpg(run.process.pid, signal.SIGKILL)
        run.process.wait()
