"""A run under way: the store, the executor, what has been done and what has failed."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import InitVar, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from fwclass.errors import FwclassError, InputError, PartialError, StoreError, several
from fwclass.run.part import Name, Outcome, Task, already_done, emptied, key_now
from fwclass.run.progress import Display
from fwclass.run.tasks import Tasks
from fwclass.store.external_file import ExternalFile
from fwclass.store.failures import Failure
from fwclass.store.generations import Generation
from fwclass.store.receipts import Receipt
from fwclass.store.run_location import RunLocation, open_store
from fwclass.store.run_store import Store


class Executor(Protocol):
    """`Loop`, `Cluster`, or `WhenNeeded`, which starts one. Dask's performance report a `Cluster` alone can write."""

    address: str

    def run(self, location: RunLocation, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes as parts end; a task is taken from `tasks` when there is room for it."""
        ...


class Done(Mapping[Name, Receipt]):
    """Receipts of parts that are done, each read when it is asked for: a large survey's do not fit into memory."""

    def __init__(self, store: Store, names: Iterable[Name]) -> None:
        self._store, self._names = store, dict.fromkeys(names)

    def __getitem__(self, name: Name) -> Receipt:
        if name not in self._names:
            raise KeyError(name)
        receipt = self._store.receipt(*name)
        if receipt is None:
            raise StoreError(
                "the receipt of a part that was finished is gone",
                where=f"{self._store.where}: {'/'.join(name)}",
                do="run again; the part is made anew",
            )
        return receipt

    def __iter__(self) -> Iterator[Name]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@dataclass
class Tally:
    """What became of one stage's parts in this run."""

    parts: int = 0
    computed: int = 0
    skipped: int = 0
    failed: int = 0
    began: float = 0.0
    ended: float = 0.0


@dataclass
class Runner:
    """Walks batches of tasks; each batch may need parts of earlier ones.

    With `fail_fast` the first part that fails ends the walk by a `PartialError`; with `accept_libraries` parts made
    with other libraries are done; with `verify` the generation that is there is read before it is taken for what
    this run delivers; `lean`, a part whose files were removed to save room is done, and made anew before one that
    reads it is made: only where all that is read of parts is read by tasks. `delivering_stages` and
    `judging_stages`: those met so far whose parts are delivered, or only judge (`Task.check`). `external`: files from
    outside that the run goes by, once they are found. `store` remembers receipts; two runners of one run share it
    (`seen`). `held` raises `StoreError` when the run's lock is lost; it is asked before a failure is believed and
    before anything is delivered.
    """

    location: RunLocation
    executor: Executor
    display: Display
    outcomes: dict[Name, Outcome] = field(default_factory=dict)
    tallies: dict[str, Tally] = field(default_factory=dict)
    began: float = field(default_factory=time.perf_counter)
    fail_fast: bool = False
    accept_libraries: bool = False
    verify: bool = False
    lean: bool = False
    whole: bool = False
    delivering_stages: set[str] = field(default_factory=set)
    judging_stages: set[str] = field(default_factory=set)
    external: list[ExternalFile] = field(default_factory=list)
    held: Callable[[], None] = lambda: None
    seen: InitVar[Store | None] = None

    def __post_init__(self, seen: Store | None) -> None:
        self.store = seen or open_store(self.location, lists=True)
        self._under_way: dict[Name, Task] = {}
        self._emptied: dict[Name, Task] = {}
        self._refilled: set[Name] = set()
        self._refilling: set[str] = set()

    @property
    def root(self) -> Path:
        """The run directory; of a run on object storage that of its copies on this host."""
        return self.store.root

    def do(self, tasks: Sequence[Task]) -> Mapping[Name, Receipt]:
        """Make all parts of `tasks` (each after those it needs); return the receipts of those that are done.

        Parts whose key holds are skipped here, without a worker. Failures are kept in `outcomes`. Of lazy `tasks` no
        more are held than the executor has in hand.
        """
        tasks = Tasks.held(tasks)
        self.display.expect(tasks.stages)
        now = time.perf_counter()
        for stage in tasks.stages:
            self.tallies.setdefault(stage, Tally(began=now))
        names: list[Name] = []
        with closing(self.executor.run(self.location, self._to_make(tasks, names))) as ended:
            for outcome in ended:
                self.held()
                name = (outcome.stage, outcome.part)
                task = self._under_way.pop(name)
                self.store.forget(name)
                self._take(outcome)
                if outcome.status == "failed":
                    self._failed(task, outcome)
        self.store.look_up(names)
        return Done(self.store, (n for n in names if self.outcomes[n].ok))

    def _to_make(self, tasks: Iterable[Task], names: list[Name]) -> Iterator[Task]:
        """Those of `tasks` that have to be made; `names` gets all of them."""
        for task in tasks:
            if self.accept_libraries:
                task = replace(task, any_libraries=True)
            names.append(task.name)
            if task.place == "deliver":
                self.delivering_stages.add(task.stage)
            if task.check:
                self.judging_stages.add(task.stage)
            if self._is_blocked(task):
                continue
            if self._under_way.keys().isdisjoint(task.needs) and already_done(task, self.store):
                self._take(Outcome(*task.name, "skipped"))
            elif self.lean and self._under_way.keys().isdisjoint(task.needs) and emptied(task, self.store):
                self._emptied[task.name] = task
                self._take(Outcome(*task.name, "skipped"))
            else:
                yield from self._with_refills(task)

    def _with_refills(self, task: Task) -> Iterator[Task]:
        """What `task` reads of parts that were emptied, each after what it reads itself; then `task`."""
        for name in task.needs:
            if name in self._emptied:
                if name[0] not in self._refilling:
                    self.display.say(f"{name[0]:<16} made anew where it is read: its files were removed to save room")
                self._refilling.add(name[0])
                self._refilled.add(name)
                yield from self._with_refills(self._emptied.pop(name))
        if not self._is_blocked(task):
            self._under_way[task.name] = task
            yield task

    def _is_blocked(self, task: Task) -> bool:
        """A part that `task` needs is known not to be done; this is its outcome then."""
        bad = [self.outcomes[n] for n in task.needs if n in self.outcomes and not self.outcomes[n].ok]
        if bad:
            self._take(Outcome(*task.name, "blocked", message=f"{bad[0].stage}/{bad[0].part} {bad[0].status}"))
        return bool(bad)

    def _take(self, outcome: Outcome) -> None:
        tally, name = self.tallies[outcome.stage], (outcome.stage, outcome.part)
        again = name in self._refilled  # it was told, as skipped
        self._refilled.discard(name)
        self.outcomes[name] = outcome
        tally.parts += not again
        tally.skipped -= again
        tally.computed += outcome.status == "computed"
        tally.skipped += outcome.status == "skipped"
        tally.failed += outcome.status in ("failed", "blocked")
        tally.ended = time.perf_counter()
        if again and outcome.ok:
            return
        if again:
            self.display.expect({outcome.stage: 1})
        self.display.ended(outcome)

    def _failed(self, task: Task, outcome: Outcome) -> None:
        """Keep what the part said for `fwclass status`, and stop here if that was asked for."""
        self.held()
        key = key_now(task, self.store) or ""
        self.store.failures.record(Failure(task.stage, task.part, key, outcome.message))
        if self.fail_fast:
            raise PartialError(
                "stopped at the first part that failed",
                where=f"{task.stage}/{task.part} in {self.store.where}",
                do="mend the cause and run the same again; what is done is kept (--keep-going makes all other parts)",
            )

    def goes_without(self, task: Task) -> bool:
        """The plan can be followed though `task`, which it stands on, is not done: never where things are made."""
        return False

    def beside(self) -> Runner:
        """A runner on the same run whose parts do not count in the report: what is asked for once more, or aside."""
        return Runner(
            self.location,
            self.executor,
            self.display,
            fail_fast=self.fail_fast,
            accept_libraries=self.accept_libraries,
            held=self.held,
            seen=self.store,
        )

    def carry_out(self, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Do what is no part, as to write the report; a walk that only looks leaves it out."""
        return work()

    def finish(self, whole: bool) -> None:
        """All parts of the plan have been walked. `whole`: the run was not restricted to some tiles; then parts that it
        does not have are removed.

        It is whole without failures, those of parts that only judge aside: what is delivered is the same with them.
        """
        self.whole = whole and all(o.ok or o.stage in self.judging_stages for o in self.outcomes.values())
        if self.whole:
            self.retire()

    @property
    def pending(self) -> Path:
        """Where reports are written, to appear together with all else that is delivered."""
        return self.store.generations.pending

    def publish(self, keep: int) -> Generation:
        """Deliver what this run made or found valid, as one generation; of earlier whole ones the last `keep` stay."""
        self.held()
        files: dict[str, tuple[Path, str]] = {}
        for stage, part in self.outcomes:
            if stage in self.delivering_stages and self.is_done(stage, part):
                receipt = self.store.receipt(stage, part)
                if receipt is None:
                    raise StoreError(
                        "a part that is to be delivered is gone",
                        where=f"{stage}/{part} in {self.store.where}",
                        do="run again; the missing parts are made",
                    )
                base = self.store.base(receipt)
                for name, facts in receipt.outputs.items():
                    file = base / name, str(facts["digest"])
                    if files.setdefault(name, file)[1] != file[1]:
                        raise StoreError(
                            "two parts deliver files of one name, and one would be lost",
                            where=f"{name}: of {stage}/{part}",
                            do="let one of the stages give its files another directory, and run again",
                        )
        return self.store.generations.publish(files, self.whole, keep, self.verify, self.display.say)

    def retire(self) -> None:
        """Remove parts of earlier runs that this run's plan does not have, with what they delivered."""
        parts: dict[str, list[str]] = {stage: [] for stage in self.tallies}
        for stage, part in self.outcomes:
            parts[stage].append(part)
        for stage, names in parts.items():
            self.store.forget_others(stage, names)

    @property
    def failures(self) -> list[Outcome]:
        """Parts that failed; if none did and yet some were blocked, those."""
        broken = [o for o in self.outcomes.values() if not o.ok]
        return [o for o in broken if o.status == "failed"] or broken

    def is_done(self, stage: str, part: str) -> bool:
        """The part is done, by this run or an earlier one, from the inputs and parameters of this run."""
        outcome = self.outcomes.get((stage, part))
        return outcome is not None and outcome.ok


class Lacking(InputError):
    """The part `name`, without which nothing can follow, is not done."""

    def __init__(self, name: Name, *words: Any, **more: Any) -> None:
        super().__init__(*words, **more)
        self.name = name


def require_all(runner: Runner, tasks: Sequence[Task]) -> Mapping[Name, Receipt]:
    """As `Runner.do` for parts without which nothing can follow: the first failure ends the run."""
    receipts = runner.do(tasks)
    for task in tasks:
        outcome = runner.outcomes[task.name]
        if not outcome.ok and not runner.goes_without(task):
            raise Lacking(
                task.name,
                f"{task.stage} of part {task.part} failed",
                where=runner.store.where,
                got=_first_line(outcome.message),
                do="see the whole message above, mend the cause and run the same again; what is done is kept",
            )
    return receipts


def _first_line(message: str) -> str:
    """The display has shown the rest."""
    return message.splitlines()[0] if message else ""


def stop_if_nothing(runner: Runner, receipts: Mapping[Name, Receipt]) -> None:
    """End the run with the first failure's own words if nothing at all came of it."""
    if not receipts and runner.failures:
        first = runner.failures[0]
        raise FwclassError(
            f"nothing could be made: {several(len(runner.failures), 'part')} failed, first {first.stage}/{first.part}",
            where=runner.store.where,
            got=_first_line(first.message),
            do="mend the cause and run the same command again; what is done is kept",
        )


def ancestors(tasks: Sequence[Task], wanted: Iterable[Name]) -> list[Task]:
    """The tasks named `wanted` and all of `tasks` that they need, in order."""
    by_name = {t.name: t for t in tasks}
    keep: set[Name] = set()
    todo = [n for n in wanted if n in by_name]
    while todo:
        name = todo.pop()
        if name not in keep:
            keep.add(name)
            todo += [n for n in by_name[name].needs if n in by_name]
    return [t for t in tasks if t.name in keep]
