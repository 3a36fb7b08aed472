"""A scheduler, workers and the command as processes that share nothing but an S3 server; killed, and started twice."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from manyhosts import LIMIT, Hosts, receipts, until
from objectstore import Server, serving
from runmaker import delivered

from fwclass.store.url import Url

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def s3() -> Iterator[Server]:
    with serving() as server:
        yield server


@pytest.fixture(scope="module")
def place(s3: Server, survey: Path) -> Url:
    url = s3.url("survey")
    s3.write_all(url, survey, "strips", "reference")
    s3.write(url / "trajectory.csv", (survey / "trajectory.csv").read_bytes())
    return url


@pytest.fixture
def hosts(s3: Server, tmp_path: Path) -> Iterator[Hosts]:
    made = Hosts(s3, tmp_path)
    try:
        yield made
    finally:
        made.stop()


def test_workers_that_share_only_object_storage_and_one_is_killed(s3, place, hosts, finished, tmp_path):
    out, address = s3.url(), hosts.scheduler()
    first = hosts.worker("first", address)
    hosts.worker("second", address)
    run = hosts.run("driver", place, out, "--scheduler", address)
    until(lambda: receipts(s3, out) > 30, run)
    first.send_signal(signal.SIGKILL)
    hosts.worker("third", address)
    assert run.wait(LIMIT) == 0, hosts.log("driver").read_text()
    assert s3.delivered(out) == delivered(finished[0])
    for name in ("second", "third"):  # each read into a directory of its own
        assert list((tmp_path / name / "scratch").rglob("*.parquet"))
    fetched = list((tmp_path / "driver").rglob("decompose/*/*/table.parquet"))
    assert len(fetched) <= 1, "the page draws waveforms of one chunk"


@pytest.mark.faults
def test_a_killed_command_is_followed_by_another_host_and_resumed(s3, place, hosts, finished):
    out = s3.url()
    killed = hosts.run("killed", place, out, "--workers", "0")
    until(lambda: receipts(s3, out) > 40, killed)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    before = receipts(s3, out)
    again = hosts.run("again", place, out, "--workers", "0")
    assert again.wait(LIMIT) == 0, hosts.log("again").read_text()
    told = hosts.log("again").read_text()
    assert "is gone; it is taken over" in told
    skipped = sum(int(n) for n in re.findall(r"(\d+) skipped", told))
    assert skipped >= before - 1  # what was done is not made again
    assert s3.delivered(out) == delivered(finished[0])
    assert not [k for k in s3.keys(out) if k.startswith("store/staging")]


@pytest.mark.faults
def test_of_two_runs_started_together_one_is_refused(s3, place, hosts, finished):
    out = s3.url()
    runs = [hosts.run(name, place, out, "--workers", "0") for name in ("one", "two")]
    until(lambda: any(run.poll() is not None for run in runs))
    [first] = [k for k, run in enumerate(runs) if run.poll() is not None]
    assert runs[first].returncode == 1
    assert re.search(r"another run is writing[\s\S]*pid", hosts.log(("one", "two")[first]).read_text())
    other = runs[1 - first]
    assert other.wait(LIMIT) == 0
    assert s3.delivered(out) == delivered(finished[0])


@pytest.mark.faults
def test_a_command_that_slept_finds_its_lock_taken_and_commits_nothing_more(s3, place, hosts, finished):
    """Stopped for longer than `store.dead`; another process follows it as one of another host would."""
    out = s3.url()
    asleep = hosts.run("asleep", place, out, "--workers", "0")
    until(lambda: receipts(s3, out) > 20, asleep)
    asleep.send_signal(signal.SIGSTOP)
    other = hosts.run("other", place, out, "--workers", "0")
    assert other.wait(LIMIT) == 0, hosts.log("other").read_text()
    assert "taken over if it is silent" in hosts.log("other").read_text()
    before = s3.read(out)
    asleep.send_signal(signal.SIGCONT)
    assert asleep.wait(LIMIT) == 1
    told = hosts.log("asleep").read_text()
    assert "lost its lock" in told or "took this run's lock over" in told
    changed = {k for k, v in s3.read(out).items() if before.get(k) != v}
    assert not [k for k in changed if k.endswith("receipt.json") or k.startswith(("generations", "current"))]
    assert s3.delivered(out) == delivered(finished[0])
