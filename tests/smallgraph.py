"""A small graph of parts as a survey has them, Parquet, Zarr, what is delivered, run in the plain loop in a moment."""

from __future__ import annotations

import hashlib
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fwclass import conf
from fwclass.cli.runner import open_runner
from fwclass.operate.history import record_run
from fwclass.operate.request import Request
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.run.part import Task
from fwclass.schema import Table
from fwclass.store.arrays import write_arrays
from fwclass.store.atomic import write_json
from fwclass.store.run_location import RunLocation, address_of
from fwclass.store.run_store import Store
from fwclass.store.tables import write_table
from fwclass.survey.file_digests import Digests

LIMITS = conf.load("demo", ()).run
REQUEST = Request("conf.yaml", "run")


def rows(seed: int, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    r = np.random.default_rng(seed)
    write_table(directory / TABLE, Table({n: r.uniform(0, 10, 50) for n in "xyz"}))
    return {"rows": 50}


def grid(part: str, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    table = inputs.table("rows", part)
    write_arrays(directory / "grid", {"z": np.sort(table["z"])})
    return {"highest": float(table["z"].max())}


def tile(part: str, text: str, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    z = inputs.arrays("grid", part, "grid")[0]["z"]
    for name, data in (
        (f"laz/tiles/{part}.laz", text.encode() + z.tobytes()),
        (f"parquet/{part}.parquet", z.tobytes()),
    ):
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_bytes(data)
    return {"rows": 50, "blocks": {}, "bounds": [0.0, 0.0, 0.0, 10.0, 10.0, 10.0], "strips": [], "times": []}


def whole(parts: str, text: str, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    (directory / "rasters").mkdir()
    heights = [inputs.arrays("grid", p, "grid")[0]["z"].tobytes() for p in parts]
    (directory / "rasters" / "all.tif").write_bytes(text.encode() + b"".join(heights))
    return {}


def tasks(parts: str, text: str, external: tuple = ()) -> list[Task]:
    """Two parts for each letter of `parts` that do not depend on `text`, what is delivered of them, which does."""
    found = [Task("rows", p, 1, {}, partial(rows, ord(p)), external=external) for p in parts]
    found += [Task("grid", p, 1, {}, partial(grid, p), needs=(("rows", p),)) for p in parts]
    delivered: dict[str, Any] = {"place": "deliver", "params": {"text": text}, "version": 1}
    found += [Task("tile", part=p, work=partial(tile, p, text), needs=(("grid", p),), **delivered) for p in parts]
    needs = tuple(("grid", p) for p in parts)
    return [*found, Task("all", part="all", work=partial(whole, parts, text), needs=needs, **delivered)]


def run(location: RunLocation, source: Path, parts: str, text: str) -> list[str]:
    """As `fwclass run`; the messages of parts that failed."""
    with record_run(location, REQUEST) as entry, open_runner(location, 0, None, LIMITS) as runner:
        REQUEST.keep(runner.store)
        entry.begin(runner)
        digests = Digests(runner.store)
        read = digests.of([source])
        digests.save()
        runner.do(tasks(parts, text, read))
        runner.finish(True)
        write_json(runner.pending / "report.json", {"text": text})
        entry.generation = runner.publish(1).number
        return [o.message for o in runner.failures]


def delivered(root: Path) -> dict[str, str]:
    """Digest of every file of the generation that is shown, by its path there; the reports too."""
    base = (root / "current").resolve()
    files = (p for p in base.rglob("*") if p.is_file() and p.name not in ("generation.json", "manifest.json"))
    return {p.relative_to(base).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def made(store: Store) -> dict[tuple[str, str], tuple[str, str]]:
    """Key and digest of every part."""
    receipts = (store.receipt(*name) for name in store.parts())
    return {(r.stage, r.part): (r.key, r.digest) for r in receipts if r is not None}


def untorn(root: Path) -> None:
    """What readers see at this moment, if anything, is all of one generation."""
    if not (root / "current").exists():
        assert not (root / "current").is_symlink(), "readers are led nowhere"
        return
    base = (root / "current").resolve()
    files = json.loads((base / "manifest.json").read_text())["files"]
    for name, facts in files.items():
        held = (base / name).read_bytes()
        assert hashlib.blake2b(held, digest_size=16).hexdigest() == facts["digest"], name


def place(location: RunLocation) -> str:
    return str(address_of(location))
