"""The parts that a scheduler has in hand, and what becomes of those whose worker was lost."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, Protocol

from fwclass.run.logs import log_attempt
from fwclass.run.lost import Losses
from fwclass.run.part import Name, Outcome, Task
from fwclass.store.run_location import RunLocation


class Scheduler(Protocol):
    """What hands parts to workers, and knows what became of a worker that was lost."""

    @property
    def window(self) -> int:
        """How many parts the scheduler may know at a time."""
        ...

    def submit(self, location: RunLocation, tasks: Sequence[Task], upstream: list[Any], alone: bool) -> Any:
        """The future of parts that are handed over together, to run one after the other, after those of `upstream`
        (futures, or outcomes), and with no other if `alone`."""
        ...

    def cancel(self, futures: list[Any]) -> None:
        """Give up parts that have not begun."""
        ...

    def outcomes(self, future: Any) -> Sequence[Outcome]:
        """The outcomes of a future that has ended well, in the order of its parts."""
        ...

    def gone(self) -> Exception:
        """What to raise when the scheduler itself is lost."""
        ...

    def turned_away(self, fault: Exception) -> bool:
        """The worker computes by other code than this run, and never began the part."""
        ...

    def killed(self, fault: Exception, key: str) -> str | None:
        """The worker lost with the task `key`; "" where with one that this one needs, None for another fault."""
        ...

    def cause(self, worker: str) -> str:
        """Why a worker was lost, in words."""
        ...


class InFlight:
    """The parts that the scheduler knows; those that are to be tried alone, and what waits for these.

    `completed` gives futures as they end (Dask's `as_completed`); more are added to it.
    """

    def __init__(self, scheduler: Scheduler, location: RunLocation, losses: Losses, completed: Any) -> None:
        self._scheduler, self._location, self._losses, self._completed = scheduler, location, losses, completed
        self._tasks: dict[Name, Task] = {}
        self._order: dict[Name, int] = {}
        self._numbers = itertools.count()
        self._futures: dict[Name, Any] = {}
        self._names: dict[str, tuple[Name, ...]] = {}
        self._suspects: dict[Name, Task] = {}
        self._waiting: dict[Name, Task] = {}
        self._failed: dict[Name, Outcome] = {}

    def __bool__(self) -> bool:
        return bool(self._futures or self._suspects or self._waiting)

    @property
    def full(self) -> bool:
        """No further part may be taken: the window is full, or everything is to end first."""
        return bool(self._suspects or self._waiting) or len(self._futures) >= self._scheduler.window

    def take(self, tasks: Sequence[Task], alone: bool = False) -> None:
        """Hand `tasks`, none of which needs another, to the scheduler together; those wait that need a suspect."""
        for task in tasks:
            if task.name not in self._order:
                self._order[task.name] = next(self._numbers)
            if any(n in self._suspects or n in self._waiting for n in task.needs):
                self._waiting[task.name] = task
        ready = [task for task in tasks if task.name not in self._waiting]
        if not ready:
            return
        needs = dict.fromkeys(n for task in ready for n in task.needs)
        upstream: dict[Any, Any] = {}
        for name in needs:
            if name in self._failed:
                upstream[name] = [self._failed[name]]
            elif (future := self._futures.get(name)) is not None:
                upstream[future.key] = future
        future = self._scheduler.submit(self._location, ready, list(upstream.values()), alone)
        self._names[future.key] = tuple(task.name for task in ready)
        for task in ready:
            self._futures[task.name], self._tasks[task.name] = future, task
        self._completed.add(future)

    def drop(self) -> None:
        """Give up all parts that have not begun."""
        self._scheduler.cancel([f for f in self._futures.values() if not f.done()])

    def ended(self) -> Iterator[Outcome]:
        """Wait until one more part has ended in some way; its outcome, if that is known now."""
        if not self._futures:
            yield from self._alone()
            return
        future = next(self._completed)
        if future.key not in self._names:
            return  # it was handed over again meanwhile
        if future.status not in ("error", "cancelled"):
            yield from self._take_outcomes(future, alone=False)
            return
        keys = {f.key for f in self._futures.values() if f.key == future.key or f.status in ("error", "cancelled")}
        for key in [key for key in self._names if key in keys]:
            names = self._names[key]
            for name in names:
                yield from self._take_loss(name, together=len(names) > 1)

    def _alone(self) -> Iterator[Outcome]:
        """Everything else has ended: try the first suspect, and hand over what waited when there is none left."""
        if not self._suspects:
            waited, self._waiting = self._waiting, {}
            for task in sorted(waited.values(), key=self._place):
                self.take([task])
            return
        name, task = min(self._suspects.items(), key=lambda one: self._place(one[1]))
        del self._suspects[name]
        suspects, self._suspects = self._suspects, {}  # a suspect may need an earlier one, none of the others
        self.take([task], alone=True)
        self._suspects = suspects
        while name in self._futures:
            if next(self._completed).key != self._futures[name].key:
                continue  # one that was handed over again before
            if self._futures[name].status not in ("error", "cancelled"):
                yield from self._take_outcomes(self._futures[name], alone=True)
            else:
                yield from self._take_loss(name, alone=True)

    def _place(self, task: Task) -> int:
        """Its place in the plan, which has every part after those that it needs."""
        return self._order[task.name]

    def _take_outcomes(self, future: Any, alone: bool) -> Iterator[Outcome]:
        """Parts have outcomes; where those were lost with their worker, the parts are handed over again and found
        done."""
        names = self._names[future.key]
        try:
            outcomes = self._scheduler.outcomes(future)
        except Exception as fault:
            if future.status == "cancelled":
                raise self._scheduler.gone() from fault
            for task in [self._forget(name) for name in names]:
                self.take([task], alone)
            return
        for name, outcome in zip(names, outcomes, strict=True):
            self._forget(name)
            del self._order[name]
            yield self._losses.with_causes(outcome)

    def _forget(self, name: Name) -> Task:
        future = self._futures.pop(name)
        self._names.pop(future.key, None)
        return self._tasks.pop(name)

    def _take_loss(self, name: Name, alone: bool = False, together: bool = False) -> Iterator[Outcome]:
        """A part's future has no outcome: its worker was lost, or that of a part that it needs. One of several that
        were handed over `together` comes back by itself."""
        future = self._futures[name]
        if future.status == "cancelled":
            raise self._scheduler.gone()
        fault, task = future.exception(), self._forget(name)
        if self._scheduler.turned_away(fault):
            self.take([task], alone)
            return
        worker = self._scheduler.killed(fault, future.key)
        if worker is None:
            message = f"no worker could begin it: {type(fault).__name__}: {fault}"
            yield self._give_up(name, message)
        elif not worker:  # that of a part that it needs
            self.take([task])
        else:
            verdict = self._losses.lost(name, self._scheduler.cause(worker), alone, together)
            if verdict == "again":
                self.take([task], alone)
            elif verdict == "alone":
                self._suspects[name] = task
            else:
                yield self._give_up(name, self._losses.message(name))

    def _give_up(self, name: Name, message: str) -> Outcome:
        del self._order[name]
        outcome = self._losses.with_causes(Outcome(*name, "failed", message=message))
        log_attempt(self._location, *name, {"status": "failed", "message": message})
        self._failed[name] = outcome
        return outcome
