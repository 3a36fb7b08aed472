"""A writer among others: runs the small graph again and again on one place, and notes what it was told."""

from __future__ import annotations

import json
import os
import random
import sys
import time
from pathlib import Path

from objectstore import quick
from smallgraph import run

from fwclass.errors import FwclassError
from fwclass.store.bucket import Remote
from fwclass.store.url import Url

BEAT, DEAD = 0.1, 0.6
"""s between two beats of the lock, and until a silent holder is given up."""


def main(who: str, place: str, source: str, notes: str, seconds: str) -> None:
    rng, k = random.Random(who), 0  # noqa: S311
    location = Remote(Url(place), quick(beat=BEAT, dead=DEAD, patience=3.0))
    ends = time.monotonic() + float(seconds)
    with Path(notes).open("w") as stream:
        while time.monotonic() < ends:
            k, text = k + 1, f"{who}{k:03d}."
            try:
                failed = run(location, Path(source), rng.choice(("ab", "ac", "abc")), text)
                told = "acknowledged" if not failed else failed[0].splitlines()[0]
            except FwclassError as fault:
                told = fault.what
            stream.write(json.dumps({"text": text, "told": told}) + "\n")
            stream.flush()
            time.sleep(rng.uniform(0, 0.3))


if __name__ == "__main__":
    main(*sys.argv[1:])
    os._exit(0)
