"""Workers and driving processes killed at random moments: the same bytes come out, and nothing is left behind."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import time

import psutil
import pytest
from faultmaker import Reader, Run, gone, kill_workers, lost, receipts, running, unharmed, words

from fwclass.store.lock import holder

pytestmark = pytest.mark.faults

LONGER = ("train.trees=100", "read.chunk_pulses=500", "tile.size=10")
"""Some 450 parts in place of 83."""


@pytest.fixture(scope="module")
def longer(survey, tmp_path_factory):
    """The run directory of an undisturbed longer run."""
    root = tmp_path_factory.mktemp("longer") / "run"
    with running(root.parent / "told", *words(survey, root, *LONGER), "--workers", "0") as run:
        assert run.code() == 0, run.said
    return root


def undisturbed(request, times):
    """The run to compare with, and what it is set to: the longer one where much is to be killed."""
    return (request.getfixturevalue("finished"), ()) if times < 10 else (request.getfixturevalue("longer"), LONGER)


@pytest.mark.slow
@pytest.mark.parametrize("times", [2, 50])
def test_killed_workers_change_nothing(survey, request, tmp_path, times):
    whole, more = undisturbed(request, times)
    root = tmp_path / "run"
    with running(tmp_path / "told", *words(survey, root, *more), "--workers", "2") as run:
        killed = kill_workers(run, root, times, receipts(whole), 7)
        assert run.code() == 0, run.said
    assert killed == times and "Traceback" not in run.said, run.said
    assert times < 10 or lost(root) >= 0.6 * times, "most kills met workers that had nothing to do"
    unharmed(root, whole)


@pytest.mark.parametrize("times", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_a_killed_driver_goes_on_where_it_was(survey, request, tmp_path, times):
    """Begun again as soon as it is dead: every other time its workers may still be ending. Where one driver dies it
    has one worker, which is cheaper to start."""
    whole, more = undisturbed(request, times)
    root, rng, killed, workers = tmp_path / "run", random.Random(times), 0, []  # noqa: S311
    line, parts = (*words(survey, root, *more), "--workers", min(times, 2)), receipts(whole)
    try:
        with Reader(root) as reader:
            for k in range(times):
                run, done = Run.begin(tmp_path / "told", *line), max(receipts(root), k * parts // (times + 2))
                try:
                    run.until(lambda done=done: receipts(root) > done)
                    time.sleep(rng.uniform(0.0, 0.4))
                    mine = run.workers()
                    workers += mine
                    assert mine and not (root / "current").exists()
                finally:
                    run.kill()
                killed += run.process.returncode == -signal.SIGKILL
                assert holder(root) is None
                assert k % 2 or gone(mine, 30.0), "workers without a driver"
            assert gone(workers, 30.0), "workers without a driver"
            with running(tmp_path / "told", *line) as run:
                assert run.code() == 0, run.said
    finally:
        for worker in workers:
            with contextlib.suppress(psutil.NoSuchProcess):
                worker.kill()
    assert killed == times and not reader.torn and "Traceback" not in run.said, run.said
    unharmed(root, whole)


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
                assert run.process.returncode == -signal.SIGKILL
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
        assert "another run is writing" in second.said and f"pid {first.process.pid} on" in second.said
        assert os.uname().nodename in second.said and "Traceback" not in second.said
        assert not first.ended, first.said


@pytest.mark.slow
def test_of_two_runs_started_together_one_is_refused(survey, finished, tmp_path):
    root = tmp_path / "run"
    line = (*words(survey, root), "--workers", "2")
    with running(tmp_path / "one", *line) as one, running(tmp_path / "two", *line) as two:
        assert sorted((one.code(), two.code())) == [0, 1], one.said + two.said
        refused = one if one.process.returncode else two
    assert "another run is writing" in refused.said and "Traceback" not in one.said + two.said
    unharmed(root, finished)


def killed_group(run: Run) -> None:
    """End what is left of a run, also after the test has failed."""
    for worker in run.workers() if psutil.pid_exists(run.process.pid) else []:
        worker.kill()
    if not run.ended:
        os.killpg(run.process.pid, signal.SIGKILL)
        run.process.wait()
