"""Workers on this machine: Ctrl-C, which a terminal sends to them too, is the command's alone; outcomes are told."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import Client
from distributed.comm import CommClosedError

from fwclass import compiling
from fwclass.errors import FwclassError
from fwclass.memory import resident_bytes
from fwclass.run.cluster import Cluster
from fwclass.run.lost import Losses, cause_of
from fwclass.run.part import Task

FROZEN = """
import atexit, gc
from fwclass.run.cluster import Unheeding

atexit.register(lambda: print(gc.get_freeze_count() > 1000))
Unheeding().setup(None)
"""

SCRIPT = """
import signal, sys, time
from functools import partial
from pathlib import Path

from fwclass.run.cluster import Cluster
from fwclass.run.part import Task


def slow(inputs, directory):
    (directory.parents[2] / "begun").touch()
    time.sleep(60)
    return {}


if __name__ == "__main__":
    root = Path(sys.argv[1])
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job is begun without it
    try:
        with Cluster(None, 2, 1.0, 1000) as cluster:
            list(cluster.run(root, [Task("slow", "all", 1, {}, partial(slow))]))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
"""


def test_a_worker_that_ends_does_not_look_for_cycles_in_all_that_it_has_loaded() -> None:
    told = subprocess.run([sys.executable, "-c", FROZEN], capture_output=True, text=True, check=True).stdout
    assert told == "True\n"


@pytest.mark.slow
def test_ctrl_c_ends_the_workers_without_a_word_of_theirs(tmp_path: Path) -> None:
    script, root = tmp_path / "slow.py", tmp_path / "run"
    script.write_text(SCRIPT)
    root.mkdir()
    with (tmp_path / "told").open("w+") as told:
        begun = subprocess.Popen([sys.executable, script, root], start_new_session=True, stderr=told, stdout=told)
        try:
            until = time.monotonic() + 90
            while not list(root.rglob("begun")) and begun.poll() is None and time.monotonic() < until:
                time.sleep(0.2)
            assert list(root.rglob("begun")), (tmp_path / "told").read_text()
            os.killpg(begun.pid, signal.SIGINT)
            assert begun.wait(60) == 130
        finally:
            if begun.poll() is None:
                os.killpg(begun.pid, signal.SIGKILL)
    assert (tmp_path / "told").read_text() == "interrupted\n"


def test_outcomes_are_heard_and_not_asked_for(tmp_path: Path) -> None:
    asked = []

    class Listening(Cluster):
        def outcomes(self, future):
            asked.append(future.key not in self._heard)
            return super().outcomes(future)

    with Listening(None, 2, 1.0, 1000) as cluster:
        tasks = [Task("quick", str(k), 1, {}, partial(quick)) for k in range(20)]
        assert [o.status for o in cluster.run(tmp_path, tasks)] == ["computed"] * 20
    assert asked and not any(asked)


def quick(inputs: object, directory: Path) -> dict[str, object]:
    return {}


def compiles(inputs, directory):
    with compiling._timed("a"):
        time.sleep(compiling.NOTIFY_AFTER + 0.5)
    return {}


def test_it_is_told_that_a_worker_compiles(tmp_path: Path) -> None:
    heard: list[tuple[str, bool]] = []
    with Cluster(None, 1, 1.0, 10, compiles=lambda *told: heard.append(told)) as cluster:
        assert [o.status for o in cluster.run(tmp_path, [Task("slow", "all", 1, {}, compiles)])] == ["computed"]
    assert [begins for _, begins in heard] == [True, False] and heard[0][0] == heard[1][0] != ""


LIMIT_GIB = 0.7
kept = []


def keeps(inputs, directory):
    """Leave the worker with 87 % of its memory, as a library's caches or memory in pieces do."""
    kept.append(np.ones(max(0, int(0.87 * LIMIT_GIB * 2**30) - resident_bytes()), np.uint8))
    time.sleep(1.0)
    return {}


@pytest.fixture
def at_most_a_minute():
    def over(*_):
        raise TimeoutError("the workers do nothing")

    before = signal.signal(signal.SIGALRM, over)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def test_a_worker_that_keeps_much_memory_goes_on(tmp_path: Path, at_most_a_minute: None) -> None:
    tasks = [
        Task("first", "all", 1, {}, keeps),
        *(Task("then", str(k), 1, {}, partial(quick), needs=(("first", "all"),)) for k in range(3)),
    ]
    with Cluster(None, 1, LIMIT_GIB, 10) as cluster:
        assert [o.status for o in cluster.run(tmp_path, tasks)] == ["computed"] * 4


@pytest.mark.slow
def test_workers_that_do_not_start_are_told_as_such(at_most_a_minute: None) -> None:
    with pytest.raises(FwclassError, match="workers of this machine do not start") as told:
        Cluster(None, 1, 0.01, 10).__exit__(None, None, None)
    assert "run.worker_memory_gib" in str(told.value)


@pytest.mark.parametrize("answers", [{}, {"tcp://127.0.0.1:1": CommClosedError("Stream is closed")}])
def test_workers_that_end_before_they_answer_are_not_said_to_compute_by_other_code(
    monkeypatch: pytest.MonkeyPatch, answers: dict[str, object]
) -> None:
    monkeypatch.setattr(Client, "run", lambda *_, **__: answers)
    with pytest.raises(FwclassError, match="workers of this machine do not start"):
        Cluster(None, 1, LIMIT_GIB, 10).__exit__(None, None, None)


def test_one_worker_that_ends_early_leaves_the_others_to_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Client.run

    def with_one_lost(client: Client, *given: Any, **options: Any) -> dict[str, object]:
        return {**run(client, *given, **options), "tcp://127.0.0.1:1": CommClosedError("Stream is closed")}

    monkeypatch.setattr(Client, "run", with_one_lost)
    with Cluster(None, 1, LIMIT_GIB, 10) as cluster:
        tasks = [Task("one", "a", 1, {}, partial(quick))]
        assert [o.status for o in cluster.run(tmp_path, tasks)] == ["computed"]


def test_a_part_that_no_worker_can_begin_is_given_up(tmp_path: Path) -> None:
    losses, cause, one = Losses(tmp_path, retries=2), cause_of(2**30, 0.9, None), ("one", "a")
    assert [losses.lost(one, cause, alone=False) for _ in range(3)] == ["again", "again", "alone"]
    assert losses.lost(one, cause, alone=True) == "failed"
    assert [losses.lost(("one", "b"), cause_of(None, None, -9), alone=False) for _ in range(9)] == ["again"] * 9
