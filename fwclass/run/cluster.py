"""Parts on a Dask cluster. The only file that imports dask.

Data never travels through the scheduler: a task's function reads from and writes to the store, and returns a small
`Outcome`. The graph's edges are the tasks' needs. `in_flight` keeps what the scheduler knows.
"""

from __future__ import annotations

import atexit
import gc
import importlib.util
import logging
import math
import os
import re
import signal
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict
from functools import cache
from multiprocessing import resource_tracker
from pathlib import Path
from types import TracebackType
from typing import Any

import dask
import distributed.batched
from dask.system import CPU_COUNT
from distributed import Client, Future, LocalCluster, Nanny, WorkerPlugin, as_completed, get_worker, performance_report
from distributed.scheduler import KilledWorker
from tornado.ioloop import IOLoop

from fwclass import compiling
from fwclass.errors import FwclassError
from fwclass.isolation import kernel_cache
from fwclass.memory import give_back, keep_freed
from fwclass.run.bundles import Bundles
from fwclass.run.cluster_errors import (
    OtherLibraries,
    difference_from_here,
    no_answer,
    program_changed,
    scheduler_gone,
    unlike_workers,
)
from fwclass.run.in_flight import InFlight
from fwclass.run.limit import ended_after
from fwclass.run.lost import Losses, cause_of
from fwclass.run.part import Outcome, Task, execute
from fwclass.store.atomic import digest_of, write_text
from fwclass.store.libraries import fingerprint
from fwclass.store.run_location import RunLocation
from fwclass.store.scratch import worker_directory

_OUTSIDE = re.compile(r'<link rel="shortcut icon" href="https?://[^">]*"[^>]*>')
"""Of a performance report: its icon, which would be fetched."""

LOOK_EVERY = 2.0
"""Seconds between looks at whether workers are missing."""

SLOW_START = 120.0
"""Seconds that a worker may take to come back before another is started in its place."""

_QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Dask looks at itself every 10 to 500 ms in every process: 12 % of a core for two workers that have nothing to do,
4 % with these."""

_ENDS: dict[str, int] = {}
"""How workers of this process ended, by address: the exit code, negative for a signal."""

CORES = CPU_COUNT
"""Cores that this process may use: of the machine, its affinity and its container's quota the least."""


def _at_worker(
    libraries: str,
    location: RunLocation,
    tasks: Sequence[Task],
    upstream: Iterable[Sequence[Outcome]],
    split: int,
    topic: str,
    seconds: float,
) -> list[Outcome]:
    """Parts, one after the other, on whatever host the scheduler has chosen; their outcomes are told under `topic` too,
    which asks nobody."""
    worker = get_worker()
    if libraries != _digest_here():
        raise OtherLibraries(worker.address, dict(fingerprint()))
    worker_directory(Path(worker.local_directory))
    compiling.listeners[:] = [lambda begins: worker.log_event(topic, {"worker": worker.address, "compiling": begins})]
    before = {(o.stage, o.part): o for several in upstream for o in several}
    outcomes = []
    for task in tasks:
        with ended_after(seconds) if math.isfinite(seconds) else nullcontext():
            outcomes.append(execute(location, task, [before[n] for n in task.needs if n in before], split))
    give_back(worker.memory_manager.memory_limit)
    worker.log_event(topic, {"key": worker.get_current_task(), "outcomes": [asdict(o) for o in outcomes]})
    return outcomes


@cache
def _digest_here() -> str:
    return digest_of(dict(fingerprint()))


def _fingerprint_here() -> dict[str, str]:
    """The libraries and the code of the worker that `Client.run` asks."""
    return dict(fingerprint())


def wait_by_monotonic_clock() -> None:
    """Let this process's senders of Dask wait by the monotonic clock.

    They wait until a time of the wall clock (`distributed.batched`, tornado's `IOLoop.time`): where that is set back by
    an hour, nothing is sent for one.
    """
    quiet_tracker()
    ahead = time.time() - time.monotonic()
    setattr(IOLoop, "time", lambda loop: time.monotonic() + ahead)  # noqa: B010 (a method of theirs, on purpose)
    distributed.batched.time = lambda: time.monotonic() + ahead


class Unheeding(WorkerPlugin):  # type: ignore[misc]
    """Has a worker ignore Ctrl-C, which a terminal sends to it too and the command answers, and the wall clock."""

    name = "unheeding"

    def setup(self, worker: object) -> None:
        wait_by_monotonic_clock()
        keep_freed()  # before there are threads with memory of their own
        atexit.register(gc.freeze)  # its last steps would look for cycles in all that libraries made
        signal.signal(signal.SIGINT, signal.SIG_IGN)


class Watcher(Nanny):  # type: ignore[misc]
    """Restarts a worker that has ended, and remembers how it ended."""

    async def _on_worker_exit(self, exitcode: int) -> None:
        _ENDS[str(self.worker_address)] = int(exitcode)
        await super()._on_worker_exit(exitcode)


class Cluster:
    """Executor on a Dask scheduler: at `address`, or on `workers` processes of one thread each on this machine.

    It is given at most `window` parts at a time. A part whose worker is lost is tried `retries` times more among
    others, then alone, in `split` × `split` pieces. One that takes longer than `part_hours` has failed, and its worker
    is ended. `watched`: for a performance report, workers note what they do.
    `say`: told of workers that are turned away; `compiles`: of those that begin or end to compile kernels.
    """

    def __init__(
        self,
        address: str | None,
        workers: int,
        worker_memory_gib: float,
        window: int,
        retries: int = 0,
        split: int = 1,
        watched: bool = False,
        say: Callable[[str], None] = print,
        part_hours: float = math.inf,
        compiles: Callable[[str, bool], None] = lambda worker, begins: None,
    ) -> None:
        wait_by_monotonic_clock()
        dask.config.set(
            {
                "distributed.scheduler.allowed-failures": 0,
                "distributed.admin.tick.limit": "30s",
                "distributed.deploy.lost-worker-timeout": f"{SLOW_START:g}s",
                **({} if watched else _QUIET),
                "distributed.scheduler.worker-ttl": None,  # it asks the wall clock; nannies know whether workers live
                "distributed.worker.memory.pause": False,  # what a worker holds between parts, waiting frees nothing of
            }
        )
        self._cluster: LocalCluster | None = None
        self._heard: dict[str, Sequence[Outcome]] = {}
        self._compiling = compiles
        self._away: set[str] = set()
        self._wanted, self._memory, self._retries, self._split = workers, worker_memory_gib, retries, split
        try:
            if address is None:
                kernel_cache()  # one for all workers
                self._cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address="127.0.0.1:0",
                    memory_limit=f"{worker_memory_gib} GiB",
                    host="127.0.0.1",
                    silence_logs=50,
                    worker_class=Watcher,
                )
            self._client = Client(self._cluster or address, timeout="30s")
            if self._cluster is not None:
                self._client.register_plugin(Unheeding())
            self._topic = f"fwclass-{uuid.uuid4().hex}"
            self._client.subscribe_topic(self._topic, self._hear)
        except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as fault:  # TypeError: no certificate
            encrypted = bool(dask.config.get("distributed.comm.require-encryption"))
            raise no_answer(address, encrypted, fault) from fault
        self.address, self.dashboard = self._client.scheduler.address, self._page()
        self.workers = len(self._client.ncores())
        self._window, self._count, self._over, self._say = window, 0, threading.Event(), say
        self._seconds = 3600.0 * part_hours
        self._check_workers()
        if self._cluster is not None:
            threading.Thread(target=self._replace_workers, daemon=True).start()

    def _check_workers(self) -> None:
        """`FwclassError` if a worker computes by other code than this process, or no worker of this machine lives."""
        answers = self._client.run(_fingerprint_here, on_error="return")
        lost = [answer for answer in answers.values() if isinstance(answer, OSError)]  # ended before it could say
        if self._cluster is not None and len(lost) == len(answers):
            self.__exit__(None, None, None)
            raise no_answer(None, False, lost[0] if lost else OSError("no worker is left"))
        codes = {
            address: difference_from_here(there) if isinstance(there, dict) else f"{type(there).__name__}: {there}"
            for address, there in answers.items()
            if self._cluster is None or not isinstance(there, OSError)
        }
        others = [f"{address}: {text}" for address, text in codes.items() if text]
        if others:
            self.__exit__(None, None, None)
            raise unlike_workers(self.address, others, len(codes))

    def turned_away(self, fault: BaseException | None) -> bool:
        """Whether `fault` is that of a worker which computes by other code; it is told, and gets no part any more."""
        if not isinstance(fault, OtherLibraries):
            return False
        address, there = fault.args
        text = f"worker {address} computes by other code than this run ({difference_from_here(there)})"
        if self._cluster is not None:
            raise program_changed(self.address, text)
        if address not in self._away:
            self._away.add(address)
            self._say(f"dask             {text}: it is retired")
            self._client.retire_workers([address], close_workers=True, remove=True)
        return True

    def _replace_workers(self) -> None:
        """Start another worker for each that its nanny has given up, as it was killed while it started."""
        while not self._over.wait(LOOK_EVERY):
            if self._cluster is not None and len(self._cluster.workers) < self._wanted:
                self._cluster.scale(self._wanted)

    def _page(self) -> str | None:
        """Address of the scheduler's dashboard; None where it serves none, for want of bokeh."""
        try:
            return str(self._client.dashboard_link) if importlib.util.find_spec("bokeh") else None
        except KeyError:
            return None

    @contextmanager
    def reported(self, path: Path, say: Callable[[str], None]) -> Iterator[None]:
        """Write Dask's performance report of what is done meanwhile to `path`: a page that opens without a network."""
        beside = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
        path.parent.mkdir(parents=True, exist_ok=True)
        recording = performance_report(filename=str(beside), mode="inline")
        recording.__enter__()
        try:
            yield
        finally:
            try:
                recording.__exit__(None, None, None)
                write_text(path, _OUTSIDE.sub("", beside.read_text(encoding="utf-8")))
            except Exception as fault:  # the scheduler writes the page, and may be gone
                say(f"no performance report: {type(fault).__name__}: {fault}")
            finally:
                beside.unlink(missing_ok=True)

    def __enter__(self) -> Cluster:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        if kind is not None:  # parts that end just now have nobody to tell: no matter for the terminal
            logging.getLogger("distributed.scheduler").setLevel(logging.CRITICAL + 1)
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def run(self, location: RunLocation, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes as parts end, in any order; edges are exactly the tasks' needs.

        The scheduler knows at most `window` parts: the next is taken when one has ended. `FwclassError` if the
        scheduler is gone.
        """
        in_flight = InFlight(self, location, Losses(location, self._retries), as_completed())
        bundles = Bundles(max(1, self.workers), self._window)  # a scheduler may get its workers later

        def ended() -> Iterator[Outcome]:
            for outcome in in_flight.ended():
                bundles.note(outcome)
                yield outcome

        try:
            for bundle in bundles.of(tasks):
                in_flight.take(bundle)
                while in_flight.full or (in_flight and bundles.waits):
                    yield from ended()
            while in_flight:
                yield from ended()
            self._heard.clear()
        except GeneratorExit:  # stopped at a failure: what has not begun is not begun any more
            in_flight.drop()
            raise

    def submit(self, location: RunLocation, tasks: Sequence[Task], upstream: list[Any], alone: bool) -> Future:
        """Hand parts to the scheduler; one that is tried alone is made in pieces."""
        self._count += 1
        return self._client.submit(
            _at_worker,
            _digest_here(),
            location,
            tasks,
            upstream,
            self._split if alone else 1,
            self._topic,
            self._seconds,
            key=f"{tasks[0].stage}-{tasks[0].part}-{self._count}",
            pure=False,
            priority=-self._count,
            retries=0,
        )

    def _hear(self, event: tuple[float, dict[str, Any]]) -> None:
        if "compiling" in event[1]:
            self._compiling(event[1]["worker"], event[1]["compiling"])
            return
        self._heard[event[1]["key"]] = [Outcome(**{**o, "lost": tuple(o["lost"])}) for o in event[1]["outcomes"]]

    def outcomes(self, future: Future) -> Sequence[Outcome]:
        """Of parts that have ended: what their worker told, or else what the scheduler finds; any fault of that."""
        heard = self._heard.pop(future.key, None)
        return heard if heard is not None else future.result()

    def cancel(self, futures: list[Future]) -> None:
        """Give up parts that have not begun."""
        self._client.cancel(futures)

    def gone(self) -> FwclassError:
        """The words for a scheduler that does not answer any more; its client's own are kept from the terminal."""
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        return scheduler_gone(self.address)

    @staticmethod
    def killed(fault: BaseException | None, key: str) -> str | None:
        """Address of the worker that was lost with the task `key`; empty if it was lost with one that this one needs,
        None for another fault."""
        if not isinstance(fault, KilledWorker):
            return None
        return str(fault.last_worker.address) if fault.task == key else ""

    def cause(self, worker: str) -> str:
        """Why the worker at this address ended, in words; empty where that is not known."""
        until = time.monotonic() + 2.0
        while self._cluster is not None and worker not in _ENDS and time.monotonic() < until:
            time.sleep(0.05)  # the scheduler may know of it before its nanny does
        try:
            events = [e for _, e in self._client.get_events("worker-restart-memory") or ()]
        except (OSError, TimeoutError):
            events = []
        over = next((int(e["rss"]) for e in events if e.get("worker") == worker), None)
        return cause_of(over, self._memory if self._cluster is not None else None, _ENDS.get(worker))

    @property
    def window(self) -> int:
        """How many parts the scheduler may know at a time."""
        return self._window


def data_frame(read: Callable[[str], Any], files: Sequence[str]) -> Any:
    """A Dask data frame, a partition a file: `read` gives a pandas frame, on the worker, when it is asked for."""
    import dask.dataframe

    return dask.dataframe.from_map(read, list(files))


def quiet_tracker() -> None:
    """Keep the resource tracker of this process from printing tracebacks about semaphores that it does not know.

    One that was killed is started again, and is told to forget names that only the first one had.
    """
    tracker: Any = resource_tracker._resource_tracker
    if "_send" in vars(tracker):  # done before
        return
    registered = set[tuple[object, ...]]()

    def send_known(command: str, name: str, kind: str) -> None:
        tracker.ensure_running()
        semaphore = (tracker._pid, name, kind)
        if command == "REGISTER":
            registered.add(semaphore)
        elif semaphore not in registered:
            return
        else:
            registered.remove(semaphore)
        with suppress(OSError):  # it was killed since; Python's own `_send` would tell the next one of this name
            os.write(tracker._fd, f"{command}:{name}:{kind}\n".encode("ascii"))

    tracker._send = send_known
