"""What `street run` and `street classify` leave in their directory."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from fwclass.errors import ConfigError
from fwclass.publish.files import sweep, written_whole
from fwclass.publish.street_pictures import draw_prescription
from fwclass.street.answers import ANSWERS
from fwclass.street.prescription import Segment
from fwclass.street.prescription_map import write_map

SUMMARY, CSV, MAP, PICTURE = "summary.json", "prescription.csv", "prescription.parquet", "prescription.png"
OURS = (ANSWERS, SUMMARY, CSV, MAP, PICTURE)

HEAD = ",".join(Segment.names()) + "\n"


@contextmanager
def working_in(target: Path, overwrite: bool) -> Iterator[None]:
    """Make the directory, without outputs of earlier, and hold it until the block ends.

    `ConfigError`: something is there that is not to be replaced, or another command is writing there.
    """
    if target.exists() and not target.is_dir():
        raise _something_else(target)
    target.mkdir(parents=True, exist_ok=True)
    handle = os.open(target, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                "another command is writing to this directory", where=target, do="name another, or wait for it to end"
            ) from None
        except OSError:  # there are file systems without locks
            pass
        _prepare(target, overwrite)
        with TemporaryFile(dir=target):  # before all work: it may be no place to write to
            pass
        yield
    finally:
        os.close(handle)


def _prepare(target: Path, overwrite: bool) -> None:
    for name in OURS:
        sweep(target / name)
    there = list(target.iterdir())
    if any(p.name not in OURS or not p.is_file() for p in there):
        raise _something_else(target)
    if there and not overwrite:
        raise ConfigError("there is an output already", where=target, do="name another, or add --overwrite")
    for path in there:
        path.unlink()


def _something_else(target: Path) -> ConfigError:
    return ConfigError(
        "something else is there",
        where=target,
        expected="a new directory, or one of this command",
        do="name another; it is not replaced",
    )


def finish(target: Path, segments: Iterable[Segment] | None, summary: dict[str, Any]) -> dict[str, Any]:
    """Write map, picture and summary, each whole; return the summary with the number of segments.

    `segments`: those of the CSV file, None where it is there already.
    """
    if segments is not None:
        with written_whole(target / CSV) as beside, beside.open("w") as file:
            file.write(HEAD)
            file.writelines(s.line() + "\n" for s in segments)
    held = read_segments(target)
    with written_whole(target / MAP) as beside:
        write_map(beside, held)
    picture = draw_prescription(held)
    with written_whole(target / PICTURE) as beside:
        beside.write_bytes(picture)
    summary = {**summary, "segments": len(held)}
    with written_whole(target / SUMMARY) as beside:
        beside.write_text(json.dumps(summary, indent=1) + "\n")
    return summary


def read_segments(target: Path) -> list[Segment]:
    """The segments of the CSV file, as they were rounded there."""
    kinds = [str, *[float] * 6, int, *[float] * 5]
    lines = (target / CSV).read_text().splitlines()[1:]
    return [Segment(*(k(v) for k, v in zip(kinds, line.split(","), strict=True))) for line in lines]
