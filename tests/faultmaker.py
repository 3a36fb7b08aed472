"""Real processes for tests of faults: runs that are begun and killed, their workers, what readers see meanwhile."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from commandline import fwclass
from runmaker import SETTINGS, delivered

from fwclass.store.lock import holder
from fwclass.store.run_store import Store

SMALL = (
    "simulate.size=60",
    "simulate.strips=1",
    "train.trees=5",
    "train.samples_per_class=500",
    "read.chunk_pulses=3000",
    "train.importance_repeats=0",
    "areas.train=[[512000,5403000,512030,5403060]]",
    "tile.size=80",
    "pulse.sample=1000",
)
"""One strip over 60 m x 60 m: a run of seconds."""

PATIENCE = 300.0
"""s, until a process that does not end counts as hung."""


def words(survey: Path, root: Path, *settings: str) -> list[str]:
    """`fwclass run` of the small survey into `root`."""
    chosen = [*SETTINGS, *SMALL, f"survey.directory={survey}", *settings]
    return ["run", "demo", "--out", str(root), *(w for s in chosen for w in ("--set", s))]


@dataclass
class Run:
    """A command in a process group of its own; what it says goes to the file `told`."""

    told: Path
    process: subprocess.Popen[bytes]

    @classmethod
    def begin(cls, told: Path, *line: object, limit: Callable[[], None] | None = None) -> Run:
        command = [sys.executable, "-c", "from fwclass.cli import main; main()", *map(str, line)]
        with told.open("ab") as stream:
            return cls(
                told, subprocess.Popen(command, stdout=stream, stderr=stream, start_new_session=True, preexec_fn=limit)
            )

    @property
    def said(self) -> str:
        return self.told.read_text(errors="replace")

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None

    def workers(self) -> list[psutil.Process]:
        """Its worker processes that live."""
        found = []
        with contextlib.suppress(psutil.NoSuchProcess):
            for child in psutil.Process(self.process.pid).children(recursive=True):
                with contextlib.suppress(psutil.NoSuchProcess):
                    if "spawn_main" in " ".join(child.cmdline()) and child.status() != psutil.STATUS_ZOMBIE:
                        found.append(child)
        return found

    def until(self, holds: Callable[[], Any]) -> None:
        """Wait until something holds; an error if the run ends or hangs before."""
        end = time.monotonic() + PATIENCE
        while not holds():
            assert not self.ended, self.said
            assert time.monotonic() < end, self.said
            time.sleep(0.01)

    def code(self) -> int:
        """Wait for its exit code."""
        return self.process.wait(PATIENCE)

    def kill(self) -> None:
        """SIGKILL for the driving process, and for it alone."""
        self.process.kill()
        self.process.wait()


@contextlib.contextmanager
def running(told: Path, *line: object, limit: Callable[[], None] | None = None) -> Iterator[Run]:
    """A run that is ended with all its workers when the test is over, however that goes."""
    run = Run.begin(told, *line, limit=limit)
    try:
        yield run
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.process.pid, signal.SIGKILL)
        run.process.wait()


@contextlib.contextmanager
def scheduler(place: Path, workers: int) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A Dask scheduler with workers of one thread, as separate processes: its own one, and its address."""
    given = {**os.environ, "PYTHONPATH": ":".join(sys.path)}
    facts, dask = place / "scheduler.json", [sys.executable, "-m", "dask"]
    where = ["--scheduler-file", str(facts), "--no-dashboard"]
    here = [*where, "--host", "127.0.0.1", "--port", "0"]
    with (place / "dask").open("wb") as told:

        def begin(*line: str) -> subprocess.Popen[bytes]:
            return subprocess.Popen([*dask, *line], stdout=told, stderr=told, env=given, start_new_session=True)

        processes = [begin("scheduler", *here)]
        processes += [begin("worker", *where, "--nthreads", "1", "--no-nanny") for _ in range(workers)]
    try:
        end = time.monotonic() + PATIENCE
        while not facts.exists():
            assert time.monotonic() < end and processes[0].poll() is None, (place / "dask").read_text()
            time.sleep(0.1)
        yield processes[0], json.loads(facts.read_text())["address"]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def kill_workers(run: Run, root: Path, times: int, parts: int, seed: int) -> int:
    """Kill one worker after the other at random moments, spread over a run of so many parts; how many died of it.

    Each while a part is being made and nothing is delivered: the test fails where the run ends before. Of two workers
    with one part between them the older dies, for the other may be one that has just begun.
    """
    rng, killed = random.Random(seed), 0  # noqa: S311
    for k in range(times):
        run.until(lambda done=k * parts // (times + 4): receipts(root) > done)
        time.sleep(rng.uniform(0.0, 0.4))
        held: list[psutil.Process] = []
        run.until(lambda held=held: _hold(run, held) and (Store(root).under_way() or _go_on(held)))
        all_have_one = len(Store(root).under_way()) >= len(held)
        victim = rng.choice(held) if all_have_one else min(held, key=psutil.Process.create_time)
        assert not (root / "current").exists() and victim.status() != psutil.STATUS_ZOMBIE
        victim.kill()
        _go_on(held)
        killed += gone([victim], 30.0)
    return killed


def _hold(run: Run, held: list[psutil.Process]) -> bool:
    """Stop all workers, so that what they are at can be seen; whether there are any."""
    held[:] = run.workers()
    for worker in held:
        with contextlib.suppress(psutil.NoSuchProcess):
            worker.suspend()
    return bool(held)


def _go_on(held: list[psutil.Process]) -> None:
    for worker in held:
        with contextlib.suppress(psutil.NoSuchProcess):
            worker.resume()


def receipts(root: Path) -> int:
    """How many parts of a run have one."""
    return sum((root / "store" / stage / part / "receipt.json").exists() for stage, part in Store(root).parts())


def lost(root: Path) -> int:
    """How often a part that had begun was lost with its worker."""
    return sum(p.read_text().count("status=lost") for p in (root / "logs").rglob("*.log"))


def unharmed(root: Path, undisturbed: Path) -> None:
    """A run has made and delivered what an undisturbed one has, to the byte, and nothing is left behind."""
    assert delivered(root) == delivered(undisturbed)
    for stage in _stages(undisturbed) | _stages(root):
        made, wanted = ({r.part: (r.key, r.outputs) for r in Store(d).receipts(stage)} for d in (root, undisturbed))
        assert made == wanted, stage
    assert not list((root / "store").glob("staging/*"))
    assert not list((root / "store" / "failures").rglob("*.json"))
    assert not (root / "generations" / ".pending").exists()
    assert not [p for p in root.rglob(".*") if p.parent != root / "logs"], "files beside their names"
    assert holder(root) is None
    told = fwclass("status", root, "--json", "--verify")
    assert told.returncode == 0 and json.loads(told.stdout)["done"], told.stdout


def _stages(root: Path) -> set[str]:
    return {p.parent.parent.name for p in (root / "store").glob("*/*/receipt.json")}


def gone(processes: list[psutil.Process], seconds: float) -> bool:
    """All of these have ended within some seconds."""
    return not psutil.wait_procs(processes, timeout=seconds)[1]


@dataclass
class Reader:
    """Looks at `current` of a run directory all the time; `torn` tells what was not whole when it was looked at."""

    root: Path
    looks: int = 0
    torn: list[str] = field(default_factory=list)
    _over: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> Reader:
        self._thread = threading.Thread(target=self._look)
        self._thread.start()
        return self

    def __exit__(self, *ended: object) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._over.wait(0.02):
            link = self.root / "current"
            if link.is_symlink():
                self.looks += 1
                try:
                    self._whole(link.resolve())
                except (OSError, ValueError) as fault:
                    self.torn.append(f"{type(fault).__name__}: {fault}")

    def _whole(self, generation: Path) -> None:
        facts = json.loads((generation / "generation.json").read_text())
        aside = {"generation.json", "manifest.json", "report.json", "report.html", "assess.parquet"}
        files = [p for p in generation.rglob("*") if p.is_file() and p.name not in aside]
        if len(files) != facts["files"]:
            raise ValueError(f"{len(files)} files of {facts['files']}")
