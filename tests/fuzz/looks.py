"""What a notebook and the viewer ask of a run, one after the other."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial

IDENTITY = "strip", "pulse", "echo_number"
SOME = (13507, 0, 1)
"""Who is asked for where the echoes cannot be read."""


def look() -> None:
    """Ask the run ``r``; ends with 1 where any of it is refused in words, and with whatever else comes."""
    import fwclass
    from fwclass import conf
    from fwclass.delivery.opened import open_run
    from fwclass.delivery.viewed import ViewedRun
    from fwclass.errors import FwclassError
    from fwclass.view.scene import ECHOES

    faults: list[FwclassError] = []

    def asked(work: Callable[[], object]) -> object:
        try:
            return work()
        except FwclassError as fault:
            faults.append(fault)
            return None

    def scene(*settings: str) -> None:
        shown = ViewedRun(open_run("r"), conf.section("view", ("view.block=1000", *settings)))
        index = shown.index()
        for level in shown.pyramid.levels():
            asked(partial(shown.level, ECHOES, level))
        for column in index["columns"][:4]:
            asked(partial(shown.scale, column["name"]))
        asked(partial(shown.pulse, *who[:2]))
        asked(partial(shown.why, *who))
        asked(shown.work)

    run = asked(partial(fwclass.open, "r"))
    if run is not None:
        row = asked(lambda: run.echoes(columns=IDENTITY).to_arrow().slice(7, 1).to_pylist()[0])
        who = tuple(row[n] for n in IDENTITY) if row else SOME
        for name in ("report", "tiles", "crs", "classes"):
            asked(lambda name=name: getattr(run, name))
        asked(lambda: run.echoes().to_pandas())
        asked(lambda: run.raster("dtm"))
        asked(lambda: run.waveform(*who[:2]))
        asked(lambda: run.explain(who))
        asked(scene)
        asked(lambda: scene("view.whole=1000"))
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)
