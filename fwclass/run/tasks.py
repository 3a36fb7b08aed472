"""Tasks that are made when they are asked for: a plan of millions of parts need not be held."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, overload

from fwclass.run.part import Task

Part = TypeVar("Part")


@dataclass(frozen=True)
class _Batch:
    """One task for each of `parts`; `stages` counts them."""

    parts: Sequence[Any]
    make: Callable[[Any], Task]
    stages: Counter[str]


class Tasks(Sequence[Task]):
    """Tasks in order; each may need only earlier ones. Going through them again makes them again."""

    def __init__(self, batches: Iterable[_Batch] = ()) -> None:
        self._batches = tuple(batches)
        self._length = sum(len(b.parts) for b in self._batches)

    @classmethod
    def of(cls, stage: str, parts: Sequence[Part], make: Callable[[Part], Task]) -> Tasks:
        """A task of `stage` for each of `parts`."""
        return cls([_Batch(parts, make, Counter({stage: len(parts)}))] if len(parts) else ())

    @classmethod
    def held(cls, tasks: Iterable[Task]) -> Tasks:
        """Tasks that are there already."""
        if isinstance(tasks, Tasks):
            return tasks
        some = tuple(tasks)
        return cls([_Batch(some, _itself, Counter(t.stage for t in some))] if some else ())

    @classmethod
    def joined(cls, several: Iterable[Tasks]) -> Tasks:
        """The tasks of `several`, in order; adding thousands one by one would copy the first ones each time."""
        return cls(batch for tasks in several for batch in tasks._batches)

    @property
    def stages(self) -> Counter[str]:
        """How many tasks every stage has, in their order."""
        total: Counter[str] = Counter()
        for batch in self._batches:
            total.update(batch.stages)
        return total

    def __add__(self, others: Iterable[Task]) -> Tasks:
        return Tasks((*self._batches, *Tasks.held(others)._batches))

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[Task]:
        for batch in self._batches:
            yield from map(batch.make, batch.parts)

    @overload
    def __getitem__(self, at: int) -> Task: ...
    @overload
    def __getitem__(self, at: slice) -> Tasks: ...
    def __getitem__(self, at: int | slice) -> Task | Tasks:
        if isinstance(at, slice):
            return Tasks.held([self[k] for k in range(*at.indices(len(self)))])
        index = at + len(self) if at < 0 else at
        for batch in self._batches:
            if 0 <= index < len(batch.parts):
                return batch.make(batch.parts[index])
            index -= len(batch.parts)
        raise IndexError(at)


def _itself(task: Task) -> Task:
    return task
