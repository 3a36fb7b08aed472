"""The lock of a run on object storage: one writer, no clock, no zombie."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time

import pytest
from objectstore import Server, Trouble, quick

from fwclass.errors import ConfigError, StoreError
from fwclass.store.bucket import Remote
from fwclass.store.lock import WRITER
from fwclass.store.objects import Objects
from fwclass.store.refusals import LostRace
from fwclass.store.remote_lock import lock_key, remote_holder, remote_writer
from fwclass.store.run_location import lock_run, unmade_again

LOCK = lock_key(WRITER)
HOLDER = """
import sys, time
from objectstore import quick
from fwclass.store.objects import Objects
from fwclass.store.remote_lock import remote_writer
from fwclass.store.url import Url

with remote_writer(Objects(Url(sys.argv[1]), quick()), print):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def objects(s3: Server) -> Objects:
    return Objects(s3.url(), quick())


def quiet(text: str) -> None:
    pass


def strange(objects: Objects, **facts: object) -> None:
    """A lock that a process of another host has taken."""
    objects.put(LOCK, json.dumps({"host": "other", "pid": 7, "machine": "m", "token": "t", **facts}).encode())


def test_a_second_writer_is_told_who_the_first_is(objects: Objects) -> None:
    with remote_writer(objects, quiet) as (token, beat):
        began = time.monotonic()
        with pytest.raises(StoreError, match=r"another run[\s\S]*pid"), remote_writer(objects, quiet):
            pass
        assert time.monotonic() - began < objects.params.dead  # it shows life long before
        beat.check()
        assert json.loads(objects.get(LOCK)[0])["token"] == token
        assert set(remote_holder(objects)) == {"host", "pid"}
    assert remote_holder(objects) is None
    with remote_writer(objects, quiet):
        pass


@pytest.mark.faults
def test_of_several_who_start_together_one_writes(objects: Objects) -> None:
    won, lost, go = [], [], threading.Event()

    def run() -> None:
        try:
            with remote_writer(objects, quiet) as (token, _):
                won.append(token)
                go.wait(20)
        except StoreError as fault:
            lost.append(fault)
            if len(lost) == 4:
                go.set()

    threads = [threading.Thread(target=run) for _ in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(won), len(lost)) == (1, 4)


@pytest.mark.faults
def test_a_silent_holder_of_another_host_is_waited_for_and_then_followed(objects: Objects) -> None:
    strange(objects)
    said: list[str] = []
    began = time.monotonic()
    with remote_writer(objects, said.append) as (token, _):
        assert time.monotonic() - began >= objects.params.dead
        assert json.loads(objects.get(LOCK)[0])["token"] == token
    assert "process 7 of other" in said[0]


@pytest.mark.faults
def test_a_killed_holder_of_this_host_is_followed_at_once(objects: Objects, tmp_path) -> None:
    script = tmp_path / "holder.py"
    script.write_text(HOLDER)
    path = ":".join(sys.path)
    given = {**os.environ, "PYTHONPATH": path}
    with subprocess.Popen(
        [sys.executable, script, objects.url], stdout=subprocess.PIPE, text=True, env=given
    ) as process:
        assert process.stdout.readline() == "held\n"
        with pytest.raises(StoreError, match="another run"), remote_writer(objects, quiet):
            pass
        process.kill()
    assert remote_holder(objects) is None
    said: list[str] = []
    with remote_writer(objects, said.append):
        pass
    assert "is gone" in said[0]


@pytest.mark.faults
def test_a_holder_whose_lock_was_taken_stops(objects: Objects) -> None:
    with remote_writer(objects, quiet) as (_, beat):
        strange(objects)
        until = time.monotonic() + 10
        with pytest.raises(LostRace, match="took this run's lock over"):
            while time.monotonic() < until:
                beat.check()
                time.sleep(0.02)
    assert json.loads(objects.get(LOCK)[0])["host"] == "other"  # the thief's lock is not given back


@pytest.mark.faults
def test_a_holder_keeps_its_lock_through_trouble(s3: Server, objects: Objects) -> None:
    with remote_writer(objects, quiet) as (token, beat):
        with s3.trouble(Trouble("busy", 6, lambda method, path: path.endswith(LOCK))):
            time.sleep(1.0)
        with s3.trouble(Trouble("deaf", 3, lambda method, path: path.endswith(LOCK))):
            time.sleep(0.5)
        beat.check()
        assert json.loads(objects.get(LOCK)[0])["token"] == token


def test_a_server_without_conditions_is_refused(objects: Objects, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that takes no notice of If-None-Match."""
    from fwclass.store.objects import Mark

    def careless(key: str, data: bytes, mode: object) -> Mark:
        objects.put(key, data)
        return Mark("x")

    monkeypatch.setattr(objects, "_conditional", careless)
    with pytest.raises(StoreError, match="no conditional writes"), remote_writer(objects, quiet):
        pass


@pytest.mark.parametrize("place", ["store", "store/x", "generations", "generations/0001-a/laz"])
def test_no_run_is_made_in_what_another_has_in_a_bucket(s3: Server, place: str) -> None:
    """The other one sweeps what it did not put there."""
    run, free = s3.url(), s3.url()
    s3.write(run / "store/run.json", b"{}")
    for enter in (lambda there: lock_run(there, quiet), unmade_again):
        with pytest.raises(ConfigError, match="what another run has made"), enter(Remote(run / place, quick())):
            pass
        with enter(Remote(free / place, quick())):
            pass
    assert s3.keys(run) == ["store/run.json"]
