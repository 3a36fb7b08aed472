"""`fwclass schedule` and `fwclass history` of runs on object storage: as in a directory, over an S3 server."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from commandline import fwclass
from objectstore import Server, Trouble, quick, serving, used
from schedulemaker import FAILS_AT_ONCE, NOWHERE, strip, under_way, until

from fwclass.store.bucket import Remote
from fwclass.store.lock import SCHEDULE
from fwclass.store.run_location import lock_run
from fwclass.store.url import Url

pytestmark = pytest.mark.slow

PARAMS = quick(beat=0.2, dead=2.0, timeout=10.0)
STORE = f"store: {json.dumps({n: v for n, v in PARAMS.model_dump().items() if v is not None})}\n"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as made:
        yield made


@pytest.fixture
def s3(server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Server:
    for name, value in used(server, tmp_path / "copies").items():
        monkeypatch.setenv(name, value)
    return server


@pytest.fixture
def out(s3: Server) -> Url:
    return s3.url()


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    (tmp_path / "data" / "strips").mkdir(parents=True)
    (tmp_path / "c.yaml").write_text(FAILS_AT_ONCE + STORE)
    return tmp_path / "c.yaml"


def quiet(text: str) -> None:
    pass


@contextmanager
def going(survey: Path, out: Url, log: str, *words: object) -> Iterator[subprocess.Popen[bytes]]:
    """A schedule under way; its standard error is in the file `log` beside the survey's."""
    line = [sys.executable, "-m", "fwclass", "schedule", str(survey), "--out", out, *map(str, words)]
    with under_way(line, survey.parent / log) as process:
        yield process


def past(out: Url, *words: object) -> list[dict[str, Any]]:
    return json.loads(fwclass("history", out, "--json", *words).stdout)


def ended(s3: Server, out: Url) -> int:
    return sum(key.endswith("-end.json") for key in s3.keys(out))


def state(s3: Server, out: Url) -> dict[str, Any]:
    return json.loads(s3.read(out).get("schedule.json", b"{}"))


def test_two_runs_and_a_refused_one_are_in_the_history(s3, out, survey):
    told = fwclass("history", out)
    assert told.returncode == 2 and "no such run directory" in told.stderr
    assert fwclass("run", survey, "--out", out, "--set", "train.trees=6").returncode == 1
    assert fwclass("run", survey, "--out", out).returncode == 1
    with lock_run(Remote(out, PARAMS), quiet):
        assert fwclass("run", survey, "--out", out).returncode == 1
    runs = past(out)  # in the order of their seconds
    assert sorted((run["word"], *run["settings"]) for run in runs) == [
        ("failed",),
        ("failed", "train.trees=6"),
        ("refused",),
    ]
    assert past(out, "--last", "1") == runs[2:]
    text = fwclass("history", out).stdout
    assert len(text.splitlines()) == 4
    assert text.count("no file matches") == 2 and text.count("another run is writing to this directory") == 1


def test_a_run_under_way_is_told_and_one_that_was_killed_is_interrupted(s3, out):
    from fwclass.operate.history import Entry, past_runs
    from fwclass.operate.request import Request

    location = Remote(out, PARAMS)
    with lock_run(location, quiet):
        Entry(location, Request("c.yaml", out)).begin(None)
        assert [run["word"] for run in past_runs(location)] == ["running"]
    assert [run["word"] for run in past_runs(location)] == ["interrupted"]


@pytest.mark.faults
def test_a_history_that_cannot_be_put_stops_no_run(s3, out, survey):
    away = Trouble("busy", 10**6, lambda method, path: "/history/" in path)
    survey.write_text(FAILS_AT_ONCE + STORE.replace('"patience": 10.0', '"patience": 0.1'))
    with s3.trouble(away):
        told = fwclass("run", survey, "--out", out)
    assert told.returncode == 1 and "no file matches" in told.stderr  # its own end, not the history's
    assert f"the history in {out} could not be written: object storage does not answer" in told.stderr
    assert past(out) == []


def test_once_ends_with_the_runs_code_and_what_cannot_be_is_refused(s3, out, survey):
    (survey.parent / "in").mkdir()
    told = fwclass("schedule", survey, "--out", out, "--inbox", survey.parent / "in")
    assert told.returncode == 2 and "an inbox needs a run directory of this machine" in told.stderr
    command = [sys.executable, "-c", "import sys, os; assert os.environ['FWCLASS_RUN'] in sys.stdin.read()"]
    with going(
        survey, out, "log", "--every", "1h", "--once", "--set", f"schedule.command={json.dumps(command)}"
    ) as process:
        assert process.wait(240) == 1
    [run] = past(out)
    assert run["word"] == "failed" and run["why"]["trigger"] == "interval" and run["told"]["command"]["ok"]
    found = state(s3, out)
    assert (found["state"], found["last"]["id"], found["last"]["run"]) == ("stopped", run["id"], out)
    assert s3.read(out)["store/schedule.lock"] == b"{}"


@pytest.mark.faults
def test_an_interval_goes_on_and_a_second_schedule_is_refused(s3, out, survey):
    """Through a storage that takes no schedule.json for a while, which is told once."""
    strip(survey.parent / "data" / "strips" / "a.las")
    deaf = Trouble("busy", 10**6, lambda method, path: method == "PUT" and path.endswith("/schedule.json"))
    survey.write_text(FAILS_AT_ONCE + STORE.replace('"patience": 10.0', '"patience": 0.5'))
    with going(survey, out, "log", "--every", "1s", "--set", NOWHERE) as process:
        until(lambda: ended(s3, out) >= 1)
        with s3.trouble(deaf):
            until(lambda: "cannot be written" in (survey.parent / "log").read_text())
            before = ended(s3, out)
            until(lambda: ended(s3, out) > before)
        second = fwclass("schedule", survey, "--out", out, "--every", "1h")
        assert second.returncode == 1 and "another schedule is at work" in second.stderr, second.stderr
        assert f"pid {process.pid} on " in second.stderr
        status = fwclass("status", survey, "--out", out)
        assert status.returncode == 3, status.stderr
        assert status.stdout.startswith(f"a schedule is at work on it: pid {process.pid} on ")
        process.send_signal(signal.SIGTERM)
        assert process.wait(240) == 0
    assert {run["why"]["trigger"] for run in past(out)} == {"interval"}
    assert state(s3, out)["state"] == "stopped"
    assert (survey.parent / "log").read_text().count("cannot be written") == 1
    assert json.loads(fwclass("status", survey, "--out", out, "--json").stdout)["schedule"] is None


@pytest.mark.faults
def test_a_schedule_that_is_silent_is_followed_and_ends_when_it_wakes(s3, out, survey):
    """Stopped for longer than `store.dead`: what it then does is not taken for the other's."""
    with going(survey, out, "asleep", "--cron", "0 0 1 1 *") as asleep:
        until(lambda: state(s3, out).get("state") == "waiting")
        os.kill(asleep.pid, signal.SIGSTOP)
        with going(survey, out, "other", "--cron", "0 0 1 1 *") as other:
            until(lambda: state(s3, out)["pid"] == other.pid)
            assert "taken over if it is silent for 2 s" in (survey.parent / "other").read_text()
            os.kill(asleep.pid, signal.SIGCONT)
            assert asleep.wait(60) == 1
            assert "another schedule took this schedule's lock over" in (survey.parent / "asleep").read_text()
            assert state(s3, out)["pid"] == other.pid
            other.kill()
            other.wait()
    with lock_run(Remote(out, PARAMS), quiet, SCHEDULE):  # its process is gone: on its own host nobody waits
        pass


@pytest.mark.faults
def test_a_killed_schedule_of_another_host_is_followed_when_it_is_dead(s3, out, survey):
    """And a tick of cron that it missed is made up for."""
    facts = {"host": "other", "pid": 7, "machine": "m", "token": "t", "beat": 3}
    s3.write(out / "store/schedule.lock", json.dumps(facts).encode())
    s3.write(out / "schedule.json", json.dumps({"last_tick": time.time() - 5 * 86400.0, "pid": 7}).encode())
    began = time.monotonic()
    with going(survey, out, "log", "--cron", "0 3 * * *", "--once") as process:
        assert process.wait(240) == 1
    assert time.monotonic() - began > PARAMS.dead
    [run] = past(out)
    assert run["why"]["trigger"] == "cron" and run["why"]["tick"] < run["began"]
    assert abs(state(s3, out)["last_tick"] - time.time()) < 600
