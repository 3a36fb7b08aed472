"""The plain loop: every part in order, in this process. It gives the same bytes as any cluster."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path

from fwclass.run.part import Name, Outcome, Task, execute


class Loop:
    """Executor without workers."""

    address = ""

    def run(self, root: Path, tasks: Sequence[Task]) -> Generator[Outcome]:
        """Outcomes in order; a task comes after every task that it needs."""
        outcomes: dict[Name, Outcome] = {}
        for task in tasks:
            upstream = [outcomes[n] for n in task.needs if n in outcomes]
            outcomes[task.name] = execute(root, task, upstream)
            yield outcomes[task.name]
