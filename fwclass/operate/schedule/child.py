"""The run as a process of its own, whose ends and signals are not the schedule's."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from types import FrameType, TracebackType
from typing import Any

from fwclass.operate.history import ORDER
from fwclass.operate.schedule.ticks import now


def without(name: str | None, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """`environment` (this process's) less the variable `name`, which holds a secret."""
    return {k: v for k, v in environment.items() if k not in (name, ORDER)}


class Child:
    """``fwclass`` with `words`, by this interpreter, in a process group of its own: Ctrl-C reaches the schedule alone.

    Standard output and error are the schedule's. `order`: what goes into its line of the history.
    """

    def __init__(self, words: Sequence[str], order: Mapping[str, Any], secret: str | None) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - our own command
            [sys.executable, "-P", "-m", "fwclass", *words],
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            env={**without(secret), ORDER: json.dumps(order)},
        )
        self.pid = self._process.pid

    def wait(self, signals: Signals, grace: float, slice_: float, meanwhile: Callable[[], None]) -> int:
        """Its exit code, negative for a signal. `meanwhile` is called every `slice_` seconds.

        When the schedule is told to stop, the run is interrupted as by Ctrl-C; after `grace` seconds, or when the
        schedule is told once more, it is killed.
        """
        interrupted = None
        while (code := self._process.poll()) is None:
            if signals.first is not None and interrupted is None:
                interrupted, signalled = now().steady, signals.count
                self._process.send_signal(signal.SIGINT)
            if interrupted is not None and (signals.count > signalled or now().steady - interrupted > grace):
                self._kill()
            meanwhile()
            signals.wait(slice_ if interrupted is None else min(slice_, 1.0))
        if code < 0:
            self._kill()  # workers that outlived it
        return code

    def _kill(self) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)


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
