"""Executors that need no Dask: the plain loop, and one that starts another when there is something to make."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from itertools import chain
from types import TracebackType
from typing import TYPE_CHECKING

from fwclass.run.limit import warned_after
from fwclass.run.part import Outcome, Task, execute
from fwclass.store.run_location import RunLocation

if TYPE_CHECKING:
    from fwclass.run.runner import Executor


class Loop:
    """Executor without workers: every part in order, in this process. It gives the same bytes as any cluster."""

    address = ""

    def __init__(self, part_hours: float | None = None, say: Callable[[str], None] = print) -> None:
        """`say` is told of a part that takes longer than `part_hours` [h]; it goes on."""
        self._seconds, self._say = 3600.0 * part_hours if part_hours else None, say

    def run(self, location: RunLocation, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes in order; a task comes after every task that it needs."""
        for task in tasks:
            watch = warned_after(self._seconds, task.name, self._say) if self._seconds else nullcontext()
            with watch:
                outcome = execute(location, task)
            yield outcome


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

    def run(self, location: RunLocation, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes as the executor gives them."""
        coming = iter(tasks)
        for first in coming:
            if self._started is None:
                self._started = self._stack.enter_context(self._start())
            yield from self._started.run(location, chain([first], coming))
