"""Parts that are handed to a worker together: what Dask takes for each task, some 6 ms of a processor, is more than a
short part itself."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from fwclass.run.part import Name, Outcome, Task

SECONDS = 0.2
"""Of a processor that the parts of a bundle take together: thirty times what Dask does, and nothing against a run's
end."""

WAITING = 5
"""Times as long a bundle may take by the clock: on a busy machine, or with a store far away, short parts take long."""

EACH_WORKER = 0.02
"""Seconds more a worker above ten: one scheduler hands out no more than some fifty bundles a second."""

MOST = 64
"""Parts of a bundle, whatever they take: they come back together."""

ENOUGH = 3
"""Parts of a stage that tell what one takes."""

UNKNOWN = 8
"""Parts for each worker that are handed over of a stage before it is known what one takes; then that is waited for."""


RECENT = 8
"""Parts that what one takes is the mean of, about: the first ones load and compile."""


@dataclass
class _Took:
    given: int = 0
    ended: int = 0
    each: float = 0.0

    @property
    def known(self) -> bool:
        return self.ended >= ENOUGH

    def note(self, seconds: float) -> None:
        self.ended += 1
        self.each += (seconds - self.each) / min(self.ended, RECENT)


@dataclass
class Bundles:
    """Bundles of parts for `workers`, by what parts of their stage took so far; a worker's share of the `window` of
    parts is never one bundle alone."""

    workers: int
    window: int
    _took: defaultdict[str, _Took] = field(default_factory=lambda: defaultdict(_Took))
    _last: str = ""

    def of(self, tasks: Iterable[Task]) -> Iterator[list[Task]]:
        """`tasks` in order, in bundles of parts of one stage, none of which needs another of its own bundle."""
        limit, most = max(SECONDS, EACH_WORKER * self.workers), min(MOST, self.window // (4 * self.workers))
        bundle: list[Task] = []
        names: set[Name] = set()
        total = 0.0
        for task in tasks:
            seconds = self._expected(task)
            if bundle and (
                total + seconds > limit or task.stage != bundle[0].stage or not names.isdisjoint(task.needs)
            ):
                yield self._given(bundle)
                bundle, names, total = [], set(), 0.0
            bundle.append(task)
            names.add(task.name)
            total += seconds
            if len(bundle) >= most or total >= limit:  # no further task need be made to know it
                yield self._given(bundle)
                bundle, names, total = [], set(), 0.0
        if bundle:
            yield self._given(bundle)

    def _given(self, bundle: list[Task]) -> list[Task]:
        self._last = bundle[0].stage
        self._took[self._last].given += len(bundle)
        return bundle

    @property
    def waits(self) -> bool:
        """So many parts of the last stage are under way that some should end first, and tell what they take."""
        took = self._took[self._last]
        return not took.known and took.given - took.ended >= UNKNOWN * self.workers

    def note(self, outcome: Outcome) -> None:
        """A part has ended."""
        took = self._took[outcome.stage]
        if outcome.status in ("computed", "failed"):
            took.note(max(outcome.processor, outcome.seconds / WAITING))
        else:  # it took nothing, and tells nothing of those that do
            took.given -= 1

    def _expected(self, task: Task) -> float:
        """Seconds of a processor that the part will take, or those by the clock through `WAITING`, as others of its
        stage, or else as those that it needs; infinite where nothing is known."""
        own = self._took[task.stage]
        if own.known:
            return own.each
        needed = (self._took[stage] for stage in {stage for stage, _ in task.needs})
        return max((took.each for took in needed if took.known), default=math.inf)
