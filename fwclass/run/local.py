"""The plain loop: every part in order, in this process. It gives the same bytes as any cluster."""

from __future__ import annotations

from collections.abc import Generator, Iterable

from fwclass.run.part import Outcome, Task, execute
from fwclass.store.home import Home


class Loop:
    """Executor without workers."""

    address = ""

    def run(self, home: Home, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes in order; a task comes after every task that it needs."""
        for task in tasks:
            yield execute(home, task)
