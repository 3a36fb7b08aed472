"""What every attempt at a part took and said: ``logs/<stage>/<part>.log``, one `key=value` line an attempt.

Logs explain and decide nothing: a part is done by its receipt alone. A log that cannot be written is left.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from fwclass.errors import InputError, StoreError
from fwclass.paths import below, open_below
from fwclass.store.bucket import Remote
from fwclass.store.run_location import RunLocation, address_of
from fwclass.store.url import Url

LIMIT = 64 * 1024
"""Bytes of a log; beyond them its older half is dropped."""

LONGEST = 16 * 1024
"""Characters of a value; the rest of a longer one is left out."""

Value = str | int | float | None
_BARE = re.compile(r"[\w./:@%+,()\[\]-]+", re.ASCII)


def log_path(location: RunLocation, stage: str, part: str) -> Path | Url:
    """Where the log of a part lies."""
    return address_of(location) / "logs" / stage / f"{part}.log"


def log_attempt(location: RunLocation, stage: str, part: str, fields: Mapping[str, Value]) -> None:
    """Append one attempt at a part to its log: when (UTC), stage, part, host, pid, and `fields`.

    The one place that knows where logs go; it is called where the work was done, on a worker. On object storage, where
    nothing can be appended, the last attempt's line stays.
    """
    when = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    who: dict[str, Value] = {"stage": stage, "part": part, "host": socket.gethostname(), "pid": os.getpid()}
    text = line({"when": when, **who, **fields})
    if isinstance(location, Remote):
        with contextlib.suppress(StoreError):
            location.objects.put(f"logs/{stage}/{part}.log", text.encode())
        return
    with contextlib.suppress(OSError, InputError):  # no log through a link to elsewhere
        name = f"logs/{stage}/{part}.log"
        try:
            _append(location, name, text)
        except FileNotFoundError:
            below(location, name).parent.mkdir(parents=True, exist_ok=True)
            _append(location, name, text)


def remove_logs(location: RunLocation, parts: Iterable[tuple[str, str]]) -> None:
    """The logs of `parts` (stage and part) go; what cannot be removed is left."""
    for stage, part in parts:
        if isinstance(location, Remote):
            with contextlib.suppress(StoreError):
                location.objects.delete([f"logs/{stage}/{part}.log"])
        else:
            with contextlib.suppress(OSError, InputError):
                below(location, f"logs/{stage}/{part}.log").unlink()


def _append(root: Path, name: str, text: str) -> None:
    path = root / name
    with os.fdopen(open_below(root, name, os.O_WRONLY | os.O_APPEND | os.O_CREAT), "ab") as stream:
        stream.write(text.encode())
        size = stream.tell()
    if size > LIMIT:
        end = path.read_bytes()[-LIMIT // 2 :]
        beside = path.with_name(f".{path.name}.{os.getpid()}")
        beside.write_bytes(end[end.find(b"\n") + 1 :] or text.encode())
        beside.replace(path)


def line(fields: Mapping[str, Value]) -> str:
    """One line of `key=value`, as logfmt has it; None is left out."""
    return " ".join(f"{key}={_value(v)}" for key, v in fields.items() if v is not None) + "\n"


def _value(value: Value) -> str:
    """Bare where nothing in it could be misread, else in double quotes with escapes as in JSON."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    if _BARE.fullmatch(text):
        return text
    text = text if len(text) <= LONGEST else text[: LONGEST // 2] + " […] " + text[-LONGEST // 2 :]
    text = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else _escape(c) for c in text) + '"'


def _escape(c: str) -> str:
    escapes = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}
    return escapes.get(c) or (f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}")
