"""One writer per run directory."""

from __future__ import annotations

import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fwclass.errors import StoreError


@contextmanager
def writer(root: Path) -> Iterator[None]:
    """Hold the run directory `root`; a second writer gets a `StoreError` naming the first one's host and pid.

    The lock is the kernel's (`flock`) and goes with the process that held it, so none is left behind by a crash.
    """
    path = root / "store" / "lock"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            stream.seek(0)
            raise StoreError(
                "another run is writing to this directory",
                where=root,
                got=stream.read(200) or "unknown holder",
                do="wait for it to end, or choose another --out",
            ) from None
        stream.seek(0)
        stream.truncate()
        stream.write(json.dumps({"host": socket.gethostname(), "pid": os.getpid()}))
        stream.flush()
        try:
            yield
        finally:
            stream.seek(0)
            stream.truncate()
