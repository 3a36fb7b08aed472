"""One part of one stage: what it needs, what it does, and doing it. The same function in a loop and on Dask."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fwclass.errors import FwclassError, full_or, is_interrupt, memory_error, system_error
from fwclass.isolation import ignore_settings
from fwclass.memory import keep_freed
from fwclass.run.inputs import Declared, PartInputs
from fwclass.run.logs import Value, log_attempt, log_path
from fwclass.store.external_file import ExternalFile
from fwclass.store.libraries import stale_by
from fwclass.store.receipts import Receipt, content_key
from fwclass.store.row_digests import Within, digest_within
from fwclass.store.run_location import RunLocation, open_store
from fwclass.store.run_store import Store

Name = tuple[str, str]
"""(stage, part)."""


@dataclass(frozen=True)
class Task:
    """A part to be made.

    Attributes
    ----------
    stage, part, version : which part, by which version of the stage.
    params : plain data that enters the key.
    work : picklable; ``work(inputs, directory)`` writes files into `directory` and returns the part's meta.
    needs : parts read; their digests enter the key.
    within : what is read of those of them that have digests of pieces (`store.row_digests`): the rows in a box, the
        piece of a name; None for all.
    check : it only judges: nothing that is delivered is made from it, and a delivery is whole though it failed.
    external : files read from outside; their digests enter the key by name.
    any_libraries : the part is done if it was made with other libraries, too (`store.libraries`).
    place : "store"; "deliver" for what the user gets, in a generation, at the paths that it has in the part; "run" for
        files of the run directory itself.
    """

    stage: str
    part: str
    version: int
    params: Any
    work: Callable[[PartInputs, Path], Mapping[str, Any]]
    needs: tuple[Name, ...] = ()
    external: tuple[ExternalFile, ...] = ()
    place: Literal["store", "deliver", "run"] = "store"
    within: Within = None
    any_libraries: bool = False
    check: bool = False

    @property
    def name(self) -> Name:
        """Stage and part."""
        return self.stage, self.part


Status = Literal["computed", "skipped", "failed", "blocked"]


@dataclass(frozen=True)
class Outcome:
    """How a part ended; small, because it travels through the scheduler. `processor`: seconds of one that it took;
    `lost`: why workers that had it were lost."""

    stage: str
    part: str
    status: Status
    seconds: float = 0.0
    peak_mib: float = 0.0
    message: str = ""
    lost: tuple[str, ...] = ()
    processor: float = 0.0

    @property
    def ok(self) -> bool:
        """The part is done, by this run or an earlier one."""
        return self.status in ("computed", "skipped")


def input_digests(task: Task, store: Store) -> dict[str, str] | None:
    """Digests of all that `task` reads, or None while a part that it needs is not done.

    A part of which nothing lies where the task reads does not count.
    """
    digests = {file.name: file.digest for file in task.external}
    store.look_up(task.needs)
    for stage, part in task.needs:
        receipt = store.receipt(stage, part)
        if receipt is None:
            return None
        read = digest_within(receipt, task.within)
        if read is not None:
            digests[f"{stage}/{part}"] = read
    return digests


def key_now(task: Task, store: Store) -> str | None:
    """The key that the part has from the inputs as they are now, None while a part that it needs is not done."""
    inputs = input_digests(task, store)
    return None if inputs is None else content_key(task.stage, task.version, task.params, inputs)


def already_done(task: Task, store: Store) -> bool:
    """The part is there, made from the inputs as they are now; of one that was never made these are not looked at."""
    key = key_now(task, store) if store.receipt(*task.name) else None
    return key is not None and holds(task, store, key)


def emptied(task: Task, store: Store) -> bool:
    """As `already_done`, but that its files were removed to save room."""
    receipt = store.receipt(*task.name)
    if receipt is None or not receipt.emptied or receipt.key != key_now(task, store):
        return False
    return task.any_libraries or not stale_by(store.provenance.libraries(receipt))


def holds(task: Task, store: Store, key: str) -> bool:
    """The part is there under this key, and was made with the libraries of here, or such as do not matter."""
    receipt = store.done(task.stage, task.part, key)
    return receipt is not None and (task.any_libraries or not stale_by(store.provenance.libraries(receipt)))


def execute(location: RunLocation, task: Task, upstream: Sequence[Outcome] = (), split: int = 1) -> Outcome:
    """Make one part, or say why not. Never raises for a fault of the part; the run goes on without it.

    With `split` the stages that hold most work in `split` × `split` pieces of a tile: less memory, the same bytes.
    """
    broken = [u for u in upstream if not u.ok]
    if broken:
        return Outcome(*task.name, "blocked", message=f"{broken[0].stage}/{broken[0].part} {broken[0].status}")
    settle_process()
    keep_freed()
    key = ""
    began, used = time.perf_counter(), time.process_time()
    try:
        store = open_store(location)
        digests = input_digests(task, store)
        if digests is None:
            return Outcome(*task.name, "blocked", message="a part that it needs is not done")
        key = content_key(task.stage, task.version, task.params, digests)
        if holds(task, store, key):
            return Outcome(*task.name, "skipped")
        inputs = PartInputs(
            store,
            external={file.name: file.digest for file in task.external},
            split=split,
            declared=Declared(task.name, frozenset(task.needs), task.within),
        )
        receipt = store.commit(
            task.stage,
            task.part,
            key,
            digests,
            task.place,
            lambda directory: _do_work(task, inputs, directory),
            task.version,
            task.params,
        )
    except Exception as fault:
        if is_interrupt(fault):
            raise KeyboardInterrupt from fault
        took, processor = time.perf_counter() - began, time.process_time() - used
        outcome = Outcome(*task.name, "failed", took, message=_message(location, task, fault), processor=processor)
        trace = (
            ""
            if isinstance(fault, (FwclassError, OSError, MemoryError))
            else "".join(traceback.format_exception(fault))
        )
        log_attempt(location, *task.name, _attempt(outcome, key) | ({"traceback": trace} if trace else {}))
        return outcome
    processor = time.process_time() - used
    outcome = Outcome(*task.name, "computed", receipt.seconds, receipt.peak_mib, processor=processor)
    log_attempt(location, *task.name, _attempt(outcome, key) | _log_values(receipt))
    return outcome


def _do_work(task: Task, inputs: PartInputs, directory: Path) -> Mapping[str, Any]:
    """The part's work; refused where a file that it reads is not, before and after, the one whose digest was taken."""
    for file in task.external:
        file.check()
    try:
        meta = task.work(inputs, directory)
    except FwclassError:
        raise
    except Exception as fault:
        for file in task.external:
            file.check()
        full = full_or(fault, directory)
        if full is fault:
            raise
        raise full from fault
    for file in task.external:
        file.check()
    return meta


def _message(location: RunLocation, task: Task, fault: Exception) -> str:
    """A fault in words for the user; one of the program has its traceback in the part's log."""
    if isinstance(fault, FwclassError):
        return str(fault)
    if isinstance(fault, OSError):
        return str(system_error(fault, location))
    if isinstance(fault, MemoryError):
        return str(memory_error(fault))
    return f"{type(fault).__name__}: {fault}\n  traceback: {log_path(location, *task.name)}"


def _attempt(outcome: Outcome, key: str) -> dict[str, Value]:
    """What a log tells of any attempt."""
    fields: dict[str, Value] = {"key": key, "status": outcome.status, "seconds": round(outcome.seconds, 3)}
    return fields | ({"message": outcome.message} if outcome.message else {})


def _log_values(receipt: Receipt) -> dict[str, Value]:
    """What a log tells of a part that was made."""
    faults = receipt.meta.get("faults") or {}
    return {
        "peak_mib": receipt.peak_mib,
        "rows": receipt.meta.get("rows"),
        "bytes": sum(int(o["bytes"]) for o in receipt.outputs.values()),
        "faults": ",".join(f"{n}:{count}" for n, count in faults.items()) or None,
    }


def settle_process() -> None:
    """No thread pools inside a part, and no settings of GDAL's: parts are what runs in parallel. Memory that Arrow
    frees is there for all again, unless ``ARROW_DEFAULT_MEMORY_POOL`` says otherwise: by default it keeps its own, 140
    MiB behind an overview.
    """
    import numcodecs.blosc
    import pyarrow as pa

    ignore_settings()
    numcodecs.blosc.use_threads = False
    pa.set_cpu_count(1)
    if "ARROW_DEFAULT_MEMORY_POOL" not in os.environ:
        pa.set_memory_pool(pa.system_memory_pool())
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
