"""A walk along the stages that makes nothing: which parts a run would have, and how each of them stands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from fwclass.errors import ConfigError, FwclassError, InputError
from fwclass.grid import Box, TileGrid
from fwclass.operate.status.why import Reason, new_files, reasons, same_reason, waiting
from fwclass.run.local import Loop
from fwclass.run.part import Name, Outcome, Task, emptied, holds, input_digests
from fwclass.run.progress import Display
from fwclass.run.runner import Done, Lacking, Runner
from fwclass.store.atomic import digest_of
from fwclass.store.external_file import ExternalFile
from fwclass.store.failures import Failure
from fwclass.store.generations import Generation
from fwclass.store.receipts import Receipt, content_key
from fwclass.store.run_location import RunLocation, held_by, open_store
from fwclass.store.run_store import Store
from fwclass.survey.bounds import header_box

Standing = Literal["done", "stale", "missing", "running", "failed"]
STANDINGS: tuple[Standing, ...] = ("done", "stale", "missing", "running", "failed")


@dataclass(frozen=True)
class PartState:
    """How one part stands: `reasons` say why it is not done, `message` what it said when it failed."""

    stage: str
    part: str
    standing: Standing
    reasons: tuple[Reason, ...] = ()
    message: str = ""

    @property
    def waits(self) -> bool:
        """It is not done only because what it needs is not: it may hold once that is made."""
        return bool(self.reasons) and all(r.waits for r in self.reasons)


CHOOSES = "select-"
"""Stages that features are chosen by: what they will say when they are made anew is not what they say now."""


class Silent(Display):
    """No progress: nothing is done."""

    def say(self, text: str) -> None:
        pass

    def expect(self, stages: Mapping[str, int]) -> None:
        pass

    def ended(self, outcome: Outcome) -> None:
        pass


class StatusWalk(Runner):
    """Takes a part's receipt, stale or not, for what a run will have made: so the parts that follow are known.

    Where a run would choose by a part that is not done, it ends.
    """

    def __init__(self, location: RunLocation, accept_libraries: bool = False) -> None:
        store = open_store(location, read_only=True, lists=True)
        super().__init__(location, Loop(), Silent(), accept_libraries=accept_libraries, seen=store)
        self.states: dict[Name, PartState] = {}
        self.tasks: dict[Name, Task] = {}
        self._waits: dict[Name, str] = {}  # what is not done, with its standing
        self.libraries: Counter[str] = Counter()  # receipts by their `libraries`
        self.absent: dict[str, Box] = {}  # files that nothing was made of, by name
        busy = held_by(location) is not None
        self._failures: dict[Name, tuple[Failure, float]] = self.store.failures.all()
        self._begun: dict[Name, float] = self.store.under_way() if busy else {}

    def do(self, tasks: Sequence[Task]) -> Mapping[Name, Receipt]:
        receipts = []
        for task in tasks:
            first = task.name not in self.tasks
            self.tasks[task.name] = task
            self.states[task.name] = state = self._state(task)
            if state.standing == "done":
                self._waits.pop(task.name, None)
            else:
                self._waits[task.name] = state.standing
            receipt = self.store.receipt(*task.name)
            if receipt is not None and first:
                self.libraries[receipt.libraries] += 1
            known = receipt is not None and (state.standing == "done" or not task.stage.startswith(CHOOSES))
            if known:
                receipts.append(task.name)
            self.outcomes[task.name] = Outcome(*task.name, "skipped" if known else "blocked")
        return Done(self.store, receipts)

    def goes_without(self, task: Task) -> bool:
        """A source that came after the others: the tiles that it says it lies over are told, the rest is as it was."""
        if task.stage != "index" or not any(n[0] == "index" and o.ok for n, o in self.outcomes.items()):
            return False
        file = task.external[0]
        box = header_box(file.path) if file.path is not None else None
        if box is None:
            return False
        self.absent[file.name] = box
        return True

    def beside(self) -> StatusWalk:
        other = copy(self)
        other.outcomes, other.tallies = {}, {}
        return other

    @property
    def failures(self) -> list[Outcome]:
        """None: the walk goes on for as long as the parts that follow are known."""
        return []

    def carry_out(self, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        return {}

    def finish(self, whole: bool) -> None:
        pass

    def _state(self, task: Task) -> PartState:
        task = replace(task, any_libraries=self.accept_libraries)
        late = {n: self._waits[n] for n in task.needs if n in self._waits}
        inputs = None if late else input_digests(task, self.store)
        key = "" if inputs is None else content_key(task.stage, task.version, task.params, inputs)
        come = self._come(task)
        if key and not come and (holds(task, self.store, key) or (self.lean and emptied(task, self.store))):
            return PartState(*task.name, "done")
        failure, failed_at = self._failures.get(task.name, (None, 0.0))
        if self._begun.get(task.name, 0.0) > failed_at:
            return PartState(*task.name, "running")
        if failure is not None and failure.key == key:
            return PartState(*task.name, "failed", message=failure.message)
        receipt = self.store.receipt(*task.name)
        before = [] if failure is None else [same_reason("it failed before, from other inputs or parameters")]
        if receipt is None:
            return PartState(*task.name, "missing", tuple(waiting(late) + new_files(task) + before))
        why = come if key and come else come + reasons(task, receipt, self.store, self._waits)
        return PartState(*task.name, "stale", tuple(why + before))

    def digest(self) -> str:
        """That of a delivery of the parts that are there."""
        names = [n for n in self.outcomes if self.tasks[n].place == "deliver"]
        receipts = [r for n in names if (r := self.store.receipt(*n)) is not None]
        return digest_of({name: facts["digest"] for r in receipts for name, facts in r.outputs.items()})

    def _come(self, task: Task) -> list[Reason]:
        """Files without parts that lie over a tile."""
        if task.stage != "tile":
            return []
        box = TileGrid(task.params["size"]).tile(task.part).box
        return [
            Reason(f"input {name} lies over it, by its header", "a new file lies over it, by its header")
            for name, extent in self.absent.items()
            if extent.touches(box)
        ]


@dataclass(frozen=True)
class RunStatus:
    """What was seen: parts in the plan's order; why the plan is not known further, None where all of it is; how many
    receipts have which `libraries`; the fault of the input by which it is not, None where it is another reason; the
    digest of a delivery of all parts; the files from outside, as they are now."""

    store: Store
    states: dict[Name, PartState]
    tasks: dict[Name, Task]
    ends: str | None
    libraries: Mapping[str, int]
    fault: FwclassError | None = None
    digest: str = ""
    external: tuple[ExternalFile, ...] = ()
    _lacking: dict[str, list[str]] = field(default_factory=dict, repr=False)

    def lacking(self, generation: Generation) -> list[str]:
        """Files of a delivery that are gone, or of another size; looked for once."""
        if generation.name not in self._lacking:
            self._lacking[generation.name] = self.store.generations.lacks(generation)
        return self._lacking[generation.name]

    @property
    def waiting(self) -> int:
        """How many parts are not done only because what they need is not."""
        return sum(s.waits for s in self.states.values())

    @property
    def all_done(self) -> bool:
        """The whole plan is known, and every part of it is done."""
        return self.ends is None and all(s.standing == "done" for s in self.states.values())


def look_at(location: RunLocation, workflow: Callable[[Runner], object], accept_libraries: bool = False) -> RunStatus:
    """Walk `workflow` over the run in `location` without making anything.

    Faults of the configuration come out as they would from a run, and so do faults of the input where nothing was made
    yet; elsewhere the plan ends there, and where parts are missing that tell which others there will be.
    """
    look = StatusWalk(location, accept_libraries)
    ends, wrong = None, None
    try:
        workflow(look)
        if look.absent:
            ends = f"nothing was made yet of {', '.join(sorted(look.absent))}"
    except ConfigError:
        raise
    except FwclassError as fault:
        if all(s.standing == "done" for s in look.states.values()):
            if not isinstance(fault, InputError) or not look.store.parts():
                raise
            wrong = fault
        ends = fault.what
        if isinstance(fault, Lacking):
            ends = f"{'/'.join(fault.name)} is {look.states[fault.name].standing}"
    external = (*look.external, *(file for task in look.tasks.values() for file in task.external))
    return RunStatus(look.store, look.states, look.tasks, ends, look.libraries, wrong, look.digest(), external)
