"""Disks that fill up, stores that cannot be written or go away, sources that change, schedulers that die."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from faultmaker import receipts, running, words
from runmaker import delivered

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
def test_a_source_that_is_truncated_is_never_taken_for_read(survey, expected, tmp_path):
    own, root = tmp_path / "survey", tmp_path / "run"
    shutil.copytree(survey, own)
    source = sorted((own / "survey" if (own / "survey").is_dir() else own).rglob("*.wdp"))[0]
    whole = source.read_bytes()
    line = (*words(own, root), "--workers", "0")
    with running(tmp_path / "told", *line) as run:
        run.until(lambda: list((root / "store" / "index").glob("*/receipt.json")))
        os.truncate(source, len(whole) // 2)
        code = run.code()
    read = list((root / "store" / "read").glob("*/receipt.json"))
    assert code in (1, 3) or code == -7, run.said  # SIGBUS: it was being read through a memory map
    assert code == -7 or (str(source) in run.said and "changed while the run was under way" in run.said)
    source.write_bytes(whole)
    with running(tmp_path / "again", *line) as run:
        assert run.code() == 0, run.said
    assert delivered(root) == expected, f"{len(read)} parts were read before"


@pytest.mark.slow
def test_a_scheduler_that_dies_ends_the_run(survey, expected, tmp_path):
    root, address = tmp_path / "run", tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker"]
    with (tmp_path / "dask").open("wb") as told:
        where = ["--scheduler-file", str(address)]
        here = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        scheduler = subprocess.Popen([*dask, *where, *here], stdout=told, stderr=told)
        workers = [
            subprocess.Popen([*worker, *where, "--nthreads", "1", "--no-dashboard"], stdout=told, stderr=told)
            for _ in range(2)
        ]
    try:
        while not address.exists():
            time.sleep(0.1)
        line = words(survey, root)
        with running(tmp_path / "told", *line, "--scheduler", json.loads(address.read_text())["address"]) as run:
            run.until(lambda: receipts(root) > 8)
            scheduler.kill()
            assert run.process.wait(90) == 1, run.said
        assert "the Dask scheduler is gone" in run.said and "Traceback" not in run.said, run.said
    finally:
        for process in (scheduler, *workers):
            for child in psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []:
                child.kill()
            process.kill()
            process.wait()
    with running(tmp_path / "again", *line, "--workers", "0") as run:
        assert run.code() == 0, run.said
    assert "skipped" in run.said and delivered(root) == expected


def state(root: Path) -> dict[str, tuple[int, int]]:
    """Size and time of everything below a directory."""
    return {str(p): (p.lstat().st_size, p.lstat().st_mtime_ns) for p in root.rglob("*")}
