"""What there is to run on, and whether the survey fits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import psutil

from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.graph.raster_outputs import MAX_CELLS
from fwclass.operate.estimate.estimate import Choice, Estimate
from fwclass.units import MIB


@dataclass(frozen=True)
class Room:
    """What a machine has: memory [MiB] and free disk where the run directory will be [bytes]."""

    memory_mib: float
    free: float


@dataclass(frozen=True)
class Limit:
    """One thing that must fit: numbers in `unit`, and what to do where they do not."""

    what: str
    needed: float
    allowed: float
    unit: str
    do: str

    @property
    def fits(self) -> bool:
        """What is needed is allowed."""
        return self.needed <= self.allowed

    @property
    def text(self) -> str:
        """Both numbers in words."""
        return f"{self.what}: {self.needed:,.0f} {self.unit} needed, {self.allowed:,.0f} {self.unit} allowed"


def room_at(root: Path) -> Room:
    """Of this machine; the disk is that of the nearest directory above `root` that exists."""
    there = root.resolve()
    while not there.exists():
        there = there.parent
    return Room(psutil.virtual_memory().total / MIB, float(psutil.disk_usage(str(there)).free))


def allowed_mib(config: Config, workers: int, room: Room) -> float:
    """Memory that a part may be planned with [MiB]: of a worker, or of the machine for the plain loop."""
    limit = config.run.worker_memory_gib * 1024 if workers else room.memory_mib
    return limit * config.plan.worker_share


def limits(config: Config, estimate: Estimate, workers: int, room: Room, best: Choice | None) -> list[Limit]:
    """All that must fit."""
    worker, longest = estimate.largest, max(estimate.stages, key=lambda s: s.longest)
    cells = next((s.amount.units for s in estimate.stages if s.name == "publish-rasters"), 0.0)
    memory, allowed = worker.memory_mib, allowed_mib(config, workers, room)
    hosts = "fewer --workers, or several machines (--scheduler)"
    shorter = f"{_KEYS.get(longest.name, 'smaller tile.size')}, or a larger run.part_hours"
    coarser = "larger terrain.cell and publish.class_cell, or the survey in several pieces"
    disk, number = room.free * config.plan.disk_share / 1e6, estimate.workers
    return [
        Limit(f"memory of a worker ({worker.name})", memory, allowed, "MiB", _advice(config, estimate, best)),
        Limit(f"memory of this machine ({number} workers)", memory * number, room.memory_mib, "MiB", hosts),
        Limit("disk", estimate.bytes / 1e6, disk, "MB", "another --out with more room, or free some"),
        Limit(f"time of a part ({longest.name})", longest.longest, config.run.part_hours * 3600.0, "s", shorter),
        Limit("cells of the delivered rasters", cells, float(MAX_CELLS), "cells", coarser),
    ]


_KEYS = {
    "index": "cut the largest file in two",
    **dict.fromkeys(("read", "decompose", "split", "pulse"), "smaller read.chunk_pulses"),
    "ground-filter": "smaller ground.block (another result) or thinner input",
    "terrain": "smaller terrain.block",
    "seams": "--set run.seam_check_echoes=0 leaves the check out",
    "publish-strip": "cut the largest file in two",
    "publish-rasters": "larger terrain.cell and publish.class_cell",
    "trees": "smaller train.samples_per_class",
}


def _advice(config: Config, estimate: Estimate, best: Choice | None) -> str:
    if best is not None and best.size != config.tile.size:
        return f"--set tile.size={best.size:g}"
    own = _KEYS.get(estimate.largest.name, "smaller tile.size")
    return f"{own}, or a larger run.worker_memory_gib"


def refuse(limits: list[Limit], where: object) -> None:
    """`ConfigError` with the numbers of everything that does not fit."""
    short = [f for f in limits if not f.fits]
    if short:
        raise ConfigError(
            "the survey does not fit",
            where=where,
            got="; ".join(f.text for f in short),
            do="; ".join(dict.fromkeys(f.do for f in short)),
        )
