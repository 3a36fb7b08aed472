"""Trying inputs in a child process, which is started anew where one of them ends it."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from child import CPU_SECONDS, drawn

WALL_SECONDS = 700.0
"""An input that waits for so long without using the processor hangs too."""

PLAIN = {
    "MALLOC_ARENA_MAX": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "RUST_BACKTRACE": "0",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}
"""Set before the process starts: memory is what is used, not what is set aside for threads; names of frames, which Rust
looks up in a full address space, hang it."""

READY_SECONDS = 600.0


class Child:
    """A running `script` for some readers (or commands); use it as a context."""

    def __init__(self, *readers: str, script: str = "child.py") -> None:
        self.readers, self._script = readers, script
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def ask(self, line: str) -> dict[str, Any]:
        """What became of the input ``READER SEED RECIPE`` or ``READER * NUMBER``."""
        if self._process is None:
            self._start()
        assert self._process is not None and self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")
        self._process.stdin.flush()
        answer = self._answer(WALL_SECONDS)
        if answer is not None:
            return answer
        reader, seed, recipe = line.split(" ", 2)
        if seed == "*" and self._script == "child.py":  # what a server draws depends on what it tried before
            seed, recipe = drawn(reader, int(recipe))
        return {
            "seed": seed,
            "recipe": recipe,
            "ended": "wrong",
            "told": self._end(),
            "seconds": 0.0,
            "size": 1,
            "grown": 0,
            "allowed": 1,
        }

    def _start(self) -> None:
        line = [sys.executable, "-X", "faulthandler", str(Path(__file__).with_name(self._script)), *self.readers]
        self._room = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)  # a process that is killed removes nothing
        self._process = subprocess.Popen(
            line,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **PLAIN, "TMPDIR": self._room.name},
        )
        if self._answer(READY_SECONDS) is None:
            raise RuntimeError(f"the sound files of {', '.join(self.readers)} are not read: {self._end()}")

    def _answer(self, seconds: float) -> dict[str, Any] | None:
        assert self._process is not None and self._process.stdout is not None
        with selectors.DefaultSelector() as waiting:
            waiting.register(self._process.stdout, selectors.EVENT_READ)
            if not waiting.select(seconds):
                return None
        line = self._process.stdout.readline()
        return json.loads(line) if line else None

    def _end(self) -> str:
        """End the process; why it ended, if it had."""
        process, self._process = self._process, None
        if process is None:
            return ""
        try:
            process.wait(0.5 if process.poll() is None else 0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            code = None
        else:
            code = process.returncode
        self._room.cleanup()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        if code is None:
            return f"no answer within {WALL_SECONDS:g} s"
        if code == -signal.SIGPROF:
            return f"more than {CPU_SECONDS:g} s of the processor"
        return f"the process ended: {signal.Signals(-code).name if code < 0 else code}"


def answers(lines: Iterable[str], *readers: str, script: str = "child.py") -> Iterator[dict[str, Any]]:
    """What became of every input of `lines`, in order."""
    with Child(*readers, script=script) as child:
        for line in lines:
            yield child.ask(line)
