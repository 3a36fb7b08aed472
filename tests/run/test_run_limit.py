"""The longest that a part may take."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from fwclass import conf
from fwclass.operate.estimate.estimate import estimate_run
from fwclass.operate.estimate.headers import simulated_facts
from fwclass.operate.estimate.limits import Room, limits
from fwclass.run.limit import ended_after, warned_after
from fwclass.run.local import Loop
from fwclass.run.lost import TIME, Losses, cause_of
from fwclass.run.part import Task
from fwclass.workflows import workflow_of

begin = workflow_of("classification").begin


def test_a_process_that_hears_nobody_is_ended():
    code = (
        "import re\n"
        "from fwclass.run.limit import ended_after\n"
        "with ended_after(0.5):\n"
        "    re.match('(a*)*b', 'a' * 60)\n"  # holds the interpreter until the end of days
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], timeout=60, capture_output=True)
    assert done.returncode == -signal.SIGALRM


def test_a_block_that_ends_in_time_is_left_alone():
    with ended_after(0.2), ended_after(60.0):
        pass
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
    with ended_after(60.0):
        with ended_after(30.0):
            assert 29.0 < signal.getitimer(signal.ITIMER_REAL)[0] <= 30.0
        assert 59.0 < signal.getitimer(signal.ITIMER_REAL)[0] <= 60.0


def test_the_plain_loop_says_so(tmp_path):
    heard, said = threading.Event(), []

    def say(text):
        said.append(text)
        heard.set()

    def slow(inputs, directory):
        assert heard.wait(30.0)
        return {}

    ended = list(Loop(0.05 / 3600.0, say).run(tmp_path, [Task("one", "a", 1, {}, slow)]))
    assert [o.status for o in ended] == ["computed"]
    assert said and said[0].startswith("one/a has taken longer than run.part_hours")
    with warned_after(3600.0, ("one", "b"), said.append):
        pass
    assert len(said) == 1


def test_one_thread_watches_all_parts():
    said, before = [], threading.active_count()
    for k in range(50):
        with warned_after(3600.0, ("one", str(k)), said.append):
            assert threading.active_count() <= before + 1
    heard = threading.Event()
    with (
        warned_after(3600.0, ("one", "long"), said.append),
        warned_after(0.01, ("one", "short"), lambda _: heard.set()),
    ):
        assert heard.wait(30.0), "a sooner end was not seen"
    assert not said


def test_a_part_that_was_ended_is_not_tried_again(tmp_path: Path):
    losses = Losses(tmp_path, retries=5)
    (tmp_path / "store" / "staging" / "x" / "one" / "a").mkdir(parents=True)
    cause = cause_of(None, None, -signal.SIGALRM)
    assert cause.startswith(TIME)
    assert losses.lost(("one", "b"), cause, alone=False) == "again"  # it had not begun
    assert losses.lost(("one", "a"), cause, alone=False) == "failed"
    assert "run.part_hours" in losses.message(("one", "a"))


def test_a_plan_tells_the_longest_part():
    config = conf.load("demo", ("run.part_hours=0.000001",))
    made = estimate_run(begin(config), simulated_facts(config), config.tile.size, 2, config.plan.stages)
    told = next(m for m in limits(config, made, 2, Room(16_000.0, 1e12), None) if m.what.startswith("time of a part"))
    assert not told.fits
    assert "run.part_hours" in told.do


def _sleeps(inputs, directory):
    time.sleep(600.0)
    return {}


def _works(inputs, directory):
    return {}


@pytest.mark.slow
def test_a_worker_is_ended_and_the_rest_goes_on(tmp_path: Path):
    from fwclass.run.cluster import Cluster

    tasks = [Task("one", "a", 1, {}, _sleeps), Task("two", "a", 1, {}, _works, needs=(("one", "a"),))]
    tasks += [Task("one", f"b{k}", 1, {}, _works) for k in range(4)]
    with Cluster(None, 1, 1.0, 1000, part_hours=5.0 / 3600.0) as cluster:
        ended = {(o.stage, o.part): o for o in cluster.run(tmp_path, tasks)}
    assert ended["one", "a"].status == "failed"
    assert "run.part_hours" in ended["one", "a"].message
    assert ended["two", "a"].status == "blocked"
    assert {ended["one", f"b{k}"].status for k in range(4)} == {"computed"}
