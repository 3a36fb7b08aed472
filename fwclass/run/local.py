"""The plain loop: every part in order, in this process. It gives the same bytes as any cluster."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from pathlib import Path

from fwclass.run.part import Outcome, Task, execute


class Loop:
    """Executor without workers."""

    address = ""

    def run(self, root: Path, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes in order; a task comes after every task that it needs."""
        for task in tasks:
            yield execute(root, task)
