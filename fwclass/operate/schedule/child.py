"""The run as a process of its own: what it takes or breaks is not the schedule's."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fwclass.operate.history import ORDER
from fwclass.operate.schedule.signals import Signals
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
                interrupted, told = now().steady, signals.count
                self._process.send_signal(signal.SIGINT)
            if interrupted is not None and (signals.count > told or now().steady - interrupted > grace):
                self._kill()
            meanwhile()
            signals.wait(slice_ if interrupted is None else min(slice_, 1.0))
        if code < 0:
            self._kill()  # workers that outlived it
        return code

    def _kill(self) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
