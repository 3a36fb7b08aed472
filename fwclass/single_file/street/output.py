"""What `street run` and `street classify` leave in their directory."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from fwclass.errors import ConfigError
from fwclass.publish.files import whole
from fwclass.publish.street_pictures import draw_prescription
from fwclass.street.answers import ANSWERS
from fwclass.street.prescription import Segment
from fwclass.street.prescription_map import write_map

SUMMARY, CSV, MAP, PICTURE = "summary.json", "prescription.csv", "prescription.parquet", "prescription.png"
OURS = (ANSWERS, SUMMARY, CSV, MAP, PICTURE)

HEAD = ",".join(Segment.names()) + "\n"


def prepare(target: Path, overwrite: bool) -> None:
    """Make the directory; `ConfigError` where something is there that is not to be replaced."""
    if target.exists():
        if not target.is_dir() or any(p.name not in OURS for p in target.iterdir()):
            raise ConfigError(
                "something else is there",
                where=target,
                expected="a new directory, or one of this command",
                do="name another; it is not replaced",
            )
        if any(target.iterdir()) and not overwrite:
            raise ConfigError("there is an output already", where=target, do="name another, or add --overwrite")
        shutil.rmtree(target)
    target.mkdir(parents=True)


def finish(target: Path, segments: Iterable[Segment] | None, summary: dict[str, Any]) -> dict[str, Any]:
    """Write map, picture and summary, each whole; return the summary with the number of segments.

    `segments`: those of the CSV file, None where it is there already.
    """
    if segments is not None:
        with whole(target / CSV) as beside, beside.open("w") as file:
            file.write(HEAD)
            file.writelines(s.line() + "\n" for s in segments)
    held = read_segments(target)
    with whole(target / MAP) as beside:
        write_map(beside, held)
    picture = draw_prescription(held)
    with whole(target / PICTURE) as beside:
        beside.write_bytes(picture)
    summary = {**summary, "segments": len(held)}
    with whole(target / SUMMARY) as beside:
        beside.write_text(json.dumps(summary, indent=1) + "\n")
    return summary


def read_segments(target: Path) -> list[Segment]:
    """The segments of the CSV file, as they were rounded there."""
    kinds = [str, *[float] * 6, int, *[float] * 5]
    lines = (target / CSV).read_text().splitlines()[1:]
    return [Segment(*(k(v) for k, v in zip(kinds, line.split(","), strict=True))) for line in lines]
