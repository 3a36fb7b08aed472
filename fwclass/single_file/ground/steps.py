"""What a ground command is doing, on standard error: a live line for a person, a plain line now and then elsewhere."""

from __future__ import annotations

import threading
import time
from types import TracebackType

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from fwclass import compiling

EVERY = 10.0
"""Seconds between two lines where no person looks on; a command that is done sooner says nothing."""


class StepDisplay:
    """Shows the step that `tell` named last, with the seconds since the start."""

    def __init__(self, console: Console | None = None, every: float = EVERY) -> None:
        self.console = console or Console(stderr=True, highlight=False, soft_wrap=True)
        self._text, self._every, self._began = "reading", every, time.monotonic()
        self._compiles = compiling.notify(self._compiling)
        self._waits = self._said = False
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

    def __enter__(self) -> StepDisplay:
        self._compiles.__enter__()
        if self.console.is_terminal:
            self._bar.start()
        else:
            self._lines.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._compiles.__exit__(None, None, None)
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
        return f"{self._text} ({compiling.ONCE})" if self._waits else self._text

    def _compiling(self, begins: bool) -> None:
        self._waits = begins
        self._show()
        if begins and not self._said and not self.console.is_terminal:
            self._said = True
            self.say(self.line)

    def _show(self) -> None:
        self._bar.update(self._row, description=self.line)

    def _plain(self) -> None:
        while not self._over.wait(self._every):
            self.say(f"{time.monotonic() - self._began:6.0f} s  {self.line}")
