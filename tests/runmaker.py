"""Runs over a small simulated survey, for tests."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
from commandline import coarse

from fwclass import conf
from fwclass.operate.status.walk import RunStatus, look_at
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.schema import Table
from fwclass.store.atomic import file_digest
from fwclass.store.run_location import RunLocation, lock_run
from fwclass.store.tables import read_table, write_table
from fwclass.workflows import WORKFLOWS, workflow_of

SETTINGS = (
    "simulate.size=120",
    "simulate.strips=2",
    "train.trees=10",
    "train.samples_per_class=3000",
    "areas.gap=5",
    "train.importance_repeats=2",
    "areas.train=[[512000, 5403000, 512060, 5403120]]",
    "read.chunk_pulses=9000",
    "pulse.sample=3000",
    "ground.block=64",
    "terrain.block=64",
    "publish.figure_pixels=200",
)


def walk(
    survey: Path | str, location: RunLocation, *settings: str, executor=None, tiles=None, workflow="classification"
):
    """Run the classification of `survey`, or another `workflow`, into `location`; return the runner and the report."""
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", *settings))
    with (
        coarse(),
        Display() as display,
        lock_run(location, display.say) as (own, held),
        executor or contextlib.nullcontext(Loop()) as running,
    ):
        runner = Runner(own, running, display, held=held)
        report = workflow_of(workflow)(config, runner, tiles)
        runner.publish(config.run.keep_generations)
        return runner, report


def looked(survey: Path, root: Path, *settings: str) -> RunStatus:
    """How the run that `walk` makes stands."""
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", *settings))
    return look_at(root, lambda runner: WORKFLOWS["classification"](config, runner, None))


ANSWER = ("strip", "pulse", "echo_number", "classification", "confidence", "entropy")


def delivered_echoes(root: Path, columns: tuple[str, ...] = ANSWER) -> dict[str, np.ndarray]:
    """Columns of all delivered echoes, ordered by strip, pulse and number, whatever the tiles."""
    parts = [pq.read_table(p, columns=list(columns)) for p in sorted((root / "parquet").glob("*.parquet"))]
    echoes = {n: np.concatenate([p.column(n).to_numpy() for p in parts]) for n in columns}
    order = np.lexsort((echoes["echo_number"], echoes["pulse"], echoes["strip"]))
    return {n: v[order] for n, v in echoes.items()}


def delivered(root: Path) -> dict[str, str]:
    """Digest of every delivered file but the report, which tells times."""
    found = {}
    for kind in ("laz", "parquet", "rasters", "model"):
        base = (root / kind).resolve().parent
        for path in sorted((base / kind).rglob("*")):
            if path.is_file():
                found[path.relative_to(base).as_posix()] = hashlib.sha256(path.read_bytes()).hexdigest()
    for path in root.glob("*.gpkg"):
        found[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def rewrite_table(place: Path, change: Callable[[Table], Table]) -> None:
    """Put ``change(table)`` in place of the table of the part that lies in `place`, with a receipt that names it."""
    receipt = json.loads((place / "receipt.json").read_text())
    table = place / receipt["key"] / "table.parquet"
    write_table(table, change(read_table(table)))
    receipt["outputs"]["table.parquet"] = {"bytes": table.stat().st_size, "digest": file_digest(table)}
    del receipt["seal"]
    (place / "receipt.json").write_text(json.dumps(receipt))


def shifted_reference(survey: Path, output: Path) -> None:
    """A reference file of `survey`, moved 10 km to the east."""
    cloud = laspy.read(next((survey / "reference").glob("*.las")))
    cloud.x = cloud.x + 10_000.0
    cloud.write(output)
