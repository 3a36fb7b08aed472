"""Waiting that ends at once when a signal comes or a child process ends."""

from __future__ import annotations

import contextlib
import os
import select
import signal
from types import FrameType, TracebackType
from typing import Any

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What a terminal, a service manager and a closing terminal send."""


class Signals:
    """While this is entered, signals to stop are noted instead of obeyed, and end `wait`; so does a child's end.

    `first`: the first of them that came, None for none; `count`: how many came.
    """

    def __init__(self) -> None:
        self.first: signal.Signals | None = None
        self.count = 0
        self._before: dict[signal.Signals, Any] = {}
        self._read = self._write = self._wakeup = -1

    def __enter__(self) -> Signals:
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(self._write, False)
        self._wakeup = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        for number in (*STOPPING, signal.SIGCHLD):
            if number is signal.SIGHUP and signal.getsignal(number) is signal.SIG_IGN:
                continue  # nohup
            self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup)
        write, self._write = self._write, -1
        os.close(self._read)
        os.close(write)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if number in STOPPING:
            self.first = self.first or signal.Signals(number)
            self.count += 1

    def wake(self) -> None:
        """End `wait`, from another thread."""
        with contextlib.suppress(OSError):  # no one waits any more
            os.write(self._write, b"\0")

    def wait(self, seconds: float) -> None:
        """Until a signal, a child's end or `wake`, or `seconds` at most."""
        ready, _, _ = select.select([self._read], [], [], max(0.0, seconds))
        while ready:
            try:
                if len(os.read(self._read, 4096)) < 4096:
                    break
            except BlockingIOError:
                break
