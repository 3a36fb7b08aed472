"""Processes that play hosts of their own: a scheduler, workers and commands that share nothing but an S3 server."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

from objectstore import Server, quick, used
from runmaker import SETTINGS

from fwclass.store.url import Url

PARAMS = quick(dead=3.0, beat=0.5, patience=60.0, timeout=20.0)
QUICK = tuple(f"store.{n}={v}" for n, v in PARAMS.model_dump().items() if v is not None)
COMMAND = "from fwclass.cli import main; main()"
LIMIT = 600
"""s, that a run may take on a loaded machine."""


class Hosts:
    """Processes, each with a directory of its own to work and to keep copies in."""

    def __init__(self, s3: Server, root: Path, address: str = "127.0.0.1") -> None:
        self._s3, self._root, self._address = s3, root, address
        self.running: list[subprocess.Popen[str]] = []

    def start(self, name: str, *line: object, copies: bool = True) -> subprocess.Popen[str]:
        """A process on a host of this name; standard output and error go to its `log`."""
        home = self._root / name
        home.mkdir(exist_ok=True)
        given = {**os.environ, **used(self._s3, home / "copies"), "PYTHONPATH": ":".join(sys.path)}
        if not copies:
            del given["FWCLASS_SCRATCH"]  # a Dask worker has a directory of its own
        with self.log(name).open("a") as told:
            process = subprocess.Popen(
                [*self.entered(name), sys.executable, *map(str, line)],
                cwd=home,
                env=given,
                stdout=told,
                stderr=told,
                text=True,
            )
        self.running.append(process)
        return process

    def entered(self, name: str) -> list[str]:
        """The words before a command that let it run on the host of this name."""
        return []

    def log(self, name: str) -> Path:
        return self._root / f"{name}.log"

    def scheduler(self) -> str:
        """Its address."""
        self.start("scheduler", "-m", "dask", "scheduler", "--host", self._address, "--port", "0", "--no-dashboard")
        until = time.monotonic() + 60
        while time.monotonic() < until:
            if found := re.search(r"Scheduler at:\s+(tcp://\S+)", self.log("scheduler").read_text()):
                return found[1]
            time.sleep(0.1)
        raise AssertionError(self.log("scheduler").read_text())

    def worker(self, name: str, address: str) -> subprocess.Popen[str]:
        return self.start(
            name,
            "-m",
            "dask",
            "worker",
            address,
            "--nthreads",
            "1",
            "--no-nanny",
            "--no-dashboard",
            "--local-directory",
            self._root / name / "scratch",
            copies=False,
        )

    def run(self, name: str, place: Url, out: Url, *words: object) -> subprocess.Popen[str]:
        settings = (*SETTINGS, *QUICK, f"survey.directory={place}")
        given = [w for s in settings for w in ("--set", s)]
        return self.start(name, "-c", COMMAND, "run", "demo", "--out", out, *given, *words)

    def stop(self) -> None:
        for process in self.running:
            if process.poll() is None:
                process.kill()
            process.wait()


def until(condition, process: subprocess.Popen[str] | None = None) -> None:
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end
        assert process is None or process.poll() is None
        time.sleep(0.1)


def receipts(s3: Server, out: Url) -> int:
    """Parts that are done."""
    return sum(key.endswith("receipt.json") for key in s3.keys(out))
