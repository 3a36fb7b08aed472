"""A whole run from Python, as the command does it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from fwclass.delivery.opened import Delivery, open_run
from fwclass.errors import FwclassError

BELOW_QUALITY = 4
"""Exit code of a delivery that is there and not as good as was asked."""


def process(
    survey: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    workers: int | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Delivery:
    """Run a survey in a process of its own, and open what it delivers; run again, only what changed is made.

    Parameters
    ----------
    survey : a survey's YAML file, or the name of one that is shipped.
    out : the run directory.
    workers : processes; None takes the configuration's number, 0 the plain loop.
    settings : values by dotted key, for example ``{"ground.max_building_size": 60}``.

    `FwclassError`: the run failed; its last words say why. A quality below the bound is no failure: `Delivery.report`
    tells it.
    """
    command = [sys.executable, "-m", "fwclass", "run", os.fspath(survey), "--out", os.fspath(out)]
    command += ["--workers", str(workers)] if workers is not None else []
    for key, value in (settings or {}).items():
        command += ["--set", f"{key}={yaml.safe_dump(value, default_flow_style=True).splitlines()[0]}"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - words, no shell
    if ended.returncode not in (0, BELOW_QUALITY):
        raise FwclassError(
            "the run failed",
            where=Path(out),
            got=f"exit {ended.returncode}: " + "\n".join(ended.stderr.strip().splitlines()[-12:]),
            do="mend the cause and run again; what is done is kept",
        )
    return open_run(out)
