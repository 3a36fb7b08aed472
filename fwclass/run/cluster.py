"""Parts on a Dask cluster. The only file that imports dask.

Data never travels through the scheduler: a task's function reads from and writes to the store, and returns a small
`Outcome`. The graph's edges are the tasks' needs.
"""

from __future__ import annotations

import importlib.util
import re
import signal
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

import dask
from distributed import Client, Future, LocalCluster, WorkerPlugin, as_completed, get_worker, performance_report

from fwclass import __version__
from fwclass.errors import FwclassError
from fwclass.run.logs import attempted
from fwclass.run.part import Name, Outcome, Task, execute
from fwclass.store.atomic import write_text
from fwclass.store.home import Home
from fwclass.store.scratch import worker_directory

_OUTSIDE = re.compile(r'<link rel="shortcut icon" href="https?://[^">]*"[^>]*>')
"""Of a performance report: its icon, which would be fetched."""


def _at_worker(version: str, home: Home, task: Task, upstream: Iterable[Outcome]) -> Outcome:
    """A part, on whatever host the scheduler has chosen."""
    worker = get_worker()
    if version != __version__:
        return Outcome(
            *task.name, "failed", message=f"worker {worker.address} has fwclass {__version__}, the run has {version}: "
            "install the same version on all hosts",
        )  # fmt: skip
    worker_directory(Path(worker.local_directory))
    return execute(home, task, tuple(upstream))


class Unheeding(WorkerPlugin):  # type: ignore[misc]
    """A terminal sends Ctrl-C to the workers too; only the command heeds it, and ends them."""

    name = "unheeding"

    def setup(self, worker: object) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _no_answer(address: str | None, fault: Exception) -> FwclassError:
    """Nobody speaks at `address`, or not to us."""
    if (address or "").startswith("tls://") or dask.config.get("distributed.comm.require-encryption"):
        return FwclassError(
            "no Dask scheduler answers, or not to this certificate", where=address or "local cluster", got=fault,
            do="name certificates of the scheduler's authority in Dask's distributed.comm.tls: ca-file, client.cert, "
            "client.key, and those of scheduler and worker where these run (docs/security.md)",
        )  # fmt: skip
    return FwclassError(
        "no Dask scheduler answers", where=address or "local cluster", got=fault,
        do="start one with `dask scheduler`, or leave --scheduler out for a local cluster; one that speaks TLS has an "
        "address tls://…",
    )  # fmt: skip


class Cluster:
    """Executor on a Dask scheduler: at `address`, or on `workers` processes of one thread each on this machine.

    It is given at most `window` parts at a time.
    """

    def __init__(self, address: str | None, workers: int, worker_memory_gib: float, window: int) -> None:
        dask.config.set({"distributed.scheduler.allowed-failures": 3, "distributed.admin.tick.limit": "30s"})
        self._cluster: LocalCluster | None = None
        try:
            if address is None:
                self._cluster = LocalCluster(
                    n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
                    memory_limit=f"{worker_memory_gib} GiB", host="127.0.0.1", silence_logs=40,
                )  # fmt: skip
            self._client = Client(self._cluster or address, timeout="30s")
            if self._cluster is not None:
                self._client.register_plugin(Unheeding())
        except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as fault:  # TypeError: no certificate
            raise _no_answer(address, fault) from fault
        self.address, self.dashboard = self._client.scheduler.address, self._page()
        self.workers = len(self._client.ncores())
        self._window, self._count = window, 0

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
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def run(self, home: Home, tasks: Iterable[Task]) -> Generator[Outcome]:
        """Outcomes as parts end, in any order; edges are exactly the tasks' needs.

        The scheduler knows at most `window` parts: the next is taken when one has ended.
        """
        names: dict[str, Name] = {}
        futures: dict[Name, Future] = {}
        ended = as_completed()

        def next_one() -> Outcome:
            future = next(ended)
            name = names.pop(future.key)
            del futures[name]
            return _outcome(home, name, future)

        try:
            for task in tasks:
                upstream = [futures[n] for n in task.needs if n in futures]
                self._count += 1
                future = self._client.submit(
                    _at_worker, __version__, home, task, upstream, key=f"{task.stage}-{task.part}-{self._count}",
                    pure=False, priority=-self._count, retries=0,
                )  # fmt: skip
                futures[task.name], names[future.key] = future, task.name
                ended.add(future)
                if len(futures) >= self._window:
                    yield next_one()
            while futures:
                yield next_one()
        except GeneratorExit:  # stopped at a failure: what has not begun is not begun any more
            self._client.cancel([f for f in futures.values() if not f.done()])
            raise


def _outcome(home: Home, name: Name, future: Future) -> Outcome:
    if future.status == "finished":
        outcome: Outcome = future.result()
        return outcome
    fault = future.exception() if future.status == "error" else future.status
    message = f"the worker was lost: {type(fault).__name__}: {fault}"
    attempted(home, *name, {"status": "failed", "message": message})
    return Outcome(*name, "failed", message=message)
