"""Disks that fill up, stores that cannot be written or go away, sources that change, schedulers that die."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import struct
import subprocess
from pathlib import Path

import pytest
from faultmaker import receipts, running, scheduler, unharmed, words
from faultparts import simple
from runmaker import delivered

from fwclass.errors import FwclassError
from fwclass.run.cluster import Cluster
from fwclass.run.part import Task
from fwclass.store.lock import holder

pytestmark = pytest.mark.faults

ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount")


def mounted(path: Path, *how: str) -> None:
    path.mkdir(exist_ok=True)
    done = subprocess.run(["mount", *how, str(path)], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"mount is refused here: {done.stderr.strip()}")


def unmounted(path: Path) -> None:
    subprocess.run(["umount", "--lazy", str(path)], capture_output=True)


@ROOT
@pytest.mark.slow
def test_a_full_disk_fails_parts_and_harms_none(survey, expected, tmp_path):
    disk = tmp_path / "disk"
    mounted(disk, "-t", "tmpfs", "-o", "size=3m", "tmpfs")
    try:
        line = (*words(survey, disk / "run"), "--workers", "0")
        with running(tmp_path / "full", *line) as run:
            assert run.code() in (1, 3), run.said
        assert "the disk is full" in run.said and f"disk {disk}:" in run.said and "Traceback" not in run.said
        kept = receipts(disk / "run")
        subprocess.run(["mount", "-o", "remount,size=300m", str(disk)], check=True)
        with running(tmp_path / "more", *line) as run:
            assert run.code() == 0, run.said
        assert 0 < kept < receipts(disk / "run") and "skipped" in run.said
        assert delivered(disk / "run") == expected
    finally:
        unmounted(disk)


@ROOT
@pytest.mark.slow
def test_a_disk_that_is_full_at_one_write_after_the_other(survey, finished, tmp_path):
    """It is a little larger each time, until the whole run fits."""
    disk, full = tmp_path / "disk", 0
    mounted(disk, "-t", "tmpfs", "-o", "size=64k", "tmpfs")
    try:
        line = (*words(survey, disk / "run"), "--workers", "0")
        for size in range(300, 30_000, 700):
            with running(tmp_path / f"told{size}", *line) as run:
                if run.code() == 0:
                    break
            assert run.code() in (1, 3) and "Traceback" not in run.said, run.said
            assert "the disk is full" in run.said, run.said
            full += 1
            subprocess.run(["mount", "-o", f"remount,size={size}k", str(disk)], check=True)
        assert full > 8 and run.code() == 0
        unharmed(disk / "run", finished)
    finally:
        unmounted(disk)


@pytest.mark.slow
def test_a_limit_on_file_size_is_told_as_such(survey, tmp_path):
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    with running(tmp_path / "told", *words(survey, tmp_path / "run"), "--workers", "0", limit=limit) as run:
        assert run.code() in (1, 3), run.said
    assert "a file may not grow that large" in run.said and "disk /" in run.said and "Traceback" not in run.said


@ROOT
def test_a_read_only_store_is_refused_and_left_as_it_is(survey, finished, tmp_path):
    root = tmp_path / "run"
    shutil.copytree(finished, root, symlinks=True)
    mounted(root, "--bind", str(root))
    try:
        done = subprocess.run(["mount", "-o", "remount,bind,ro", str(root)], capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"mount is refused here: {done.stderr.strip()}")
        before = state(root)
        with running(tmp_path / "told", *words(survey, root, "train.trees=11"), "--workers", "0") as run:
            assert run.code() == 1, run.said
        assert "Read-only" in run.said and "Traceback" not in run.said
        assert state(root) == before
    finally:
        unmounted(root)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["store", "."])
def test_a_store_that_is_removed_ends_the_run(survey, expected, tmp_path, what):
    root = tmp_path / "run"
    line = (*words(survey, root), "--workers", "0")
    with running(tmp_path / "told", *line) as run:
        run.until(lambda: receipts(root) > 8)
        shutil.rmtree(root / what, ignore_errors=True)
        assert run.code() == 1, run.said
    assert "was removed while the run was under way" in run.said and "Traceback" not in run.said
    if what == "store":
        with running(tmp_path / "again", *line) as run:
            assert run.code() == 0, run.said
        assert delivered(root) == expected


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["0", "2"])
@pytest.mark.parametrize("kind", ["strips/*.wdp", "strips/*.las", "reference/*.las"])
def test_a_source_that_is_truncated_is_never_taken_for_read(survey, finished, tmp_path, kind, workers):
    own, root = tmp_path / "survey", tmp_path / "run"
    shutil.copytree(survey, own)
    [source] = own.glob(kind)
    whole = source.read_bytes()
    line = (*words(own, root), "--workers", workers)
    with running(tmp_path / "told", *line) as run:
        run.until(lambda: list((root / "store" / "index").glob("*/receipt.json")))
        os.truncate(source, len(whole) // 2)
        code = run.code()
    bus = code == -signal.SIGBUS and workers == "0"  # it was being read through a memory map
    assert bus or (code in (1, 3) and str(source) in run.said and "was changed while" in run.said), (code, run.said)
    assert "Traceback" not in run.said
    source.write_bytes(whole)
    with running(tmp_path / "again", *line) as run:
        assert run.code() == 0, run.said
    unharmed(root, finished)


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["0", "2"])
@pytest.mark.parametrize(("kind", "at"), [("strips/*.wdp", 100_000), ("strips/*.las", 171), ("reference/*.las", 171)])
def test_a_source_that_is_exchanged_leaves_nothing_of_both(survey, tmp_path, kind, at, workers):
    """Another sound file takes its name: other samples, or another offset of z in the header."""
    own, root = tmp_path / "survey", tmp_path / "run"
    shutil.copytree(survey, own)
    [source] = own.glob(kind)
    whole, other = source.read_bytes(), tmp_path / "other"
    put = struct.pack("<d", 0.5 + struct.unpack_from("<d", whole, at)[0]) if at == 171 else whole[at + 8 : at + 16]
    other.write_bytes(whole[:at] + put + whole[at + 8 :])
    line = (*words(own, root), "--workers", workers)
    with running(tmp_path / "told", *line) as run:
        run.until(lambda: list((root / "store" / "index").glob("*/receipt.json")))
        other.replace(source)
        assert run.code() in (0, 1, 3) and "Traceback" not in run.said, run.said
        assert run.code() == 0 or "was changed while" in run.said, run.said
    for place in (root, tmp_path / "clean"):
        with running(tmp_path / f"told-{place.name}", *words(own, place), "--workers", "0") as run:
            assert run.code() == 0, run.said
    assert delivered(root) == delivered(tmp_path / "clean")


@ROOT
@pytest.mark.slow
def test_sources_that_may_not_be_written_are_only_read(survey, finished, tmp_path):
    own, root = tmp_path / "survey", tmp_path / "run"
    shutil.copytree(survey, own)
    mounted(own, "--bind", str(own))
    try:
        done = subprocess.run(["mount", "-o", "remount,bind,ro", str(own)], capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"mount is refused here: {done.stderr.strip()}")
        with running(tmp_path / "told", *words(own, root), "--workers", "0") as run:
            assert run.code() == 0, run.said
        unharmed(root, finished)
        with running(tmp_path / "inside", *words(own, own / "run"), "--workers", "0") as run:
            assert run.code() in (1, 2) and "Traceback" not in run.said, run.said
    finally:
        unmounted(own)


def test_a_scheduler_that_dies_is_named(tmp_path):
    root, tasks = tmp_path / "run", [Task("simple", f"a{k}", 1, {}, simple) for k in range(100)]
    with scheduler(tmp_path, 1) as (process, address), Cluster(address, 0, 1.0, 10) as cluster:
        made = []
        with pytest.raises(FwclassError, match="the Dask scheduler is gone"):
            for outcome in cluster.run(root, tasks):
                made.append(outcome)
                process.kill()
    assert made and {o.status for o in made} == {"computed"} and receipts(root) < len(tasks)


@pytest.mark.slow
def test_a_scheduler_that_dies_ends_the_run(survey, finished, tmp_path):
    root, line = tmp_path / "run", words(survey, tmp_path / "run")
    with scheduler(tmp_path, 2) as (process, address):
        with running(tmp_path / "told", *line, "--scheduler", address) as run:
            run.until(lambda: receipts(root) > 8)
            process.kill()
            assert run.process.wait(90) == 1, run.said
        assert "the Dask scheduler is gone" in run.said and "Traceback" not in run.said, run.said
        assert holder(root) is None
        with running(tmp_path / "again", *line, "--workers", "0") as run:  # workers may still have a part in hand
            assert run.code() == 0, run.said
    assert "skipped" in run.said
    unharmed(root, finished)


def state(root: Path) -> dict[str, tuple[int, int]]:
    """Size and time of everything below a directory."""
    return {str(p): (p.lstat().st_size, p.lstat().st_mtime_ns) for p in root.rglob("*")}
