"""Parts made with other versions of libraries: told, made again, or counted as done where that is asked for."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
from distributed import LocalCluster
from objectstore import quick, serving, used

from fwclass.errors import FwclassError
from fwclass.operate.status.walk import look_at
from fwclass.run import libraries as told
from fwclass.run.cluster import Cluster
from fwclass.run.libraries import library_remarks
from fwclass.run.local import Loop
from fwclass.run.part import Task, execute
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.store import libraries, run_store
from fwclass.store.bucket import Remote
from fwclass.store.provenance import Provenance
from fwclass.store.run_location import open_store
from fwclass.store.run_store import Store

THEN = {"python": "3.11.7", "numpy": "2.4.6", "pyarrow": "26.0.1"}
NOW = {**THEN, "pyarrow": "22.0.0"}


def written(text, inputs, directory):
    (directory / "a").write_text(text)
    return {}


def tasks(count=2):
    first = Task("one", "all", 1, {}, partial(written, "1"))
    return [first, *(Task("two", str(k), 1, {}, partial(written, str(k)), needs=(first.name,)) for k in range(count))]


def workflow(runner):
    runner.do(tasks())
    runner.finish(whole=False)


def here(monkeypatch, versions, source="0123456789abcdef") -> None:
    """As if these were the libraries of this environment, and this its code."""
    whole = {"fwclass": "0.1.0", "source": source, **versions}
    for module in (libraries, told, run_store):
        monkeypatch.setattr(module, "fingerprint", lambda: whole)
    monkeypatch.setattr(libraries, "installed_versions", lambda: versions)


def made(root, **settings) -> list[str]:
    runner = Runner(root, Loop(), Display(), **settings)
    workflow(runner)
    return [o.status for o in runner.outcomes.values()]


def test_parts_made_with_other_libraries_are_stale_told_and_made_again(tmp_path, monkeypatch):
    here(monkeypatch, THEN)
    assert made(tmp_path) == ["computed"] * 3 and made(tmp_path) == ["skipped"] * 3
    assert library_remarks(Store(tmp_path), False) == []
    here(monkeypatch, NOW)
    looked = look_at(tmp_path, workflow)
    reasons = {s.part: [r.text for r in s.reasons] for s in looked.states.values()}
    assert {s.standing for s in looked.states.values()} == {"stale"}
    assert reasons["all"] == ["pyarrow 26.0.1 to 22.0.0"] and "pyarrow 26.0.1 to 22.0.0" in reasons["0"]
    [line] = library_remarks(Store(tmp_path), False)
    assert line.startswith("3 parts were made with other libraries (pyarrow 26.0.1 to 22.0.0)") and "again" in line
    assert made(tmp_path) == ["computed"] * 3
    assert look_at(tmp_path, workflow).all_done and library_remarks(Store(tmp_path), False) == []


def test_other_libraries_are_done_where_that_is_asked_for(tmp_path, monkeypatch):
    here(monkeypatch, THEN)
    made(tmp_path)
    here(monkeypatch, NOW)
    [line] = library_remarks(Store(tmp_path), True)
    assert "count as done" in line
    runner = Runner(tmp_path, Loop(), Display(), accept_libraries=True)
    workflow(runner)
    assert {o.status for o in runner.outcomes.values()} == {"skipped"}
    assert told.report_libraries(runner)["accepted"] == {"pyarrow 26.0.1 to 22.0.0": 3}
    assert look_at(tmp_path, workflow, accept_libraries=True).all_done
    assert not look_at(tmp_path, workflow).all_done
    [task, *_] = tasks()
    assert execute(tmp_path, task).status == "computed"  # a worker goes by the same rule as the driver


def test_another_commit_is_told_and_makes_nothing_stale(tmp_path, monkeypatch):
    here(monkeypatch, THEN)
    made(tmp_path)
    here(monkeypatch, THEN, source="fedcba9876543210")
    looked = look_at(tmp_path, workflow)
    assert looked.all_done and library_remarks(Store(tmp_path), False) == []
    [row] = told.by_libraries(looked.libraries, looked.store)
    assert row["parts"] == 3 and "source 0123456789abcdef, not 0.1.0, source fedcba" in told.text_of(row)


def test_receipts_of_before_count_as_done_and_are_told(tmp_path, monkeypatch):
    here(monkeypatch, THEN)
    monkeypatch.setattr(Provenance, "keep", lambda *_: "")
    made(tmp_path)
    monkeypatch.undo()
    here(monkeypatch, NOW)
    looked = look_at(tmp_path, workflow)
    assert looked.all_done
    [row] = told.by_libraries(looked.libraries, looked.store)
    assert row["made_with"] is None and "counted as done" in told.text_of(row)
    assert "do not tell" in library_remarks(Store(tmp_path), False)[0]


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"numpy": 1}', '{"numpy": "1"}', None])
def test_parts_whose_fingerprint_is_lost_are_stale(tmp_path, monkeypatch, damage):
    """Nobody knows then whether other libraries made them."""
    here(monkeypatch, THEN)
    made(tmp_path)
    [path] = (tmp_path / "store" / "libraries").glob("*.json")
    path.unlink() if damage is None else path.write_text(damage)
    monkeypatch.setattr(libraries, "_KNOWN", {})
    assert look_at(tmp_path, workflow).all_done  # it is that of here
    here(monkeypatch, NOW)
    monkeypatch.setattr(libraries, "_KNOWN", {})
    looked = look_at(tmp_path, workflow)
    assert {s.standing for s in looked.states.values()} == {"stale"}
    [row] = told.by_libraries(looked.libraries, looked.store)
    assert "not recorded any more" in told.text_of(row)
    [line] = library_remarks(Store(tmp_path), False)
    assert line.startswith("3 parts were made with other libraries (what it was made with is not recorded any more")
    assert made(tmp_path) == ["computed"] * 3 and look_at(tmp_path, workflow).all_done


def test_versions_are_read_without_loading_a_library(tmp_path):
    """A stub's metadata before the others on the path is believed; nothing of what is told is imported."""
    stub(tmp_path)
    code = (
        "import sys; from fwclass.store.libraries import fingerprint; f = fingerprint(); "
        "print(f['pyarrow'], f['gdal'], f['laszip'], len(f['source'])); print(set(f) & set(sys.modules) - {'fwclass'})"
    )
    given = {**os.environ, "PYTHONPATH": str(tmp_path)}
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=given, check=True)
    first, second = ended.stdout.splitlines()
    assert first.split()[0] == "22.0.0" and "none" not in first and first.endswith("16") and second == "set()"


def stub(folder: Path) -> None:
    """A package's metadata, as of another version."""
    own = folder / "pyarrow-22.0.0.dist-info"
    own.mkdir()
    (own / "METADATA").write_text("Metadata-Version: 2.1\nName: pyarrow\nVersion: 22.0.0\n")


@contextmanager
def other_worker(address: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A worker of the scheduler at `address` that says of itself to have another pyarrow."""
    stub(folder)
    line = [sys.executable, "-m", "dask", "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    path = ":".join([str(folder), *sys.path])
    with subprocess.Popen(
        [*line, "--local-directory", folder], env={**os.environ, "PYTHONPATH": path}, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def until(condition) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_worker_with_other_libraries_gets_no_part(tmp_path):
    """One that joins is told and retired, and the parts are made by the others; where it is there at the beginning,
    nothing begins."""
    folder, root, words = tmp_path / "other", tmp_path / "run", []
    folder.mkdir()
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as ours,
        Cluster(ours.scheduler_address, 0, 1.0, 100, say=words.append) as cluster,
        other_worker(ours.scheduler_address, folder) as other,
    ):
        workers = ours.scheduler.workers
        until(lambda: len(workers) == 2)
        with pytest.raises(FwclassError, match=r"1 of 2 workers(.|\n)*pyarrow \S+ to 22\.0\.0"):
            Cluster(ours.scheduler_address, 0, 1.0, 100)
        outcomes = list(cluster.run(root, tasks(30)))
        assert [o.status for o in outcomes] == ["computed"] * 31
        assert len(words) == 1 and "pyarrow" in words[0] and "22.0.0" in words[0]
        until(lambda: len(workers) == 1)
        other.wait(60)
    pids = {(root / "logs" / "two" / f"{k}.log").read_text().split("pid=")[1].split()[0] for k in range(30)}
    assert str(other.pid) not in pids


def test_on_object_storage_too(tmp_path, monkeypatch):
    with serving() as s3:
        for name, value in used(s3, tmp_path / "copies").items():
            monkeypatch.setenv(name, value)
        location = Remote(s3.url(), quick())
        here(monkeypatch, THEN)
        made(location)
        monkeypatch.setattr(libraries, "_KNOWN", {})
        here(monkeypatch, NOW)
        store = open_store(location, lists=True)
        assert store.provenance.fingerprints() == [{"fwclass": "0.1.0", "source": "0123456789abcdef", **THEN}]
        assert library_remarks(store, False)[0].startswith(
            "3 parts were made with other libraries (pyarrow 26.0.1 to 22.0.0)"
        )
        assert made(location, accept_libraries=True) == ["skipped"] * 3
        assert made(location) == ["computed"] * 3 and made(location) == ["skipped"] * 3
