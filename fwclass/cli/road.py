"""A run directory opened for work, and the words for parts that failed."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click


@contextmanager
def open_road(root: Path, workers: int, scheduler: str | None, limits: Any) -> Iterator[Any]:
    """A run directory locked for writing, with its executor; `limits` is section `run` of the configuration."""
    from fwclass.run.local import Loop
    from fwclass.run.progress import Display
    from fwclass.run.road import Road
    from fwclass.store.lock import writer

    root = root.resolve()
    with writer(root), Display() as display:
        if scheduler is None and workers == 0:
            road = Road(root, Loop(), display)
            road.store.clear_staging()
            yield road
            return
        from fwclass.run.cluster import Cluster

        with Cluster(scheduler, workers, limits.worker_memory_gib, limits.window) as cluster:
            display.say(f"dask         {cluster.address}")
            road = Road(root, cluster, display)
            road.store.clear_staging()
            yield road


def tell_failures(failures: list[Any], request: Any = None) -> None:
    """The parts that failed, and, with the run's `request`, the command that makes each alone."""
    click.echo(f"{len(failures)} parts failed; everything else is done and kept:", err=True)
    for outcome in failures:
        first = outcome.message.splitlines()[0] if outcome.message else ""
        click.echo(f"  {outcome.stage}/{outcome.part}: {first}", err=True)
        alone = request.replay((outcome.stage, outcome.part)) if request is not None else ""
        if alone:
            click.echo(f"    alone: {alone}", err=True)
    again = shlex.join(["fwclass", *sys.argv[1:]])
    click.echo(f"mend the cause and run the same again; only the missing parts are made: {again}", err=True)
