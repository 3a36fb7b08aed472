"""A plan of 10 000 km² by headers alone, in a process of its own: ``planning_scale.py DIR`` prints what it took."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from pyproj import CRS

from fwclass import conf
from fwclass.grid import Box
from fwclass.memory import peak_mib
from fwclass.operate.estimate.forecast import make_forecast
from fwclass.operate.estimate.headers import SourceFacts, SurveyFacts
from fwclass.operate.estimate.limits import Room
from fwclass.operate.estimate.output import write_plan
from fwclass.workflows import workflow_of

begin = workflow_of("classification").begin

STRIPS, PIECES, EDGE = 250, 40, 100_000.0
"""Flight lines 400 m apart that overlap by half, in files of 2.5 km."""


def headers() -> tuple[SourceFacts, ...]:
    wide, long = EDGE / STRIPS, EDGE / PIECES
    return tuple(
        SourceFacts(
            Path(f"{s:03d}_{p:02d}.las"),
            10_000_000,
            0,
            True,
            800_000_000,
            Box(4e5 + (s - 0.25) * wide, 5.3e6 + p * long, 4e5 + (s + 1.25) * wide, 5.3e6 + (p + 1) * long),
        )
        for s in range(STRIPS)
        for p in range(PIECES)
    )


def main(directory: Path) -> None:
    began = time.perf_counter()
    # all of it tested, figures and objects of 10^11 echoes are one part of 33 h, longer than a part may take by default
    settings = "tile.size=316", "areas.train=[[450000, 5350000, 450100, 5350100]]", "run.part_hours=36"
    config = conf.load("city-1200m", settings)
    facts = SurveyFacts(headers(), (), CRS.from_epsg(25832).to_wkt(), None)
    plan = make_forecast(begin(config), facts, 64, Room(64 * 16_000.0, 1e15))
    paths = write_plan(plan, directory)
    told = {
        "cpu_seconds": time.process_time(),
        "seconds": time.perf_counter() - began,
        "tiles": plan.tiles.number,
        "points": float(plan.counts.points.sum()),
        "peak_mib": peak_mib(),
        "fits": plan.fits,
        "bytes": [p.stat().st_size for p in paths],
    }
    sys.stdout.write(json.dumps(told))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
