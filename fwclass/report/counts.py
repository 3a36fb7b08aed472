"""What went into a run and what came out: files and their faults, counts, parts of every stage, delivered files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.water_column import water_facts
from fwclass.formats.header_counts import MOST, count_faults
from fwclass.graph.sources import strip_of
from fwclass.graph.vectors import DELIVER_VECTORS
from fwclass.report.facts import receipts_of_run
from fwclass.report.summary import KINDS
from fwclass.run.runner import Runner, Tally
from fwclass.store.receipts import Receipt
from fwclass.survey.layout import Survey


def source_files(runner: Runner, survey: Survey) -> dict[str, Any]:
    """The survey's files with what their index counted and what of their ``header`` is not so, and the faults of all
    of them."""
    faults, numbers = Counter[str](), dict[int, NDArray[np.int64]]()
    for receipt in _chunks(runner):
        faults.update(receipt.meta["faults"])
        counted = np.array(receipt.meta.get("values", {}).get("numbers", [0] * MOST))
        numbers[strip_of(receipt.part)] = numbers.get(strip_of(receipt.part), 0) + counted
    indexed = {r.part: r.meta for r in receipts_of_run(runner, "index")}
    files = []
    for strip in survey.strips:
        meta = indexed.get(f"{strip.number:05d}", {})
        facts = {n: meta.get(n) for n in ("points", "pulses", "point_format")}
        counted = numbers.get(strip.number, np.zeros(MOST, np.int64))
        whole = bool(meta.get("stated")) and counted.sum() == facts["points"]  # of failed spans nothing is counted
        header = count_faults(meta["stated"], counted.tolist()) if whole else []
        files.append({"path": strip.path.name, "strip": strip.number, **facts, "header": header})
    return {"files": files, "excluded": list(survey.excluded), "faults": dict(sorted(faults.items()))}


def echo_counts(runner: Runner) -> dict[str, int]:
    """Pulses, returns and echoes of the run, from files to tiles."""
    reads = _chunk_facts(runner)
    tiles = receipts_of_run(runner, "tile")
    return {
        "pulses": sum(r.meta["pulses"] for r in receipts_of_run(runner, "index")),
        "returns": sum(m["returns"] for m in reads),
        "returns_without_packet": sum(r.meta["kept_returns"] for r in receipts_of_run(runner, "decompose")),
        "returns_without_echo": sum(r.meta["returns_without_echo"] for r in receipts_of_run(runner, "decompose")),
        "echoes_decomposed": sum(r.meta["echoes"] for r in receipts_of_run(runner, "decompose")),
        "echoes_in_tiles": sum(r.meta["rows"] for r in tiles),
        "tiles": len(tiles),
    }


def bathymetry_facts(runner: Runner) -> dict[str, Any] | None:
    """`water_facts` of the run; None of a survey not asked for water, or where a part of earlier does not tell."""
    metas = [r.meta for r in receipts_of_run(runner, "decompose")]
    if not metas or not all("water" in meta for meta in metas):
        return None
    counts = [meta["water"] for meta in metas]
    return water_facts({name: sum(one[name] for one in counts) for name in counts[0]})


def withheld_returns(runner: Runner) -> int:
    """How many returns their sources flag as withheld or synthetic."""
    return sum(int(meta["withheld"]) for meta in _chunk_facts(runner))


def _chunk_facts(runner: Runner) -> list[Mapping[str, Any]]:
    return [r.meta for r in _chunks(runner)]


def _chunks(runner: Runner) -> list[Receipt]:
    """What every chunk held: told by those that were read, and by those that were decomposed as they were read."""
    return [r for stage in ("read", "decompose") for r in receipts_of_run(runner, stage) if "returns" in r.meta]


def vector_counts(runner: Runner) -> dict[str, int] | None:
    """Buildings and trees that the run delivers, of what is asked for; None where it delivers no vectors."""
    metas = [r.meta for r in receipts_of_run(runner, DELIVER_VECTORS.name)]
    return {name: metas[0][name] for name in ("buildings", "trees") if name in metas[0]} if metas else None


def stage_figures(runner: Runner, name: str, tally: Tally) -> dict[str, Any]:
    """How many parts of a stage were made, skipped and failed, and what they took."""
    receipts = receipts_of_run(runner, name)
    return {
        "name": name,
        "parts": tally.parts,
        "computed": tally.computed,
        "skipped": tally.skipped,
        "failed": tally.failed,
        "seconds": round(sum(r.seconds for r in receipts), 3),
        "peak_mib": max((r.peak_mib for r in receipts), default=0.0),
        "rows": sum(int(r.meta.get("rows", 0)) for r in receipts),
    }


def delivered_files(runner: Runner) -> dict[str, list[str]]:
    """Paths of the files that the run delivers, by kind (`KINDS`); an array (``.zarr``) counts as one."""
    names = {
        _path(n)
        for stage in sorted(runner.delivering_stages)
        for r in receipts_of_run(runner, stage)
        for n in r.outputs
    }
    listed = {kind: sorted(n for n in names if n.startswith(begin)) for kind, begin in KINDS.items()}
    return {**listed, "other": sorted(names.difference(*listed.values()))}


def _path(name: str) -> str:
    """A file, or the array that it is a chunk of."""
    head, array, _ = name.partition(".zarr/")
    return f"{head}.zarr" if array else name
