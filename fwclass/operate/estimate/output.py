"""Where a plan is written: ``plan/`` in the run directory."""

from __future__ import annotations

from pathlib import Path

from fwclass.errors import ConfigError
from fwclass.operate.estimate.picture import plan_picture
from fwclass.operate.estimate.polygons import write_gpkg
from fwclass.operate.estimate.whole import Plan, as_json
from fwclass.store.atomic import move_into_place, staged, write_json

NAMES = ("tiles.gpkg", "plan.png", "plan.json")


def check_free(root: Path, overwrite: bool) -> None:
    """`ConfigError` where an earlier plan lies and may not be replaced."""
    there = [root / "plan" / n for n in NAMES if (root / "plan" / n).exists()]
    if there and not overwrite:
        raise ConfigError(
            "there is a plan already",
            where=there[0].parent,
            got=", ".join(p.name for p in there),
            do="--overwrite, or another --out",
        )


def deliver(plan: Plan, root: Path) -> tuple[Path, ...]:
    """Write the polygons, the picture and the numbers; each appears whole. Return their paths."""
    target = root / "plan"
    paths = tuple(target / n for n in NAMES)
    target.mkdir(parents=True, exist_ok=True)
    with staged(target) as directory:
        write_gpkg(plan, directory / NAMES[0])
        (directory / NAMES[1]).write_bytes(plan_picture(plan))
        write_json(directory / NAMES[2], as_json(plan, paths))
        for path in paths:
            move_into_place(directory / path.name, path)
    return paths
