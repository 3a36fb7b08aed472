"""The last command of a run, given once more from the viewer where that was allowed."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import subprocess
import sys
from collections import deque
from threading import Lock, Thread
from typing import Any

from fwclass.errors import FwclassError, InputError, visible
from fwclass.operate.history import word_of
from fwclass.operate.request import Request
from fwclass.redact import redacted, redacted_words
from fwclass.store.run_location import RunLocation
from fwclass.store.run_store import Store

KEPT = 200
"""Lines of the run that are kept, and letters of each that are."""

GRACE = 20.0
"""s, that a run has to end after it was interrupted because the viewer ends."""


class LastCommand:
    """See `fwclass.view.scene.Again`. What is started is what the run itself kept; nothing of a page gets into it."""

    def __init__(self, root: RunLocation, allowed: bool) -> None:
        self._root, self._allowed = root, allowed
        self._lines: deque[str] = deque(maxlen=KEPT)
        self._child: subprocess.Popen[str] | None = None
        self._stopped, self._lock = False, Lock()

    def words(self) -> list[str]:
        """Of the command, without the program; `FwclassError` where nothing tells it."""
        return Request.kept(Store(self._root, read_only=True)).words()

    def state(self) -> dict[str, Any]:
        try:
            command, why = shlex.join(["fwclass", *redacted_words(self.words())]), ""
        except FwclassError as fault:
            command, why = "", str(fault)
        code = self._child.poll() if self._child is not None else None
        return {
            "allowed": self._allowed,
            "command": command,
            "why": why,
            "running": self._child is not None and code is None,
            "code": code,
            "word": "" if code is None else word_of(code),
            "lines": list(self._lines),
        }

    def start(self) -> dict[str, Any]:
        if not self._allowed:
            raise InputError(
                "this page may start nothing",
                where="fwclass view",
                expected="--allow-run, given when the viewer was started",
                got="none",
                do="type the command yourself",
            )
        with self._lock:
            if self._child is not None and self._child.poll() is None:
                raise InputError("the run is under way already", where=self._root, do="wait for it, or stop it")
            words = self.words()
            self._lines.clear()
            self._stopped = False
            self._child = subprocess.Popen(  # noqa: S603 - our own command, words of the run's own file
                [sys.executable, "-P", "-m", "fwclass", *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                text=True,
                encoding="utf-8",
                errors="replace",
            )
            Thread(target=self._hear, args=(self._child,), daemon=True).start()
        return self.state()

    def stop(self) -> dict[str, Any]:
        with self._lock:
            child = self._child
            if child is not None and child.poll() is None:
                if self._stopped:
                    _kill(child)
                else:
                    child.send_signal(signal.SIGTERM)  # a viewer in the background ignores SIGINT, and so would it
                self._stopped = True
        return self.state()

    def close(self) -> None:
        """Interrupt what still runs, and wait for it; what does not end is killed."""
        self.stop()
        if self._child is not None:
            try:
                self._child.wait(GRACE)
            except subprocess.TimeoutExpired:
                _kill(self._child)
                self._child.wait()

    def _hear(self, child: subprocess.Popen[str]) -> None:
        """Keep its lines; one without end is cut."""
        if child.stdout is not None:
            with child.stdout as stream:
                while line := stream.readline(64 * KEPT):
                    self._lines.append(visible(redacted(line.rstrip("\n")))[:KEPT])


def _kill(child: subprocess.Popen[str]) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)
