"""The corrections of a run, ``labels/corrections.parquet``: rows are added, none is ever changed or removed."""

from __future__ import annotations

import random
import time
import uuid
from collections.abc import Callable
from pathlib import Path

from fwclass.errors import LockedError, StoreError, system_error
from fwclass.formats.echo_labels import MOST_BYTES, MOST_ROWS, EchoLabels, echo_labels_bytes, read_echo_labels
from fwclass.paths import below
from fwclass.store.atomic import write_bytes
from fwclass.store.bucket import Remote
from fwclass.store.directory import ANY
from fwclass.store.lock import Lock, writer
from fwclass.store.objects import Mark
from fwclass.store.refusals import LostRace
from fwclass.store.run_location import RunLocation, address_of
from fwclass.store.url import Url

CORRECTIONS = "labels/corrections.parquet"
"""Below the run's address."""
WRITING = Lock(
    "corrections.lock",
    "another process is writing corrections to this run",
    "try again when it has ended",
    "process",
    "nothing is written",
)
PATIENCE = 20.0
"""s, that a writer waits for others: each has the file for some tenths of a second."""

Change = Callable[[EchoLabels], EchoLabels]


def place_of(location: RunLocation) -> Path | Url:
    """Where the corrections of a run lie, whether or not there are any."""
    return address_of(location) / CORRECTIONS


def read_corrections(location: RunLocation) -> EchoLabels:
    """Every row, in the order in which they were added; none where nothing was ever corrected.

    `InputError`: the file is damaged, or larger than any that this program writes.
    """
    return _read(location)[0]


def add_corrections(location: RunLocation, change: Change) -> EchoLabels:
    """Add the rows that `change` makes of those that are there; these are returned, once they are on the disk.

    Nothing comes between what `change` sees and what is written: of two writers at the same time one waits for the
    other (a directory), or sees what the other wrote (a bucket) and is asked again. Without rows nothing is written.

    `StoreError`: the place cannot be written to, or another writer does not end. `InputError`: the file that is there
    is damaged, or would have too many rows.
    """
    until = time.monotonic() + PATIENCE
    while True:
        try:
            if isinstance(location, Remote):
                return _add(location, change)
            with writer(location, WRITING):
                return _add(location, change)
        except (LostRace, LockedError):
            if time.monotonic() > until:
                raise
            time.sleep(0.05 + 0.1 * random.random())  # noqa: S311 - no secret
        except OSError as fault:
            raise _not_written(location, fault) from fault


def check_writable(location: RunLocation) -> None:
    """`StoreError` where corrections could not be added; for who is to know before the first one is drawn."""
    try:
        if isinstance(location, Remote):
            key = f"labels/.{uuid.uuid4().hex}"
            location.objects.put(key, b"")
            location.objects.delete([key])
            return
        labels = below(location, CORRECTIONS).parent
        beside = (labels if labels.exists() else location) / f".{uuid.uuid4().hex}"
        write_bytes(beside, b"")
        beside.unlink()
    except OSError as fault:
        raise _not_written(location, fault) from fault


def _read(location: RunLocation) -> tuple[EchoLabels, Mark | None]:
    where = place_of(location)
    if isinstance(location, Remote):
        sizes = [item.size for item in location.objects.list("labels") if item.key == CORRECTIONS]
        if sizes and sizes[0] > MOST_BYTES:
            raise StoreError(
                "the corrections are larger than any that are written here",
                where=where,
                expected=f"at most {MOST_BYTES:,} bytes",
                got=f"{sizes[0]:,}",
                do="see who wrote it",
            )
        stored = location.objects.get(CORRECTIONS)
        if stored is None:
            return EchoLabels.none(), None
        return read_echo_labels(stored[0], where, signed=True), stored[1]
    path = location / CORRECTIONS
    return (read_echo_labels(path, where, signed=True), ANY) if path.is_file() else (EchoLabels.none(), None)


def _add(location: RunLocation, change: Change) -> EchoLabels:
    before, mark = _read(location)
    new = change(before)
    if not new.rows:
        return new
    if before.rows + new.rows > MOST_ROWS:
        raise StoreError(
            "the run has too many corrections",
            where=place_of(location),
            expected=f"at most {MOST_ROWS:,} rows",
            got=f"{before.rows:,}, and {new.rows:,} more",
            do="where so much is wrong, label a training area instead (docs/labels.md)",
        )
    data = echo_labels_bytes(EchoLabels.joined([before, new]))
    if not isinstance(location, Remote):
        write_bytes(below(location, CORRECTIONS), data)
    elif mark is None:
        location.objects.put_new(CORRECTIONS, data)
    else:
        location.objects.put_over(CORRECTIONS, data, mark)
    return new


def _not_written(location: RunLocation, fault: OSError) -> StoreError:
    return StoreError(
        "corrections cannot be written here",
        where=place_of(location),
        expected="a directory that can be written to",
        got=system_error(fault).what,
        do="copy the run to a disk that can be written to, or ask for the right to write there",
    )
