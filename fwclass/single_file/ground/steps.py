"""What a ground command is doing, on standard error: a live line for a person, a plain line now and then elsewhere."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

from numba.core import event
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

EVERY = 10.0
"""Seconds between two lines where no person looks on; a command that is done sooner says nothing."""

COMPILE = "numba:compile"
ONCE = "compiling for this machine, once"

Tell = Callable[[str], None]
"""Told what begins now."""


def quiet(text: str) -> None:
    """A `Tell` that says nothing."""


class CompileClock(event.Listener):  # type: ignore[misc]
    """Seconds that kernels took to compile inside a ``with`` block; a kernel that is read from the cache takes none.

    `changed` is called when compiling begins and when it ends.
    """

    def __init__(self, changed: Callable[[], None] = lambda: None) -> None:
        self._changed = changed
        self._depth, self._since, self._seconds = 0, 0.0, 0.0

    def __enter__(self) -> CompileClock:
        event.register(COMPILE, self)
        return self

    def __exit__(self, *fault: object) -> None:
        event.unregister(COMPILE, self)

    @property
    def runs(self) -> bool:
        """A kernel is being compiled."""
        return self._depth > 0

    @property
    def seconds(self) -> float:
        return self._seconds

    def on_start(self, told: Any) -> None:
        """A kernel, perhaps on behalf of another, is compiled."""
        self._depth += 1
        if self._depth == 1:
            self._since = time.perf_counter()
            self._changed()

    def on_end(self, told: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._seconds += time.perf_counter() - self._since
            self._changed()


class Steps:
    """Shows the step that `tell` named last, with the seconds since the start."""

    def __init__(self, console: Console | None = None, every: float = EVERY) -> None:
        self.console = console or Console(stderr=True, highlight=False, soft_wrap=True)
        self._text, self._every, self._began = "reading", every, time.monotonic()
        self._clock = CompileClock(self._show)
        self._over = threading.Event()
        self._lines = threading.Thread(target=self._plain, daemon=True)
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            TimeElapsedColumn(),
            console=self.console,
            transient=True,
        )
        self._row = self._bar.add_task(self._text)

    def __enter__(self) -> Steps:
        self._clock.__enter__()
        if self.console.is_terminal:
            self._bar.start()
        else:
            self._lines.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._clock.__exit__()
        if self.console.is_terminal:
            self._bar.stop()
        self._over.set()
        if self._lines.is_alive():
            self._lines.join()

    def tell(self, text: str) -> None:
        """This begins now."""
        self._text = text
        self._show()

    def say(self, text: str) -> None:
        """A line that stays."""
        self.console.print(text, markup=False)

    @property
    def line(self) -> str:
        """What is shown."""
        return f"{self._text} ({ONCE})" if self._clock.runs else self._text

    def _show(self) -> None:
        self._bar.update(self._row, description=self.line)

    def _plain(self) -> None:
        while not self._over.wait(self._every):
            self.say(f"{time.monotonic() - self._began:6.0f} s  {self.line}")
