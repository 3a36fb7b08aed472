"""Executors that need no Dask: the plain loop, and one that starts another when there is something to make."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager, ExitStack
from itertools import chain
from types import TracebackType
from typing import TYPE_CHECKING

from fwclass.run.part import Outcome, Task, execute
from fwclass.store.home import Home

if TYPE_CHECKING:
    from fwclass.run.road import Executor


class Loop:
    """Executor without workers: every part in order, in this process. It gives the same bytes as any cluster."""

    address = ""

    def run(self, home: Home, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes in order; a task comes after every task that it needs."""
        for task in tasks:
            yield execute(home, task)


class WhenNeeded:
    """Executor that is started by `start` for the first part, and never where nothing has to be made."""

    address = ""

    def __init__(self, start: Callable[[], AbstractContextManager[Executor]]) -> None:
        self._start, self._stack = start, ExitStack()
        self._started: Executor | None = None

    def __enter__(self) -> WhenNeeded:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, fault, trace)

    def run(self, home: Home, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes as the executor gives them."""
        coming = iter(tasks)
        for first in coming:
            if self._started is None:
                self._started = self._stack.enter_context(self._start())
            yield from self._started.run(home, chain([first], coming))
